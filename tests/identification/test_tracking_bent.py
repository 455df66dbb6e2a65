"""Tracking a rig with a bow or run-out: from an independent world's point, against what is true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.worlds import Effects, Spread, World, draw_world, record
from daq.signals.run import Run
from dynamics import RotorParameters
from identification.tracking.phase_clock import PhaseClock
from identification.tracking.replay import TrackedRun, track
from identification.tracking.run_out import without_run_out

SEED, POINT = 1000, "point-E"
ALIGNED = Spread(zero_deg=0.0, index_deg=0.0, axis_deg=0.0, gain=0.0, clock_ppm=0.0)


def shortened(run: Run, until_s: float) -> Run:
    x, y, a, m = (t < until_s for t in (run.x_time_s, run.y_time_s, run.angle_time_s, run.mark_time_s))
    return replace(
        run,
        x_time_s=run.x_time_s[x],
        x_m=run.x_m[x],
        y_time_s=run.y_time_s[y],
        y_m=run.y_m[y],
        angle_time_s=run.angle_time_s[a],
        angle_rad=run.angle_rad[a],
        mark_time_s=run.mark_time_s[m],
        mark_phase_rad=run.mark_phase_rad[m],
    )


def true_physics(world: World, bow: bool) -> RotorParameters:
    m = world.mechanics
    b = m.bow_m * np.exp(1j * m.bow_rad)
    physics = world.rig.physics.with_values(**world.truth)
    return replace(physics, bow_x_m=float(b.real), bow_y_m=float(b.imag)) if bow else physics


def off(found: TrackedRun, world: World) -> list[float]:
    """Tracked minus true of ln c3, ln c4 in the tracker's standard deviations."""
    last = found.last
    return [float(np.log(v / world.truth[n]) / (last.std[n] / v)) for n, v in last.values.items()]


def test_a_point_of_a_bent_shaft_is_followed_with_its_bow_alone() -> None:
    world = draw_world(SEED, effects=Effects(bow_m=1e-4))
    run = shortened(record(world, SEED, POINT, 12.0), 16.0)
    bent = track(run, true_physics(world, bow=True), imbalance_std=1e-3)
    assert bent.last.trusted
    assert np.abs(off(bent, world)).max() < 2
    assert all(bent.last.std[n] < 0.1 * v for n, v in bent.last.values.items())
    straight = track(run, true_physics(world, bow=False), imbalance_std=1e-3)
    assert np.abs(off(straight, world)).max() > 5


@pytest.fixture(scope="module")
def out_of_round() -> tuple[World, Run, complex]:
    """Lasers along the springs without offset, of a target that is not centred; run-out common to both."""
    world = draw_world(SEED, ALIGNED, Effects(runout_m=1e-4))
    straight = record(replace(world, effects=Effects()), SEED, POINT, 12.0)
    run = record(world, SEED, POINT, 12.0)
    locked = run.x_time_s < run.mark_time_s[-1]
    psi = np.interp(run.x_time_s[locked], run.mark_time_s, run.mark_phase_rad)
    seen = (run.x_m - straight.x_m)[locked]
    r = 2 * np.mean(seen * np.exp(-1j * psi))
    assert abs(r) == pytest.approx(1e-4, rel=0.01)
    # the offsets: what the lasers show on average over the late, even part
    late = run.x_time_s > run.x_time_s[-1] - 2.0
    even = replace(run, x_m=run.x_m - run.x_m[late].mean(), y_m=run.y_m - run.y_m[late].mean())
    return world, shortened(even, 16.0), complex(r)


def test_run_out_is_taken_off_the_lasers(out_of_round: tuple[World, Run, complex]) -> None:
    world, run, r = out_of_round
    round_ = track(run, true_physics(world, bow=False), imbalance_std=1e-3, laser_run_out_m=(r, r))
    assert np.abs(off(round_, world)).max() < 2
    shown = track(run, true_physics(world, bow=False), imbalance_std=1e-3, laser_run_out_m=(0j, 0j))
    x = [np.sqrt(np.mean(f.states[-40:, :2] ** 2)) for f in (round_, shown)]
    assert x[1] > x[0] + 1e-5  # balanced: what the filter takes for motion is the surface's
    assert np.abs(off(shown, world)).max() > 2


def test_without_marks_nothing_is_taken_off() -> None:
    rows = np.array([[0.0, 0.0, 1e-3, 1.0], [0.0, 1.0, 2e-3, 1.0], [0.0, 2.0, 0.3, 1.0]])
    clock = PhaseClock()
    assert np.array_equal(without_run_out(rows, clock, (1e-4 + 0j, 1e-4j)), rows)
    clock.feed(np.array([0.0, 1.0]), np.array([0.5 * np.pi, 2.5 * np.pi]))
    # e^{iψ} = i: Re(r_x i) = −Im r_x = 0, Im(r_y i) = Re r_y = 0
    assert without_run_out(rows, clock, (1e-4 + 0j, 1e-4j)) == pytest.approx(rows)
    there = without_run_out(rows, clock, (1e-4j, 1e-4 + 0j))
    assert there[:, 2] == pytest.approx([1e-3 + 1e-4, 2e-3 - 1e-4, 0.3])

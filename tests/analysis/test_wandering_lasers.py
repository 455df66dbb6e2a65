"""Points whose lasers wander or hum: settled by the motion, judged against the noise that is there, and named."""

import dataclasses
import math

import numpy as np
import pytest
from analysis_runs import Drawn, point_run

from analysis import validate
from analysis.steady_state import measure
from analysis.to_come import UNEXPLAINED
from daq.signals.run import Run
from rig_configs import Rig

SETTLED_S = {"A": 45.0, "B": 50.0}
WANDER_M = 1e-5


@pytest.fixture(scope="module")
def quiet(rig: Rig, drawn: Drawn) -> dict[str, Run]:
    return {name: point_run(rig, name, drawn=drawn, after_s=after) for name, after in SETTLED_S.items()}


def wandering(run: Run, seed: int) -> Run:
    """The run with 1/f noise from 0.02 Hz on, 10 µm rms, on both lasers."""
    rng = np.random.default_rng([seed, 11])
    shown = []
    for time, value in ((run.x_time_s, run.x_m), (run.y_time_s, run.y_m)):
        frequency = np.fft.rfftfreq(len(time), float(np.median(np.diff(time))))
        shape = np.where(frequency >= 0.02, np.maximum(frequency, 0.02) ** -0.5, 0.0)
        noise = np.fft.irfft(
            shape * (rng.standard_normal(len(shape)) + 1j * rng.standard_normal(len(shape))), len(time)
        )
        shown.append(value + WANDER_M * noise / noise.std())
    return dataclasses.replace(run, x_m=shown[0], y_m=shown[1])


def test_wandering_lasers_leave_the_verdicts(rig: Rig, drawn: Drawn, quiet: dict[str, Run]) -> None:
    for seed in range(3):
        runs = [wandering(run, seed) for run in quiet.values()]
        found = validate(runs, rig, drawn.identified, drawn.axis_angle_deg)
        assert {n: p.verdict for n, p in found.points.items()} == {"A": "pass", "B": "pass"}, seed
        named = [w for w in found.warnings if "wanders" in w and "µm rms below 1 Hz" in w]
        assert len(named) == len(found.warnings) == 4  # each laser once per log


def test_quiet_lasers_are_not_named(rig: Rig, drawn: Drawn, quiet: dict[str, Run]) -> None:
    assert validate(list(quiet.values()), rig, drawn.identified, drawn.axis_angle_deg).warnings == []


def test_intervals_of_the_orbit_are_wider_and_those_of_the_angles_are_not(rig: Rig, quiet: dict[str, Run]) -> None:
    for run in quiet.values():
        before, after = measure(run, rig), measure(wandering(run, 0), rig)
        assert after.noise_x_m > 4 * before.noise_x_m
        for was, now in zip(before.theta_rad, after.theta_rad, strict=True):
            assert now.std < 1.1 * was.std + math.radians(0.002)
            assert now.value == pytest.approx(was.value, abs=math.radians(0.01))


def test_the_orbit_is_off_by_what_is_stated(rig: Rig, quiet: dict[str, Run]) -> None:
    """Vectors with wander less those without, over the stated deviations."""
    off = []
    for run in quiet.values():
        before = measure(run, rig)
        for seed in range(4):
            after = measure(wandering(run, seed), rig)
            assert after.to_come.model != UNEXPLAINED
            std = np.sqrt(np.diag(after.to_come.covariance))[2:]
            change = [after.x_m - before.x_m, after.y_m - before.y_m]
            off += list(np.array([part for c in change for part in (c.real, c.imag)]) / std)
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.4


def test_hum_is_named_and_leaves_the_verdict(rig: Rig, drawn: Drawn, quiet: dict[str, Run]) -> None:
    run = quiet["B"]
    hum = 5e-5 * np.sin(2 * np.pi * 50.0 * run.x_time_s) + 2e-5 * np.sin(2 * np.pi * 100.0 * run.x_time_s + 1.0)
    humming = dataclasses.replace(run, x_m=run.x_m + hum)
    clean, seen = measure(run, rig), measure(humming, rig)
    assert abs(seen.x_m - clean.x_m) < 0.05e-6  # 0.4 µm leaks into a window where the line stays in
    assert seen.noise_x_m < 1.2 * clean.noise_x_m
    found = validate([humming], rig, drawn.identified, drawn.axis_angle_deg)
    assert found.points["B"].verdict == "pass"
    assert len(found.warnings) == 1
    assert (
        "laser x shows steady lines at 50.00 Hz, 50 µm: mains hum?; 100.00 Hz, 20 µm: mains hum?" in found.warnings[0]
    )

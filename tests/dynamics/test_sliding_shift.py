"""Dry friction under a wobble: the shift it makes, against the independent laboratory's motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.worlds import Spread, draw_world
from benchmarks.worlds.motion import Mechanics, Turning, moved
from dynamics import SpeedHistory, steady_states
from dynamics.motions.integrate import fastest_rate, integrate
from dynamics.steady.sliding_shift import sliding_shift

SHARE = 2e-3  # of c · 12 rad/s: the first order is enough


def settled(mechanics: Mechanics, speed: float, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean angles and order-1 amplitudes over the last twenty revolutions."""
    times = np.arange(0, 60.0, 2 * np.pi / speed / 64)
    late = moved(mechanics, Turning.steady(0.0, speed), times, start, True)[-64 * 20 :]
    turn = np.exp(-1j * speed * times[-64 * 20 :])
    return late[:, 2:4].mean(axis=0), 2 * (late[:, :2] * turn[:, None]).mean(axis=0)


def test_a_wobbling_pair_is_moved_as_the_independent_motion_moves() -> None:
    world = draw_world(0, Spread.exact())
    p, smooth = world.rig.physics.with_values(**world.truth), world.mechanics
    speed = p.speed_rad_s(world.rig.points["A"].speed_ratio)
    state = next(s for s in steady_states(p, speed, 1e-6) if s.stable)
    torque = SHARE * 12 * np.array([smooth.a.damping_Nms_per_rad, 0.7 * smooth.b.damping_Nms_per_rad])
    a, b = (replace(m, dry_Nm=t) for m, t in zip((smooth.a, smooth.b), torque.tolist(), strict=True))
    rough = replace(smooth, a=a, b=b)
    start = np.asarray(state.start, np.float64)
    history = SpeedHistory.constant(speed)

    def motion(y: np.ndarray, times: np.ndarray) -> np.ndarray:
        step = 0.03 / fastest_rate(p, speed)
        return integrate(y, times, step, history.knots_s, history.coefficients, p.packed(), 1.0, 1.0)

    angles, orbit = (r - s for r, s in zip(settled(rough, speed, start), settled(smooth, speed, start), strict=True))
    found = sliding_shift(p, speed, start, motion, torque)
    assert np.real(found[:2]) == pytest.approx(angles, rel=0.05)
    assert abs(found[2] - orbit[0]) < 0.05 * abs(orbit[0])
    assert np.all(np.abs(angles) > 3e-4)


def test_pendulums_at_rest_on_the_rotor_are_not_moved() -> None:
    world = draw_world(0, Spread.exact())
    p = world.rig.physics.with_values(**world.truth)
    found = sliding_shift(p, 30.0, np.zeros(8), lambda _, times: np.zeros((len(times), 8)), np.full(2, 1e-4))
    assert np.all(found == 0)

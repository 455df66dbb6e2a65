# pyright: strict
"""Where repeated start-ups from rest end: pendulums or balls free from the start, anywhere at first.

A machine with a passive balancer starts with balls or pendulums wherever the last run-down has left them. Without dry
friction every start-up ends in the same steady state (or its mirror image). With friction it ends where the motion
died out within the band that friction holds (dynamics.steady.stick_band), elsewhere from elsewhere.

Source: docs/theory/start_ups.md.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.equations.parameters import RotorParameters
from dynamics.equations.scene import Scene
from dynamics.equations.speed_history import SpeedHistory
from dynamics.errors import NotConverged, OutsideDomain
from dynamics.motions.friction_steps import fixed_states
from dynamics.motions.integrate import simulate

Array = NDArray[np.float64]

ACCURACY = 1e-3
"""Of a followed motion: of angles in rad. Where it ends is wanted, not how it gets there."""
_PER_TURN = 64
_LOOK_S = 1.0
_STEP_S = 125e-6


@dataclass(frozen=True)
class StartUpEnds:
    """Ends of start-ups from rest.

    Attributes:
        start_rad: θ3, θ4 at rest, shape (n, 2).
        theta_rad: mean over the last revolution, in [0, 2π), shape (n, 2).
        amplitude_m: order-1 amplitudes along x and y in the last revolution, shape (n, 2).
        drift_rad: how far the mean angles have moved in the last second, the larger one, shape (n,).
        followed: whether the path is known to ACCURACY, shape (n,). Balls that run around while the rotor passes its
            resonance separate so fast from their neighbours that no arithmetic follows them; the path is then one of
            those that neighbours take, by fixed steps.
    """

    start_rad: Array
    theta_rad: Array
    amplitude_m: Array
    drift_rad: Array
    followed: NDArray[np.bool_]


def start_ups_from_rest(
    parameters: Sequence[RotorParameters],
    speed: float,
    ramp_s: float,
    start_rad: Array,
    settle_s: float = 30.0,
    progress: Callable[[int, int], None] | None = None,
) -> StartUpEnds:
    """Start-ups from rest to a speed, pendulums or balls free.

    Args:
        parameters: of each start-up.
        speed: reached, rad/s.
        ramp_s: for how long the rotor speeds up, evenly, s.
        start_rad: θ3, θ4 at rest, shape (n, 2).
        settle_s: how long it then turns, s.
        progress: called with (start-ups done, all).
    Raises:
        OutsideDomain: counts that do not match, or a speed or time not above 0.
    """
    starts = np.asarray(start_rad, np.float64)
    if starts.shape != (len(parameters), 2):
        raise OutsideDomain(f"start_rad: expected shape ({len(parameters)}, 2), a row a start-up, got {starts.shape}")
    for name, value in (("speed", speed), ("ramp_s", ramp_s), ("settle_s", settle_s)):
        if not (math.isfinite(value) and value > 0):
            raise OutsideDomain(f"{name} must be finite and above 0, got {value!r}")
    history = SpeedHistory.ramp(0.0, speed, ramp_s)
    end, turn = ramp_s + settle_s, 2 * math.pi / speed
    last = end - turn + turn / _PER_TURN * np.arange(1, _PER_TURN + 1)
    times = np.r_[0.0, max(ramp_s, last[0] - _LOOK_S), last]

    def one(i: int) -> tuple[Array, bool]:
        scene = Scene(history, (True, True), np.r_[0.0, 0.0, starts[i], np.zeros(4)])
        try:
            return np.asarray(simulate(parameters[i], scene, times, ACCURACY).state[1:], np.float64), True
        except NotConverged:
            return fixed_states(parameters[i], scene, times, _STEP_S)[1:], False

    states, followed = np.empty((len(starts), _PER_TURN + 1, 8)), np.zeros(len(starts), bool)
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        for i, (found, known) in enumerate(pool.map(one, range(len(starts)))):
            states[i], followed[i] = found, known
            if progress is not None:
                progress(i + 1, len(starts))
    mean = states[:, 1:, 2:4].mean(axis=1)
    wave = np.exp(-1j * history.phase(last)[:, 0])
    orders = 2 / _PER_TURN * np.einsum("ntk,t->nk", states[:, 1:, :2], wave)
    drift = np.abs(states[:, 0, 2:4] - mean).max(axis=1)
    return StartUpEnds(starts, mean % (2 * math.pi), np.abs(orders), drift, followed)


def random_starts(count: int, seed: int) -> Array:
    """Places at rest, evenly distributed, rad, shape (count, 2)."""
    return np.random.default_rng(seed).uniform(0.0, 2 * math.pi, (count, 2))

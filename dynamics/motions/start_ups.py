"""End states of repeated start-ups from rest, with pendulums or balls that are free from the start.

The start positions of balls or pendulums depend on the last run-down. Without dry friction every start-up ends in the
same steady state or its mirror image. With friction the end depends on the start: it is the position in the band held
by friction (dynamics.steady.stick_band) at which the motion has decayed.

Source: docs/theory/start_ups.md.
"""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array, Flags
from dynamics.equations.parameters import RotorParameters
from dynamics.equations.scene import Scene
from dynamics.equations.speed_history import SpeedHistory
from dynamics.errors import NotConverged, OutsideDomain
from dynamics.motions.friction_steps import fixed_states
from dynamics.motions.integrate import simulate
from rig_basics.tabular import Column, Tabular
from rig_basics.thread_pool import ThreadPool

_log = logging.getLogger(__name__)

ACCURACY = 1e-3
"""Accuracy of the simulated angles, rad. It is low because only the end state is used."""
_SAMPLES_PER_REVOLUTION = 64
_DRIFT_INTERVAL_S = 1.0
_STEP_S = 125e-6


@dataclass(frozen=True)
class StartUpEnds(Tabular):
    """End states of start-ups from rest.

    Attributes:
        start_rad: θ3, θ4 at rest, shape (n, 2).
        theta_rad: mean over the last revolution, in [0, 2π), shape (n, 2).
        amplitude_m: order-1 amplitudes along x and y in the last revolution, shape (n, 2).
        drift_rad: change of the mean angles in the last second, the larger one, shape (n,).
        followed: whether the motion was computed to ACCURACY, shape (n,). Neighbouring motions of balls that orbit
            while the rotor passes its resonance diverge too fast for any arithmetic. Such a motion is computed with
            fixed steps and is representative only.
    """

    start_rad: Array
    theta_rad: Array
    amplitude_m: Array
    drift_rad: Array
    followed: Flags

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each start-up."""
        names = "start3_rad", "start4_rad", "theta3_rad", "theta4_rad", "amplitude_x_m", "amplitude_y_m"
        found = np.concatenate([self.start_rad, self.theta_rad, self.amplitude_m], axis=1).T
        return dict(zip(names, found, strict=True)) | {"drift_rad": self.drift_rad, "followed": self.followed}


def start_ups_from_rest(
    parameters: Sequence[RotorParameters],
    speed: float,
    ramp_s: float,
    start_rad: Array,
    settle_s: float = 30.0,
    progress: Callable[[int, int], None] | None = None,
) -> StartUpEnds:
    """Simulate start-ups from rest to a speed, with free pendulums or balls.

    Args:
        parameters: parameters of each start-up.
        speed: final speed, rad/s.
        ramp_s: duration of the linear ramp, s.
        start_rad: θ3, θ4 at rest, shape (n, 2).
        settle_s: duration at the final speed, s.
        progress: called with (number of finished start-ups, number of all start-ups).
    Raises:
        OutsideDomain: the counts do not match, or the speed or a duration is not above 0.
    """
    starts = np.asarray(start_rad, np.float64)
    if starts.shape != (len(parameters), 2):
        raise OutsideDomain(f"start_rad: expected shape ({len(parameters)}, 2), a row a start-up, got {starts.shape}")
    for name, value in (("speed", speed), ("ramp_s", ramp_s), ("settle_s", settle_s)):
        if not (math.isfinite(value) and value > 0):
            raise OutsideDomain(f"{name} must be finite and above 0, got {value!r}")
    history = SpeedHistory.ramp(0.0, speed, ramp_s)
    end, turn = ramp_s + settle_s, 2 * math.pi / speed
    last = end - turn + turn / _SAMPLES_PER_REVOLUTION * np.arange(1, _SAMPLES_PER_REVOLUTION + 1)
    times = np.r_[0.0, max(ramp_s, last[0] - _DRIFT_INTERVAL_S), last]

    def one(i: int) -> tuple[Array, bool]:
        scene = Scene(history, (True, True), np.r_[0.0, 0.0, starts[i], np.zeros(4)])
        try:
            return np.asarray(simulate(parameters[i], scene, times, ACCURACY).state[1:], np.float64), True
        except NotConverged as error:
            _log.debug("start-up %d: fixed steps are used: %s", i, error)
            return fixed_states(parameters[i], scene, times, _STEP_S)[1:], False

    states, followed = np.empty((len(starts), _SAMPLES_PER_REVOLUTION + 1, 8)), np.zeros(len(starts), bool)
    with ThreadPool(os.cpu_count() or 1) as pool:
        for i, (found, is_accurate) in enumerate(pool.map(one, range(len(starts)))):
            states[i], followed[i] = found, is_accurate
            if progress is not None:
                progress(i + 1, len(starts))
    mean = states[:, 1:, 2:4].mean(axis=1)
    wave = np.exp(-1j * history.phase(last)[:, 0])
    orders = 2 / _SAMPLES_PER_REVOLUTION * np.einsum("ntk,t->nk", states[:, 1:, :2], wave)
    drift = np.abs(states[:, 0, 2:4] - mean).max(axis=1)
    return StartUpEnds(starts, mean % (2 * math.pi), np.abs(orders), drift, followed)


def random_starts(count: int, seed: int) -> Array:
    """Uniformly distributed start positions, rad, shape (count, 2).

    Example:
        >>> import numpy as np
        >>> from dynamics import Scene, SpeedHistory, locked_state, random_starts, simulate_batch
        >>> from rig_configs import load_rig
        >>> rig, history = load_rig("virtual").physics, SpeedHistory.constant(40.0)
        >>> states = locked_state(rig, 40.0, 0.0, *random_starts(3, seed=1).T)  # releases at any angle
        >>> scenes = [Scene(history, start=state) for state in states]
        >>> found = simulate_batch([rig] * 3, scenes, [0.0, 20.0], last_only=True)
        >>> np.sort(np.degrees(found.states[:, 0, 2:4]) % 360, axis=1).round(-1)
        array([[110., 250.],
               [110., 250.],
               [110., 250.]])
    """
    return np.random.default_rng(seed).uniform(0.0, 2 * math.pi, (count, 2))

"""Time against true error of the motion after a release, for every method and tolerance."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy.integrate

from dynamics.arrays import Array
from dynamics.bench import heyoka_runs
from dynamics.bench.heyoka_runs import Rig
from dynamics.bench.records import Measurement
from dynamics.bench.timing import median_seconds
from dynamics.equations.kernels import rates
from dynamics.equations.scene import Scene
from dynamics.equations.speed_history import SpeedHistory
from dynamics.errors import DynamicsError
from dynamics.motions.fixed_steps import integrate
from dynamics.motions.integrate import simulate
from dynamics.motions.locked_motion import locked_state
from dynamics.motions.motion_problem import motion_problem
from dynamics.motions.trajectory import run

_log = logging.getLogger(__name__)

_integrators: Any = scipy.integrate  # scipy has no annotations
SERVICE = "motion"
PLAY_RAD = (2e-3, -1e-3)
"""Angles of pendulums A and B at release relative to the locks at 0 and π, rad."""
_MAX_STEPS = 20_000_000
_MAX_USEFUL_ERROR_RAD = 1.0


def release(rig: Rig) -> Scene:
    """Scene at constant speed in which both pendulums are released from their locked positions."""
    parameters, speed = rig
    start = locked_state(parameters, speed, 0.0, PLAY_RAD[0], math.pi + PLAY_RAD[1])
    return Scene(SpeedHistory.constant(speed), start=start)


def motion_rows(
    case: str,
    rig: Rig,
    duration_s: float,
    tolerances: Sequence[float],
    accuracies: Sequence[float],
    peer_tolerances: Sequence[float],
    scipy_settings: Sequence[tuple[str, float]],
    repeats: int,
) -> list[Measurement]:
    """Rows of the project's integrators, of `simulate`, of fixed steps and of the peers.

    Args:
        tolerances: per step, for the explicit and the implicit method.
        accuracies: requested from dynamics.simulate.
        peer_tolerances: per step of heyoka.
        scipy_settings: (method, tolerance) of scipy's integrators.
    """
    scene = release(rig)
    start = np.array(scene.start)
    true = None
    if heyoka_runs.available():
        true = heyoka_runs.end_state(rig, start, duration_s, heyoka_runs.EXTENDED_TOLERANCE)
    bench = _Case(case, rig, scene, start, duration_s, true, repeats)
    rows: list[Measurement | None] = []
    for method in ("explicit", "implicit"):
        rows += [bench.own(method, tolerance) for tolerance in tolerances]
    rows += [bench.fixed(per_cycle) for per_cycle in (32, 128, 512, 2048)[: len(tolerances)]]
    rows += [bench.service(accuracy) for accuracy in accuracies]
    rows += [bench.scipy(method, tolerance) for method, tolerance in scipy_settings]
    if true is not None:
        rows += [bench.heyoka(tolerance) for tolerance in peer_tolerances]
    return [row for row in rows if row is not None and (row.true_error or 0.0) < _MAX_USEFUL_ERROR_RAD]


class _Case:
    """One release and its run by each method."""

    def __init__(
        self,
        name: str,
        rig: Rig,
        scene: Scene,
        start: Array,
        duration_s: float,
        true: Array | None,
        repeats: int,
    ) -> None:
        self.name, self.rig, self.scene, self.start = name, rig, scene, start
        self.times, self.true, self.repeats = np.array([0.0, duration_s]), true, repeats

    def _row(self, method: str, setting: str, end: Callable[[], Array], peer: bool = False) -> Measurement:
        state = end()
        error = None if self.true is None else heyoka_runs.angle_error(state, self.true)
        useful = error is None or error < _MAX_USEFUL_ERROR_RAD
        seconds = median_seconds(end, self.repeats) if useful else math.nan
        return Measurement(
            SERVICE, self.name, method, setting, seconds, "run", error if useful else math.inf, peer=peer
        )

    def own(self, method: str, tolerance: float) -> Measurement | None:
        """Integration at one tolerance, without the second run that bounds the error."""
        problem = motion_problem(self.rig[0], self.scene, self.times).problem
        try:
            return self._row(
                method,
                f"tolerance {tolerance:.0e}",
                lambda: run(problem, tolerance, method == "implicit", _MAX_STEPS).states[-1],
            )
        except DynamicsError as error:
            _log.info("%s, tolerance %.0e: left out of the table: %s", method, tolerance, error)
            return None

    def service(self, accuracy: float) -> Measurement | None:
        """dynamics.simulate with its error estimate."""
        try:
            motion = simulate(self.rig[0], self.scene, self.times, accuracy)
        except DynamicsError as error:
            _log.info("simulate, accuracy %.0e: left out of the table: %s", accuracy, error)
            return None
        seconds = median_seconds(lambda: simulate(self.rig[0], self.scene, self.times, accuracy), self.repeats)
        error = None if self.true is None else heyoka_runs.angle_error(motion.state[-1], self.true)
        return Measurement(
            SERVICE,
            self.name,
            f"automatic: {motion.method}",
            f"accuracy {accuracy:.0e}",
            seconds,
            "run",
            error,
            motion.error_estimate,
            automatic=True,
            accuracy=accuracy,
            chosen=(motion.method,),
        )

    def fixed(self, per_cycle: int) -> Measurement:
        """Classical Runge–Kutta with a number of steps per cycle of the fastest of resonances and running speed."""
        parameters, speed = self.rig
        step = 2 * math.pi / max(*parameters.natural_frequencies_rad_s, speed) / per_cycle
        history, packed = self.scene.history, parameters.packed()
        return self._row(
            "fixed steps (RK4)",
            f"{per_cycle} a cycle",
            lambda: integrate(self.start, self.times, step, history.knots_s, history.coefficients, packed, 1.0, 1.0)[
                -1
            ],
        )

    def scipy(self, method: str, tolerance: float) -> Measurement:
        """scipy's integrator with the compiled right-hand side."""
        packed, speed, out = self.rig[0].packed(), self.rig[1], np.empty(8)

        def right(t: float, y: Array) -> Array:
            rates(y, speed * t, speed, 0.0, packed, 1.0, 1.0, out)
            return out.copy()

        def end() -> Array:
            return _integrators.solve_ivp(
                right, self.times, self.start, method, rtol=tolerance, atol=1e-3 * tolerance
            ).y[:, -1]

        return self._row(f"scipy {method}", f"tolerance {tolerance:.0e}", end, peer=True)

    def heyoka(self, tolerance: float) -> Measurement:
        """heyoka in double precision."""
        return self._row(
            "heyoka",
            f"tolerance {tolerance:.1g}",
            lambda: heyoka_runs.end_state(self.rig, self.start, self.times[1], tolerance),
            peer=True,
        )

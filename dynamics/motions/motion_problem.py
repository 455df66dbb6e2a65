"""Problem of the integrator from parameters and scene: scales, expected work, explicit or implicit method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynamics.arguments import real_array
from dynamics.arrays import Array
from dynamics.equations.parameters import RotorParameters
from dynamics.equations.phase_segments import PhaseSegments, speed_crossings
from dynamics.equations.scene import Scene
from dynamics.errors import OutsideDomain
from dynamics.motions.locked_motion import damping_rates, locked_state
from dynamics.motions.motion import MotionEvent
from dynamics.motions.trajectory import Problem
from rig_basics.times import need_ascending, seconds

SAMPLES_PER_S = 200.0
_MIN_COMPARED_INSTANTS = 64
# Radians of the fastest oscillation per step at a tolerance of 1e-9 (measured on the nominal rig), the stability limit
# of the explicit method on the real axis, and the cost of a step
_EXPLICIT_REACH, _IMPLICIT_REACH = 1.3, 0.6
_STABLE_REACH = 5.5
_EXPLICIT_COST_S, _IMPLICIT_COST_S = 2.0e-6, 6.0e-6


@dataclass(frozen=True)
class Setup:
    """Problem of the integrator with its relation to the caller's arguments.

    Attributes:
        problem: the problem. Its instants contain the output instants and, if these are few, instants between them.
        wanted: indices of the output instants, shape (n,).
        arm_m: displacement whose error has the same weight as an angle error of 1 rad, m.
        damping: fastest decay rate, 1/s.
        oscillation: fastest oscillation that an implicit method must resolve too, 1/s.
        stop: events that follow from the speed history alone.
    """

    problem: Problem
    wanted: NDArray[np.intp]
    arm_m: float
    damping: float
    oscillation: float
    stop: tuple[MotionEvent, ...]

    @property
    def duration_s(self) -> float:
        """Duration of the run, s."""
        return float(self.problem.times[-1] - self.problem.times[0])

    def expected_steps(self, tolerance: float, implicit: bool) -> float:
        """Expected number of steps of one run at a tolerance, accurate to a factor of a few."""
        if implicit:
            rate = self.oscillation / (_IMPLICIT_REACH * (tolerance / 1e-9) ** (1 / 6))
        else:
            follow = self.problem.pace if self.damping < self.problem.pace else self.oscillation
            rate = max(follow / (_EXPLICIT_REACH * (tolerance / 1e-9) ** (1 / 8)), self.damping / _STABLE_REACH)
            rate = max(rate, 1.0 / self.problem.longest_step_s)
        return rate * self.duration_s

    def prefers_implicit(self, tolerance: float) -> tuple[bool, str]:
        """Whether the implicit method is expected to be faster, and the reason as text."""
        explicit, implicit = self.expected_steps(tolerance, False), self.expected_steps(tolerance, True)
        choice = _IMPLICIT_COST_S * implicit < _EXPLICIT_COST_S * explicit
        return choice, (
            f"fastest decay {self.damping:.3g} /s, oscillation {self.oscillation:.3g} /s: "
            f"about {explicit:.2g} explicit or {implicit:.2g} implicit steps"
        )


def instants(time_s: ArrayLike) -> Array:
    """Output instants from an argument: an array unchanged, a number as a duration from 0 with 200 samples a second.

    Raises:
        OutsideDomain: the array contains dates, is empty, not finite or not ascending, or the duration is invalid.
    """
    given = seconds(time_s, OutsideDomain)
    if given.ndim == 0:
        duration = float(given)
        if not (np.isfinite(duration) and 0 < duration * SAMPLES_PER_S < 1e9):
            raise OutsideDomain(f"a duration must be finite and above 0 s (give instants for a long run): {duration!r}")
        return np.linspace(0.0, duration, int(np.ceil(duration * SAMPLES_PER_S - 1e-9)) + 1)
    times = given
    if times.ndim != 1 or len(times) == 0 or not np.all(np.isfinite(times)):
        raise OutsideDomain("time_s must be a duration or a one-dimensional array of finite, ascending instants in s")
    need_ascending(times, OutsideDomain)
    return times


def motion_problem(parameters: RotorParameters, scene: Scene, times: Array, resolved: bool = False) -> Setup:
    """Problem of one run. With `resolved`, steps are at most one radian of the fastest oscillation.

    Raises:
        OutsideDomain: the start state does not consist of eight finite numbers.
    """
    segments = PhaseSegments.of(scene.history)
    psi, speed, _ = segments.phase(float(times[0]))
    locked = scene.start is None
    start = locked_state(parameters, speed, psi, 0.0, np.pi) if locked else real_array("start", scene.start).copy()
    if start.shape != (8,) or not np.all(np.isfinite(start)):
        raise OutsideDomain(f"a start state must be eight finite numbers, got {start!r}")
    moving = (scene.released[0] and parameters.a.present, scene.released[1] and parameters.b.present)
    go = scene.release_time_s or (-np.inf, -np.inf)
    free_from = (float(go[0]) if moving[0] else np.inf, float(go[1]) if moving[1] else np.inf)
    _check_locked_rates(start, free_from, float(times[0]))
    all_times = times
    if len(times) < _MIN_COMPARED_INSTANTS:
        all_times = np.union1d(times, np.linspace(float(times[0]), float(times[-1]), _MIN_COMPARED_INSTANTS))
    peak = _peak_speed(segments, float(times[0]), float(times[-1]))
    w1, w2 = parameters.natural_frequencies_rad_s
    arm = _arm(parameters)
    pace1, pace2 = max(peak, w1), max(peak, w2)
    weights = np.array([arm, arm, 1.0, 1.0, arm * pace1, arm * pace2, pace1, pace1])
    pace = max(w1, w2, peak)
    longest = 1.0 / pace if resolved else np.inf
    problem = Problem(start, all_times, parameters.packed(), segments, free_from, weights, pace, longest)
    stops = speed_crossings(segments, 0.0, float(times[0]), float(times[-1]))
    return Setup(
        problem,
        np.searchsorted(all_times, times),
        arm,
        max(damping_rates(parameters, moving)),
        max(w1, peak, min(w2, 10 * max(w1, peak))),
        tuple(MotionEvent(float(t), "stop", None) for t in stops if t > times[0]),
    )


def _check_locked_rates(start: Array, free_from: tuple[float, float], begin: float) -> None:
    """Check that a locked pendulum has no start rate, which the lock would discard.

    Raises:
        OutsideDomain: a locked pendulum has a rate. The message contains the pendulum.
    """
    for i, at in enumerate(free_from):
        if at > begin and start[6 + i] != 0:
            raise OutsideDomain(
                f"start state: pendulum {'AB'[i]} is locked or absent at the start and can't have a rate of "
                f"{start[6 + i]:.6g} rad/s; give 0, or release it from the start"
            )


def _arm(parameters: RotorParameters) -> float:
    arms = [m.length_m for m in (parameters.a, parameters.b) if m.present]
    return min(1.0, max(arms, default=parameters.imbalance_radius_m) or 1.0)


def _peak_speed(segments: PhaseSegments, begin: float, end: float) -> float:
    """Largest |ω| of a run: at its ends, at a knot, or where α = 0 within a cubic, rad/s."""
    c2, c3 = segments.cubics[:, 2], segments.cubics[:, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        turning = segments.origins - c2 / (3 * c3)
    at = np.r_[begin, end, segments.knots, turning[np.isfinite(turning)]]
    return max(abs(segments.phase(float(t))[1]) for t in np.unique(np.clip(at, begin, end)))

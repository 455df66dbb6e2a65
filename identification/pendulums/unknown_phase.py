"""A release with an inexact recorded phase, whose errors are the last unknowns of θ.

A phase without reference has a constant error; a noisy phase has the errors of its smoothing
(identification.pendulums.recorded_speed).

The motion depends on the constant error if the suspension has different stiffnesses along x and y. A rotation of the
whole rig by half a revolution does not change the encoders' readings, unless gravity acts in the plane of the disk. A
fit with a wrong angle may end in a side minimum. Therefore several angles are tried over the first horizons, and those
with a much larger χ² are dropped.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dynamics.equations.parameters import RotorParameters
from identification.errors import FitFailed
from identification.least_squares import Minimum
from identification.pendulums.answers import covering
from identification.pendulums.transient import Predict, TransientFit, TransientProblem
from rig_basics.arrays import Array
from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)

TURN_STD_RAD = float(np.pi)
"""Prior standard deviation of an unknown constant angle, rad."""
_PER_HALF = 6  # number of trial angles per half revolution
_DIFFERENCE = 1e-5  # step of the angle, rad
_MODE_DIFFERENCE = 1e-2  # step of a mode in standard deviations
_FURTHEST = 7.5  # largest change of ln c: three prior standard deviations
_HORIZONS, _ITERATIONS = 3, 8
_MAX_CHI2_ABOVE_BEST = 50.0  # χ² above the best trial's for which a trial is dropped
_MAX_DETERMINED_DEG = 30.0  # standard deviation of the angle below which the readings determine it
_MAX_SAME_DISTANCE = 1.0  # squared standard deviations between trials that count as the same

Hold = Callable[[TransientProblem, Array], TransientProblem]
"""(problem, start value) ↦ the problem with the damping held near that of the start value."""
Phased = Callable[[Array, float, Array, bool], tuple[Array, Array]]
"""(other unknowns, last instant, errors of the phase, whether derivatives are computed) ↦ readings, derivatives."""


def angles_to_try(physics: RotorParameters) -> Array:
    """Return trial angles over half a revolution, or over a whole one if gravity makes its halves different, rad."""
    halves = 2 if physics.gravity_m_per_s2 else 1
    return np.pi * (np.arange(halves * _PER_HALF) / _PER_HALF - 0.5 * halves)


def with_phase(predict: Phased, damping: Array, modes: int, turn: bool) -> Predict:
    """Return a prediction with the phase's errors as last parameters.

    Args:
        predict: (other parameters, last instant, modes in standard deviations followed by an angle, whether derivatives
            are computed) ↦ readings (n,) and derivatives (n, p), NaN for a motion that is not finite.
        damping: prior ln c3, ln c4. Trials with a wrong angle diverge to dampings whose integration takes seconds; they
            are refused.
        modes: number of modes.
        turn: whether the constant angle is unknown.
    """
    count, free = modes + 1, modes + int(turn)

    def phased(theta: Array, end_s: float, slopes: bool = True, /) -> tuple[Array, Array]:
        own, by = theta[: len(theta) - free], np.zeros(count)
        by[:free] = theta[len(theta) - free :]
        if turn and np.max(np.abs(theta[:2] - damping)) >= _FURTHEST:
            own = np.full(len(own), np.inf)
        angle, slope = predict(own, end_s, by, slopes)
        if not slopes:
            return angle, slope
        columns = [slope]
        for j in range(free):
            step = _DIFFERENCE if j == modes else _MODE_DIFFERENCE
            moved, _ = predict(own, end_s, by + step * np.eye(count)[j], False)
            columns.append((moved - angle)[:, None] / step)
        return angle, np.column_stack(columns)

    return phased


def screened_starts(
    problem: TransientProblem, trials: Sequence[Array], horizons: Sequence[float], hold: Hold
) -> list[Array]:
    """Return the best start values after a few iterations over the first horizons, the best first, each place once.

    Args:
        problem: problem whose θ ends with the angle.
        trials: start values.
        horizons: last instants, ascending, of which the first few are used, s.
        hold: holds a problem's damping near that of a start, since it could diverge with a wrong angle.
    Raises:
        FitFailed: the motion is not finite from any start.
    """
    starts = list(trials)
    for end_s in horizons[:_HORIZONS]:
        minima: list[Minimum] = []
        for theta in starts:
            with ignoring(_log, "fitting from an angle of the rotor", FitFailed):  # the motion is not finite
                minima.append(hold(problem, theta).solve(theta, end_s, _ITERATIONS))
        if not minima:
            raise FitFailed("the motion of the model is not finite at any angle of the rotor; check masses and lengths")
        minima.sort(key=lambda m: m.cost)
        best = minima[0].cost
        limit = best + _MAX_CHI2_ABOVE_BEST * max(1.0, best / len(minima[0].residual))
        ahead: list[Minimum] = []
        for minimum in minima:
            if minimum.cost <= limit and all(_apart(minimum, other) > _MAX_SAME_DISTANCE for other in ahead):
                ahead.append(minimum)
        starts = [minimum.theta for minimum in ahead]
    return starts


def _apart(one: Minimum, other: Minimum) -> float:
    """Return the squared distance of two minima in ln c3, ln c4 and the angle modulo half a revolution."""
    shift = (one.theta - other.theta)[[0, 1, -1]]
    shift[2] -= np.pi * np.round(shift[2] / np.pi)
    return float(shift @ np.linalg.inv(other.covariance[np.ix_([0, 1, -1], [0, 1, -1])]) @ shift)


def with_phase_warning(fit: TransientFit, answers: Sequence[Minimum], physics: RotorParameters) -> TransientFit:
    """Return a fit with intervals that contain other plausible minima, and with a warning about the fitted angle."""
    turn, std = (np.degrees(v) for v in (answers[0].theta[-1], np.sqrt(answers[0].covariance[-1, -1])))
    half = "" if physics.gravity_m_per_s2 else ", or half a revolution more"
    seen = "the readings do not depend on it"
    if std < _MAX_DETERMINED_DEG:
        seen = f"the phase lacks {turn:.1f}° ± {std:.1g}°{half}"
    warning = (
        "the recorded phase has no absolute reference, so the rotor's angle was fitted with the damping, whose "
        f"intervals contain it: {seen}"
    )
    with_warning = replace(fit, warnings=[*fit.warnings, warning])
    return covering(with_warning, answers, "with the rotor at another angle", "A recording with its phase decides")

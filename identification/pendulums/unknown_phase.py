"""A release on a rotor whose recorded phase is not exact: how far it may be otherwise is unknown, the last of θ.

A phase without reference is wrong by a constant angle, a noisy one by the errors its smoothing leaves
(identification.pendulums.recorded_speed).

Where the suspension is stiffer one way than the other the motion depends on it. Turning everything by half a revolution
changes nothing the encoders see unless gravity pulls in the disk's plane. From a wrong angle a fit may end in a side
minimum, so several race over the first horizons and those that fall behind are dropped.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dynamics.equations.parameters import RotorParameters
from identification.errors import FitFailed
from identification.least_squares import Minimum
from identification.pendulums.answers import covering
from identification.pendulums.transient import Predict, TransientFit, TransientProblem

TURN_STD_RAD = np.pi
_PER_HALF = 6
_DIFFERENCE = 1e-5  # rad
_MODE_DIFFERENCE = 1e-2  # standard deviations
_FURTHEST = 7.5  # ln c: three standard deviations of what is known of a damping
_HORIZONS, _ITERATIONS = 3, 8
_BEHIND = 50.0  # χ² above the leader's
_SEEN_DEG = 30.0
_ALIKE = 1.0  # squared standard deviations between runners that are one

Hold = Callable[[TransientProblem, np.ndarray], TransientProblem]
Phased = Callable[[np.ndarray, float, np.ndarray, bool], tuple[np.ndarray, np.ndarray]]


def angles_to_try(physics: RotorParameters) -> np.ndarray:
    """Angles evenly over half a revolution, or over a whole one where gravity tells its halves apart, rad."""
    halves = 2 if physics.gravity_m_per_s2 else 1
    return np.pi * (np.arange(halves * _PER_HALF) / _PER_HALF - 0.5 * halves)


def with_phase(predict: Phased, damping: np.ndarray, modes: int, turn: bool) -> Predict:
    """Readings and derivatives with the phase's errors as last parameters.

    Args:
        predict: (other parameters, last instant, standard deviations of each mode and a last angle, whether derivatives
            are wanted) ↦ readings (n,) and derivatives (n, p), NaN for infinite ones.
        damping: ln c3, ln c4 as given. From a wrong angle trials run off to dampings that take seconds to follow; they
            are refused.
        modes, turn: how many modes there are, and whether the angle is unknown.
    """
    count, free = modes + 1, modes + int(turn)

    def phased(theta: np.ndarray, end_s: float, slopes: bool = True, /) -> tuple[np.ndarray, np.ndarray]:
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


def race(
    problem: TransientProblem, trials: Sequence[np.ndarray], horizons: Sequence[float], hold: Hold
) -> list[np.ndarray]:
    """Where a few iterations over the first horizons lead: each place once, the best first, no stragglers.

    Args:
        problem: its θ ends with the angle.
        trials: start values.
        horizons: last instants, ascending; the first few are used.
        hold: keeps a problem's damping near a start's: from a wrong angle it could run off.
    Raises:
        FitFailed: the model gives no finite numbers from any of them.
    """
    runners = list(trials)
    for end_s in horizons[:_HORIZONS]:
        minima: list[Minimum] = []
        for theta in runners:
            with contextlib.suppress(FitFailed):  # the motion from there is beyond all numbers
                minima.append(hold(problem, theta).solve(theta, end_s, _ITERATIONS))
        if not minima:
            raise FitFailed("from no angle of the rotor does the model give finite numbers; check masses and lengths")
        minima.sort(key=lambda m: m.cost)
        best = minima[0].cost
        limit = best + _BEHIND * max(1.0, best / len(minima[0].residual))
        ahead: list[Minimum] = []
        for minimum in minima:
            if minimum.cost <= limit and all(_apart(minimum, other) > _ALIKE for other in ahead):
                ahead.append(minimum)
        runners = [minimum.theta for minimum in ahead]
    return runners


def _apart(one: Minimum, other: Minimum) -> float:
    """Squared distance in ln c3, ln c4 and the angle up to half revolutions."""
    shift = (one.theta - other.theta)[[0, 1, -1]]
    shift[2] -= np.pi * np.round(shift[2] / np.pi)
    return float(shift @ np.linalg.inv(other.covariance[np.ix_([0, 1, -1], [0, 1, -1])]) @ shift)


def told(fit: TransientFit, answers: Sequence[Minimum], physics: RotorParameters) -> TransientFit:
    """A fit whose intervals reach other answers, with what a reader must know of the angle."""
    turn, std = (np.degrees(v) for v in (answers[0].theta[-1], np.sqrt(answers[0].covariance[-1, -1])))
    half = "" if physics.gravity_m_per_s2 else ", or half a revolution more"
    seen = f"the phase lacks {turn:.1f}° ± {std:.1g}°{half}" if std < _SEEN_DEG else "the readings do not depend on it"
    warning = (
        "the recorded phase has no absolute reference, so the rotor's angle was fitted with the damping, whose "
        f"intervals contain it: {seen}"
    )
    with_warning = replace(fit, warnings=[*fit.warnings, warning])
    return covering(with_warning, answers, "with the rotor at another angle", "A recording with its phase decides")

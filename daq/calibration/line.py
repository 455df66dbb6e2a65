"""The line through a sensor's readings at known positions: gain, offset, linearity, hysteresis, each with uncertainty.

Model: position = intercept + gain × reading. Weighted least squares with the covariance of positions and readings; two
readings of one position share the error of its block. Scatter beyond the stated uncertainties (seating, play,
hysteresis) is estimated from the residuals, as an independent error of every reading. The derivation is in
docs/theory/calibration.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import fdtrc, stdtr

from daq.errors import AcquisitionError
from rig_basics.arrays import Array
from uncertainty.coverage import coverage_factor

_OUTLIER_P, _CURVED_P = 0.01, 0.01  # significance levels
_OUTLIER_SHARE = 0.3  # of the scatter that may be left without an outlier
_SAME_M = 1e-9
_BISECTIONS = 100


def widening(freedom: float) -> float:
    """Return the factor on a standard deviation known from some degrees of freedom, so that ± 1.96 of it are 95 %."""
    return coverage_factor(0.95, freedom) / coverage_factor(0.95)


class TooFewPositions(AcquisitionError, ValueError):
    """The positions do not determine a gain. The text contains what to do."""


@dataclass(frozen=True)
class GaugeReading:
    """One reading at a known position.

    Attributes:
        position_m, position_std_m: position of the target and its standard uncertainty. Readings of the same position
            share its error.
        reading_m, reading_std_m: mean displacement that the sensor reports, and its standard uncertainty.
    """

    position_m: float
    position_std_m: float
    reading_m: float
    reading_std_m: float


@dataclass(frozen=True)
class Outlier:
    """Readings that contradict the line through the others.

    Attributes:
        numbers: their numbers, from 0.
        position_m: their position.
        off_m: mean distance from the line through the others, in units of position.
        off_stds: the same in standard deviations.
    """

    numbers: tuple[int, ...]
    position_m: float
    off_m: float
    off_stds: float


@dataclass(frozen=True)
class GaugeLine:
    """Result of a calibration of a displacement sensor. All standard uncertainties give 95 % intervals at ± 1.96.

    Attributes:
        readings: readings in their order of time.
        gain, gain_std: displacement over reading.
        centre_m: mean of the readings, at which the errors of gain and position are independent.
        position_m, position_std_m: position at the reading `centre_m`.
        residuals_m: positions less the line, shape (n,).
        scatter_m: standard deviation of every reading beyond the stated uncertainties; 0 if they explain the residuals.
        freedom: degrees of freedom of the residuals.
        repeatability_m: standard deviation of readings of one position, with hysteresis; NaN without repetitions.
        hysteresis_m, hysteresis_std_m: mean difference between readings approached from smaller and from larger
            positions; NaN if no position was approached from both sides.
        nonlinearity_m: largest deviation of a cubic from the line over the span.
        curved: whether this deviation is significant.
        outlier: readings that contradict the others; None if there are none.
    """

    readings: tuple[GaugeReading, ...]
    gain: float
    gain_std: float
    centre_m: float
    position_m: float
    position_std_m: float
    residuals_m: Array
    scatter_m: float
    freedom: int
    repeatability_m: float
    hysteresis_m: float
    hysteresis_std_m: float
    nonlinearity_m: float
    curved: bool
    outlier: Outlier | None

    @property
    def span_m(self) -> float:
        """Distance between the outermost positions, m."""
        return _span(self.readings)

    def offset_m(self, zero_m: float) -> tuple[float, float]:
        """Return what is added to gain × reading so that the displacement is 0 at a position, and its uncertainty.

        Args:
            zero_m: position of displacement 0, m.
        """
        offset = self.position_m - zero_m - self.gain * self.centre_m
        return offset, math.hypot(self.position_std_m, self.gain_std * self.centre_m)


@dataclass(frozen=True)
class _Fit:
    """Weighted fit of a polynomial of the readings.

    Attributes:
        coefficients, covariance: of the powers of the reading less its centre.
        residuals, chi2: positions less the polynomial, and the weighted sum of their squares.
        scatter_m: standard deviation of every reading in addition to the stated uncertainties.
        stated: covariance of the coefficients from the stated uncertainties alone.
    """

    coefficients: Array
    covariance: Array
    residuals: Array
    chi2: float
    scatter_m: float
    stated: Array

    def std(self, at: Array, freedom: int) -> float:
        """Return the standard uncertainty of at · coefficients, such that ± 1.96 of it is a 95 % interval.

        The scatter is known from `freedom` degrees of freedom, which widens its share (Welch and Satterthwaite).
        """
        variance = float(at @ self.covariance @ at)
        share = 1.0 - min(1.0, float(at @ self.stated @ at) / variance)
        return (widening(freedom / share**2) if share > 1e-3 and freedom > 0 else 1.0) * math.sqrt(variance)


def fit_line(readings: Sequence[GaugeReading], range_m: float) -> GaugeLine:
    """Fit gain and offset.

    Args:
        readings: in their order of time.
        range_m: measuring range of the sensor, m.
    Raises:
        TooFewPositions: fewer than two positions, a span below 5 % of the range, or stated uncertainties that yield a
            gain known worse than to 1 %.
    """
    known = tuple(readings)
    _refuse_too_few(known, range_m)
    y = np.array([r.reading_m for r in known])
    centre = float(np.mean(y))
    fit = _scattered(known, y - centre, 1)
    freedom = len(known) - 2
    gain, gain_std = float(fit.coefficients[1]), fit.std(np.array([0.0, 1.0]), freedom)
    outlier = _outlier(known)
    if gain_std > 0.01 * abs(gain) and outlier is None:
        raise TooFewPositions(
            f"the gain would be known to {100 * gain_std / abs(gain):.2g} % only: use positions that are farther apart "
            "or better known"
        )
    nonlinearity, variation, curved = _curvature(known, y - centre, fit, freedom)
    if curved:  # the gain within a part of the span differs from the mean one
        gain_std = math.hypot(gain_std, variation)
    hysteresis, hysteresis_std = _hysteresis(known)
    return GaugeLine(
        readings=known,
        gain=gain,
        gain_std=gain_std,
        centre_m=centre,
        position_m=float(fit.coefficients[0]),
        position_std_m=fit.std(np.array([1.0, 0.0]), freedom),
        residuals_m=fit.residuals,
        scatter_m=fit.scatter_m,
        freedom=freedom,
        repeatability_m=_repeatability(known),
        hysteresis_m=hysteresis,
        hysteresis_std_m=hysteresis_std,
        nonlinearity_m=nonlinearity,
        curved=curved,
        outlier=outlier,
    )


def _refuse_too_few(readings: tuple[GaugeReading, ...], range_m: float) -> None:
    if len(_positions(readings)) < 2:
        raise TooFewPositions("expected at least two different positions, better five, each approached from both sides")
    if _span(readings) < 0.05 * range_m:
        raise TooFewPositions(
            f"the positions span {1e3 * _span(readings):.3g} mm, less than 5 % of the range of {1e3 * range_m:.3g} mm: "
            "use positions over the whole displacement that the tests reach"
        )


def _span(readings: Sequence[GaugeReading]) -> float:
    positions = [r.position_m for r in readings]
    return max(positions) - min(positions)


def _positions(readings: Sequence[GaugeReading]) -> dict[int, list[int]]:
    """Return the numbers of the readings of each position."""
    found: dict[int, list[int]] = {}
    for number, reading in enumerate(readings):
        found.setdefault(round(reading.position_m / _SAME_M), []).append(number)
    return found


def _covariance(readings: Sequence[GaugeReading], slope: float) -> Array:
    """Return the covariance of position − slope × reading, shape (n, n)."""
    out = np.diag([(slope * r.reading_std_m) ** 2 for r in readings])
    for numbers in _positions(readings).values():
        out[np.ix_(numbers, numbers)] += readings[numbers[0]].position_std_m ** 2
    floor = 1e-9**2  # a nanometre, so that exact numbers do not make it singular
    return out + floor * np.eye(len(readings))


def _scattered(readings: Sequence[GaugeReading], y: Array, degree: int) -> _Fit:
    """Fit a polynomial with the scatter for which chi² equals its degrees of freedom (Mandel and Paule).

    With a basis of the contrasts that no polynomial changes, chi² is a sum of q² / (λ + scatter²).
    """
    p, columns, _, stated = _equations(readings, y, degree)
    freedom = len(p) - degree - 1
    if freedom < 1:
        return _fitted(readings, y, degree, 0.0)
    contrasts = np.linalg.qr(columns, mode="complete")[0][:, degree + 1 :]
    sizes, turn = np.linalg.eigh(contrasts.T @ stated @ contrasts)
    squares = (turn.T @ (contrasts.T @ p)) ** 2

    if float(np.sum(squares / sizes)) <= freedom:
        return _fitted(readings, y, degree, 0.0)
    low, variance = 0.0, float(np.sum(squares))  # chi² falls with the variance: bisection
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + variance)
        if float(np.sum(squares / (sizes + middle))) > freedom:
            low = middle
        else:
            variance = middle
    return _fitted(readings, y, degree, math.sqrt(variance))


def _equations(readings: Sequence[GaugeReading], y: Array, degree: int) -> tuple[Array, Array, float, Array]:
    """Return positions, powers of the scaled readings, the scale, and the covariance of the stated errors."""
    p = np.array([r.position_m for r in readings])
    slope = float(np.sum((p - p.mean()) * (y - y.mean())) / np.sum((y - y.mean()) ** 2)) if np.ptp(y) else 1.0
    scale = float(np.max(np.abs(y))) or 1.0
    return p, np.column_stack([(y / scale) ** k for k in range(degree + 1)]), scale, _covariance(readings, slope)


def _fitted(readings: Sequence[GaugeReading], y: Array, degree: int, scatter_m: float) -> _Fit:
    p, columns, scale, stated = _equations(readings, y, degree)
    weights = np.linalg.inv(stated + scatter_m**2 * np.eye(len(p)))
    inverse = np.linalg.pinv(columns.T @ weights @ columns, hermitian=True)
    estimator = inverse @ columns.T @ weights  # coefficients = estimator · p
    coefficients = estimator @ p
    residuals = p - columns @ coefficients
    sizes = scale ** -np.arange(degree + 1.0)
    turned = np.outer(sizes, sizes)
    return _Fit(
        coefficients * sizes,
        inverse * turned,
        residuals,
        float(residuals @ weights @ residuals),
        scatter_m,
        estimator @ stated @ estimator.T * turned,
    )


def _curvature(readings: tuple[GaugeReading, ...], y: Array, line: _Fit, freedom: int) -> tuple[float, float, bool]:
    """Compare a cubic with the line.

    Returns:
        Largest deviation over the span, m; rms deviation of the local gain; whether the cubic is significant.
    """
    if len(_positions(readings)) < 4 or freedom < 3:
        return 0.0, 0.0, False
    cubic = _scattered(readings, y, 3)
    grid = np.linspace(float(y.min()), float(y.max()), 101)
    difference = cubic.coefficients.copy()
    difference[:2] -= line.coefficients
    deviation = np.polyval(difference[::-1], grid)
    variation = np.polyval(np.polyder(difference[::-1]), grid)
    left = freedom - 2
    same = _fitted(readings, y, 1, cubic.scatter_m)
    ratio = 0.5 * (same.chi2 - cubic.chi2) / max(1.0, cubic.chi2 / left)
    significant = bool(fdtrc(2, left, ratio) < _CURVED_P)
    return float(np.max(np.abs(deviation))), math.sqrt(float(np.mean(variation**2))), significant


def _repeatability(readings: tuple[GaugeReading, ...]) -> float:
    groups = [np.array([readings[n].reading_m for n in numbers]) for numbers in _positions(readings).values()]
    freedom = sum(len(group) - 1 for group in groups)
    return math.sqrt(sum(float(np.sum((g - g.mean()) ** 2)) for g in groups) / freedom) if freedom else math.nan


def _hysteresis(readings: tuple[GaugeReading, ...]) -> tuple[float, float]:
    """Return the mean difference of readings from below and from above, and its standard uncertainty."""
    up: dict[int, list[float]] = {}
    down: dict[int, list[float]] = {}
    for before, reading in pairwise(readings):
        step = reading.position_m - before.position_m
        if abs(step) > _SAME_M:
            side = up if step > 0 else down
            side.setdefault(round(reading.position_m / _SAME_M), []).append(reading.reading_m)
    pairs = [float(np.mean(up[key]) - np.mean(down[key])) for key in up if key in down]
    if not pairs:
        return math.nan, math.nan
    spread = float(np.std(pairs, ddof=1)) / math.sqrt(len(pairs)) if len(pairs) > 1 else math.nan
    return float(np.mean(pairs)), spread


def _outlier(readings: tuple[GaugeReading, ...]) -> Outlier | None:
    """Return the readings, or the position, that contradict the line through the others."""
    y = np.array([r.reading_m for r in readings])
    y -= y.mean()
    whole = _scattered(readings, y, 1)
    if whole.scatter_m == 0:
        return None
    groups = [(n,) for n in range(len(readings))]
    groups += [tuple(numbers) for numbers in _positions(readings).values() if len(numbers) > 1]
    found: list[tuple[float, Outlier]] = []
    for group in groups:
        rest = [n for n in range(len(readings)) if n not in group]
        freedom = len(rest) - 2
        if freedom < 1 or len(_positions([readings[n] for n in rest])) < 2:
            continue
        others = _scattered([readings[n] for n in rest], y[rest], 1)
        if others.scatter_m > _OUTLIER_SHARE * whole.scatter_m:
            continue
        off, stds = _distance([readings[n] for n in group], y[list(group)], others, freedom)
        chance = 2 * len(groups) * float(stdtr(freedom, -abs(stds)))
        if chance < _OUTLIER_P:
            position = readings[group[0]].position_m
            found.append((others.scatter_m, Outlier(group, position, off, stds)))
    return min(found, key=lambda one: one[0])[1] if found else None


def _distance(group: Sequence[GaugeReading], y: Array, line: _Fit, freedom: int) -> tuple[float, float]:
    """Return the mean distance of a group from a line, and the same in standard deviations."""
    mean = float(np.mean(y))
    off = float(np.mean([r.position_m for r in group])) - float(line.coefficients[0] + line.coefficients[1] * mean)
    own = float(np.mean(_covariance(group, float(line.coefficients[1])))) + line.scatter_m**2 / len(group)
    return off, off / math.hypot(math.sqrt(own), line.std(np.array([1.0, mean]), freedom))

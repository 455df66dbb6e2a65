"""Smooth rotor phase during a release from its recording, and the uncertainty of that phase.

A spline through every noisy reading has accelerations that move the pendulums by more than the damping's uncertainty: a
time error of 1 µs at 8 revolutions per second gives 0.03 rad/s². The rotor's inertia keeps its speed smooth, so the
phase is a cubic spline with as few pieces as the recording requires.

- Index marks: a spline with more pieces is used if a steady rotor would require it by chance with a probability of 1 in
  1000. Akaike's criterion has 1 in 4 false detections, which moved c by six standard deviations of a release that
  creeps away from its lock.
- Angle in every row: it is averaged over revolutions. Its noise is white, or the quantisation of an encoder or a file,
  or a random walk if a noisy speed was integrated. Quantisation errors are bounded, and slow if the speed and the
  sampling beat, so they must not be fitted. The increments of a random walk are independent, its values are not. The
  first spline whose residual is explained by that noise is used, with the covariance of its coefficients as prior in
  the fit of the release.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate
from scipy.interpolate import BSpline, PPoly
from scipy.special import fdtri

from daq.signals.phase_noise import encoder_step, white_and_walk
from daq.signals.run import Run
from dynamics.equations.speed_history import SpeedHistory
from dynamics.errors import OutsideDomain
from identification.samples import correlation_inflation
from rig_basics.arrays import Array

Floats = NDArray[np.floating]

_untyped: Any = interpolate  # scipy has no types

_FEWEST = 8
_MARKS_PER_PIECE = 2.0
_CHANCE = 1e-3  # probability of a false step to more pieces for a steady rotor
_SAMPLES, _MOST_BLOCKS, _SAMPLES_PER_BLOCK = 400, 300, 8
_MODES, _LEAST_RAD = 4, 5e-5
_OFFSETS = 8


@dataclass(frozen=True)
class RecordedSpeed:
    """Rotor phase and its uncertainty.

    Attributes:
        history: ψ(t).
        modes: independent changes of the coefficients of `history`, one standard deviation each, shape (q, m, 4).
    """

    history: SpeedHistory
    modes: np.ndarray

    def moved(self, by: np.ndarray) -> SpeedHistory:
        """Return the history changed by q modes in standard deviations and a constant angle in rad, shape (q + 1,)."""
        change = np.tensordot(by[:-1], self.modes, 1) if len(by) > 1 else 0.0
        constant = np.array([float(by[-1]), 0.0, 0.0, 0.0])
        return SpeedHistory(self.history.knots_s, np.ascontiguousarray(self.history.coefficients + change + constant))


def recorded_speed(run: Run, begin_s: float) -> RecordedSpeed:
    """Return the phase of a run from an instant on, from its angle in every row if it has one, else from its marks.

    Raises:
        OutsideDomain: there are fewer than four marks, or their time is not ascending.
    """
    rows = (run.phase_time_s >= begin_s) & np.isfinite(run.phase_rad) if len(run.phase_time_s) else np.zeros(0, bool)
    if np.count_nonzero(rows) >= _SAMPLES:
        return speed_of_samples(run.phase_time_s[rows], run.phase_rad[rows])
    needed = run.mark_time_s >= begin_s
    needed[:2] = False  # the first two marks have no earlier ones
    history = speed_of_marks(run.mark_time_s[needed], run.mark_phase_rad[needed])
    return RecordedSpeed(history, np.zeros((0, *history.coefficients.shape)))


def speed_of_marks(time_s: np.ndarray, phase_rad: np.ndarray) -> SpeedHistory:
    """Return a speed history from noisy marks.

    Args:
        time_s, phase_rad: shape (n,), n ≥ 4, time strictly ascending.
    Raises:
        OutsideDomain: there are fewer than four marks, or their time is not ascending.
    """
    through = SpeedHistory.from_phases(time_s, phase_rad)  # raises for invalid marks
    n = len(time_s)
    if n < _FEWEST:
        return through
    line = np.polynomial.Polynomial.fit(time_s, phase_rad, 1)
    rest = phase_rad - line(time_s)
    best: BSpline | None = None
    least, used = np.inf, 0
    floor = (4 * np.finfo(float).eps * float(np.max(np.abs(phase_rad)))) ** 2 * n
    for pieces in _pieces(n / _MARKS_PER_PIECE):
        spline: BSpline = _untyped.make_lsq_spline(time_s, rest, _knots(time_s, pieces), 3)
        square = float(np.sum((spline(time_s) - rest) ** 2)) + floor
        more, left = pieces + 3 - used, n - pieces - 3
        if best is None or (left > 0 and (least / square - 1) * left / more > fdtri(more, left, 1 - _CHANCE)):
            best, least, used = spline, square, pieces + 3
    if best is None:
        raise OutsideDomain(f"expected at least 4 marks for a speed history, got {n}; record longer")
    return _history(best, line)


def speed_of_samples(time_s: np.ndarray, phase_rad: np.ndarray) -> RecordedSpeed:
    """Return a speed history from an angle in every row.

    Args:
        time_s, phase_rad: shape (n,), time strictly ascending, phase unwrapped.
    Raises:
        OutsideDomain: the time is not ascending, or there are too few revolutions.
    """
    if not np.all(np.diff(time_s) > 0):
        raise OutsideDomain("the times of the rotor's phase must rise from sample to sample")
    line = np.polynomial.Polynomial.fit(time_s, phase_rad, 1)
    slope = abs(float(line.deriv()(0.0)))
    apart = float(np.median(np.diff(time_s)))
    span = float(time_s[-1] - time_s[0])
    width = max(2 * np.pi / max(slope, 1e-9), span / _MOST_BLOCKS, _SAMPLES_PER_BLOCK * apart)
    first = np.flatnonzero(np.r_[True, np.diff(np.floor((time_s - time_s[0]) / width)) != 0])
    count = np.diff(np.r_[first, len(time_s)])
    if len(count) < _FEWEST:
        raise OutsideDomain(
            f"expected at least {_FEWEST} blocks of the rotor's phase, each of a revolution or longer, got "
            f"{len(count)}; record longer"
        )
    rest = phase_rad - line(time_s)
    middle = np.add.reduceat(time_s, first) / count
    value = np.add.reduceat(rest, first) / count
    step = encoder_step(np.diff(phase_rad))  # from row to row the phase changes by many steps, its increment by few
    white, walk = white_and_walk(rest, step, apart)
    variance = white / count
    if step:
        variance = variance + _beats(phase_rad, rest, step, first, count)
    lasts = count * apart
    cov = np.diag(variance - walk * lasts / 6 * (walk > 0))
    if walk:
        cov = cov + walk * np.minimum.outer(middle - time_s[0], middle - time_s[0])
    cov = cov + np.eye(len(count)) * (4 * np.finfo(float).eps * float(np.max(np.abs(phase_rad)))) ** 2
    return _fewest_pieces(middle, value, np.linalg.cholesky(cov), line)


def _beats(phase: np.ndarray, rest: np.ndarray, step: float, first: np.ndarray, count: np.ndarray) -> float:
    """Return the variance of the block means by rounding of a smooth phase of this speed, rad²."""
    smooth = phase - rest + np.interp(np.arange(len(rest)), first, np.add.reduceat(rest, first) / count)
    total = 0.0
    for offset in np.arange(_OFFSETS) / _OFFSETS:
        moved = smooth / step + offset
        error: Array = (np.rint(moved) - moved) * step
        total += float(np.var(np.add.reduceat(error, first) / count))
    return total / _OFFSETS


def _fewest_pieces(
    time_s: np.ndarray, value: np.ndarray, root: np.ndarray, line: np.polynomial.Polynomial
) -> RecordedSpeed:
    """Return the first spline whose residual is noise, by whitened least squares; else that of Akaike's criterion."""
    n, data = len(time_s), np.linalg.solve(root, value)
    best: tuple[Floats, Floats, Floats, Floats, Floats] | None = None
    lowest = np.inf
    for pieces in _pieces(n / _MARKS_PER_PIECE):
        knots = _knots(time_s, pieces)
        basis: Array = _untyped.BSpline.design_matrix(time_s, knots, 3).toarray()
        design = np.linalg.solve(root, basis)
        found = np.linalg.lstsq(design, data, rcond=None)[0]
        residual = data - design @ found
        chi2, free = float(residual @ residual), basis.shape[1]
        explained = chi2 < n - free + 3 * np.sqrt(2 * n)
        if explained or chi2 + 2 * free < lowest:
            best, lowest = (knots, found, design, residual, basis), chi2 + 2 * free
        if explained:
            break
    assert best is not None
    knots, found, design, residual, columns = best
    stretch = max(1.0, float(residual @ residual) / max(1, n - len(found))) * correlation_inflation(residual, 4) ** 2
    history = _history(BSpline(knots, found, 3), line)
    return RecordedSpeed(history, _modes(knots, np.linalg.pinv(design) * np.sqrt(stretch), columns, time_s, history))


def _modes(
    knots: np.ndarray, spread: np.ndarray, basis: np.ndarray, time_s: np.ndarray, history: SpeedHistory
) -> np.ndarray:
    """Return independent errors of the spline, the largest in phase first; a constant angle is one of them."""
    left, sizes, _ = np.linalg.svd(basis @ spread, full_matrices=False)
    large = sizes / np.sqrt(len(time_s)) > _LEAST_RAD
    count = min(_MODES, int(large.sum()))
    if not count:
        return np.zeros((0, *history.coefficients.shape))
    coefficients = np.linalg.lstsq(basis, left[:, :count] * sizes[:count], rcond=None)[0]
    return np.array([_cubics(BSpline(knots, c, 3)) for c in coefficients.T])


def _pieces(most: float) -> list[int]:
    counts = [1, 2]
    while counts[-1] * 1.5 <= most:
        counts.append(int(np.ceil(1.5 * counts[-1])))
    return [c for c in counts if c <= max(most, 1)]


def _knots(time_s: np.ndarray, pieces: int) -> np.ndarray:
    inner = np.quantile(time_s, np.arange(1, pieces) / pieces)
    return np.r_[[time_s[0]] * 4, inner, [time_s[-1]] * 4]


def _cubics(spline: BSpline) -> np.ndarray:
    """Return the coefficients of the powers of time of each piece, shape (m, 4)."""
    parts: PPoly = _untyped.PPoly.from_spline(spline)
    return np.ascontiguousarray(parts.c[::-1, np.diff(parts.x) > 0].T)


def _history(spline: BSpline, line: np.polynomial.Polynomial) -> SpeedHistory:
    coefficients = _cubics(spline)
    edges = np.unique(spline.t)
    coefficients[:, 0] += line(edges[:-1])
    coefficients[:, 1] += float(line.deriv()(0.0))
    return SpeedHistory(edges, coefficients)

"""The rotor's phase while a release lasts, no livelier than its recording shows, and what is left open of it.

Where readings are noise, a spline through every one of them pushes the pendulums by more than the damping's own
uncertainty: a microsecond of stamping at 8 revolutions a second makes accelerations of 0.03 rad/s². The rotor's inertia
keeps its speed smooth, so the phase is a cubic spline with as few pieces as the recording asks for.

- Index marks: a spline with more pieces is taken where, of a thousand steady rotors, one would seem to ask for it by
  chance. Akaike's criterion takes one in four of them for a wobble, which moved c by six standard deviations of a
  release that creeps away from its lock.
- An angle in every row is averaged over revolutions. Its noise is known: white, an encoder's or a file's steps
  (bounded and slow where the speed and the sampling beat, so that the last of it must not be fitted), or a walk where
  a noisy speed was integrated, whose increments are independent and not its values. The first spline whose residual
  that noise explains is taken, with the covariance of its coefficients: the release's fit leaves them free within it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, PPoly, make_lsq_spline
from scipy.special import fdtri

from daq.signals.phase_noise import encoder_step, white_and_walk
from daq.signals.run import Run
from dynamics.equations.speed_history import SpeedHistory
from dynamics.errors import OutsideDomain
from identification.samples import correlation_inflation

_FEWEST = 8
_MARKS_PER_PIECE = 2.0
_CHANCE = 1e-3  # of a step to more pieces on a steady rotor
_SAMPLES, _MOST_BLOCKS, _SAMPLES_PER_BLOCK = 400, 300, 8
_MODES, _LEAST_RAD = 4, 5e-5
_OFFSETS = 8


@dataclass(frozen=True)
class RecordedSpeed:
    """A rotor's phase and how far it may be otherwise.

    Attributes:
        history: ψ(t).
        modes: changes of history's coefficients, one standard deviation each and independent, shape (q, m, 4).
    """

    history: SpeedHistory
    modes: np.ndarray

    def moved(self, by: np.ndarray) -> SpeedHistory:
        """The history changed by so many standard deviations of each mode, shape (q,), and a last constant angle."""
        change = np.tensordot(by[:-1], self.modes, 1) if len(by) > 1 else 0.0
        constant = np.array([float(by[-1]), 0.0, 0.0, 0.0])
        return SpeedHistory(self.history.knots_s, np.ascontiguousarray(self.history.coefficients + change + constant))


def recorded_speed(run: Run, begin_s: float) -> RecordedSpeed:
    """The phase of a run from an instant on: from its angle in every row where it has one, else from its marks.

    Raises:
        OutsideDomain: fewer than four marks or time not ascending.
    """
    rows = (run.phase_time_s >= begin_s) & np.isfinite(run.phase_rad) if len(run.phase_time_s) else np.zeros(0, bool)
    if np.count_nonzero(rows) >= _SAMPLES:
        return speed_of_samples(run.phase_time_s[rows], run.phase_rad[rows])
    needed = run.mark_time_s >= begin_s
    needed[:2] = False  # two marks at the begin have no earlier ones to lean on
    history = speed_of_marks(run.mark_time_s[needed], run.mark_phase_rad[needed])
    return RecordedSpeed(history, np.zeros((0, *history.coefficients.shape)))


def speed_of_marks(time_s: np.ndarray, phase_rad: np.ndarray) -> SpeedHistory:
    """A speed history from noisy marks.

    Args:
        time_s, phase_rad: shape (n,), n ≥ 4, time strictly ascending.
    Raises:
        OutsideDomain: fewer than four marks or time not ascending.
    """
    through = SpeedHistory.from_phases(time_s, phase_rad)  # refuses what is no history
    n = len(time_s)
    if n < _FEWEST:
        return through
    line = np.polynomial.Polynomial.fit(time_s, phase_rad, 1)
    rest = phase_rad - line(time_s)
    best: BSpline | None = None
    least, used = np.inf, 0
    floor = (4 * np.finfo(float).eps * float(np.max(np.abs(phase_rad)))) ** 2 * n
    for pieces in _pieces(n / _MARKS_PER_PIECE):
        spline = make_lsq_spline(time_s, rest, _knots(time_s, pieces), 3)
        square = float(np.sum((spline(time_s) - rest) ** 2)) + floor
        more, left = pieces + 3 - used, n - pieces - 3
        if best is None or (left > 0 and (least / square - 1) * left / more > fdtri(more, left, 1 - _CHANCE)):
            best, least, used = spline, square, pieces + 3
    if best is None:
        raise OutsideDomain(f"{n} marks give no speed history")
    return _history(best, line)


def speed_of_samples(time_s: np.ndarray, phase_rad: np.ndarray) -> RecordedSpeed:
    """A speed history from an angle in every row.

    Args:
        time_s, phase_rad: shape (n,), time strictly ascending, the phase unwrapped.
    Raises:
        OutsideDomain: time not ascending.
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
        raise OutsideDomain(f"{len(count)} revolutions of the rotor's phase give no speed history; record longer")
    rest = phase_rad - line(time_s)
    middle = np.add.reduceat(time_s, first) / count
    value = np.add.reduceat(rest, first) / count
    step = encoder_step(np.diff(phase_rad))  # a rotor goes many steps from row to row, its speed changes by few
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
    """Variance of the block means that rounding a smooth phase of this speed leaves, rad²."""
    smooth = phase - rest + np.interp(np.arange(len(rest)), first, np.add.reduceat(rest, first) / count)
    total = 0.0
    for offset in np.arange(_OFFSETS) / _OFFSETS:
        moved = smooth / step + offset
        error = (np.round(moved) - moved) * step
        total += float(np.var(np.add.reduceat(error, first) / count))
    return total / _OFFSETS


def _fewest_pieces(
    time_s: np.ndarray, value: np.ndarray, root: np.ndarray, line: np.polynomial.Polynomial
) -> RecordedSpeed:
    """The first spline whose residual is noise, by whitened least squares; where none is, Akaike's."""
    n, data = len(time_s), np.linalg.solve(root, value)
    best, lowest = None, np.inf
    for pieces in _pieces(n / _MARKS_PER_PIECE):
        knots = _knots(time_s, pieces)
        basis = BSpline.design_matrix(time_s, knots, 3).toarray()
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
    knots, found, design, residual, basis = best
    stretch = max(1.0, float(residual @ residual) / max(1, n - len(found))) * correlation_inflation(residual, 4) ** 2
    history = _history(BSpline(knots, found, 3), line)
    return RecordedSpeed(history, _modes(knots, np.linalg.pinv(design) * np.sqrt(stretch), basis, time_s, history))


def _modes(
    knots: np.ndarray, spread: np.ndarray, basis: np.ndarray, time_s: np.ndarray, history: SpeedHistory
) -> np.ndarray:
    """Independent errors of the spline, the largest in phase first; a constant angle counts like any other."""
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
    """Coefficients of each piece's powers of time, shape (m, 4)."""
    parts = PPoly.from_spline(spline)
    return np.ascontiguousarray(parts.c[::-1, np.diff(parts.x) > 0].T)


def _history(spline: BSpline, line: np.polynomial.Polynomial) -> SpeedHistory:
    coefficients = _cubics(spline)
    edges = np.unique(spline.t)
    coefficients[:, 0] += line(edges[:-1])
    coefficients[:, 1] += float(line.deriv()(0.0))
    return SpeedHistory(edges, coefficients)

"""Measured rotor phase of a passage: smooth phase history as the drive of the model, and its noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from dynamics.equations.speed_history import SpeedHistory
from dynamics.errors import OutsideDomain
from identification.errors import NotIdentifiable
from identification.typed_scipy import toeplitz
from rig_basics.arrays import Array
from rig_basics.texts import number_of

_KNOTS_PER_TURN = 40  # twenty per period of a ripple of twice per revolution
_MIN_MARKS = 10
_MAX_SPEED_HZ = 200.0  # above any rig of this kind; a phase in degrees is 57 times too fast
_MAX_STEP_RAD = 0.95 * np.pi  # between samples of a phase; the number of turns is ambiguous above it
_QUANTILE = 0.98  # of the samples; the others may be gaps
_MIN_DIFFERENCES, _MIN_EVEN, _MIN_STRETCH = 80, 60, 20  # fifth differences: all, of even turns, of one stretch
_SKIPPED_MARKS = 2  # the end piece of the spline has a neighbour on one side only
_MIN_NOISE_RATIO = 1.5  # noise of the speed over the part due to white noise of the phase; chance is a tenth of 0.5
_MIN_FREQUENCY = np.pi / 10  # rad per turn
_OUTLIER_STD, _MIN_BEND = 6.0, 0.3  # standard deviations; change of a turn's duration over its usual change
_FIFTHS, _FOURTHS = np.array([1.0, -5, 10, -10, 5, -1]), np.array([1.0, -4, 6, -4, 1])
_FIFTH, _FOURTH = 252.0, 70.0  # variance of a fifth and a fourth difference of white noise
_TRIMMED = 0.6616  # rms of the smaller four fifths of a Gaussian's values; time stamps are too coarse for a median
_MAX_STEP_ERROR = 0.1  # of a step: largest deviation of a second difference from a whole number of steps
_SMOOTHED = 6  # knots of the phase per knot of the curve that is rounded again
_SCALE_SAMPLES = 20000  # samples for the quantile of a scale


@dataclass(frozen=True)
class Rounding:
    """Rounding of an encoder.

    Attributes:
        step_rad: step of the encoder, rad.
        reading_s: times of its readings, shape (n,), s.
        history: curve close to the phase that is smooth over many readings. A closer curve would follow the steps, and
            its rounding errors would all have the same sign.
    """

    step_rad: float
    reading_s: np.ndarray
    history: SpeedHistory


@dataclass(frozen=True)
class PhaseHistory:
    """Phase history and its noise.

    Attributes:
        history: ψ(t), twice differentiable.
        start_s, end_s: range of validity, s.
        noise_time_s, noise_density: power density of the phase's white noise (standard deviation² × spacing of the
            readings) at m instants, s and rad² s, shape (m,) each.
        mark_rad: ψ modulo one turn if it is known at this angle only, so that ripple within a turn is unknown; NaN if
            it is known at all angles.
        wander_density: density of a random walk of the phase, rad²/s, such as the integral of a noisy speed.
        rounding: rounding of an encoder, if its steps are most of the noise. noise_density is then the remainder.
        marks_s: instants of the marks, shape (k,), s, if the phase is interpolated between marks: each mark has an
            error of its own, and the phase has no noise that changes faster. None if it is read all the time.
    """

    history: SpeedHistory
    start_s: float
    end_s: float
    noise_time_s: np.ndarray
    noise_density: np.ndarray
    mark_rad: float = float("nan")
    wander_density: float = 0.0
    rounding: Rounding | None = None
    marks_s: Array | None = None

    @classmethod
    def from_samples(cls, time_s: np.ndarray, phase_rad: np.ndarray) -> PhaseHistory:
        """Build the phase from samples, wrapped or not. NaN is left out.

        Readings are averaged over a fortieth of the fastest turn. The mean is corrected for the curvature of the phase.

        Args:
            time_s, phase_rad: samples, shape (n,), s and rad; at least 200.
        Raises:
            NotIdentifiable: there are too few samples or less than two turns, the times do not rise, or the steps are
                too large for a rotor (a phase in degrees).
        """
        good = np.isfinite(phase_rad) & np.isfinite(time_s)
        time, phase = np.asarray(time_s, float)[good], np.asarray(phase_rad, float)[good]
        if len(time) < 200:
            raise NotIdentifiable(f"the phase has {number_of(len(time), 'valid sample')}; a passage needs at least 200")
        if np.any(np.diff(time) <= 0):
            raise NotIdentifiable("the times of a run-up must rise from sample to sample")
        phase = np.unwrap(phase) if _is_wrapped(phase) else phase
        every = slice(None, None, max(1, len(time) // _SCALE_SAMPLES))
        step = float(np.quantile(np.abs(np.diff(phase)), _QUANTILE))
        if step > _MAX_STEP_RAD:
            raise NotIdentifiable(
                f"the phase changes by {step:.3g} rad from sample to sample, {_MAX_STEP_RAD:.3g} at most can be "
                "followed; is the phase in radians and in order, and sampled more than twice a turn?"
            )
        noise = _white_noise(time, phase)
        fastest = float(np.quantile((np.abs(phase[20:] - phase[:-20]) / (time[20:] - time[:-20]))[every], 0.995))
        if fastest * (time[-1] - time[0]) < 4 * np.pi:
            raise NotIdentifiable("the rotor turns less than twice in this record; record the whole passage")
        if fastest > 2 * np.pi * _MAX_SPEED_HZ:
            raise NotIdentifiable(
                f"the phase turns at {fastest / (2 * np.pi):.4g} Hz, {_MAX_SPEED_HZ:g} Hz are expected at most; is the "
                "phase in radians and the time in seconds?"
            )
        width = 2 * np.pi / fastest / _KNOTS_PER_TURN
        first = np.flatnonzero(np.r_[True, np.diff(np.floor((time - time[0]) / width)) != 0])
        count = np.diff(np.r_[first, len(time)])
        middle, spread = _means(time - time[0], first, count)
        mean, _ = _means(phase - phase[0], first, count)
        middle, mean = middle + time[0], mean + phase[0]
        if count.max() > 1:
            bent = SpeedHistory.from_phases(middle, mean).phase(middle)[:, 2]
            mean = mean - 0.5 * spread * bent
        history = SpeedHistory.from_phases(middle, mean)
        apart = float(np.median(np.diff(time)[every]))
        wander = _wander(middle, mean, fastest / (2 * np.pi), noise**2 * apart)
        coarse = _encoder_step(phase)
        white = max(0.0, noise**2 - coarse**2 / 12) * apart
        rounding = Rounding(coarse, time, _sparse(middle, mean)) if coarse else None
        return cls(
            history,
            float(middle[0]),
            float(middle[-1]),
            time[[0, -1]],
            np.full(2, white),
            float("nan"),
            wander,
            rounding,
        )

    @classmethod
    def from_marks(cls, time_s: np.ndarray, phase_rad: np.ndarray) -> PhaseHistory:
        """Build the phase from tachometer marks, instants of known phase.

        Args:
            time_s, phase_rad: time and phase of the marks, shape (n,), s and rad.
        Raises:
            NotIdentifiable: there are fewer than ten marks, or they do not ascend.
        """
        if len(time_s) < _MIN_MARKS:
            raise NotIdentifiable(f"{number_of(len(time_s), 'tachometer mark')}; a run-up needs ten")
        try:
            history = SpeedHistory.from_phases(time_s, phase_rad)
        except OutsideDomain as error:
            raise NotIdentifiable(str(error)) from error
        middle = 0.5 * (time_s[1:] + time_s[:-1])
        speed = np.diff(phase_rad) / np.diff(time_s)
        jitter, wander = _mark_noise(time_s, phase_rad)
        density = (speed * jitter) ** 2 * np.diff(time_s)
        start, end = float(time_s[_SKIPPED_MARKS]), float(time_s[-_SKIPPED_MARKS])
        once = float(np.median(np.abs(np.diff(phase_rad)))) > np.pi
        mark = float(phase_rad[0] % (2 * np.pi)) if once else float("nan")
        return cls(history, start, end, middle, density, mark, wander, marks_s=time_s)


def _sparse(time_s: np.ndarray, phase_rad: np.ndarray) -> SpeedHistory:
    """Phase history through means of several neighbours."""
    first = np.arange(0, len(time_s), _SMOOTHED)
    count = np.diff(np.r_[first, len(time_s)])
    return SpeedHistory.from_phases(np.add.reduceat(time_s, first) / count, np.add.reduceat(phase_rad, first) / count)


def _encoder_step(phase: np.ndarray) -> float:
    """Step of a phase whose noise is mainly rounding, rad; 0 for another phase.

    Second differences of a rounded ramp are −2 … 2 steps of both signs at any speed. Those of an exact ramp are equal.
    """
    signed = np.diff(phase, 2)[:: max(1, len(phase) // _SCALE_SAMPLES)]
    bends = np.abs(signed)
    largest = float(np.quantile(bends, _QUANTILE))
    whole = bends[bends > 0.4 * largest]
    if largest < 1e-9 or len(whole) == 0:
        return 0.0
    smallest = float(np.median(whole[whole < 1.2 * float(np.min(whole))]))
    steps = bends / smallest
    on = (np.abs(steps - np.round(steps)) < _MAX_STEP_ERROR) & (steps < 2 + _MAX_STEP_ERROR)
    up, down = np.count_nonzero(signed > 0.5 * smallest), np.count_nonzero(signed < -0.5 * smallest)
    return smallest if np.mean(on) > _QUANTILE and min(up, down) > 0.5 * max(up, down) else 0.0


def _white_noise(time_s: np.ndarray, phase_rad: np.ndarray) -> float:
    """Standard deviation of a phase's white part from third divided differences, valid for uneven times."""
    offset = [time_s[k : len(time_s) - 3 + k] for k in range(4)]
    weights = np.array([1 / np.prod([one - other for other in offset if other is not one], axis=0) for one in offset])
    terms = [w * phase_rad[k : len(time_s) - 3 + k] for k, w in enumerate(weights)]
    third: Array = np.abs(np.sum(terms, axis=0)) / np.sqrt(np.sum(weights**2, axis=0))
    limit = 8 * float(np.median(third)) / 0.6745
    return float(np.sqrt(np.mean(np.clip(third, 0, limit if limit else np.inf) ** 2)))


def _is_wrapped(phase: np.ndarray) -> bool:
    return float(np.ptp(phase)) < 2.2 * np.pi and bool(np.any(np.abs(np.diff(phase)) > np.pi))


def _means(value: np.ndarray, first: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance of each stretch."""
    base = value[first]
    local = value - np.repeat(base, count)
    mean = np.add.reduceat(local, first) / count
    square = np.add.reduceat(local * local, first) / count
    return base + mean, np.maximum(square - mean * mean, 0.0)


def _wander(time_s: np.ndarray, phase_rad: np.ndarray, top_Hz: float, white: float) -> float:
    """Density of white noise in the speed, (rad/s)²/Hz, beyond the part due to white noise of the phase.

    The band is above three times the fastest speed and thus above ramp and ripple. White noise of the phase rises with
    the square of the frequency there; the noise of an integrated speed is constant.
    """
    step = float(np.mean(np.diff(time_s)))
    low, high = 3 * top_Hz + 10.0, min(6 * top_Hz + 20.0, 0.3 / step)
    even = np.interp(np.arange(time_s[0], time_s[-1], step), time_s, phase_rad)
    speed = np.diff(even) / step
    window = np.hanning(len(speed))
    frequency = np.fft.rfftfreq(len(speed), step)
    band = (frequency > low) & (frequency < high)
    if np.count_nonzero(band) < 50:
        return 0.0
    power = step * np.abs(np.fft.rfft((speed - speed.mean()) * window)[band]) ** 2 / np.sum(window**2)
    known = white * (2 * np.pi * frequency[band]) ** 2
    return float(np.mean(power - known)) if np.mean(power) > _MIN_NOISE_RATIO * np.mean(known) else 0.0


def _mark_noise(time_s: np.ndarray, phase_rad: np.ndarray) -> tuple[float, float]:
    """White error of a mark's time (s) and density of a random walk of the phase (rad²/s).

    Both come from fifth differences over neighbouring turns. A smooth passage has none. Wander that is too fast for the
    marks has some; it counts as the error of the interpolation. The spectrum of the differences decides which of both
    errors is present, and the other one is zero.
    """
    step = np.median(np.diff(phase_rad))
    fifth = np.diff(time_s, 5)
    turns = (phase_rad[5:] - phase_rad[:-5]) / step
    whole = np.flatnonzero(np.abs(turns - 5) < 1e-3)
    if len(whole) < 10:
        return 0.0, 0.0
    span = (time_s[whole + 5] - time_s[whole]) / 5
    quick = span <= np.median(span)  # fast turns, relative to which slow wander is slowest
    whole, span = whole[quick], span[quick]
    white = _trimmed_rms(fifth[whole]) / np.sqrt(_FIFTH)
    walk = _trimmed_rms(fifth[whole] * abs(step) / span**1.5) ** 2 / _FOURTH
    stretches = _even_stretches(time_s, fifth, whole, white)
    if len(whole) < _MIN_DIFFERENCES or sum(map(len, stretches)) < _MIN_EVEN:
        return white, walk  # too few for a decision: both are assumed
    return (0.0, walk) if _is_walk([fifth[one] for one in stretches]) else (white, 0.0)


def _even_stretches(time_s: np.ndarray, fifth: np.ndarray, whole: np.ndarray, white: float) -> list[np.ndarray]:
    """Stretches of the fifth differences at `whole` with evenly changing turns, each of at least 20 differences.

    At the end of a ramp the speed has a kink, which looks like a random walk. Differences are left out if they share a
    mark with an outlier, or with a difference over which the duration of a turn changes much less than usual.
    """
    bend = (time_s[5:] - time_s[4:-1] - time_s[1:-4] + time_s[:-5]) / 4
    usual = float(np.median(bend[whole]))
    apart = np.abs(fifth) > _OUTLIER_STD * white * np.sqrt(_FIFTH)
    apart |= bend * np.sign(usual) < _MIN_BEND * abs(usual) - 2 * white
    even = whole[~np.convolve(apart, np.ones(11), "same").astype(bool)[whole]]
    parts = np.split(even, np.flatnonzero(np.diff(even) > 1) + 1)
    return [part for part in parts if len(part) >= _MIN_STRETCH]


def _is_walk(stretches: list[np.ndarray]) -> bool:
    """Whether a random walk is more likely than white noise, given fifth differences of evenly spaced values.

    Fifth differences of white noise and the fourth differences that result from a walk are normal with known
    correlations. The likelihood is exact for periods below twenty turns. Slower changes belong to the passage.
    """
    gain = 0.0
    squares, count = np.zeros(2), 0
    for fifth in stretches:
        n = len(fifth)
        wave = np.arange(max(1, round(_MIN_FREQUENCY / np.pi * n)), n)
        quick = np.cos(np.pi * np.outer(wave, np.arange(n) + 0.5) / n) * np.sqrt(2 / n)
        seen = quick @ fifth
        count += len(seen)
        for which, weights in enumerate((_FIFTHS, _FOURTHS)):
            lag = np.correlate(weights, weights, "full")[len(weights) - 1 :]
            matrix = quick @ toeplitz(np.r_[lag, np.zeros(n - len(lag))]) @ quick.T
            solved = cast(Array, np.linalg.solve(matrix, seen))
            squares[which] += float(seen @ solved)
            gain += (0.5, -0.5)[which] * float(np.linalg.slogdet(matrix)[1])
    return bool(gain + 0.5 * count * np.log(squares[0] / squares[1]) > 0)


def _trimmed_rms(value: np.ndarray) -> float:
    left = np.sort(np.abs(value))[: int(0.8 * len(value))]
    return float(np.sqrt(np.mean(left**2)) / _TRIMMED)

"""Separable model of a passage: two forced oscillators measured by two rotated and delayed sensors.

The complete θ is (ln ω1, ln ζ1, ln ω2, ln ζ2, β, delay x, delay y, drift x, drift y, Re c1, Im c1, Re c2, Im c2). A
sample of a sensor with time stamp t shows the motion at t − delay − drift (t − middle), which relates the clock of the
sensor to that of the phase. The linear unknowns of each sensor are its complex amplitude (gain, zero of the phase), the
free oscillations of both modes, and a polynomial drift. A `Structure` states which elements of θ are free.

c1 and c2 are speed ripple between tachometer marks, which record one instant of each turn only: a phase of
ψ + 2|c1| sin(ψ + arg c1) + 2|c2| sin(2ψ + arg c2) drives with e^{iψ} + c1 e^{2iψ} − c1* + c2 e^{3iψ} − c2* e^{−iψ}.

A structure may add up to three further linear complex amplitudes per sensor (identification.run_up.slow_roll): run-out,
which the sensor shows at any speed, the response of the suspension to a bent shaft, and a motion that grows with the
square of the speed. If the suspension depends on amplitude, the response to the bow is part of the motion
(identification.run_up.bent_passage).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from identification.least_squares import SeparableBlock, linear_unknowns
from identification.ring_down.modes import rate_derivatives
from identification.run_up.bent_passage import MOTION, BentPassage, Sensed
from identification.run_up.forced_oscillator import Excitation, Response, responses_at, responses_of
from identification.run_up.slow_roll import PhasorMeans, bow_answer, turning
from identification.samples import Averages

OMEGAS, ZETAS, ANGLE, DELAYS, DRIFTS, RIPPLE, PARAMETERS = (0, 2), (1, 3), 4, slice(5, 7), slice(7, 9), slice(9, 13), 13
TERMS, RATIO = slice(13, 17), 17  # of θ with an amplitude-dependent suspension: H1, H2, Q1, Q2; ln(gain y / gain x)
AXIS_PRIOR_STD = np.radians(30.0)  # the data determine β; the prior only prevents an exchange of x and y
_SLOW_ROLL = 6  # index of the slow roll in a sensor's linear unknowns, after the imbalance and the free oscillations
_MAX_CACHED = 2  # sets of responses: for the best θ and for the one that is tried next
_SHARES, _PARTS = (0.0, 0.25, 0.5, 0.75), (1.0, 0.5, 0.25, 0.1)  # of terms; of a step
_MAX_FIRST_STEPS, _MAX_STEPS, _TOLERANCE = 4, 12, 1e-6  # Newton steps; step size relative to the amplitude
CLOCKS = slice(DELAYS.start, DRIFTS.stop)


@dataclass(frozen=True)
class RunUpRecord:
    """Block averages of both sensors and their drive.

    Attributes:
        x, y: block averages of the sensors.
        drive: e^{iψ} over their span.
        recent: cache of the latest responses, since a solution is evaluated several times.
        bent: amplitude dependence of the suspension; None for a linear one.
    """

    x: Averages
    y: Averages
    drive: Excitation
    recent: dict[tuple[float, ...], list[list[Response]]] = field(
        default_factory=dict[tuple[float, ...], list[list[Response]]], repr=False, compare=False
    )
    bent: BentPassage | None = None

    @property
    def channels(self) -> tuple[Averages, Averages]:
        """Block averages of x and y."""
        return self.x, self.y

    @property
    def middle_s(self) -> float:
        """Middle of the drive's span, s."""
        return 0.5 * (self.drive.start_s + self.drive.end_s)

    def when(self, theta: np.ndarray, axis: int) -> np.ndarray:
        """Times of a sensor's blocks on the clock of the phase, shape (n,), s."""
        time = self.channels[axis].time_s
        return time - theta[DELAYS][axis] - theta[DRIFTS][axis] * (time - self.middle_s)

    def responses(self, theta: np.ndarray, oscillators: list[tuple[float, float]]) -> list[list[Response]]:
        """Responses of each oscillator in the blocks of each sensor, [sensor][oscillator]."""
        key = (*(value for one in oscillators for value in one), *theta[CLOCKS].tolist())
        if key not in self.recent:
            sensors = [(self.when(theta, axis), c.spread_s2) for axis, c in enumerate(self.channels)]
            while len(self.recent) >= _MAX_CACHED:
                del self.recent[next(iter(self.recent))]
            self.recent[key] = responses_of(sensors, self.drive, oscillators)
        return self.recent[key]


@dataclass(frozen=True)
class Structure:
    """Structure of a model: θ = base + spread @ φ, with a Gaussian prior of φ.

    Attributes:
        base: shape (13,), or (18,) with the suspension's terms.
        spread: matrix of zeros and ones, shape (13 or 18, p).
        prior, prior_std: prior of φ, shape (p,). The std is inf without a prior.
        drift_order: order of the sensors' polynomial drift.
        run_out, bow, growing: whether the model contains run-out, a bow, and a motion that grows with the square of the
            speed.
    """

    base: np.ndarray
    spread: np.ndarray
    prior: np.ndarray
    prior_std: np.ndarray
    drift_order: int
    run_out: bool = False
    bow: bool = False
    growing: bool = False

    @property
    def run_out_at(self) -> slice:
        """Indices of the run-out in a sensor's linear unknowns; empty without it."""
        return slice(_SLOW_ROLL, _SLOW_ROLL + 2 * self.run_out)

    @property
    def bow_at(self) -> slice:
        """Indices of the bow in a sensor's linear unknowns; empty without it."""
        return slice(self.run_out_at.stop, self.run_out_at.stop + 2 * self.bow)

    @property
    def growing_at(self) -> slice:
        """Indices of the growing motion in a sensor's linear unknowns; empty without it."""
        return slice(self.bow_at.stop, self.bow_at.stop + 2 * self.growing)

    @property
    def turning(self) -> tuple[bool, bool, bool]:
        """Whether the model contains run-out, a bow and a growing motion."""
        return self.run_out, self.bow, self.growing

    @property
    def motion_at(self) -> np.ndarray:
        """Indices of the linear unknowns on which the motion of a bent passage depends."""
        return np.r_[0:MOTION, self.bow_at]

    def theta(self, phi: np.ndarray) -> np.ndarray:
        """Complete θ of φ."""
        return self.base + self.spread @ phi

    def without(self, *rows: int) -> Structure:
        """Return the structure with some elements of θ fixed at zero."""
        keep = ~self.spread[list(rows)].any(axis=0)
        return replace(self, spread=self.spread[:, keep], prior=self.prior[keep], prior_std=self.prior_std[keep])

    def with_more(self, rows: slice, std: Sequence[float]) -> Structure:
        """Return the structure with further free elements of θ, with a prior of the given std about zero."""
        more = np.eye(len(self.base))[:, rows]
        return replace(
            self,
            spread=np.hstack([self.spread, more]),
            prior=np.r_[self.prior, np.zeros(len(std))],
            prior_std=np.r_[self.prior_std, std],
        )

    def only(self, rows: slice, theta: np.ndarray) -> Structure:
        """Return the structure in which only these elements are free; the others have the values of θ."""
        more = np.eye(len(self.base))[:, rows]
        base = theta - more @ theta[rows]
        return replace(self, base=base, spread=more, prior=theta[rows], prior_std=np.full(more.shape[1], np.inf))

    def project(self, theta: np.ndarray) -> np.ndarray:
        """Return the φ closest to a θ."""
        return np.linalg.lstsq(self.spread, theta - self.base, rcond=None)[0]


def free_structure(prior: np.ndarray, prior_std: np.ndarray, drift_order: int) -> Structure:
    """Return a structure whose free elements are those with a non-zero prior std; the others equal their prior."""
    free = prior_std > 0
    base = np.where(free, 0.0, prior)
    return Structure(base, np.eye(len(prior))[:, free], prior[free], prior_std[free], drift_order)


def run_up_blocks(record: RunUpRecord, structure: Structure, phi: np.ndarray) -> list[SeparableBlock]:
    """Evaluate the model at φ, one block per sensor."""
    theta = structure.theta(phi)
    oscillators = oscillators_of(theta)
    if record.bent is not None:
        return [_bent_block(record, record.bent, axis, structure, theta, oscillators) for axis in range(2)]
    return [_sensor_block(record, axis, structure, theta, oscillators) for axis in range(2)]


def _bent_block(
    record: RunUpRecord,
    bent: BentPassage,
    axis: int,
    structure: Structure,
    theta: np.ndarray,
    oscillators: list[tuple[float, float]],
) -> SeparableBlock:
    """Block of a sensor, linearised about the motion of its own linear unknowns, which Newton's method determines."""
    about = partial(_about, record, bent, axis, structure, theta, oscillators)
    at = structure.motion_at
    if axis in bent.starts:
        c, block, _ = _newton(about, at, _as_long(bent.starts[axis], len(at)), _MAX_STEPS)
    else:
        grown = linear_unknowns(_sensor_block(record, axis, structure, theta, oscillators))[at]
        for share in _SHARES:  # continuation from the linear motion to the complete terms
            grown = _newton(partial(about, share=share), at, grown, _MAX_FIRST_STEPS)[0]
        nominal = _as_long(np.array([bent.amplitude_m.real, bent.amplitude_m.imag]), len(at))
        tried = [_newton(about, at, start, _MAX_STEPS) for start in (grown, nominal)]
        c, block, _ = min(tried, key=lambda each: each[2])
    if np.all(np.isfinite(c)):
        bent.starts[axis] = c
    return block


def _about(
    record: RunUpRecord,
    bent: BentPassage,
    axis: int,
    structure: Structure,
    theta: np.ndarray,
    oscillators: list[tuple[float, float]],
    c: np.ndarray,
    share: float = 1.0,
) -> SeparableBlock:
    """Block of a sensor, linearised about the motion of given linear unknowns, with a share of the terms."""
    instants = record.when(theta, axis), record.channels[axis].spread_s2
    own, ratio = share * theta[TERMS], float(np.exp(theta[RATIO]))
    sensed = bent.sensed(record.drive, axis, float(theta[ANGLE]), oscillators, own, ratio, instants, c)
    return _sensor_block(record, axis, structure, theta, oscillators, sensed)


def _as_long(c: np.ndarray, length: int) -> np.ndarray:
    """Adapt linear unknowns to a structure without a bow, or with a bow of zero."""
    return np.pad(c, (0, max(0, length - len(c))))[:length]


def _newton(
    about: Callable[[np.ndarray], SeparableBlock], at: np.ndarray, c: np.ndarray, most: int
) -> tuple[np.ndarray, SeparableBlock, float]:
    """Linear unknowns that solve the block linearised about them, the block, and its sum of squared residuals."""
    block = about(c)
    left = _left(block, at, c)
    for _ in range(most):
        step = linear_unknowns(block)[at] - c
        if not np.all(np.isfinite(step)) or np.max(np.abs(step)) < _TOLERANCE * np.hypot(*c[:2]):
            break
        for part in _PARTS:
            trial = about(c + part * step)
            trial_left = _left(trial, at, c + part * step)
            if trial_left < left * (1 + _TOLERANCE):
                break
        else:
            break
        c, block, left = c + part * step, trial, trial_left
    return c, block, left


def _left(block: SeparableBlock, at: np.ndarray, c: np.ndarray) -> float:
    """Sum of squared residuals of a block for given values of some of its linear unknowns."""
    others = np.setdiff1d(np.arange(block.basis.shape[1], dtype=np.intp), at)
    rest = SeparableBlock(block.data - block.basis[:, at] @ c, block.basis[:, others], block.tangent)
    left = rest.data - rest.basis @ linear_unknowns(rest)
    found = float(left @ left)
    return found if np.isfinite(found) else np.inf


def oscillators_of(theta: np.ndarray) -> list[tuple[float, float]]:
    """Natural frequency ω, rad/s, and damping ratio ζ of both modes."""
    return [
        (float(np.exp(np.clip(theta[w], -3.0, 8.0))), float(np.exp(np.clip(theta[z], -16.0, -0.05))))
        for w, z in zip(OMEGAS, ZETAS, strict=True)
    ]


def drift_columns(structure: Structure, from_middle: np.ndarray) -> list[np.ndarray]:
    """Columns 1, s, s² … with s from −1 to 1 over the record."""
    s = from_middle / max(float(np.abs(from_middle).max()), 1e-9)
    return [s**k for k in range(structure.drift_order + 1)]


def _ripple(
    when_s: np.ndarray, channel: Averages, drive: Excitation, oscillators: list[tuple[float, float]]
) -> np.ndarray:
    """Derivatives ∂h/∂(Re c1, Im c1, Re c2, Im c2) of both oscillators, shape (2, 4, n)."""
    back, second, third = (responses_at(when_s, channel.spread_s2, drive.order(k), oscillators) for k in (-1, 2, 3))
    return np.array([[s.h, 1j * s.h, t.h - b.h, 1j * (t.h + b.h)] for b, s, t in zip(back, second, third, strict=True)])


def _sensor_block(
    record: RunUpRecord,
    axis: int,
    structure: Structure,
    theta: np.ndarray,
    oscillators: list[tuple[float, float]],
    given: Sensed | None = None,
) -> SeparableBlock:
    channel, drive = record.channels[axis], record.drive
    from_middle = channel.time_s - record.middle_s
    cos, sin = np.cos(theta[ANGLE]), np.sin(theta[ANGLE])
    # x = Re(A h1), y = Im(A h2) = Re(−i A h2): both are Re(A times a complex signal)
    mix = ((cos, -1j * sin), (-sin, -1j * cos))[axis]
    turned = ((-sin, -1j * cos), (-cos, 1j * sin))[axis]
    seen = record.responses(theta, oscillators)[axis] if given is None else given.responses
    ripple = (
        _ripple(record.when(theta, axis), channel, drive, oscillators)
        if structure.spread[RIPPLE].any()
        else np.zeros((2, 4, 1))
    )
    shown = [seen[mode].h + theta[RIPPLE] @ ripple[mode] for mode in range(2)]
    whole = shown if given is None else [q + theta[RIPPLE] @ r for q, r in zip(given.whole, ripple, strict=True)]
    signal = mix[0] * shown[0] + mix[1] * shown[1]
    columns = [np.real(signal), -np.imag(signal)]
    for one in seen:
        columns += [np.real(one.decay), -np.imag(one.decay)]
    slow: list[_Slow] = []
    if any(structure.turning):
        turn = turning(drive, record.when(theta, axis), channel.spread_s2)
        slow = _slow_roll(structure, turn, oscillators, seen, axis, (mix, turned), given)
    for one in slow:
        columns += [np.real(one.signal), -np.imag(one.signal)]
    weight = channel.weight
    basis = np.column_stack([*columns, *drift_columns(structure, from_middle)]) * weight[:, None]

    def tangent(c: np.ndarray) -> np.ndarray:
        amplitude = complex(c[0], c[1])
        out = np.zeros((len(theta), len(from_middle)))
        for mode in range(2):
            factor = amplitude * mix[mode]
            out[2 * mode] = (factor * seen[mode].by_omega).real
            out[2 * mode + 1] = (factor * seen[mode].by_zeta).real
            out[ANGLE] += (amplitude * turned[mode] * whole[mode]).real
            out[RIPPLE] += (factor * ripple[mode]).real
            out[DELAYS.start + axis] -= (factor * seen[mode].rate).real
            free = complex(c[2 + 2 * mode], c[3 + 2 * mode])
            for k, derivative in enumerate(rate_derivatives(*oscillators[mode])):
                out[2 * mode + k] += (free * derivative * seen[mode].decay_slope).real
        for k, one in enumerate(slow):
            factor = complex(c[_SLOW_ROLL + 2 * k], c[_SLOW_ROLL + 1 + 2 * k])
            for row, by in one.by.items():
                out[row] += (factor * by).real
            out[DELAYS.start + axis] -= (factor * one.rate).real
        if given is not None:
            out[TERMS], out[RATIO] = given.by_terms.T, given.by_ratio
        out[DRIFTS.start + axis] = out[DELAYS.start + axis] * from_middle
        return (out.T @ structure.spread) * weight[:, None]

    value = channel.value if given is None else channel.value - given.offset
    return SeparableBlock(value * weight, basis, tangent)


def _blocks_about_last(record: RunUpRecord, structure: Structure, phi: np.ndarray) -> list[SeparableBlock]:
    """Model at φ, linearised about the motion that was last found, for a structure with other free elements."""
    bent = record.bent
    if bent is None or len(bent.starts) < len(record.channels):
        return run_up_blocks(record, structure, phi)
    theta = structure.theta(phi)
    oscillators = oscillators_of(theta)
    return [
        _about(record, bent, axis, structure, theta, oscillators, _as_long(start, len(structure.motion_at)))
        for axis, start in sorted(bent.starts.items())
    ]


@dataclass(frozen=True)
class _Slow:
    """Further motion once per turn in a sensor's signal.

    Attributes:
        signal, rate: complex, shape (n,).
        by: derivatives of the signal by index of θ.
    """

    signal: np.ndarray
    rate: np.ndarray
    by: dict[int, np.ndarray]


def slow_roll_columns(record: RunUpRecord, structure: Structure, phi: np.ndarray) -> np.ndarray:
    """Columns of run-out, bow and growing motion for a model without them, shape (3, n, 4), in standard deviations."""
    wider = replace(structure, run_out=True, bow=True, growing=True)
    blocks = _blocks_about_last(record, wider, phi)
    first = len(blocks[0].data)
    out = np.zeros((3, first + len(blocks[1].data), 4))
    for k, at in enumerate((wider.run_out_at, wider.bow_at, wider.growing_at)):
        out[k, :first, :2], out[k, first:, 2:] = (block.basis[:, at] for block in blocks)
    return out


def _slow_roll(
    structure: Structure,
    turn: PhasorMeans,
    oscillators: list[tuple[float, float]],
    seen: list[Response],
    axis: int,
    mixes: tuple[Sequence[complex], Sequence[complex]],
    given: Sensed | None,
) -> list[_Slow]:
    """Run-out, bow and growing motion of the structure.

    Args:
        structure: model.
        turn: means of e^{iψ} in the sensor's blocks.
        oscillators, seen: oscillators and their responses.
        axis: 0 for sensor x, 1 for y.
        mixes: factors of both oscillators in the sensor, and their derivatives by β.
        given: motion of a bent passage. The bow is part of it, and its derivatives are those of its amplitude.
    """
    found: list[_Slow] = []
    own = (1.0, -1j)[axis]  # sensor x shows Re(r e^{iψ}), sensor y Im(r e^{iψ})
    if structure.run_out:
        found.append(_Slow(own * turn.phasor, own * turn.rate, {}))
    if structure.bow and given is not None:
        found.append(_Slow(given.bow, np.zeros_like(given.bow), {}))
    elif structure.bow:
        mix, turned = mixes
        answers = [bow_answer(one, turn, *mode) for one, mode in zip(seen, oscillators, strict=True)]
        by = {ANGLE: turned[0] * answers[0].h + turned[1] * answers[1].h}
        for mode, answer in enumerate(answers):
            by[2 * mode], by[2 * mode + 1] = mix[mode] * answer.by_omega, mix[mode] * answer.by_zeta
        a, b = answers
        found.append(_Slow(mix[0] * a.h + mix[1] * b.h, mix[0] * a.rate + mix[1] * b.rate, by))
    if structure.growing:
        found.append(_Slow(own * turn.grown, own * turn.grown * turn.rate / turn.phasor, {}))
    return found

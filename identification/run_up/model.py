"""The separable model of a passage: two forced oscillators seen by two rotated, delayed sensors.

The whole θ is (ln ω1, ln ζ1, ln ω2, ln ζ2, β, delay x, delay y, drift x, drift y, Re c1, Im c1, Re c2, Im c2). A
sensor's sample stamped t shows the motion at t − delay − drift (t − middle): its clock against the phase's. Each sensor
has its own complex amplitude (gain, and what the phase's zero leaves), free oscillations of both modes and a polynomial
drift, all linear. A `Structure` says which of θ are free.

c1 and c2 are speed ripple between tachometer marks, which see one instant of each turn only: a phase of
ψ + 2|c1| sin(ψ + arg c1) + 2|c2| sin(2ψ + arg c2) drives with e^{iψ} + c1 e^{2iψ} − c1* + c2 e^{3iψ} − c2* e^{−iψ}.

A structure may add the slow roll, two complex amplitudes more per sensor, linear too (identification.run_up.slow_roll):
run-out, which the sensor shows at any speed, and the answer of the suspension to a bent shaft. Where the suspension
depends on the motion, that answer is part of the motion (identification.run_up.bent_passage).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from identification.least_squares import Block, linear_unknowns
from identification.ring_down.modes import rate_derivatives
from identification.run_up.bent_passage import MOTION, BentPassage, Sensed
from identification.run_up.forced_oscillator import Drive, Response, responses_at, responses_of
from identification.run_up.slow_roll import Turning, bow_answer, turning
from identification.samples import Averages

OMEGAS, ZETAS, ANGLE, DELAYS, DRIFTS, RIPPLE, PARAMETERS = (0, 2), (1, 3), 4, slice(5, 7), slice(7, 9), slice(9, 13), 13
TERMS, RATIO = slice(13, 17), 17  # of θ where the suspension depends on the motion: H1, H2, Q1, Q2; ln of gain y over x
AXIS_PRIOR_STD = np.radians(30.0)  # the data determine β; this only keeps x from being called y
_SLOW_ROLL = 6  # linear unknowns of a sensor before it: the imbalance's amplitude, free oscillations
_REMEMBERED = 2  # sets of responses: of the best θ and of the one tried after it
_SHARES, _PARTS = (0.0, 0.25, 0.5, 0.75), (1.0, 0.5, 0.25, 0.1)  # of terms; of a step
_FIRST, _NEWTON, _SETTLED = 4, 12, 1e-6  # steps; of the amplitude
CLOCKS = slice(DELAYS.start, DRIFTS.stop)


@dataclass(frozen=True)
class RunUpRecord:
    """Both sensors' block averages and the drive that covers them.

    Attributes:
        x, y: the block averages.
        drive: e^{iψ} over their span.
        recent: responses last computed, as a solution is looked at several times.
        bent: how the suspension changes with the motion; None where it does not.
    """

    x: Averages
    y: Averages
    drive: Drive
    recent: dict[tuple[float, ...], list[list[Response]]] = field(default_factory=dict, repr=False, compare=False)
    bent: BentPassage | None = None

    @property
    def channels(self) -> tuple[Averages, Averages]:
        """x and y."""
        return self.x, self.y

    @property
    def middle_s(self) -> float:
        """The middle of the drive's span."""
        return 0.5 * (self.drive.start_s + self.drive.end_s)

    def when(self, theta: np.ndarray, axis: int) -> np.ndarray:
        """When a sensor's blocks saw what they show, on the phase's clock; shape (n,), s."""
        time = self.channels[axis].time_s
        return time - theta[DELAYS][axis] - theta[DRIFTS][axis] * (time - self.middle_s)

    def responses(self, theta: np.ndarray, oscillators: list[tuple[float, float]]) -> list[list[Response]]:
        """What either sensor sees of each oscillator."""
        key = (*(value for one in oscillators for value in one), *theta[CLOCKS].tolist())
        if key not in self.recent:
            sensors = [(self.when(theta, axis), c.spread_s2) for axis, c in enumerate(self.channels)]
            while len(self.recent) >= _REMEMBERED:
                del self.recent[next(iter(self.recent))]
            self.recent[key] = responses_of(sensors, self.drive, oscillators)
        return self.recent[key]


@dataclass(frozen=True)
class Structure:
    """Which model: θ = base + spread @ φ, with a Gaussian prior of φ.

    Attributes:
        base: shape (13,), with the suspension's terms (18,).
        spread: shape (13 or 18, p), of zeros and ones.
        prior, prior_std: of φ, shape (p,); std inf where nothing is known.
        drift_order: of the sensors' polynomial drift.
        run_out, bow: whether either is in the model.
    """

    base: np.ndarray
    spread: np.ndarray
    prior: np.ndarray
    prior_std: np.ndarray
    drift_order: int
    run_out: bool = False
    bow: bool = False

    @property
    def run_out_at(self) -> slice:
        """Places of the run-out among a sensor's linear unknowns; empty without it."""
        return slice(_SLOW_ROLL, _SLOW_ROLL + 2 * self.run_out)

    @property
    def bow_at(self) -> slice:
        """Places of the bow among a sensor's linear unknowns; empty without it."""
        return slice(self.run_out_at.stop, self.run_out_at.stop + 2 * self.bow)

    @property
    def motion_at(self) -> np.ndarray:
        """Places of the linear unknowns that a bent passage's motion depends on."""
        return np.r_[0:MOTION, self.bow_at]

    def theta(self, phi: np.ndarray) -> np.ndarray:
        """The whole θ."""
        return self.base + self.spread @ phi

    def without(self, *rows: int) -> Structure:
        """The same with some of θ fixed at zero."""
        keep = ~self.spread[list(rows)].any(axis=0)
        return replace(self, spread=self.spread[:, keep], prior=self.prior[keep], prior_std=self.prior_std[keep])

    def with_more(self, rows: slice, std: Sequence[float]) -> Structure:
        """The same with further θ free, about zero within std."""
        more = np.eye(len(self.base))[:, rows]
        return replace(
            self,
            spread=np.hstack([self.spread, more]),
            prior=np.r_[self.prior, np.zeros(len(std))],
            prior_std=np.r_[self.prior_std, std],
        )

    def only(self, rows: slice, theta: np.ndarray) -> Structure:
        """Nothing free but these; the others at θ."""
        more = np.eye(len(self.base))[:, rows]
        base = theta - more @ theta[rows]
        return replace(self, base=base, spread=more, prior=theta[rows], prior_std=np.full(more.shape[1], np.inf))

    def project(self, theta: np.ndarray) -> np.ndarray:
        """φ nearest to a θ."""
        return np.linalg.lstsq(self.spread, theta - self.base, rcond=None)[0]


def free_structure(prior: np.ndarray, prior_std: np.ndarray, drift_order: int) -> Structure:
    """Every θ free whose prior standard deviation is not zero; the others stay at their prior."""
    free = prior_std > 0
    base = np.where(free, 0.0, prior)
    return Structure(base, np.eye(len(prior))[:, free], prior[free], prior_std[free], drift_order)


def run_up_blocks(record: RunUpRecord, structure: Structure, phi: np.ndarray) -> list[Block]:
    """The model at φ, one block per sensor."""
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
) -> Block:
    """A sensor's block, linear about the motion that its own linear unknowns make: Newton's method for these."""
    about = partial(_about, record, bent, axis, structure, theta, oscillators)
    at = structure.motion_at
    if axis in bent.starts:
        c, block, _ = _newton(about, at, _as_long(bent.starts[axis], len(at)), _NEWTON)
    else:
        grown = linear_unknowns(_sensor_block(record, axis, structure, theta, oscillators))[at]
        for share in _SHARES:  # out of the linear motion, as the terms grow
            grown = _newton(partial(about, share=share), at, grown, _FIRST)[0]
        nominal = _as_long(np.array([bent.amplitude_m.real, bent.amplitude_m.imag]), len(at))
        tried = [_newton(about, at, start, _NEWTON) for start in (grown, nominal)]
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
) -> Block:
    """A sensor's block about the motion of given linear unknowns, with a share of the suspension's terms."""
    instants = record.when(theta, axis), record.channels[axis].spread_s2
    own, ratio = share * theta[TERMS], float(np.exp(theta[RATIO]))
    sensed = bent.sensed(record.drive, axis, float(theta[ANGLE]), oscillators, own, ratio, instants, c)
    return _sensor_block(record, axis, structure, theta, oscillators, sensed)


def _as_long(c: np.ndarray, length: int) -> np.ndarray:
    """Linear unknowns of another structure: without the bow, or with one of zero."""
    return np.pad(c, (0, max(0, length - len(c))))[:length]


def _newton(
    about: Callable[[np.ndarray], Block], at: np.ndarray, c: np.ndarray, most: int
) -> tuple[np.ndarray, Block, float]:
    """The linear unknowns at which a block that is linear about them stays, the block, and what it leaves."""
    block = about(c)
    left = _left(block, at, c)
    for _ in range(most):
        step = linear_unknowns(block)[at] - c
        if not np.all(np.isfinite(step)) or np.max(np.abs(step)) < _SETTLED * np.hypot(*c[:2]):
            break
        for part in _PARTS:
            trial = about(c + part * step)
            trial_left = _left(trial, at, c + part * step)
            if trial_left < left * (1 + _SETTLED):
                break
        else:
            break
        c, block, left = c + part * step, trial, trial_left
    return c, block, left


def _left(block: Block, at: np.ndarray, c: np.ndarray) -> float:
    """Squares of what a block leaves of whose linear unknowns some are given."""
    others = np.setdiff1d(np.arange(block.basis.shape[1]), at)
    rest = Block(block.data - block.basis[:, at] @ c, block.basis[:, others], block.tangent)
    left = rest.data - rest.basis @ linear_unknowns(rest)
    found = float(left @ left)
    return found if np.isfinite(found) else np.inf


def oscillators_of(theta: np.ndarray) -> list[tuple[float, float]]:
    """ω and ζ of both modes."""
    return [
        (float(np.exp(np.clip(theta[w], -3.0, 8.0))), float(np.exp(np.clip(theta[z], -16.0, -0.05))))
        for w, z in zip(OMEGAS, ZETAS, strict=True)
    ]


def drift_columns(structure: Structure, from_middle: np.ndarray) -> list[np.ndarray]:
    """1, s, s² … with s from −1 to 1 over the record."""
    s = from_middle / max(float(np.abs(from_middle).max()), 1e-9)
    return [s**k for k in range(structure.drift_order + 1)]


def _ripple(when_s: np.ndarray, channel: Averages, drive: Drive, oscillators: list[tuple[float, float]]) -> np.ndarray:
    """∂h/∂(Re c1, Im c1, Re c2, Im c2) of either oscillator, shape (2, 4, n)."""
    back, second, third = (responses_at(when_s, channel.spread_s2, drive.order(k), oscillators) for k in (-1, 2, 3))
    return np.array([[s.h, 1j * s.h, t.h - b.h, 1j * (t.h + b.h)] for b, s, t in zip(back, second, third, strict=True)])


def _sensor_block(
    record: RunUpRecord,
    axis: int,
    structure: Structure,
    theta: np.ndarray,
    oscillators: list[tuple[float, float]],
    given: Sensed | None = None,
) -> Block:
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
    slow = _slow_roll(
        structure, record.when(theta, axis), channel, drive, oscillators, seen, axis, (mix, turned), given
    )
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
    return Block(value * weight, basis, tangent)


def _blocks_as_they_are(record: RunUpRecord, structure: Structure, phi: np.ndarray) -> list[Block]:
    """The model at φ about the motion last found, whatever else the structure lets free."""
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
    """One part of the slow roll as a sensor shows it, complex, shape (n,), its rate and ∂/∂θ by row."""

    signal: np.ndarray
    rate: np.ndarray
    by: dict[int, np.ndarray]


def slow_roll_columns(record: RunUpRecord, structure: Structure, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How run-out and bow, so far not in the model, would move the data: shape (n, 4) each, in standard deviations."""
    wider = replace(structure, run_out=True, bow=True)
    blocks = _blocks_as_they_are(record, wider, phi)
    first = len(blocks[0].data)
    out = np.zeros((2, first + len(blocks[1].data), 4))
    for k, at in enumerate((wider.run_out_at, wider.bow_at)):
        out[k, :first, :2], out[k, first:, 2:] = (block.basis[:, at] for block in blocks)
    return out[0], out[1]


def _slow_roll(
    structure: Structure,
    when_s: np.ndarray,
    channel: Averages,
    drive: Drive,
    oscillators: list[tuple[float, float]],
    seen: list[Response],
    axis: int,
    mixes: tuple[Sequence[complex], Sequence[complex]],
    given: Sensed | None,
) -> list[_Slow]:
    """Run-out and bow, whichever the structure has; mixes: of both oscillators in a sensor, and its slope by β.

    A bow is part of a bent passage's motion, whose derivatives go with its amplitude.
    """
    if not (structure.run_out or structure.bow):
        return []
    turn: Turning = turning(drive, when_s, channel.spread_s2)
    found = []
    if structure.run_out:
        own = (1.0, -1j)[axis]  # sensor x shows Re(r e^{iψ}), sensor y Im(r e^{iψ})
        found.append(_Slow(own * turn.phasor, own * turn.rate, {}))
    if structure.bow and given is not None:
        found.append(_Slow(given.bow, np.zeros_like(given.bow), {}))
    elif structure.bow:
        mix, turned = mixes
        answers = [bow_answer(one, turn, *own) for one, own in zip(seen, oscillators, strict=True)]
        by = {ANGLE: turned[0] * answers[0].h + turned[1] * answers[1].h}
        for mode, answer in enumerate(answers):
            by[2 * mode], by[2 * mode + 1] = mix[mode] * answer.by_omega, mix[mode] * answer.by_zeta
        a, b = answers
        found.append(_Slow(mix[0] * a.h + mix[1] * b.h, mix[0] * a.rate + mix[1] * b.rate, by))
    return found

"""Data of a ring-down's fit: channels, fitted span, priors, and a solved model."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from identification.errors import FitFailed, NotIdentifiable
from identification.least_squares import Minimum, Solution, solve_separable
from identification.lines import SpectralLine
from identification.ring_down.averaging import corrected
from identification.ring_down.model import BETA, DELAYS, RATIO, DecayModel, DecayRecord, rotation
from identification.ring_down.record import SensorRecord
from identification.samples import Averages
from rig_basics.texts import distinct, number_of

_log = logging.getLogger(__name__)

_T = TypeVar("_T")
COARSE_S = 1 / 250.0  # duration of the blocks for start values: 20 per cycle up to 12.5 Hz
_MIN_BLOCKS, _MIN_CYCLES = 24, 1.5
_MAX_ITERATIONS = 100  # a close pair needs many
_START_ITERATIONS = 3  # from each of several start values
_CORRECTIONS = 3  # each reduces the error of amplitudes and exact motion to a thirtieth at 3 % of stiffness


@dataclass(frozen=True)
class Priors:
    """Priors of a turned pair: standard deviations about zero.

    Attributes:
        axis_rad: axis angle (mounting of the sensors), rad.
        ratio: logarithm of the ratio of the sensors' gains.
        delay_s: delay between the clocks of the two lasers, s; 0 for a common clock.
    """

    axis_rad: float = np.radians(30.0)
    ratio: float = 2e-3
    delay_s: float = 0.0


@dataclass(frozen=True)
class DecayData:
    """Channels of every record with the start and end of the fitted span, s."""

    records: tuple[tuple[SensorRecord, ...], ...]
    begins: tuple[float, ...]
    ends: tuple[float, ...]

    def averages(self, width_s: float) -> list[list[Averages]]:
        """Block averages of the channels of every record within its span.

        Raises:
            NotIdentifiable: a span has fewer than 24 blocks.
        """
        out: list[list[Averages]] = []
        for channels, begin, end in zip(self.records, self.begins, self.ends, strict=True):
            own = [c.averages(width_s, begin, end) for c in channels]
            if any(len(a.time_s) < _MIN_BLOCKS for a in own):
                found, needed = distinct(min(len(a.time_s) for a in own) * width_s, _MIN_BLOCKS * width_s)
                raise NotIdentifiable(
                    f"only {found} s with readings after the release at {begin:.4g} s, {needed} s are needed; record "
                    "at least a few cycles of the decay"
                )
            out.append(own)
        return out

    def model(self, width_s: float, modes: int, turned: bool, drift: int = 0, delays: bool = False) -> DecayModel:
        """Build a model of this decay with blocks of width_s."""
        records: list[DecayRecord] = []
        spans = zip(self.records, self.begins, self.ends, strict=True)
        for own, (channels, begin, end) in zip(self.averages(width_s), spans, strict=True):
            lines = (
                tuple(c.line_columns(width_s, begin, end) for c in channels) if any(c.lines for c in channels) else ()
            )
            colours = tuple(c.colour_for(width_s) for c in channels)
            records.append(DecayRecord(tuple(own), float(own[0].time_s[0]), lines, colours if any(colours) else ()))
        return DecayModel(tuple(records), modes, turned, drift, delays and turned, width_s)

    def with_channels(self, change: Callable[[int, int, SensorRecord], SensorRecord]) -> DecayData:
        """Return the decay with every channel replaced by change(record, axis, channel)."""
        records = tuple(
            tuple(change(r, axis, channel) for axis, channel in enumerate(channels))
            for r, channels in enumerate(self.records)
        )
        return replace(self, records=records)

    def only(self, axis: int) -> DecayData:
        """Return the decay with one sensor of every record."""
        return replace(self, records=tuple((r[axis],) for r in self.records))


@dataclass(frozen=True, eq=False)
class FittedDecay:
    """Solved model of a decay. Instances are compared by identity."""

    decay: DecayData
    model: DecayModel
    solution: Solution

    @property
    def theta(self) -> np.ndarray:
        """Nonlinear parameters."""
        return self.solution.minimum.theta

    @property
    def chi2(self) -> float:
        """Sum of squared residuals in noise variances."""
        return sum(float(r @ r) for r in self.solution.residuals)

    @property
    def count(self) -> int:
        """Number of blocks."""
        return sum(len(r) for r in self.solution.residuals)

    @property
    def width_s(self) -> float:
        """Duration of a block, s."""
        return self.model.width_s

    def plain_residuals(self) -> list[list[np.ndarray]]:
        """Block means minus model without whitening, m, [record][channel]."""
        if not any(any(record.colours) for record in self.model.records):
            return [
                [own / channel.weight for channel, own in zip(record.channels, residuals, strict=True)]
                for record, residuals in zip(self.model.records, self.channel_residuals(), strict=True)
            ]
        plain = replace(self.model, records=tuple(replace(r, colours=()) for r in self.model.records))
        out: list[list[np.ndarray]] = []
        for record, block, c in zip(plain.records, plain(self.theta), self.solution.coefficients, strict=True):
            residual = (block.data - block.basis @ c) / record.weight
            out.append(np.split(residual, np.cumsum([len(t) for t in record.times])[:-1]))
        return out

    def channel_residuals(self) -> list[list[np.ndarray]]:
        """Residuals in standard deviations, whitened by the known colour of the noise, [record][channel]."""
        out: list[list[np.ndarray]] = []
        for record, residual in zip(self.model.records, self.solution.residuals, strict=True):
            edges = np.cumsum([len(t) for t in record.times])[:-1]
            out.append(np.split(residual, edges))
        return out

    def amplitude(self, record: int, axis: int, mode: int) -> complex:
        """Complex amplitude of a mode in a sensor at the record's zero, m."""
        c = self.solution.coefficients[record]
        if self.model.turned:
            mix, _ = rotation(float(self.theta[BETA]), float(np.exp(self.theta[RATIO])))
            return complex(mix[axis, mode] * complex(c[2 * mode], c[2 * mode + 1]))
        at = 2 * (axis * self.model.modes + mode)
        return complex(c[at], c[at + 1])

    def found_lines(self) -> list[list[list[SpectralLine]]]:
        """Lines as subtracted from the samples plus their correction by the fit, [record][channel]."""
        out: list[list[list[SpectralLine]]] = []
        for record, channels, c in zip(self.model.records, self.decay.records, self.solution.coefficients, strict=True):
            drifts = len(record.channels) * (self.model.drift + 1)
            at = len(c) - drifts - record.line_columns.shape[1]
            own: list[list[SpectralLine]] = []
            for channel, means in zip(channels, record.channels, strict=True):
                lines: list[SpectralLine] = []
                for line in channel.lines:
                    order = line.order + 1 if channel.in_blocks(line, self.width_s) else 0
                    if order:
                        first = float(means.time_s[0])
                        more = complex(c[at], -c[at + order])
                        since = line.amplitude_m * np.exp(line.rate * (first - line.zero_s))
                        lines.append(replace(line, amplitude_m=complex(since + more), zero_s=first))
                    else:
                        lines.append(line)
                    at += 2 * order
                own.append(lines)
            out.append(own)
        return out

    @property
    def omegas(self) -> np.ndarray:
        """Natural frequencies, rad/s."""
        return np.exp(self.theta[0 : 2 * self.model.modes : 2])

    @property
    def zetas(self) -> np.ndarray:
        """Damping ratios."""
        return self.theta[1 : 2 * self.model.modes : 2]


def once_per_fit(judge: Callable[[FittedDecay], _T]) -> Callable[[FittedDecay], _T]:
    """Cache the result of a function of a fit for the lifetime of the fit."""
    made: WeakKeyDictionary[FittedDecay, _T] = WeakKeyDictionary()

    @wraps(judge)
    def cached(fitted: FittedDecay) -> _T:
        if fitted not in made:
            made[fitted] = judge(fitted)
        return made[fitted]

    return cached


def solve(decay: DecayData, model: DecayModel, starts: Sequence[np.ndarray], priors: Priors) -> FittedDecay:
    """Return the fit with the smallest cost from several start values."""
    fitted = _solved(decay, model, starts, priors)
    for _ in range(_CORRECTIONS if model.backbone is not None else 0):
        model = corrected(fitted.model, fitted.theta, fitted.solution.coefficients)
        if model.is_absurd(fitted.theta):  # amplitude and terms are incompatible: not a real mode
            break
        fitted = _solved(decay, model, [fitted.theta], priors)
    return fitted


def best_start(model: DecayModel, starts: Sequence[np.ndarray], priors: Priors) -> np.ndarray | None:
    """Return θ with the smallest cost after a few iterations from each start value; None if each of them fails."""
    found: list[Minimum] = []
    for start in starts:
        if model.is_absurd(start):
            continue
        try:
            std = prior_std(model, priors)
            found.append(solve_separable(model, start, np.zeros(model.size), std, _START_ITERATIONS).minimum)
        except FitFailed as error:
            _log.debug("a start value is left out: %s", error)
    return min(found, key=lambda one: one.cost).theta if found else None


def prior_std(model: DecayModel, priors: Priors) -> np.ndarray:
    """Prior standard deviations of θ about zero; inf without a prior."""
    std = np.full(model.size, np.inf)
    if model.turned:
        std[BETA], std[RATIO] = priors.axis_rad, priors.ratio
        std[DELAYS : model.tail] = priors.delay_s
    if model.backbone is not None:
        std[model.tail :] = model.backbone.prior_std
    return std


def _solved(decay: DecayData, model: DecayModel, starts: Sequence[np.ndarray], priors: Priors) -> FittedDecay:
    std = prior_std(model, priors)
    best: Solution | None = None
    for start in starts:
        if model.is_absurd(start):
            continue
        found = solve_separable(model, start, np.zeros(model.size), std, _MAX_ITERATIONS)
        if best is None or found.minimum.cost < best.minimum.cost:
            best = found
    if best is None:
        raise NotIdentifiable(
            "ring-down: nothing rings: no start value describes a decaying oscillation; plot the record"
        )
    if model.turned and not best.minimum.converged:
        best = _at_best_fixed_angle(model, best, best.minimum.theta, std)
    return FittedDecay(decay, model, best)


def second_mode_gain(fitted: FittedDecay) -> tuple[float, np.ndarray]:
    """Gain of χ² of a turned pair over one mode free in every channel, in noise variances, and that mode's θ."""
    alone = replace(fitted.model, modes=1, turned=False, delays=False, backbone=None)
    start = 0.5 * (fitted.theta[0:2] + fitted.theta[2:4])
    fits = [solve(fitted.decay, alone, [s], Priors()) for s in (start, fitted.theta[0:2], fitted.theta[2:4])]
    if fitted.model.backbone is not None:  # a single mode may also have rates that depend on amplitude
        plain = tuple(replace(r, lacking=()) for r in alone.records)
        for mode in np.flatnonzero(np.any(np.reshape(fitted.model.backbone.taken, (2, 2)), axis=1)).tolist():
            model = replace(alone, records=plain, backbone=fitted.model.backbone.in_order((mode,)))
            places = [2 * mode, 2 * mode + 1, fitted.model.tail + 2 * mode, fitted.model.tail + 2 * mode + 1]
            fits.append(solve(fitted.decay, model, [fitted.theta[places]], Priors()))
    single = min(fits, key=lambda f: f.chi2)
    return (single.chi2 - fitted.chi2) / max(1.0, fitted.solution.chi2_per_dof), single.theta[:2]


def both_alike(fitted: FittedDecay, single: np.ndarray, priors: Priors) -> FittedDecay:
    """Fit a turned pair of two equal modes, starting at a single mode, at the best of several fixed angles."""
    theta = np.r_[single, single, fitted.theta[BETA:]]
    found = _at_best_fixed_angle(fitted.model, fitted.solution, theta, prior_std(fitted.model, priors))
    return replace(fitted, solution=found)


def _at_best_fixed_angle(model: DecayModel, lost: Solution, near: np.ndarray, std: np.ndarray) -> Solution:
    """Solution at the best of several fixed angles β, for a fit that does not converge in β.

    If equal modes are polarised along one axis of the model, the other mode has no amplitude and its rate is
    arbitrary. Any other angle fits equally well and is numerically regular.
    """
    best = lost
    for beta in np.radians((-30.0, -15.0, 0.0, 15.0, 30.0)):
        held, centre, theta = std.copy(), np.zeros(model.size), near.copy()
        held[BETA], centre[BETA], theta[BETA] = 1e-7, beta, beta
        mean = 0.5 * (near[0:2] + near[2:4])
        for start in (theta, np.r_[mean, mean, theta[4:]]):
            if model.is_absurd(start):
                continue
            found = solve_separable(model, start, centre, held)
            if found.minimum.converged and (best is lost or found.minimum.cost < best.minimum.cost):
                best = found
    if best is lost:
        return lost
    return solve_separable(model, best.minimum.theta, np.zeros(model.size), std, max_iterations=1)


def width_for(omega: float, blocks_per_cycle: int) -> float:
    """Duration of a block, s."""
    return 2 * np.pi / omega / blocks_per_cycle


def refuse_too_short(fitted: FittedDecay) -> None:
    """Raise NotIdentifiable if the record contains less than one and a half cycles of the slowest mode."""
    slowest = float(np.min(fitted.omegas)) / (2 * np.pi)
    for record in fitted.model.records:
        span = min(float(t[-1] - t[0]) for t in record.times)
        cycles = span * slowest
        if cycles < _MIN_CYCLES:
            shown, needed = distinct(cycles, _MIN_CYCLES)
            raise NotIdentifiable(
                f"the record shows {number_of(shown, 'cycle')} of {slowest:.3g} Hz after the release; at least "
                f"{needed} are needed, "
                "five or more are better"
            )

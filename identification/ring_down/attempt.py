"""Fit of one span: start values, block duration, lines, noise, drift required by the data, masking of outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.ring_down.backbone import REFERENCE_M, Backbone
from identification.ring_down.decay import (
    COARSE_S,
    DecayData,
    FittedDecay,
    Priors,
    best_start,
    once_per_fit,
    refuse_too_short,
    solve,
    width_for,
)
from identification.ring_down.disturbances import (
    SMALL,
    ResidualOscillation,
    coloured,
    foreign_mode,
    is_disturbed,
    mode_size,
    other_oscillation,
    stays,
    steady_mode,
    white_rests,
    without_mode,
    without_other,
)
from identification.ring_down.evidence import rubs
from identification.ring_down.model import BETA
from identification.ring_down.modes import Start, damped_periodogram, rate
from identification.ring_down.outliers import suspicious, trimmed
from identification.ring_down.residuals import gain_of
from identification.ring_down.rungs import bent_leader, climbed, explains, is_misfit, pair_with_leader
from identification.ring_down.scores import known_columns, stretches
from identification.ring_down.start import pair_starts
from identification.rungs import Rung
from identification.samples import Averages
from identification.setting import Setting
from identification.work import tried

BLOCKS_PER_CYCLE: dict[Setting, int] = {"fast": 12, "balanced": 20, "reference": 64}
"""Averages over 1/n of a cycle lose (2π/n)²/12 of the information: 2.3 %, 0.8 %, 0.08 %."""

_STARTS: dict[Setting, int] = {"fast": 1, "balanced": 2, "reference": 6}
_MAX_TRIMS = 12
_MAX_LINES, _MAX_COLOURS = 8, 2
_CUT_AT = 8.0  # decay times, after which a mode is below 1/3000 of its start
_MIN_STRETCH = 1.15  # factor on intervals for coloured residuals above which a record may be shortened
_SECOND_MODE_GAIN = 20.0  # of χ² beyond BIC's penalty; above the largest peak of noise among thousands
_MIN_SPLIT = 3.0  # half-bandwidths; two closer decays may describe one decay of another law
_MIN_BEAT = 0.4  # half-bandwidths between the frequencies of two closer modes
_SPLITS = (0.3, 1.0, 2.0)  # half-bandwidths, from the mean of two close modes to each of them at the start
_MIN_CHI2 = 0.5  # χ²/dof
_MAX_FREQUENCY_RATIO = 6.0  # of a second mode of the suspension to the first one


@dataclass(frozen=True)
class FitOptions:
    """Options of a fit.

    Attributes:
        turned: whether a turned pair is fitted; otherwise one mode, free in every channel.
        setting: effort of the fit.
        priors: priors of a turned pair.
        valid: usable samples of each record and channel.
        without: rungs that are not used.
    """

    turned: bool
    setting: Setting
    priors: Priors
    valid: tuple[tuple[np.ndarray, ...], ...]
    without: frozenset[Rung] = frozenset()

    def __call__(self, decay: DecayData, near: FittedDecay | None = None) -> FittedDecay:
        """Fit a decay with automatic start values. The fit of another span may provide an additional one.

        Raises:
            NotIdentifiable: the record after the release is too short.
        """
        fitted = self.from_starts(decay, near)
        tried(_described(fitted))
        refuse_too_short(fitted)
        fitted = fitted if self.turned else self.with_second_mode(fitted, sole=True)
        fitted = self.with_rungs(self.with_residual_noise(fitted), first=True)
        fitted = self.with_known_noise(self.without_lines(fitted, near))
        fitted = self.with_hidden_mode(fitted)
        fitted, _ = self.without_outliers(fitted)
        fitted = self.with_rungs(fitted if self.turned else self.with_second_mode(fitted))
        if any(rubs(*falling) for falling in _falling(fitted)):
            tried("there the damping falls with amplitude: dry friction in the suspension?")
        return fitted

    def with_rungs(self, fitted: FittedDecay, first: bool = False) -> FittedDecay:
        """Add the amplitude dependence of the modes' rates that the data require.

        Args:
            fitted: solved fit.
            first: whether lines and coloured noise are not yet known. Only terms that explain most of a misfit are
                then added.
        """
        if self.setting == "fast" or "amplitude" in self.without:
            return fitted
        climb = climbed(fitted, self.priors, first)
        if first and self.turned and climb is fitted and is_misfit(fitted):
            return self.with_bent_leader(fitted)
        return climb

    def with_bent_leader(self, fitted: FittedDecay) -> FittedDecay:
        """Fit a turned pair again if both modes of the start values describe one strong mode with changing rates.

        The strong mode is fitted alone in both sensors. The residual shows the other mode.
        """
        bent = bent_leader(fitted, self.priors)
        if bent is None:
            return fitted
        other = theta_of([damped_periodogram(rests(bent))])
        pairs = (pair_with_leader(fitted.model, bent, other, place) for place in range(2))
        best = min((solve(fitted.decay, model, [theta], self.priors) for model, theta in pairs), key=lambda f: f.chi2)
        return best if explains(fitted, best) else fitted

    def from_starts(self, decay: DecayData, near: FittedDecay | None = None) -> FittedDecay:
        """Return the best fit from start values that are found in the decay."""
        coarse = decay.model(COARSE_S, 2 if self.turned else 1, self.turned, 0, self.priors.delay_s > 0)
        if self.turned:
            starts = pair_starts(coarse)[: _STARTS[self.setting]]
            fastest = max(float(np.exp(max(s[0], s[2]))) for s in starts)
            starts += [near.theta[: near.model.tail]] if near is not None else []
        else:
            start = damped_periodogram([list(r.channels) for r in coarse.records])
            starts, fastest = [theta_of([start])], start.omega
        return self.refitted(decay, starts, fastest, 0)

    def without_lines(self, fitted: FittedDecay, near: FittedDecay | None = None) -> FittedDecay:
        """Add the lines that the residuals show in addition to the modes, until no line is left."""
        for _ in range(0 if "lines" in self.without else _MAX_LINES):
            mode = steady_mode(fitted)
            mode = foreign_mode(fitted) if mode is None else mode
            if mode is not None:
                fitted = self.from_starts(without_mode(fitted, mode), near)
                continue
            other = other_oscillation(fitted)
            if other is None:
                break
            apart = self.again(fitted, without_other(fitted, other))
            bent = fitted.model.backbone is not None  # rates of another law cause a misfit in the mode's own band
            if other.near and (bent or not stays(apart, other.lam.imag / (2 * np.pi))):
                break  # the misfit of a mode
            fitted = apart if other.line else self.better_shaped(fitted, apart, other)
        return fitted

    def better_shaped(self, fitted: FittedDecay, apart: FittedDecay, other: ResidualOscillation) -> FittedDecay:
        """Decide by fits whether the weakest mode or another decaying oscillation is the mode.

        The weakest mode may come from a wrong minimum, or the shape of the other oscillation fits a turned pair.
        """
        sizes = [mode_size(fitted, m) for m in range(fitted.model.modes)]
        weak = int(np.argmin(sizes))
        small = len(sizes) > 1 and sizes[weak] < SMALL * max(sizes)
        theta = fitted.theta[: fitted.model.tail].copy()
        theta[2 * weak : 2 * weak + 2] = np.log(abs(other.lam)), -other.lam.real / abs(other.lam)
        fastest, drift = float(np.max(np.exp(theta[0 : 2 * len(sizes) : 2]))), fitted.model.drift
        choices = [apart]
        if small or not self.turned:
            choices.append(self.refitted(fitted.decay, [theta], fastest, drift))
        if small and self.turned and np.all(fitted.zetas > 0):
            choices.append(self.refitted(without_mode(fitted, weak), [theta], fastest, drift))
        noise = min(f.solution.chi2_per_dof for f in choices)
        return min(choices, key=lambda f: (f.chi2 / noise + f.model.linear * np.log(f.count)) / f.count)

    def with_hidden_mode(self, fitted: FittedDecay) -> FittedDecay:
        """Search again for the weaker mode of a turned pair with equal rates, which lines or noise may have hidden."""
        if not self.turned or not is_disturbed(fitted):
            return fitted
        lams = [rate(float(w), float(z)) for w, z in zip(fitted.omegas, fitted.zetas, strict=True)]
        if abs(lams[0] - lams[1]) > _MIN_SPLIT * max(abs(lam.real) for lam in lams):
            return fitted
        hidden = damped_periodogram(white_rests(fitted))
        fastest, drift = float(np.max(fitted.omegas)), fitted.model.drift
        best = fitted
        for place in range(2):
            theta = fitted.theta[: fitted.model.tail].copy()
            theta[2 * place : 2 * place + 2] = theta_of([hidden])
            theta[BETA] = 0.0
            found = self.refitted(fitted.decay, [theta], fastest, drift)  # same blocks, so that χ² is comparable
            best = found if found.chi2 < best.chi2 - _SECOND_MODE_GAIN else best
        return fitted if best is fitted else self.with_known_noise(self.again(best))

    def with_known_noise(self, fitted: FittedDecay) -> FittedDecay:
        """Weight the fit by the spectrum of its noise if that is not white."""
        for _ in range(0 if "spectrum" in self.without else _MAX_COLOURS):
            decay = coloured(fitted)
            if decay is None:
                break
            fitted = self.again(fitted, decay)
        return fitted

    def refitted(
        self,
        decay: DecayData,
        starts: Sequence[np.ndarray],
        fastest: float,
        drift: int,
        modes: int = 0,
        backbone: Backbone | None = None,
    ) -> FittedDecay:
        """Fit from start values.

        Args:
            decay: data.
            starts: start values of θ.
            fastest: highest natural frequency, rad/s, which determines the duration of the blocks.
            drift: order of the drift.
            modes: number of modes; 0 for the number of the plan.
            backbone: amplitude dependence of the rates.
        """
        width = width_for(fastest, BLOCKS_PER_CYCLE[self.setting])
        count = modes or (2 if self.turned else 1)
        model = decay.model(width, count, self.turned, drift, self.priors.delay_s > 0)
        return solve(decay, replace(model, backbone=backbone), starts, self.priors)

    def labelled(self, fitted: FittedDecay) -> FittedDecay:
        """Name the mode closer to sensor x mode 1. An angle beyond 45° is equivalent to the other order."""
        beta = float(fitted.theta[BETA]) if self.turned else 0.0
        if abs(beta) <= np.pi / 4:
            return fitted
        theta = fitted.theta.copy()
        theta[:BETA] = theta[[2, 3, 0, 1]]
        theta[BETA] = beta - np.sign(beta) * np.pi / 2
        fastest, drift, backbone = float(np.max(fitted.omegas)), fitted.model.drift, fitted.model.backbone
        if backbone is not None:
            backbone, theta[fitted.model.tail :] = backbone.in_order((1, 0)), np.roll(theta[fitted.model.tail :], 2)
        other = self.refitted(fitted.decay, [theta], fastest, drift, backbone=backbone)
        return other if abs(float(other.theta[BETA])) < abs(beta) else fitted

    def again(self, fitted: FittedDecay, decay: DecayData | None = None, drift: int | None = None) -> FittedDecay:
        """Repeat a fit with other data or another drift, starting at its own parameters."""
        order = fitted.model.drift if drift is None else drift
        fastest = float(np.max(fitted.omegas))
        model = fitted.model
        return self.refitted(decay or fitted.decay, [fitted.theta], fastest, order, model.modes, model.backbone)

    def with_drift(self, fitted: FittedDecay) -> FittedDecay:
        """Fit with the order of the drift that has the smallest BIC."""
        choices = drift_criteria(fitted)
        highest = 1 if "wander" in self.without else 3
        order = min((k for k in choices if k <= highest), key=lambda k: choices[k])
        return fitted if order == fitted.model.drift else self.again(fitted, drift=order)

    def with_second_mode(self, fitted: FittedDecay, *, sole: bool = False) -> FittedDecay:
        """Fit with two modes in one sensor if the data require it. The stronger mode is the first one.

        The other explanation of a decay that is not exponential, rates that depend on amplitude, is fitted as well.

        Args:
            fitted: fit of one mode.
            sole: whether the second mode must explain most of what the best of these leaves.
        """
        if "second-mode" in self.without or fitted.model.modes == 2 or not is_misfit(fitted):
            return fitted
        first, second = fitted.theta[:2], theta_of([damped_periodogram(rests(fitted))])
        starts = [np.r_[first, second], *(np.r_[first - apart, first + apart] for apart in _splits(float(first[1])))]
        width = width_for(float(np.exp(max(first[0], second[0]))), BLOCKS_PER_CYCLE[self.setting])
        model = fitted.decay.model(width, 2, False, fitted.model.drift, False)
        start = best_start(model, [each for each in starts if _is_of_suspension(each, first)], self.priors)
        if start is None:
            return fitted
        both = _stronger_first(solve(fitted.decay, model, [start], self.priors))
        return both if _is_of_suspension(both.theta, first) and self.are_two(both, sole=sole) else fitted

    def with_fewest_modes(self, fitted: FittedDecay) -> FittedDecay:
        """Fit with one mode in one sensor, unless a second mode has a very significant gain."""
        if self.turned or fitted.model.modes == 1 or self.are_two(fitted):
            return fitted
        return self.with_rungs(self.with_stronger_mode(fitted))

    def with_stronger_mode(self, fitted: FittedDecay) -> FittedDecay:
        """Fit with the first of two modes alone."""
        fastest = float(np.max(fitted.omegas))
        return self.refitted(fitted.decay, [fitted.theta[:2]], fastest, fitted.model.drift, modes=1)

    def are_two(self, fitted: FittedDecay, *, sole: bool = False) -> bool:
        """Whether a second mode in one sensor has a very significant gain; for `sole` see `with_second_mode`."""
        apart, beat = _separate(fitted)
        single, noise = self.with_stronger_mode(fitted), max(1.0, fitted.solution.chi2_per_dof)
        if not (np.all(fitted.zetas > 0) and (apart or beat)) or single.chi2 - fitted.chi2 < _SECOND_MODE_GAIN * noise:
            return False
        bent = climbed(single, self.priors, first=False)
        more = fitted.model.linear + fitted.model.free - bent.model.linear - bent.model.free
        is_clear = bent.chi2 - fitted.chi2 > noise * (more * np.log(fitted.count) + _SECOND_MODE_GAIN)
        return is_clear and ((apart and not sole) or explains(bent, fitted))

    def without_outliers(self, fitted: FittedDecay) -> tuple[FittedDecay, int]:
        """Mask outliers until nothing changes. Return the fit with its drift selected, and the number of outliers."""
        fitted, count = self.with_residual_noise(fitted), 0
        if suspicious(fitted) or not _same(fitted.decay, self.valid):
            for _ in range(_MAX_TRIMS):
                records, count, changed = trimmed(fitted, self.valid)
                if not changed:
                    break
                fitted = self.again(fitted, replace(fitted.decay, records=tuple(records)))
        return self.with_drift(fitted), count

    def with_residual_noise(self, fitted: FittedDecay) -> FittedDecay:
        """Take the noise from the residuals if the differences of few samples per cycle contain the motion."""
        residuals = fitted.channel_residuals()
        dof = fitted.count - fitted.model.linear - fitted.model.size
        if fitted.solution.chi2_per_dof > min(_MIN_CHI2, 1 - 5 * np.sqrt(2 / dof)):
            return fitted
        used = fitted.count / dof
        records = tuple(
            tuple(
                replace(c, noise=c.noise * min(1.0, float(np.sqrt(used * np.mean(r**2)))))
                for c, r in zip(channels, own, strict=True)
            )
            for channels, own in zip(fitted.decay.records, residuals, strict=True)
        )
        return self.again(fitted, replace(fitted.decay, records=records))

    def shortened(self, fitted: FittedDecay) -> FittedDecay:
        """Cut the record at 8 decay times with a cubic drift, if wander widens the intervals and this narrows them."""
        if "wander" in self.without:
            return fitted
        stretch = stretches(fitted)
        slowest = float(np.min(fitted.zetas * fitted.omegas))
        if float(np.max(stretch[: 2 * fitted.model.modes])) < _MIN_STRETCH or slowest <= 0:
            return fitted
        ends = tuple(min(e, b + _CUT_AT / slowest) for b, e in zip(fitted.decay.begins, fitted.decay.ends, strict=True))
        if all(e > 0.9 * old for e, old in zip(ends, fitted.decay.ends, strict=True)):
            return fitted
        short = self.again(fitted, replace(fitted.decay, ends=ends), drift=3)
        ours, theirs = (np.sqrt(np.diag(f.solution.minimum.covariance)) * stretches(f) for f in (short, fitted))
        places = np.arange(2 * fitted.model.modes)
        return short if np.all(ours[places] < theirs[places]) else fitted


def _described(fitted: FittedDecay) -> str:
    """Description of an attempt for the progress: its start, modes and misfit."""
    begins = ", ".join(f"{begin:.4g}" for begin in fitted.decay.begins)
    modes = " and ".join(f"{omega / (2 * np.pi):.4g}" for omega in fitted.omegas)
    return f"from {begins} s on, {modes} Hz, χ²/dof {fitted.solution.chi2_per_dof:.3g}"


def _falling(fitted: FittedDecay) -> list[tuple[float, float]]:
    """Decrease of each mode's damping ratio up to its largest amplitude, and the ratio at zero amplitude."""
    backbone = fitted.model.backbone
    if backbone is None:
        return []
    rates = [fitted.model.mode_rates(fitted.theta, mode) for mode in range(fitted.model.modes)]
    levels = zip(rates, backbone.largest_m, strict=True)
    return [(-own.drag * largest / REFERENCE_M, own.zeta) for own, largest in levels]


def _splits(zeta: float) -> list[np.ndarray]:
    """Halves of the differences in ln ω and ζ of two close modes of which one fit has found the mean."""
    return [np.array([away * abs(zeta), 0.0]) for away in _SPLITS]


def _is_of_suspension(theta: np.ndarray, first: np.ndarray) -> bool:
    """Whether the frequencies of two modes are within the usual ratio of that of a fit of one."""
    return float(np.max(np.abs(theta[0:3:2] - first[0]))) < np.log(_MAX_FREQUENCY_RATIO)


def _separate(fitted: FittedDecay) -> tuple[bool, bool]:
    """Whether two modes of one sensor are certainly not two parts of one decay of another law, and whether they beat.

    A rate that changes with amplitude or time changes the envelope and its phase slowly; it makes no beat.
    """
    lams = [rate(float(w), float(z)) for w, z in zip(fitted.omegas, fitted.zetas, strict=True)]
    width = max(-lam.real for lam in lams)
    return abs(lams[0] - lams[1]) > _MIN_SPLIT * width, abs(lams[0].imag - lams[1].imag) > _MIN_BEAT * width


def _stronger_first(fitted: FittedDecay) -> FittedDecay:
    """Order two free modes by their energies in the first channel."""
    energy = [abs(fitted.amplitude(0, 0, m)) ** 2 / max(fitted.zetas[m], 1e-6) / fitted.omegas[m] for m in range(2)]
    if energy[0] >= energy[1]:
        return fitted
    swapped = fitted.theta[[2, 3, 0, 1]]
    return solve(fitted.decay, fitted.model, [swapped], Priors())


def rests(fitted: FittedDecay) -> list[list[Averages]]:
    """Residuals of a fit as block averages, [record][channel]."""
    return [
        [replace(c, value=own) for c, own in zip(record.channels, residuals, strict=True)]
        for record, residuals in zip(fitted.model.records, fitted.plain_residuals(), strict=True)
    ]


def theta_of(starts: Sequence[Start]) -> np.ndarray:
    """Parameters θ of free modes."""
    return np.array([v for s in starts for v in (np.log(s.omega), s.zeta)])


@once_per_fit
def drift_criteria(fitted: FittedDecay) -> dict[int, float]:
    """BIC relative to the drift of the fit, by order of the drift, for orders from that of the fit on."""
    known, residuals = known_columns(fitted)
    noise = max(1.0, fitted.solution.chi2_per_dof)
    out = {fitted.model.drift: 0.0}
    for order in (1, 3):
        if order <= fitted.model.drift:
            continue
        higher = replace(fitted.model, drift=order)
        gain, channels = 0.0, 0
        for record, columns, residual in zip(fitted.model.records, known, residuals, strict=True):
            extra = record.scaled(higher.drift_columns(record))
            gain += gain_of(residual, columns, extra)
            channels += len(record.channels)
        out[order] = (order - fitted.model.drift) * channels * np.log(fitted.count) - gain / noise
    return out


def _same(decay: DecayData, valid: tuple[tuple[np.ndarray, ...], ...]) -> bool:
    """Whether every usable sample within the spans is used."""
    for channels, masks, begin, end in zip(decay.records, valid, decay.begins, decay.ends, strict=True):
        for channel, mask in zip(channels, masks, strict=True):
            first, last = np.searchsorted(channel.time_s, (begin, end))
            if not np.array_equal(channel.keep[first:last], mask[first:last]):
                return False
    return True

"""One attempt at a fit: start values, block length, drift as far as the data ask for it, outliers masked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.ring_down.backbone import Backbone
from identification.ring_down.decay import (
    COARSE_S,
    Decay,
    Fitted,
    Priors,
    once_per_fit,
    refuse_too_short,
    solve,
    width_for,
)
from identification.ring_down.disturbances import (
    SMALL,
    Other,
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
from identification.ring_down.model import BETA
from identification.ring_down.modes import Start, damped_periodogram, rate
from identification.ring_down.outliers import suspicious, trimmed
from identification.ring_down.residuals import gain_of
from identification.ring_down.rungs import bent_leader, beside_leader, climbed, explains, is_misfit
from identification.ring_down.scores import known_columns, stretches
from identification.ring_down.start import pair_starts
from identification.rungs import Rung
from identification.samples import Averages
from identification.setting import Setting

BLOCKS_PER_CYCLE: dict[Setting, int] = {"fast": 12, "balanced": 20, "reference": 64}
"""Averaging over 1/n of a cycle loses (2π/n)²/12 of the information: 2.3 %, 0.8 %, 0.08 %."""

_STARTS: dict[Setting, int] = {"fast": 1, "balanced": 2, "reference": 6}
_TRIMS = 12
_LINES, _COLOURS = 8, 2
_CUT_AT = 8.0  # decay times; beyond, a mode is below 1/3000 of its start
_COLOURED = 1.15
_SECOND_MODE_GAIN = 20.0  # of χ², above what BIC asks: noise's largest peak of thousands stays below
_APART = 3.0  # half-bandwidths
_TOO_GOOD = 0.5  # χ²/dof
_FASTEST_SECOND = 6.0  # beyond so many times the first mode's frequency it is no mode of the suspension


@dataclass(frozen=True)
class Plan:
    """What is to be fitted.

    Attributes:
        turned: a turned pair; otherwise one mode, free in every channel.
        setting: speed against accuracy.
        priors: of a turned pair.
        valid: per record and channel the samples that may be used at all.
        without: rungs that are not taken.
    """

    turned: bool
    setting: Setting
    priors: Priors
    valid: tuple[tuple[np.ndarray, ...], ...]
    without: frozenset[Rung] = frozenset()

    def __call__(self, decay: Decay, near: Fitted | None = None) -> Fitted:
        """Fit without any start value, or with a turned pair's fit on another span for a further one.

        Raises:
            NotIdentifiable: too little is left after the release.
        """
        fitted = self.from_starts(decay, near)
        refuse_too_short(fitted)
        fitted = self.with_rungs(self.with_residual_noise(fitted), first=True)
        fitted = self.with_known_noise(self.without_lines(fitted, near))
        fitted = self.with_hidden_mode(fitted)
        fitted, _ = self.without_outliers(fitted)
        return self.with_rungs(fitted if self.turned else self.with_second_mode(fitted))

    def with_rungs(self, fitted: Fitted, first: bool = False) -> Fitted:
        """The fit with those of its modes' rates made to depend on amplitude that the data ask for.

        Args:
            first: before lines and coloured noise are looked for: only what explains most of a misfit.
        """
        if self.setting == "fast" or "amplitude" in self.without:
            return fitted
        climb = climbed(fitted, self.priors, first)
        if first and self.turned and climb is fitted and is_misfit(fitted):
            return self.with_bent_leader(fitted)
        return climb

    def with_bent_leader(self, fitted: Fitted) -> Fitted:
        """A turned pair where a strong mode whose rates change took both modes of the first start values.

        The strong mode is fitted alone in both sensors; what that leaves shows the other one.
        """
        bent = bent_leader(fitted, self.priors)
        if bent is None:
            return fitted
        other = theta_of([damped_periodogram(rests(bent))])
        pairs = (beside_leader(fitted.model, bent, other, place) for place in range(2))
        best = min((solve(fitted.decay, model, [theta], self.priors) for model, theta in pairs), key=lambda f: f.chi2)
        return best if explains(fitted, best) else fitted

    def from_starts(self, decay: Decay, near: Fitted | None = None) -> Fitted:
        """The best fit from start values found in the decay itself."""
        coarse = decay.model(COARSE_S, 2 if self.turned else 1, self.turned, 0, self.priors.delay_s > 0)
        if self.turned:
            starts = pair_starts(coarse)[: _STARTS[self.setting]]
            fastest = max(float(np.exp(max(s[0], s[2]))) for s in starts)
            starts += [near.theta[: near.model.tail]] if near is not None else []
        else:
            start = damped_periodogram([list(r.channels) for r in coarse.records])
            starts, fastest = [theta_of([start])], start.omega
        return self.refitted(decay, starts, fastest, 0)

    def without_lines(self, fitted: Fitted, near: Fitted | None = None) -> Fitted:
        """The fit with lines that it shows beside its modes, until it shows none."""
        for _ in range(0 if "lines" in self.without else _LINES):
            mode = steady_mode(fitted)
            mode = foreign_mode(fitted) if mode is None else mode
            if mode is not None:
                fitted = self.from_starts(without_mode(fitted, mode), near)
                continue
            other = other_oscillation(fitted)
            if other is None:
                break
            apart = self.again(fitted, without_other(fitted, other))
            bent = fitted.model.backbone is not None  # rates that change by another law misfit in the mode's own band
            if other.near and (bent or not stays(apart, other.lam.imag / (2 * np.pi))):
                break  # a mode's own misfit
            fitted = apart if other.line else self.better_shaped(fitted, apart, other)
        return fitted

    def better_shaped(self, fitted: Fitted, apart: Fitted, other: Other) -> Fitted:
        """Of the weakest mode and another oscillation that decays: which is the mode, as the fits tell.

        The weakest mode may have been none at all, from a wrong minimum; or the other's shape befits a turned pair.
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

    def with_hidden_mode(self, fitted: Fitted) -> Fitted:
        """A turned pair that shares one rate, where lines or noise hid the fainter mode from the first start values."""
        if not self.turned or not is_disturbed(fitted):
            return fitted
        lams = [rate(float(w), float(z)) for w, z in zip(fitted.omegas, fitted.zetas, strict=True)]
        if abs(lams[0] - lams[1]) > _APART * max(abs(lam.real) for lam in lams):
            return fitted
        hidden = damped_periodogram(white_rests(fitted))
        fastest, drift = float(np.max(fitted.omegas)), fitted.model.drift
        best = fitted
        for place in range(2):
            theta = fitted.theta[: fitted.model.tail].copy()
            theta[2 * place : 2 * place + 2] = theta_of([hidden])
            theta[BETA] = 0.0
            found = self.refitted(fitted.decay, [theta], fastest, drift)  # the same blocks, so that χ² compares
            best = found if found.chi2 < best.chi2 - _SECOND_MODE_GAIN else best
        return fitted if best is fitted else self.with_known_noise(self.again(best))

    def with_known_noise(self, fitted: Fitted) -> Fitted:
        """The fit weighted by its noise's spectrum where that is not white."""
        for _ in range(0 if "spectrum" in self.without else _COLOURS):
            decay = coloured(fitted)
            if decay is None:
                break
            fitted = self.again(fitted, decay)
        return fitted

    def refitted(
        self,
        decay: Decay,
        starts: Sequence[np.ndarray],
        fastest: float,
        drift: int,
        modes: int = 0,
        backbone: Backbone | None = None,
    ) -> Fitted:
        """Fit from start values; fastest in rad/s sets the blocks, modes counts free ones (0: as planned)."""
        width = width_for(fastest, BLOCKS_PER_CYCLE[self.setting])
        count = modes or (2 if self.turned else 1)
        model = decay.model(width, count, self.turned, drift, self.priors.delay_s > 0)
        return solve(decay, replace(model, backbone=backbone), starts, self.priors)

    def labelled(self, fitted: Fitted) -> Fitted:
        """Mode 1 is the one nearer to sensor x: an angle beyond 45° is another name for the other order."""
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

    def again(self, fitted: Fitted, decay: Decay | None = None, drift: int | None = None) -> Fitted:
        """The same fit on another span or with another drift, from its own parameters."""
        order = fitted.model.drift if drift is None else drift
        fastest = float(np.max(fitted.omegas))
        model = fitted.model
        return self.refitted(decay or fitted.decay, [fitted.theta], fastest, order, model.modes, model.backbone)

    def with_drift(self, fitted: Fitted) -> Fitted:
        """The smallest drift that the data do not contradict, by BIC."""
        choices = drift_criteria(fitted)
        highest = 1 if "wander" in self.without else 3
        order = min((k for k in choices if k <= highest), key=lambda k: choices[k])
        return fitted if order == fitted.model.drift else self.again(fitted, drift=order)

    def with_second_mode(self, fitted: Fitted) -> Fitted:
        """Two modes in one sensor where residuals ask for it; the stronger comes first."""
        dof = fitted.count - fitted.model.linear - fitted.model.size
        if "second-mode" in self.without or fitted.solution.chi2_per_dof < 1 + 4 * np.sqrt(2 / dof):
            return fitted
        second = damped_periodogram(rests(fitted))
        theta = np.r_[fitted.theta[:2], theta_of([second])]
        fastest = max(float(np.max(fitted.omegas)), second.omega)
        first = rate(float(fitted.omegas[0]), float(fitted.zetas[0]))
        # nearer than that, two decays are a decay that is not exponential
        apart = abs(second.lam - first) > _APART * max(-first.real, -second.lam.real)
        if not apart or not 1 / _FASTEST_SECOND < second.omega / abs(first) < _FASTEST_SECOND:
            return fitted
        both = self.refitted(fitted.decay, [theta], fastest, fitted.model.drift, modes=2)
        both = _stronger_first(both)
        if fitted.model.backbone is not None and both.chi2 > fitted.chi2:
            return fitted
        return both if self.with_fewest_modes(both) is both else fitted

    def with_fewest_modes(self, fitted: Fitted) -> Fitted:
        """One mode in one sensor unless a second is worth its parameters by far."""
        if self.turned or fitted.model.modes == 1:
            return fitted
        fastest = float(np.max(fitted.omegas))
        single = self.refitted(fitted.decay, [fitted.theta[:2]], fastest, fitted.model.drift, modes=1)
        single = self.with_rungs(single) if fitted.model.backbone is not None else single
        gain = (single.chi2 - fitted.chi2) / max(1.0, fitted.solution.chi2_per_dof)
        lams = [rate(float(w), float(z)) for w, z in zip(fitted.omegas, fitted.zetas, strict=True)]
        apart = abs(lams[0] - lams[1]) > _APART * max(-lams[0].real, -lams[1].real)
        worth = gain > 4 * np.log(fitted.count) + _SECOND_MODE_GAIN and np.all(fitted.zetas > 0) and apart
        return fitted if worth else single

    def without_outliers(self, fitted: Fitted) -> tuple[Fitted, int]:
        """Masks what no noise explains until nothing changes; the fit with its drift chosen, and how many masked."""
        fitted, count = self.with_residual_noise(fitted), 0
        if suspicious(fitted) or not _same(fitted.decay, self.valid):
            for _ in range(_TRIMS):
                records, count, changed = trimmed(fitted, self.valid)
                if not changed:
                    break
                fitted = self.again(fitted, replace(fitted.decay, records=tuple(records)))
        return self.with_drift(fitted), count

    def with_residual_noise(self, fitted: Fitted) -> Fitted:
        """Where a cycle has few samples their differences see the motion, not the noise; residuals do not."""
        residuals = fitted.channel_residuals()
        dof = fitted.count - fitted.model.linear - fitted.model.size
        if fitted.solution.chi2_per_dof > min(_TOO_GOOD, 1 - 5 * np.sqrt(2 / dof)):
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

    def shortened(self, fitted: Fitted) -> Fitted:
        """Where wander widens the intervals: the record cut at 8 decay times and cubic drift, if that narrows them."""
        if "wander" in self.without:
            return fitted
        stretch = stretches(fitted)
        slowest = float(np.min(fitted.zetas * fitted.omegas))
        if float(np.max(stretch[: 2 * fitted.model.modes])) < _COLOURED or slowest <= 0:
            return fitted
        ends = tuple(min(e, b + _CUT_AT / slowest) for b, e in zip(fitted.decay.begins, fitted.decay.ends, strict=True))
        if all(e > 0.9 * old for e, old in zip(ends, fitted.decay.ends, strict=True)):
            return fitted
        short = self.again(fitted, replace(fitted.decay, ends=ends), drift=3)
        ours, theirs = (np.sqrt(np.diag(f.solution.minimum.covariance)) * stretches(f) for f in (short, fitted))
        places = np.arange(2 * fitted.model.modes)
        return short if np.all(ours[places] < theirs[places]) else fitted


def _stronger_first(fitted: Fitted) -> Fitted:
    """Two free modes in the order of their energies in the first channel."""
    energy = [abs(fitted.amplitude(0, 0, m)) ** 2 / max(fitted.zetas[m], 1e-6) / fitted.omegas[m] for m in range(2)]
    if energy[0] >= energy[1]:
        return fitted
    swapped = fitted.theta[[2, 3, 0, 1]]
    return solve(fitted.decay, fitted.model, [swapped], Priors())


def rests(fitted: Fitted) -> list[list[Averages]]:
    """[record][channel], what a fit leaves."""
    return [
        [replace(c, value=own) for c, own in zip(record.channels, residuals, strict=True)]
        for record, residuals in zip(fitted.model.records, fitted.plain_residuals(), strict=True)
    ]


def theta_of(starts: Sequence[Start]) -> np.ndarray:
    """θ of free modes."""
    return np.array([v for s in starts for v in (np.log(s.omega), s.zeta)])


@once_per_fit
def drift_criteria(fitted: Fitted) -> dict[int, float]:
    """BIC relative to the fit's own drift, by order of the drift; only orders from the fit's own on."""
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


def _same(decay: Decay, valid: tuple[tuple[np.ndarray, ...], ...]) -> bool:
    """Whether every usable sample within the spans is in use."""
    for channels, masks, begin, end in zip(decay.records, valid, decay.begins, decay.ends, strict=True):
        for channel, mask in zip(channels, masks, strict=True):
            first, last = np.searchsorted(channel.time_s, (begin, end))
            if not np.array_equal(channel.keep[first:last], mask[first:last]):
                return False
    return True

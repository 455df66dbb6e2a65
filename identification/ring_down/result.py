"""Result of a ring-down's fit: values, intervals, chosen model, and evidence against the model."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from identification.curve import FittedCurve
from identification.errors import FitFailed
from identification.fit_result import FitResult
from identification.laser_wander import wander_sentences
from identification.lines import sentences
from identification.ring_down.amplitude import AmplitudeDependence
from identification.ring_down.decay import FittedDecay, Priors
from identification.ring_down.direction_terms import DirectionTerms, direction_terms
from identification.ring_down.evidence import refuse_dry_friction
from identification.ring_down.model import BETA
from identification.ring_down.model_table import OTHER_LAW, model_table
from identification.ring_down.over_amplitude import RatesOverAmplitude, rates_over_amplitude
from identification.ring_down.reported_values import (
    Numbers,
    amplitudes_of,
    beyond_terms,
    damping_remark,
    numbers_of,
    widen_for_amplitude,
    widen_for_friction,
    widen_for_other_law,
    with_stiffness,
)
from identification.ring_down.residuals import Whiteness, whiteness
from identification.ring_down.resolution import RESOLVED_GAIN, RESOLVED_SPLIT, WALD_STD, Resolution, resolution
from identification.ring_down.scores import stretches
from identification.rungs import Rung
from identification.setting import ModelChoice, Setting
from rig_basics.texts import distinct, number_of

_MAX_RESIDUAL_RATIO, _MAX_CHI2 = 0.1, 10.0  # residual over signal and χ²/dof; a model above both is rejected
_LARGE_CHI2 = 1.3  # χ²/dof that yields a warning
_MIN_WHITE_P = 1e-4


@dataclass(frozen=True)
class RingDownFit(FitResult):
    """Fit of a ring-down.

    Attributes:
        values: f1_Hz, zeta1 and, with a second mode, f2_Hz, zeta2, axis_angle_deg; with a mass k1_N_per_m, k2_N_per_m.
        covariance: covariance of the values in their order, shape (n, n).
        warnings: findings that limit the use of the values.
        curves: curve of each record and channel, from the release on.
        noise: white noise of one sample of each channel, m.
        residual_rms: rms of the residuals of the block averages of each channel, m.
        chi2_per_dof: χ² of the residuals per degree of freedom, relative to white noise; 1 for a correct model.
        release_s: start of the fit in each record, s.
        intervals: 95 % interval of every value, from the profile likelihood if the covariance is not sufficient.
        model: description of the smallest adequate model.
        model_table: compared models. The criterion is BIC relative to the chosen model.
        verdict: sentence about the adequacy of the model.
        whiteness: whiteness test of the residuals.
        axes_resolved: whether the axes of two modes are distinguishable.
        amplitude: damping and frequency over amplitude of each mode, if the decay is long enough.
        nonlinear: directions whose frequency or damping ratio depends on amplitude, as fitted. Their values are
            those at zero amplitude.
        setting: effort of the fit.
        settled: whether the iteration converged. Always true, since other fits are rejected.
        terms: amplitude dependence of stiffness and damping in each direction, including terms that are only likely.
    """

    values: dict[str, float]
    covariance: np.ndarray
    warnings: list[str]
    curves: list[FittedCurve]
    noise: list[float]
    residual_rms: list[float]
    chi2_per_dof: float
    release_s: list[float]
    intervals: dict[str, tuple[float, float]]
    model: str
    model_table: list[ModelChoice]
    verdict: str
    whiteness: Whiteness
    axes_resolved: bool
    amplitude: list[AmplitudeDependence]
    nonlinear: list[RatesOverAmplitude]
    setting: Setting
    settled: bool = True
    terms: list[DirectionTerms] = field(default_factory=list[DirectionTerms])


@dataclass
class Findings:
    """Options of a fit and the warnings collected so far."""

    setting: Setting
    priors: Priors
    mass_kg: float | None
    warnings: list[str]
    without: frozenset[Rung] = frozenset()

    def add_outliers(self, count: int) -> None:
        """Add a warning with the number of outliers."""
        if count:
            self.warnings.append(f"{number_of(count, 'sample')} that no noise explains left out")


def result(fitted: FittedDecay, findings: Findings, labels: tuple[str, ...], gain: float = np.inf) -> RingDownFit:
    """Convert a solved fit to a RingDownFit.

    Args:
        fitted: solved fit.
        findings: options and warnings so far.
        labels: numbers of the directions, "1" or "2" or both.
        gain: reduction of χ² by the second mode compared with one mode in both sensors.
    Raises:
        FitFailed: the fit did not converge, the model leaves a large part of the signal, or dry friction damps it.
        NotIdentifiable: the damping is below the noise.
    """
    chi2 = fitted.solution.chi2_per_dof
    stretch = stretches(fitted)
    warnings = [*findings.warnings, *_disturbance_messages(fitted, labels)]
    found = _resolution_of_settled(fitted, findings.priors, stretch, gain)
    curves, rms = _curves(fitted, chi2, _axes(labels))
    numbers = numbers_of(fitted, findings.setting, findings.priors, labels, stretch, found)
    dependence = amplitudes_of(fitted, len(labels), stretch) if findings.setting != "fast" else []
    nonlinear = rates_over_amplitude(fitted, labels, stretch)
    refuse_dry_friction(nonlinear)
    warnings += [one.sentence for one in nonlinear]
    table = model_table(fitted, found, ", ".join(one.short for one in nonlinear))
    chosen = next(choice for choice in table if choice.chosen)
    other_law = bool(nonlinear) and OTHER_LAW in chosen.missing
    if other_law:
        widen_for_other_law(numbers, nonlinear, labels)
    widen_for_friction(numbers, nonlinear, labels)
    changes = widen_for_amplitude(numbers, beyond_terms(fitted, dependence, stretch), labels)
    warnings += changes
    warnings += _doubts(numbers, labels, found, chosen, chi2)
    white = whiteness([r for record in fitted.channel_residuals() for r in record])
    numbers = with_stiffness(numbers, findings.mass_kg)
    return RingDownFit(
        values=dict(zip(numbers.names, numbers.values.tolist(), strict=True)),
        covariance=numbers.covariance,
        warnings=warnings,
        curves=curves,
        noise=[c.noise for record in fitted.model.records for c in record.channels],
        residual_rms=rms,
        chi2_per_dof=chi2,
        release_s=list(fitted.decay.begins),
        intervals={n: (float(a), float(b)) for n, a, b in zip(numbers.names, numbers.low, numbers.high, strict=True)},
        model=chosen.name,
        model_table=table,
        verdict=_verdict(white, chi2, stretch, bool(changes), _coloured_noise(fitted), other_law),
        whiteness=white,
        axes_resolved=found is None or found.resolved,
        amplitude=dependence,
        nonlinear=nonlinear,
        setting=findings.setting,
        terms=direction_terms(fitted, labels, stretch),
    )


def _resolution_of_settled(fitted: FittedDecay, priors: Priors, stretch: np.ndarray, gain: float) -> Resolution | None:
    """Return the resolution of the axes, None for free modes; raise `FitFailed` if the fit did not converge."""
    minimum, chi2 = fitted.solution.minimum, fitted.solution.chi2_per_dof
    found: Resolution | None = None
    if fitted.model.turned:
        # the angle is held: χ² does not depend on it and has no minimum
        held = not minimum.converged and minimum.iterations == 1
        found = resolution(fitted, priors, float(stretch[BETA]), 0.0 if held else gain)
    lost = not minimum.converged and (found is None or found.resolved)  # an unresolved angle has no minimum
    if lost or not np.all(np.isfinite(minimum.theta)):
        raise FitFailed(
            f"ring-down: no convergence in {number_of(minimum.iterations, 'iteration')}"
            + (
                f", and χ²/dof {chi2:.3g} is above 1.3: is it a free decay, and in metres?"
                if chi2 > _LARGE_CHI2
                else f"; χ²/dof {chi2:.3g} supports the model, but the data do not determine its values: record longer"
            )
        )
    return found


def _doubts(
    numbers: Numbers, labels: tuple[str, ...], found: Resolution | None, chosen: ModelChoice, chi2: float
) -> list[str]:
    """Return the warnings about the values; raise `NotIdentifiable` for a damping ratio that is not positive."""
    warnings: list[str] = []
    for label, i in zip(labels, range(1, 2 * len(labels), 2), strict=True):
        warnings += damping_remark(numbers, label, i)
    if found is not None and not found.resolved:
        warnings.append(_unresolved(found))
    warnings += [chosen.why] if chosen.missing else []
    if chi2 > _LARGE_CHI2:
        warnings.append(f"residuals exceed the sensor noise: χ²/dof {chi2:.3g}; standard deviations are scaled up")
    return warnings


def _disturbance_messages(fitted: FittedDecay, labels: tuple[str, ...]) -> list[str]:
    """Messages about lines and wander. A single sensor has the name of its direction."""
    found, axes = fitted.found_lines(), _axes(labels)
    lines = sentences([(a, lines) for own in found for a, lines in zip(axes, own, strict=True)])
    left = zip(fitted.model.records, fitted.plain_residuals(), strict=True)
    return lines + wander_sentences(
        one for record, rests in left for one in zip(axes, record.channels, rests, strict=True)
    )


def _axes(labels: tuple[str, ...]) -> str:
    return "xy" if len(labels) == 2 else "xy"[int(labels[0]) - 1]


def _coloured_noise(fitted: FittedDecay) -> str:
    """Rms of the coloured noise of each channel as text; "" if all noise is white."""
    parts: list[str] = []
    for record in fitted.model.records:
        for colour, channel in zip(record.colours, record.channels, strict=False):
            if colour is not None:
                rms = colour.rms * colour.noise / float(np.sqrt(np.median(channel.count)))
                parts.append(f"{1e6 * rms:.2g} µm")
    return f"{' and '.join(parts)} rms in the means that are fitted" if parts else ""


def _curves(fitted: FittedDecay, chi2: float, axes: str) -> tuple[list[FittedCurve], list[float]]:
    curves, rms = list[FittedCurve](), list[float]()
    for number, (record, residuals) in enumerate(zip(fitted.model.records, fitted.plain_residuals(), strict=True)):
        for axis, channel, metres in zip(axes, record.channels, residuals, strict=True):
            left_over = float(np.std(metres) / np.std(channel.value))
            white = float(np.std(1 / channel.weight) + np.mean(1 / channel.weight)) / float(np.std(channel.value))
            if left_over > max(_MAX_RESIDUAL_RATIO, 2 * white) and chi2 > _MAX_CHI2:
                raise FitFailed(
                    f"ring-down: the model leaves {left_over:.0%} of sensor {axis}'s signal, above "
                    f"{max(_MAX_RESIDUAL_RATIO, 2 * white):.0%}, at a χ²/dof of {chi2:.3g}, above {_MAX_CHI2:g}: the "
                    f"motion is not a sum of {number_of(fitted.model.modes, 'decaying mode')}"
                )
            rms.append(float(np.sqrt(np.mean(metres**2))))
            curves.append(
                FittedCurve(
                    f"ring-down {number + 1}: {axis}", "m", channel.time_s, channel.value, channel.value - metres
                )
            )
    return curves, rms


def _unresolved(found: Resolution) -> str:
    why: list[str] = []
    if found.split < RESOLVED_SPLIT:
        split, needed = distinct(found.split, RESOLVED_SPLIT)
        why.append(f"the modes are {split} half-bandwidths apart, {needed} are needed")
    elif not found.certain:
        why.append(f"the modes are {found.split:.2g} ± {found.split_std:.2g} half-bandwidths apart, not significantly")
    if found.axis_std_rad > WALD_STD:
        angle, needed = distinct(min(float(np.degrees(found.axis_std_rad)), 90.0), float(np.degrees(WALD_STD)))
        why.append(f"the axis angle stays uncertain by {angle}°, {needed}° are needed")
    if found.gain < RESOLVED_GAIN:
        gain, needed = distinct(found.gain, RESOLVED_GAIN, 3)
        much = f"improves χ² by only {gain}" if found.gain > 0 else "does not improve χ²"
        why.append(f"a second mode {much} compared with one mode in both sensors, {needed} are needed")
    return f"axes not resolved: {'; '.join(why)}. Intervals are from the profile likelihood over the angle"


def _verdict(white: Whiteness, chi2: float, stretch: np.ndarray, changes: bool, coloured: str, other_law: bool) -> str:
    if other_law:
        return (
            "not adequate: frequency or damping depends on amplitude by another law than that of a cubic spring and of "
            "damping quadratic in speed (dry friction?); intervals cover the change"
        )
    if changes:
        return "not adequate: the decay is not exponential; see damping over amplitude"
    if coloured:
        return f"the noise is not white, {coloured}; its spectrum is in the weights and in the intervals"
    if white.p >= _MIN_WHITE_P and chi2 < 1.3:
        return f"adequate: residuals are white (p = {white.p:.2g}, χ²/dof {chi2:.3g})"
    widest = float(np.max(stretch))
    how = f"p = {white.p:.1g}, largest autocorrelation {white.correlation:+.2f}, χ²/dof {chi2:.3g}"
    if widest > 1.05:
        return f"doubtful: residuals are not white ({how}); intervals are widened by a factor of {widest:.2g}"
    return f"adequate: residuals are not white ({how}), but not in the modes' band"

"""Checks whether a record contains a ring-down: an oscillation in the covered band, sampled at a sufficient rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from dynamics.compiled_code import compiled
from identification.errors import FitFailed, NotIdentifiable
from identification.ring_down.decay import COARSE_S, FittedDecay
from identification.ring_down.disturbances import is_disturbed, mode_size
from identification.ring_down.over_amplitude import RatesOverAmplitude
from identification.ring_down.record import SensorRecord, sample_noise
from identification.ring_down.scores import stretches
from identification.samples import usual_interval

_CUBIC = 3
_MIN_CHI2_MARGIN = 20.0  # of χ² beyond the penalty of the search: probability e⁻¹⁰
HIGHEST_Hz: Final = 0.4 / COARSE_S  # below the Nyquist frequency 0.5 / COARSE_S of the blocks for start values
_LOUDEST_S = 1.0
_PEAK_HALF_WIDTH, _MIN_PEAK_SHARE = 0.2, 0.5  # of the peak's frequency; of the stretch's energy
_ZETA_OF_ONE_PERIOD = 1 / (2 * np.pi)  # damping ratio of a mode that falls to 1/e within one period
_MAX_ZETA = 0.5  # of a mode of the suspension
_MIN_BEFORE_S = 0.1  # of a record before the start of its fit
_MAX_EARLY_RATIO, _MAX_MISFIT = 4.0, 0.01  # early over late residuals; early residuals over the strongest mode
_MAX_FALL = 0.25
"""Fall of ζ with amplitude over ζ at the largest amplitude, above which ζ is refused.

With dry friction the viscous ratio lies below both. Of decays with 0.6 to 5 % of friction at the largest amplitude, the
value at zero amplitude is too large by 0.75 to 0.9 of the fall. Beyond this limit its error is larger than a sixth.
"""
_MAX_NOISE_RATIO, _FEW_SAMPLES = 0.7, 25.0  # noise of residuals over noise of differences; samples per cycle


def refuse_nothing_rings(fitted: FittedDecay) -> None:
    """Raise NotIdentifiable if the modes explain no more χ² than the best frequency would in drift and noise.

    The largest of N periodogram ordinates of noise explains about 2 ln N of χ². Each mode was selected among as many
    frequencies as there are blocks.
    """
    higher = replace(fitted.model, drift=max(_CUBIC, fitted.model.drift))
    alone = 0.0
    for record, block in zip(fitted.model.records, fitted.model(fitted.theta), strict=True):
        columns = record.scaled(higher.other_columns(record))
        rest = block.data - columns @ np.linalg.lstsq(columns, block.data, rcond=None)[0]
        alone += float(rest @ rest)
    modes = fitted.model.modes
    band = float(np.max(stretches(fitted)[: 2 * modes])) ** 2  # noise in the modes' band over white noise
    gain = (alone - fitted.chi2) / band
    price = 2 * modes * float(np.log(fitted.count)) + _MIN_CHI2_MARGIN
    if gain < price:
        begins = ", ".join(f"{b:.4g} s" for b in fitted.decay.begins)
        raise NotIdentifiable(
            f"nothing rings after the release at {begins}: the best oscillation explains {max(gain, 0.0):.3g} of χ² "
            f"beyond drift, chance alone up to {price:.3g}; pull farther and release suddenly"
        )


def refuse_no_suspension_mode(fitted: FittedDecay) -> None:
    """Raise NotIdentifiable if a mode decays within one period and is therefore not a mode of the suspension.

    A push, a hold or a drift within the fitted span look like such a mode, and the motion they hide looks like coloured
    noise. A damping ratio up to 0.5 is accepted if the noise is white, or if it is even over the record and nothing
    precedes the decay.
    """
    for m, (omega, zeta) in enumerate(zip(fitted.omegas, fitted.zetas, strict=True)):
        if zeta < _ZETA_OF_ONE_PERIOD:
            continue
        early, late = _early_and_late(fitted)
        precedes = any(
            begin - float(channels[0].time_s[0]) > _MIN_BEFORE_S
            for begin, channels in zip(fitted.decay.begins, fitted.decay.records, strict=True)
        )
        coloured = any(c.colour is not None for own in fitted.decay.records for c in own)
        if zeta > _MAX_ZETA or (coloured and (precedes or early > _MAX_EARLY_RATIO * late)):
            raise NotIdentifiable(
                f"what moves at {omega / (2 * np.pi):.3g} Hz after {fitted.decay.begins[0]:.4g} s decays within "
                f"{1 / (2 * np.pi * zeta):.2f} of its period (ζ = {zeta:.2g}, mode {m + 1}), which no mode of the "
                "suspension does; the fitted span may contain a part of the pull or the hold. Cut the recording at "
                "the release"
            )


def refuse_misfit(fitted: FittedDecay) -> None:
    """Raise FitFailed if the residuals, modelled as coloured noise, are much larger at the start than later."""
    if not is_disturbed(fitted):
        return
    early, late = _early_and_late(fitted)
    size = max(mode_size(fitted, m) for m in range(fitted.model.modes))
    if early > _MAX_EARLY_RATIO * late and early > _MAX_MISFIT * size:
        raise FitFailed(
            f"ring-down: the modes leave {1e6 * early:.3g} µm rms in the first eighth of the record and "
            f"{1e6 * late:.3g} µm later, {early / late:.2g} times as much: this is not noise but motion other than a "
            f"free decay; does the fit, from {fitted.decay.begins[0]:.4g} s on, begin before the release?"
        )


class DryFriction(FitFailed):
    """Dry friction damps the decay. No other start and no other sensor of the record helps."""


def rubs(fall: float, zeta: float) -> bool:
    """Whether damping falls with amplitude so much that dry friction is a part of it that must not be neglected.

    Args:
        fall: decrease of the damping ratio from zero amplitude to the largest one.
        zeta: damping ratio at zero amplitude.
    """
    return fall > _MAX_FALL * max(zeta - fall, 0.0)


def refuse_dry_friction(nonlinear: Sequence[RatesOverAmplitude]) -> None:
    """Raise DryFriction if a direction rubs."""
    for one in nonlinear:
        if rubs(one.fall, one.zeta):
            largest = max(one.zeta - one.fall, 0.0)
            raise DryFriction(
                f"ring-down: direction {one.direction}'s damping ratio falls with amplitude, from {one.zeta:.3g} close "
                f"to rest to {largest:.3g} at {1e3 * one.largest_m:.3g} mm. This is dry friction in the suspension, "
                "and no damping ratio describes such a decay. Look for what rubs: a cable, a guide, a loose joint"
            )


def refuse_line_in_mode(fitted: FittedDecay) -> None:
    """Raise FitFailed if a steady line lies within the half-bandwidth of a mode, where only its misfit is likely."""
    for own in fitted.found_lines():
        for line in (line for lines in own for line in lines if not line.decay):
            for omega, zeta in zip(fitted.omegas, fitted.zetas, strict=True):
                mode_Hz = float(omega) / (2 * np.pi)
                if abs(line.frequency_Hz - mode_Hz) < float(zeta) * mode_Hz:
                    raise FitFailed(
                        f"ring-down: {1e6 * abs(line.amplitude_m):.3g} µm at {line.frequency_Hz:.4g} Hz do not decay, "
                        f"within the half-bandwidth of the mode at {mode_Hz:.4g} Hz: the mode is not a decaying "
                        "sinusoid (dry friction, a clearance, a spring that yields?), or something drives it"
                    )


def friction_std(one: RatesOverAmplitude) -> float:
    """Standard uncertainty of ζ of a direction whose damping falls with amplitude, because of dry friction.

    Without friction the value at zero amplitude holds, with friction it is too large by up to the fall. The error is
    taken as uniform up to the fall to both sides.
    """
    return one.fall / float(np.sqrt(3))


def _early_and_late(fitted: FittedDecay) -> tuple[float, float]:
    """Rms of the residuals in the first eighth, and median rms of the others, m, for the channel of largest ratio."""
    worst = (0.0, 1e-300)
    for residuals in fitted.plain_residuals():
        for own in residuals:
            parts = [float(np.std(part)) for part in np.array_split(own, 8)]
            late = max(float(np.median(parts[1:])), 1e-300)
            worst = max(worst, (parts[0], late), key=lambda pair: pair[0] / pair[1])
    return worst


def refuse_too_fast(records: Sequence[Sequence[SensorRecord]]) -> None:
    """Raise NotIdentifiable if most energy of a sensor's loudest second is a tone above the covered band."""
    for channels in records:
        for sensor, channel in zip("xy", channels, strict=False):
            frequency, share = _loudest_tone(channel)
            if frequency > HIGHEST_Hz and share > _MIN_PEAK_SHARE:
                raise NotIdentifiable(
                    f"sensor {sensor} rings at about {frequency:.3g} Hz; frequencies up to {HIGHEST_Hz:.4g} Hz are "
                    "covered. Is time_s in seconds, and is it the suspension that rings?"
                )


def _loudest_tone(channel: SensorRecord) -> tuple[float, float]:
    """Frequency of the strongest peak in the loudest second, Hz, and the share of the energy near that peak.

    Samples that are left out count as rest, which is sufficient to distinguish a tone from spikes and steps.
    """
    step = usual_interval(channel.time_s)
    if step <= 0 or 0.5 / step < HIGHEST_Hz:
        return 0.0, 0.0
    size = max(16, min(len(channel.value_m), round(_LOUDEST_S / step)))
    first, mean = _loudest(channel.value_m, channel.keep, size)
    stretch = slice(first, first + size)
    move = np.where(channel.keep[stretch], channel.value_m[stretch] - mean, 0.0)
    power = np.abs(np.fft.rfft(move, 2 * size)) ** 2
    frequency = np.arange(len(power)) / (2 * size * step)
    peak = float(frequency[int(np.argmax(power))])
    near = np.abs(frequency - peak) <= _PEAK_HALF_WIDTH * peak
    return peak, float(power[near].sum() / max(float(power.sum()), 1e-300))


@compiled(nogil=True)
def _loudest(value: np.ndarray, keep: np.ndarray, size: int) -> tuple[int, float]:
    """First index of the stretch of `size` samples whose kept ones have the largest scatter, and their mean."""
    best, begin, level = -1.0, 0, 0.0
    for first in range(0, len(value), size):
        last = min(first + size, len(value))
        total, count = 0.0, 0
        for i in range(first, last):
            total += value[i] if keep[i] else 0.0
            count += keep[i]
        mean, energy = total / max(count, 1), 0.0
        for i in range(first, last):
            energy += (value[i] - mean) ** 2 if keep[i] else 0.0
        if energy > best:
            best, begin, level = energy, first, mean
    return begin, level


def coarse_remark(fitted: FittedDecay) -> list[str]:
    """Return a message if the noise comes from the residuals, so that χ² cannot reveal a wrong model."""
    cycle_s = 2 * np.pi / float(np.max(fitted.omegas))
    for record in fitted.decay.records:
        for channel in record:
            per_cycle = cycle_s / usual_interval(channel.time_s)
            coarse = per_cycle < _FEW_SAMPLES
            if coarse and channel.noise < _MAX_NOISE_RATIO * sample_noise(channel.value_m[channel.keep]):
                return [
                    f"only {per_cycle:.2g} samples a cycle: the noise is taken from the residuals and χ² does not "
                    "test the model; sample faster"
                ]
    return []

"""Whether a record holds a ring-down at all: something rings, in the band that is covered, sampled finely enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numba import njit

from identification.errors import FitFailed, NotIdentifiable
from identification.ring_down.decay import COARSE_S, Fitted
from identification.ring_down.disturbances import is_disturbed, mode_size
from identification.ring_down.record import Channel, sample_noise
from identification.ring_down.scores import stretches
from identification.samples import usual_interval

_CUBIC = 3
_MARGIN = 20.0  # of χ²: e⁻¹⁰ beyond the price of the search
HIGHEST_Hz = 0.4 / COARSE_S  # of Nyquist's 0.5 for the blocks that start values come from
_LOUDEST_S = 1.0
_NEAR, _MOST = 0.2, 0.5  # of the peak's frequency; of the stretch's energy
_WITHIN_A_PERIOD = 1 / (2 * np.pi)  # ζ of a mode that falls to 1/e within one
_NO_SUSPENSION = 0.5
_LEAST_BEFORE_S = 0.1  # of a record before its fit's begin
_UNLIKE, _MISFIT = 4.0, 0.01  # times the usual noise; of the strongest mode
_COARSE, _FEW = 0.7, 25.0  # residuals' noise over differences'; samples a cycle


def refuse_nothing_rings(fitted: Fitted) -> None:
    """Raises NotIdentifiable when the modes explain no more than the best of all frequencies would in drift and noise.

    Noise's largest periodogram ordinate of N explains about 2 ln N of χ²; each mode was picked among as many
    frequencies as there are blocks.
    """
    higher = replace(fitted.model, drift=max(_CUBIC, fitted.model.drift))
    alone = 0.0
    for record, block in zip(fitted.model.records, fitted.model(fitted.theta), strict=True):
        columns = record.scaled(higher.beside_columns(record))
        rest = block.data - columns @ np.linalg.lstsq(columns, block.data, rcond=None)[0]
        alone += float(rest @ rest)
    modes = fitted.model.modes
    band = float(np.max(stretches(fitted)[: 2 * modes])) ** 2  # noise above white where the modes are
    gain = (alone - fitted.chi2) / band
    price = 2 * modes * float(np.log(fitted.count)) + _MARGIN
    if gain < price:
        begins = ", ".join(f"{b:.4g} s" for b in fitted.decay.begins)
        raise NotIdentifiable(
            f"nothing rings after the release at {begins}: the best oscillation explains {max(gain, 0.0):.3g} of χ² "
            f"beyond drift, chance alone up to {price:.3g}; pull farther and let go suddenly"
        )


def refuse_no_suspension_mode(fitted: Fitted) -> None:
    """Raises NotIdentifiable when what was found decays within a period: it turns round once and is gone.

    A push, a hold or a drift that the fit took in look like that, and what they hide passes for coloured noise. Up to
    a damping of a half it is believed where the noise is white, or even and nothing precedes the decay.
    """
    for m, (omega, zeta) in enumerate(zip(fitted.omegas, fitted.zetas, strict=True)):
        if zeta < _WITHIN_A_PERIOD:
            continue
        early, late = _early_and_late(fitted)
        precedes = any(
            begin - float(channels[0].time_s[0]) > _LEAST_BEFORE_S
            for begin, channels in zip(fitted.decay.begins, fitted.decay.records, strict=True)
        )
        coloured = any(c.colour is not None for own in fitted.decay.records for c in own)
        if zeta > _NO_SUSPENSION or (coloured and (precedes or early > _UNLIKE * late)):
            raise NotIdentifiable(
                f"what moves at {omega / (2 * np.pi):.3g} Hz after {fitted.decay.begins[0]:.4g} s decays within "
                f"{1 / (2 * np.pi * zeta):.2f} of its period (ζ = {zeta:.2g}, mode {m + 1}), which no mode of the "
                "suspension does; the fit may hold a part of the pull or the hold. Cut the recording at the release"
            )


def refuse_misfit(fitted: Fitted) -> None:
    """Raises FitFailed when what a fit leaves, taken for coloured noise, is far larger at the begin than later on."""
    if not is_disturbed(fitted):
        return
    early, late = _early_and_late(fitted)
    size = max(mode_size(fitted, m) for m in range(fitted.model.modes))
    if early > _UNLIKE * late and early > _MISFIT * size:
        raise FitFailed(
            f"ring-down: the modes leave {1e6 * early:.3g} µm rms in the first eighth of the record and "
            f"{1e6 * late:.3g} µm later, {early / late:.2g} times as much: that is no noise but motion that is no free "
            f"decay; does the fit, from {fitted.decay.begins[0]:.4g} s on, begin before the release?"
        )


def _early_and_late(fitted: Fitted) -> tuple[float, float]:
    """Rms of what a fit leaves in the first eighth and, the median, in the others, m, where they differ most."""
    worst = (0.0, 1e-300)
    for residuals in fitted.plain_residuals():
        for own in residuals:
            parts = [float(np.std(part)) for part in np.array_split(own, 8)]
            late = max(float(np.median(parts[1:])), 1e-300)
            worst = max(worst, (parts[0], late), key=lambda pair: pair[0] / pair[1])
    return worst


def refuse_too_fast(records: Sequence[Sequence[Channel]]) -> None:
    """Raises NotIdentifiable when most of a sensor's loudest second is a tone above the band that is covered."""
    for channels in records:
        for sensor, channel in zip("xy", channels, strict=False):
            frequency, share = _loudest_tone(channel)
            if frequency > HIGHEST_Hz and share > _MOST:
                raise NotIdentifiable(
                    f"sensor {sensor} rings at about {frequency:.3g} Hz; frequencies up to {HIGHEST_Hz:.4g} Hz are "
                    "covered. Is time_s in seconds, and is it the suspension that rings?"
                )


def _loudest_tone(channel: Channel) -> tuple[float, float]:
    """Frequency of the strongest peak in the loudest second, Hz, and the share of its energy near that peak.

    Samples left out count as rest, which suffices to tell a tone from spikes and steps.
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
    near = np.abs(frequency - peak) <= _NEAR * peak
    return peak, float(power[near].sum() / max(float(power.sum()), 1e-300))


@njit(cache=True, nogil=True, error_model="numpy")
def _loudest(value: np.ndarray, keep: np.ndarray, size: int) -> tuple[int, float]:
    """Where the stretch of `size` samples begins whose kept ones scatter most, and their mean."""
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


def coarse_remark(fitted: Fitted) -> list[str]:
    """A sentence when the noise had to be taken from the residuals, so that χ² can't tell a wrong model."""
    cycle_s = 2 * np.pi / float(np.max(fitted.omegas))
    for record in fitted.decay.records:
        for channel in record:
            per_cycle = cycle_s / usual_interval(channel.time_s)
            if per_cycle < _FEW and channel.noise < _COARSE * sample_noise(channel.value_m[channel.keep]):
                return [
                    f"only {per_cycle:.2g} samples a cycle: the noise is taken from the residuals and χ² says "
                    "nothing of the model; sample faster"
                ]
    return []

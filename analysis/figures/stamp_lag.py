"""Time lag between displacements and the rotor's phase, estimated with the model, as sentences below figures.

Lasers and encoder have clocks of their own, and the encoder's blocks arrive by radio. The time of the displacements
relative to the rotor's phase is therefore known only up to a shift, which appears in every figure with both.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from analysis.figures.order_vectors import OrderVectors, PassedVectors
from rig_basics.arrays import Array, Complex
from rig_basics.units import TO_RPM

_MAX_REST_RAD, _MAX_REST_SHARE = math.radians(1.5), 0.25  # rms residual of a line, absolute and of the whole phase
_MIN_STDS = 3.0  # phase at one speed in standard deviations above which it is reported
_LEAST_RAD = math.radians(0.5)
_FREE = "Every fit leaves this shift between the devices free."


def lag_words(found: PassedVectors) -> list[str]:
    """Describe how much later or earlier than the rotor's phase each displacement is stamped, by the simulated run.

    A lag is a straight line through the origin of phase over speed, weighted by the amplitudes. Its ± is half the
    difference of the lags of the slow and the fast half of the weight. If no line fits, there is another difference.
    At one speed no line exists: the phase difference is reported, with the time shift that would cause it.
    """
    if not found.simulated:
        return []
    if all(len(seen.speed_rad_s) == 1 for seen in found.measured.values()):
        return _one_speed_words(found)
    words = [_lag_word(name, found.simulated[name], seen) for name, seen in found.measured.items()]
    lags = [word for word, is_line in words if is_line and word]
    others = [word for word, is_line in words if not is_line and word]
    messages: list[str] = []
    if lags:
        messages.append(
            "Measured less simulated phase is a straight line through 0 at standstill, as of stamps that are shifted "
            f"against the rotor's phase: {', '.join(lags)}. {_FREE}"
        )
    if others:
        messages.append(f"No lag of the stamps explains measured less simulated phase: {', '.join(others)}.")
    return messages


def _one_speed_words(found: PassedVectors) -> list[str]:
    """Describe the phase difference at one speed, where a shift of the stamps cannot be separated from a phase."""
    messages: list[str] = []
    speed = 0.0
    for name, seen in found.measured.items():
        simulated = found.simulated.get(name)
        if simulated is None:
            continue
        measured, model, speed = (
            complex(seen.amplitude_m[0]),
            complex(simulated.amplitude_m[0]),
            float(seen.speed_rad_s[0]),
        )
        if not (abs(measured) > 0 and abs(model) > 0):
            continue
        ahead = float(np.angle(measured * np.conj(model)))
        std = math.hypot(float(seen.std_m[0]) / abs(measured), float(simulated.std_m[0]) / abs(model))
        if math.isfinite(ahead) and abs(ahead) > max(_MIN_STDS * std, _LEAST_RAD):
            messages.append(
                f"{name} {abs(math.degrees(ahead)):.1f} ± {max(math.degrees(std), 0.1):.1f}° "
                f"{'ahead' if ahead > 0 else 'behind'}, as of stamps {1e3 * abs(ahead) / speed:.2f} ms "
                f"{'early' if ahead > 0 else 'late'}"
            )
    if not messages:
        return []
    return [
        f"Measured against the model's 1× phase at {TO_RPM * speed:.1f} rpm: {'; '.join(messages)}. At one speed a "
        f"shift of the stamps cannot be separated from a phase. {_FREE}"
    ]


def _lag_word(name: str, model: OrderVectors, measured: OrderVectors) -> tuple[str, bool]:
    """Describe a displacement's lag, and whether it is one; else the residual of a line. Empty with too few vectors."""
    speed, simulated = measured.speed_rad_s, _complex_interp(measured.speed_rad_s, model)
    ahead = np.angle(measured.amplitude_m * np.conj(simulated))
    weight = np.abs(simulated) * np.abs(measured.amplitude_m)
    good = np.isfinite(ahead) & np.isfinite(weight)
    speed, ahead, weight = speed[good], ahead[good], weight[good]

    def lag_of(part: NDArray[np.bool_] | slice) -> float:
        return -float((weight * speed * ahead)[part].sum() / (weight * speed**2)[part].sum())

    passed = np.cumsum(weight * speed**2)
    slow = passed <= 0.5 * passed[-1:]
    if not 0 < np.count_nonzero(slow) < len(slow) or not passed[slow][-1] > 0:
        return "", False
    lag, std = lag_of(slice(None)), 0.5 * abs(lag_of(slow) - lag_of(~slow))
    rest = math.sqrt(float(np.average((ahead + lag * speed) ** 2, weights=weight)))
    if rest > _MAX_REST_RAD and rest > _MAX_REST_SHARE * math.sqrt(float(np.average(ahead**2, weights=weight))):
        return f"a line leaves {math.degrees(rest):.0f}° rms in {name}", False
    return f"{name} {1e3 * abs(lag):.2f} ± {max(1e3 * std, 0.01):.2f} ms {'late' if lag > 0 else 'early'}", True


def _complex_interp(speed: Array, found: OrderVectors) -> Complex:
    order = np.argsort(found.speed_rad_s)
    at, values = found.speed_rad_s[order], found.amplitude_m[order]
    return np.interp(speed, at, values.real) + 1j * np.interp(speed, at, values.imag)

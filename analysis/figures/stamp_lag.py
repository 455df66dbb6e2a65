"""Time lag between displacements and the rotor's phase, estimated with the model, as sentences below figures.

Lasers and encoder have clocks of their own, and the encoder's blocks arrive by radio. The time of the displacements
relative to the rotor's phase is therefore known only up to a shift, which appears in every figure with both.
"""

from __future__ import annotations

import math

import numpy as np

from analysis.figures.intervals import TIMES
from analysis.figures.order_vectors import PassedVectors
from analysis.quantities.stamp_lag import UNKNOWN_LAG_STD_S, fitted_lag
from rig_basics.units import TO_RPM

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
    words = [_lag_word(name, found) for name in found.measured]
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


def _lag_word(name: str, found: PassedVectors) -> tuple[str, bool]:
    """Describe a displacement's lag, and whether it is one; else the residual of a line. Empty with too few vectors."""
    measured = found.measured[name]
    lag = fitted_lag(measured.speed_rad_s, measured.amplitude_m, found.simulated[name].at(measured.speed_rad_s))
    if lag is None:
        return "", False
    if not lag.is_line:
        return f"a line leaves {math.degrees(lag.rest_rad):.0f}° rms in {name}", False
    lag = found.lags.get(name, lag)
    return f"{name} {1e3 * abs(lag.lag_s):.2f} ± {1e3 * lag.std_s:.2f} ms {'late' if lag.lag_s > 0 else 'early'}", True


def correction_words(found: PassedVectors) -> list[str]:
    """Describe what the drawn phases and their intervals contain of the lags, in a sentence."""
    corrected = [name for name, lag in found.lags.items() if lag.is_line]
    unknown = [name for name, lag in found.lags.items() if not lag.is_line and lag.std_s > 0]
    messages: list[str] = []
    if corrected:
        messages.append(
            f"Measured vectors of {' and '.join(corrected)} are drawn without this shift; its ± is part of the "
            "intervals of the phase."
        )
    if unknown:
        messages.append(
            f"The shift of {' and '.join(unknown)} against the rotor's phase is not known: ± "
            f"{1e3 * TIMES * UNKNOWN_LAG_STD_S:.0f} ms (separate clocks) are part of the intervals of the phase."
        )
    return messages

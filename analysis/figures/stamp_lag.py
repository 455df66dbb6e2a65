# pyright: strict
"""How far displacements are stamped beside the rotor's phase, by the model: the words under every figure that shows it.

Lasers and encoder are stamped by clocks of their own, and the encoder's blocks come by radio: what they share with the
rotor's phase is known only up to a shift, which every figure with both shows.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from analysis.figures.order_vectors import RPM, PassedVectors, Vectors

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_STRAIGHT_RAD, _SHARE = math.radians(1.5), 0.25  # left beside a line: little, or little of what there was
_TOLD = 3.0  # standard deviations above which a phase at one speed is spoken of
_LEAST_RAD = math.radians(0.5)
_FREE = "Every fit leaves this shift between the devices free."


def lag_words(found: PassedVectors) -> list[str]:
    """How much later or earlier than the rotor's phase each displacement is stamped, by the simulated run, a sentence.

    A lag is a straight line through the origin of phase against speed, weighted by the amplitudes; its ± is half the
    difference of the lags of slow and fast half of the weight. Where no line fits, something else differs. At one
    speed there is no line: what the phase differs by is said, and what shift would do that.
    """
    if not found.simulated:
        return []
    if all(len(seen.speed_rad_s) == 1 for seen in found.measured.values()):
        return _one_speed_words(found)
    words = [_lag_word(name, found.simulated[name], seen) for name, seen in found.measured.items()]
    lags = [word for word, is_line in words if is_line and word]
    others = [word for word, is_line in words if not is_line and word]
    told: list[str] = []
    if lags:
        told.append(
            "Measured less simulated phase is a straight line through 0 at standstill, as of stamps that are shifted "
            f"against the rotor's phase: {', '.join(lags)}. {_FREE}"
        )
    if others:
        told.append(f"No lag of the stamps explains measured less simulated phase: {', '.join(others)}.")
    return told


def _one_speed_words(found: PassedVectors) -> list[str]:
    """At one speed a shift of the stamps is a phase, and a phase may be anything's."""
    told: list[str] = []
    speed = 0.0
    for name, seen in found.measured.items():
        beside = found.simulated.get(name)
        if beside is None:
            continue
        measured, model, speed = (
            complex(seen.amplitude_m[0]),
            complex(beside.amplitude_m[0]),
            float(seen.speed_rad_s[0]),
        )
        if not (abs(measured) > 0 and abs(model) > 0):
            continue
        ahead = float(np.angle(measured * np.conj(model)))
        std = math.hypot(float(seen.std_m[0]) / abs(measured), float(beside.std_m[0]) / abs(model))
        if math.isfinite(ahead) and abs(ahead) > max(_TOLD * std, _LEAST_RAD):
            told.append(
                f"{name} {abs(math.degrees(ahead)):.1f} ± {max(math.degrees(std), 0.1):.1f}° "
                f"{'ahead' if ahead > 0 else 'behind'}, as of stamps {1e3 * abs(ahead) / speed:.2f} ms "
                f"{'early' if ahead > 0 else 'late'}"
            )
    if not told:
        return []
    return [
        f"Measured beside the model's 1× phase at {RPM * speed:.1f} rpm: {'; '.join(told)}. At one speed a shift of "
        f"the stamps cannot be told from a phase. {_FREE}"
    ]


def _lag_word(name: str, model: Vectors, measured: Vectors) -> tuple[str, bool]:
    """A displacement's lag in words, and whether it is one; else what a line leaves. No words of too few vectors."""
    speed, beside = measured.speed_rad_s, _complex_interp(measured.speed_rad_s, model)
    ahead = np.angle(measured.amplitude_m * np.conj(beside))
    weight = np.abs(beside) * np.abs(measured.amplitude_m)
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
    if rest > _STRAIGHT_RAD and rest > _SHARE * math.sqrt(float(np.average(ahead**2, weights=weight))):
        return f"a line leaves {math.degrees(rest):.0f}° rms in {name}", False
    return f"{name} {1e3 * abs(lag):.2f} ± {max(1e3 * std, 0.01):.2f} ms {'late' if lag > 0 else 'early'}", True


def _complex_interp(speed: Array, found: Vectors) -> Complex:
    order = np.argsort(found.speed_rad_s)
    at, values = found.speed_rad_s[order], found.amplitude_m[order]
    return np.interp(speed, at, values.real) + 1j * np.interp(speed, at, values.imag)

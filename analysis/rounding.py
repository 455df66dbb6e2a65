"""Numbers rounded to their uncertainty."""

from __future__ import annotations

import math

_MINUS = "\u2212"


def with_std(value: float, std: float, unit: str = "", digits: int = 1) -> str:
    """Format "2616.6 ± 0.2 N/m": the deviation with `digits` digits (one more if it begins with 1), the value alike.

    Very large and very small numbers have a power of ten: "(1.040 ± 0.004)·10⁻³ N m s/rad".
    """
    if not math.isfinite(value):
        return "–"
    tail = "" if unit in ("", "1") else unit if unit == "°" else f" {unit}"
    if not math.isfinite(std) or std <= 0:
        return plain(value) + tail
    magnitude = math.floor(math.log10(max(abs(value), std)))
    power = magnitude if magnitude < -2 or magnitude > 5 else 0
    value, std = value / 10.0**power, std / 10.0**power
    place = math.floor(math.log10(std))
    decimals = max(0, digits - 1 - place + (1 if round(std / 10.0**place, 6) < 1.95 else 0))
    text = f"{value:.{decimals}f} ± {std:.{decimals}f}"
    if power:
        text = f"({text})·10{_superscript(power)}"
    return text.replace("-", _MINUS) + tail


def plain(value: float, digits: int = 5) -> str:
    """Format a number without an uncertainty to some significant digits."""
    if not math.isfinite(value):
        return "–"
    text = f"{value:.{digits}g}"
    if "e" in text:
        mantissa, power = text.split("e")
        text = f"{mantissa}·10{_superscript(int(power))}"
    return text.replace("-", _MINUS)


def signed(value: float, digits: int = 1) -> str:
    """Format a signed number with fixed decimals."""
    return "–" if not math.isfinite(value) else f"{value:+.{digits}f}".replace("-", _MINUS)


def _superscript(number: int) -> str:
    return str(number).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))

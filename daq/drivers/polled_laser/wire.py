"""Texts of displacement sensors that answer one value to one request, by dialect.

Sources: docs/protocols/polled_laser.md, which also states what is not verified.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce

LONGEST_LINE_BYTES = 120
_NUMBER = re.compile(rb"[+-]?\d{1,8}(?:\.\d{1,7})?")
_OVER = re.compile(rb"([+-]?)F{3,}")
_NOTHING = re.compile(rb"X{3,}|-{3,}")
_REFUSED = re.compile(rb"ER,([A-Z0-9%#]{1,4}),(\d{1,3})")
_PANASONIC = re.compile(rb"%(\d\d)\$RMD([+-]\d{7})(\*\*|[0-9A-F]{2})")
_PANASONIC_REFUSED = re.compile(rb"%(\d\d)!(\d{1,3})(\*\*|[0-9A-F]{2})?")

KEYENCE_REFUSALS = {
    0: "unknown command",
    1: "not possible in its present state",
    20: "wrong length of the command",
    21: "wrong number of parameters",
    22: "wrong parameter",
    88: "time-out",
    99: "other error",
}
"""Reasons in an answer `ER,COMMAND,CODE`."""


@dataclass(frozen=True)
class Reading:
    """An answer with a value.

    Attributes:
        value: in the dialect's unit; NaN without a reading.
        state: why there is none: "over", "under" or "nothing"; empty with a reading.
    """

    value: float
    state: str = ""


@dataclass(frozen=True)
class Refusal:
    """An answer that refuses the request, with its reason."""

    why: str


@dataclass(frozen=True)
class Dialect:
    """Request and answer of one family of sensors.

    Attributes:
        sensors: families with this dialect.
        unit_m: unit of the value, m.
        request: makes the request for an output (its number or the sensor's address).
        parse: reads an answer without its end; None if it is not one.
        answer: makes the answer of a simulated sensor to a request; None for a request of another output.
        outputs: smallest and largest number of an output.
        baud: usual line rate, baud.
    """

    sensors: str
    unit_m: float
    request: Callable[[int], bytes]
    parse: Callable[[bytes, int], Reading | Refusal | None]
    answer: Callable[[bytes, int, Reading], bytes | None]
    outputs: tuple[int, int]
    baud: int


def _value(text: bytes) -> Reading | None:
    """Read a value, or the text in its place if the sensor has none."""
    if _NUMBER.fullmatch(text):
        return Reading(float(text))
    over = _OVER.fullmatch(text)
    if over:
        return Reading(math.nan, "under" if over[1] == b"-" else "over")
    return Reading(math.nan, "nothing") if _NOTHING.fullmatch(text) else None


def _refused(line: bytes) -> Refusal | None:
    found = _REFUSED.fullmatch(line)
    if not found:
        return None
    code = int(found[2])
    return Refusal(f"{found[1].decode()} refused with code {code:02d}: {KEYENCE_REFUSALS.get(code, 'unknown code')}")


def _text(reading: Reading, decimals: int, width: int) -> bytes:
    """Write a value with sign, leading zeros and decimals, or the text of its state."""
    match reading.state:
        case "over":
            return b"+" + b"F" * (width - 1)
        case "under":
            return b"-" + b"F" * (width - 1)
        case "":
            return f"{reading.value:+0{width}.{decimals}f}".encode()
        case _:
            return b"X" * width


def _lkg_parse(line: bytes, output: int) -> Reading | Refusal | None:
    head, comma, value = line.partition(b",")
    return (_value(value) if comma and head == b"M%d" % output and len(value) == 8 else None) or _refused(line)


def _lkg5_parse(line: bytes, output: int) -> Reading | Refusal | None:
    head, _, value = line.rpartition(b",")
    return (_value(value) if head == b"MS,%02d" % output and len(value) >= 8 else None) or _refused(line)


def _il_parse(line: bytes, output: int) -> Reading | Refusal | None:
    head, *values = line.split(b",")
    whole = head == b"M0" and len(values) > output
    return (_value(values[output]) if whole else None) or _refused(line)


def _il_answer(request: bytes, output: int, reading: Reading) -> bytes | None:
    if request != b"M0\r":
        return None
    values = [_text(Reading(0.0), 3, 7)] * output + [_text(reading, 3, 7)]
    return b"M0," + b",".join(values) + b"\r\n"


def check_sum(text: bytes) -> bytes:
    """Return the block check of a text: exclusive or of all bytes, two hexadecimal digits."""
    return b"%02X" % reduce(lambda whole, byte: whole ^ byte, text, 0)


def _panasonic_parse(line: bytes, output: int) -> Reading | Refusal | None:
    found = _PANASONIC.fullmatch(line)
    if found and int(found[1]) == output:
        return Reading(float(found[2]))
    refused = _PANASONIC_REFUSED.fullmatch(line)
    return Refusal(f"refused with code {int(refused[2])}") if refused and int(refused[1]) == output else None


def _panasonic_answer(request: bytes, output: int, reading: Reading) -> bytes | None:
    if request != b"%%%02d#RMD**\r" % output:
        return None
    far = {"over": 9_500_000.0, "under": -9_500_000.0, "nothing": 9_500_000.0}
    value = far.get(reading.state, reading.value)
    text = b"%%%02d$RMD%s" % (output, f"{round(value):+08d}".encode())
    return text + check_sum(text) + b"\r"


DIALECTS: Mapping[str, Dialect] = {
    "LK-G": Dialect(
        "Keyence LK-G",
        1e-3,
        lambda output: b"M%d\r" % output,
        _lkg_parse,
        lambda request, output, value: (
            b"M%d,%s\r" % (output, _text(value, 4, 8)) if request == b"M%d\r" % output else None
        ),
        (1, 2),
        115_200,
    ),
    "LK-G5000": Dialect(
        "Keyence LK-G5000",
        1e-3,
        lambda output: b"MS,%02d\r" % output,
        _lkg5_parse,
        lambda request, output, value: (
            b"MS,%02d,%s\r" % (output, _text(value, 4, 8)) if request == b"MS,%02d\r" % output else None
        ),
        (1, 12),
        115_200,
    ),
    "IL": Dialect("Keyence IL with DL-RS1A", 1e-3, lambda output: b"M0\r", _il_parse, _il_answer, (0, 14), 9_600),
    "HL-G1": Dialect(
        "Panasonic HL-G1",
        1e-7,
        lambda output: b"%%%02d#RMD**\r" % output,
        _panasonic_parse,
        _panasonic_answer,
        (1, 16),
        115_200,
    ),
}
"""Dialects by their name in a rig file. For HL-G1 the output is the sensor's address."""

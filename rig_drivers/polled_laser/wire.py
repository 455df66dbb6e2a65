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
_IL_STATES = {  # numbers and texts that are no value, with the decimals of IL-030 to 100, IL-300 and 600, IL-2000
    "over": re.compile(rb"\+(?:99\.999|999\.99|9999\.9)"),
    "under": re.compile(rb"-(?:99\.999|999\.99|9999\.9)"),
    "nothing": re.compile(rb"-(?:99\.998|999\.98|9999\.8)"),
    "error": re.compile(rb"\+E{1,5}\.E{1,5}"),
}
_REFUSED = re.compile(rb"ER,([A-Z0-9%#]{1,4}),(\d{1,3})")
_PANASONIC = re.compile(rb"%(\d\d)\$RMD([+-]\d{7})(\*\*|[0-9A-F]{2})")
_PANASONIC_REFUSED = re.compile(rb"%(\d\d)!(\d{1,3})(\*\*|[0-9A-F]{2})?")
_PANASONIC_FARTHEST = 9_500_000  # the largest value that is a measurement, 0.1 µm

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
PANASONIC_REFUSALS = {
    1: "unknown command",
    2: "wrong address",
    3: "wrong length of the data",
    4: "wrong block check",
    11: "damaged request: parity, framing or overrun",
    21: "the sensor is being set up (setting mode)",
    22: "not possible",
    31: "its memory is recording",
    32: "wrong settings of its memory",
    33: "its memory is not ready",
}
"""Reasons in an answer `%NN!CODE`."""


@dataclass(frozen=True)
class Reading:
    """An answer with a value.

    Attributes:
        value: in the dialect's unit; NaN without a reading, or the number that the sensor sends instead of one.
        state: why there is none: "over", "under", "nothing" or "error"; empty with a reading.
        check: whether the answer's block check is right; None without a block check.
    """

    value: float
    state: str = ""
    check: bool | None = None


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
        probe: makes a request that only reads, and whose answer cannot be taken for a value. A sensor answers in the
            order of the requests: after the answer to a probe no answer to an earlier request follows.
        answers_probe: whether a line without its end is the answer to the probe, also its refusal with the command.
        probe_answer: makes the answer of a simulated sensor to the probe.
        is_foreign: whether a line without its end is sent without a request, or belongs to another sensor.
        end: end of an answer.
    """

    sensors: str
    unit_m: float
    request: Callable[[int], bytes]
    parse: Callable[[bytes, int], Reading | Refusal | None]
    answer: Callable[[bytes, int, Reading], bytes | None]
    outputs: tuple[int, int]
    baud: int
    probe: Callable[[int], bytes]
    answers_probe: Callable[[bytes, int], bool]
    probe_answer: Callable[[int], bytes]
    is_foreign: Callable[[bytes, int], bool]
    end: bytes = b"\r"


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
    if head not in (b"MS,%02d" % output, b"MS"):
        return _refused(line)
    found = _value(value)
    return found if found and (len(value) >= 8 or found.state) else None


def _il_parse(line: bytes, output: int) -> Reading | Refusal | None:
    head, *values = line.split(b",")
    if head != b"M0" or len(values) <= output:
        return _refused(line)
    text = values[output]
    for state, known in _IL_STATES.items():
        if known.fullmatch(text):
            return Reading(math.nan if state == "error" else float(text), state)
    return _value(text)


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
        value = float(found[2])
        state = "" if abs(value) <= _PANASONIC_FARTHEST else "over" if value > 0 else "under"
        return Reading(value, state, check=None if found[3] == b"**" else check_sum(line[:-2]) == found[3])
    refused = _PANASONIC_REFUSED.fullmatch(line)
    if not refused or int(refused[1]) != output:
        return None
    code = int(refused[2])
    why = PANASONIC_REFUSALS.get(code)
    return Refusal(f"refused with code {code:02d}: {why}" if why else f"refused with code {code}")


def _keyence_probed(command: bytes) -> Callable[[bytes, int], bool]:
    known = re.compile(rb"%b(?:,.*)?|ER,%b,\d{1,3}" % (command, command), re.DOTALL)
    return lambda line, output: known.fullmatch(line) is not None


def _lkg_other(output: int) -> bytes:
    """Return the request for the other one of two outputs."""
    return b"M%d" % (3 - output)


_LKG_PROBED = {output: _keyence_probed(_lkg_other(output)) for output in (1, 2)}


def _panasonic_foreign(line: bytes, output: int) -> bool:
    """A value sent without a request (timing and continuous mode), or a line of or to another sensor."""
    found = re.match(rb"%(0[1-9]|1[0-6]|EE)(?:\$(?:[A-Z]{3}|[+-]\d{5})|[!#])", line)
    is_other = found is not None and (found[1] == b"EE" or int(found[1]) != output)
    return is_other or re.fullmatch(rb"%\d\d\$[+-]\d{7}(?:\*\*|[0-9A-F]{2})", line) is not None


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
        lambda output: _lkg_other(output) + b"\r",
        lambda line, output: _LKG_PROBED[output](line, output),
        lambda output: _lkg_other(output) + b",+00.0000\r",
        lambda line, output: line.startswith(b"TG,"),
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
        lambda output: b"M1\r",
        _keyence_probed(b"M1"),
        lambda output: b"ER,M1,00\r",
        lambda line, output: line.startswith(b"TG,"),
    ),
    "IL": Dialect(
        "Keyence IL with DL-RS1A",
        1e-3,
        lambda output: b"M0\r",
        _il_parse,
        _il_answer,
        (0, 14),
        9_600,
        lambda output: b"SR,00,037\r",
        _keyence_probed(b"SR"),
        lambda output: b"SR,00,037,+00.000\r\n",
        lambda line, output: line.startswith(b"DR,"),
        end=b"\r\n",
    ),
    "HL-G1": Dialect(
        "Panasonic HL-G1",
        1e-7,
        lambda output: b"%%%02d#RMD**\r" % output,
        _panasonic_parse,
        _panasonic_answer,
        (1, 16),
        115_200,
        lambda output: b"%%%02d#ROA**\r" % output,
        lambda line, output: line.startswith(b"%%%02d$ROA" % output),
        lambda output: b"%%%02d$ROA+00000**\r" % output,
        _panasonic_foreign,
    ),
}
"""Dialects by their name in a rig file. For HL-G1 the output is the sensor's address."""

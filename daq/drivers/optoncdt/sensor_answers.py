"""Answers of optoNCDT sensors to ASCII commands: identification and output words. Source: ILD1420 manual."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple, TypedDict

from daq.errors import DeviceError

PROMPT = "->"
DISTANCE, COUNTER, TIMESTAMP_LO, TIMESTAMP_HI = "DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI"

_OUTINFO = "GETOUTINFO_RS422 "
_NOT_DISTANCE = ("SHUTTER", "COUNTER", "TIMESTAMP", "INTENSITY", "STATE", "DIST_RAW", "TEMP")  # other outputs
_KNOWN = frozenset({*_NOT_DISTANCE, TIMESTAMP_LO, TIMESTAMP_HI})
_MILLIMETRES = re.compile(r"(\d+(?:[.,]\d*)?)\s*mm", re.IGNORECASE)
MAX_WORDS = 32
"""Largest number of words in a block; sensors have about ten."""


class SensorInfo(TypedDict):
    """Contents of the answer to GETINFO: name, serial number, measuring range in m, firmware version."""

    name: str
    serial: str
    range_m: float
    version: str


def parse_info(lines: Sequence[str]) -> SensorInfo:
    """Parse the answer to GETINFO.

    The measuring range is the only length in mm if firmware names it otherwise.

    Raises:
        DeviceError: the measuring range is missing or is not a positive number of mm.
    """
    fields = {key.strip().lower(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    lengths = [value for value in fields.values() if _MILLIMETRES.fullmatch(value)]
    text = fields.get("measuring range", lengths[0] if len(lengths) == 1 else "")
    match = _MILLIMETRES.fullmatch(text)
    range_mm = float(match[1].replace(",", ".")) if match else 0.0
    if range_mm <= 0:
        raise DeviceError(
            f"expected a line like 'Measuring range: 25.00mm' in the answer to GETINFO, got {text!r} "
            f"in {list(lines)!r}: is this an optoNCDT sensor, and was the stream stopped before the command?"
        )
    name, serial, version = (fields.get(key, "") for key in ("name", "serial", "version"))
    return SensorInfo(name=name, serial=serial, range_m=range_mm / 1000.0, version=version)


def parse_outinfo(line: str) -> tuple[str, ...]:
    """Parse the answer to GETOUTINFO_RS422, like ``GETOUTINFO_RS422 DIST COUNTER TIMESTAMP``.

    Returns:
        Word names in stream order. The distance is named ``DIST`` independent of the firmware: it is the first output,
        or, if that is another known output, the first whose name begins with DIST. TIMESTAMP is two words, low half
        first. Other names are kept.

    Raises:
        DeviceError: the line is another answer, no output is selected, or there are more than `MAX_WORDS` words.
    """
    head, *names = line.upper().replace(",", " ").split() or [""]
    if names and names[-1] == "OK":
        names.pop()
    if head != _OUTINFO.strip() or not names or names == ["NONE"]:
        raise DeviceError(
            f"expected 'GETOUTINFO_RS422 DIST …', got {line!r}: select an output with OUTPUT RS422 / OUTADD_RS422"
        )
    distance = next(
        (i for i, name in enumerate(names) if i == 0 or name.startswith("DIST") if name not in _NOT_DISTANCE), -1
    )
    words: list[str] = []
    for i, name in enumerate(names):
        words += [TIMESTAMP_LO, TIMESTAMP_HI] if name == "TIMESTAMP" else [DISTANCE if i == distance else name]
    if len(words) > MAX_WORDS:
        raise DeviceError(f"expected at most {MAX_WORDS} output words, got {len(words)} in {line!r:.80}")
    return tuple(words)


def announced(line: str) -> tuple[str, ...] | None:
    """Return the words that a line of text announces; None if it is not an answer to GETOUTINFO_RS422."""
    if not line.upper().startswith(_OUTINFO):
        return None
    try:
        return parse_outinfo(line)
    except DeviceError:  # usual: a line with another number of words is not the answer
        return None


def named(answer: Sequence[str]) -> tuple[str, ...] | None:
    """Return the words that the lines of an answer to GETOUTINFO_RS422 name together, without the command's name.

    Firmware may send the names alone, in one line or one for each line, with commas or a colon, after an echo. Only
    names of known outputs are accepted, since such lines do not state what they are. None if there are other names.
    """
    names: list[str] = []
    for line in answer:
        found = re.sub("[,:]", " ", line.upper()).split()
        if found and re.fullmatch(r"W\d{2,3}", found[0]):
            continue
        names += [name for name in found if name not in (_OUTINFO.strip(), "OK")]
    if len({*names}) < len(names) or not all(re.fullmatch(r"DIST\d?", name) or name in _KNOWN for name in names):
        return None
    return announced(_OUTINFO + " ".join(names))


class WordPositions(NamedTuple):
    """Positions of a sample's words in a block.

    Attributes:
        words: number of words in a block.
        distance, counter, low, high: positions from 0; low and high are the halves of the timestamp.
    """

    words: int
    distance: int
    counter: int
    low: int
    high: int


def places_of(words: Sequence[str]) -> WordPositions | None:
    """Return the positions of distance, counter and timestamp in a block; None if one of them is missing."""
    try:
        found = [words.index(name) for name in (DISTANCE, COUNTER, TIMESTAMP_LO, TIMESTAMP_HI)]
    except ValueError:  # usual: the stream lacks one of the words
        return None
    return WordPositions(len(words), *found)

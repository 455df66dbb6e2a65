"""The wire: a sample or an answer, and its line. Pure."""

import binascii
import re
from dataclasses import dataclass

LONGEST = 64  # bytes of a line, its end not counted
COUNT_WRAP, MS_WRAP = 1000, 2**32
RAD = 1e-6

_SAMPLE = re.compile(rb"T (\d{3}) (\d{10}) (-?\d{1,9}) (-?\d{1,9})")


@dataclass(frozen=True)
class Sample:
    """One sample: counter, device time in ms, angles in units of RAD."""

    count: int
    ms: int
    x: int
    y: int


def encode(text: str) -> bytes:
    """A line with its check."""
    return f"{text}*{binascii.crc_hqx(text.encode(), 0xFFFF):04X}\r\n".encode()


def sample_line(sample: Sample) -> bytes:
    """The line of a sample."""
    return encode(f"T {sample.count:03d} {sample.ms:010d} {sample.x} {sample.y}")


def parse(line: bytes) -> Sample | str | None:
    """A sample, an answer, or None: damaged. `line` comes without its end."""
    text, star, check = line.rpartition(b"*")
    if not star or check != b"%04X" % binascii.crc_hqx(text, 0xFFFF):
        return None
    if found := _SAMPLE.fullmatch(text):
        return Sample(*map(int, found.groups()))
    return text.decode("ascii", "replace") if text.startswith(b"I ") else None

"""Identification of an optoNCDT sensor on an unknown port. Queries only: its output is neither stopped nor changed."""

from __future__ import annotations

import re
from functools import partial

from daq.drivers.identification import FoundDevice, IdentityRequest, IdentityTurns
from daq.drivers.optoncdt import sensor_answers
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.optoncdt.wire import BlockDecoder
from daq.errors import DeviceError

_WORDS = ("DIST",)  # answers are found between blocks of any number of words
_RATE = re.compile(r"MEASRATE\s+(\d+(?:\.\d+)?)(?:\s*KHZ)?", re.IGNORECASE)


def identity_turns(settings: Laser) -> IdentityTurns:
    """Query name, serial number, range and measuring rate: `GETINFO` and `MEASRATE` without an argument.

    Source: ILD1420 manual, ASCII commands. The line feed before the first command ends a line that another program
    or another request has begun.
    """
    info = _lines((yield IdentityRequest(b"\nGETINFO\n", partial(_contains, b"Measuring range"))))
    try:
        found = sensor_answers.parse_info(info)
    except DeviceError:  # usual: another device, or none
        return None
    rate = next((m for line in _lines((yield _rate_request())) if (m := _RATE.match(line))), None)
    known = {"range_m": found["range_m"], "baud": settings.baud}
    if rate is not None:
        known["rate_Hz"] = float(rate[1]) * 1e3
    return FoundDevice(known, {key: found[key] for key in ("name", "serial", "version") if found[key]})


def _rate_request() -> IdentityRequest:
    return IdentityRequest(b"MEASRATE\n", partial(_contains, b"MEASRATE"))


def _lines(data: bytes) -> list[str]:
    """Return the lines of text in received bytes; a stream may be between them."""
    return BlockDecoder(_WORDS).feed(data).text


def _contains(key: bytes, data: bytes) -> bool:
    """Whether the answer with a key is complete: the prompt follows it."""
    at = data.find(key)
    return at >= 0 and sensor_answers.PROMPT.encode() in data[at:]

"""Identification of an RF60x sensor on an unknown port. Reads only: a stream continues, no parameter is written."""

from __future__ import annotations

import re

from daq.drivers.identification import FoundDevice, IdentityRequest, IdentityTurns
from daq.errors import DeviceError
from rig_drivers.riftek import wire
from rig_drivers.riftek.settings import RiftekLaser

_RUNS = re.compile(rb"[\x80-\x8F]+|[\x90-\x9F]+|[\xA0-\xAF]+|[\xB0-\xBF]+")
"""Bytes of packets that are not new results, by the packets' numbers."""


def identity_turns(settings: RiftekLaser) -> IdentityTurns:
    """Request the identification until two answers are equal, then read the sampling period.

    The line has no checksum, so two equal answers are required. Answers have another high half than the results of a
    stream, by which they are separated from it.
    """
    size = wire.ANSWER_BYTES[wire.IDENTIFY]
    request = IdentityRequest(
        wire.request(settings.address, wire.IDENTIFY), lambda data: answer_in(data, size) is not None
    )
    first = answer_in((yield request), size)
    if first is None:
        return None
    if answer_in((yield request), size) != first and answer_in((yield request), size) != first:
        return None
    try:
        info = wire.parse_info(first)
    except DeviceError:  # usual: another device
        return None
    known = {"range_m": info.range_m, "baud": settings.baud, "parity": settings.parity, "address": settings.address}
    period_us = 0
    for parameter in (wire.PERIOD + 1, wire.PERIOD):  # high byte first
        byte = answer_in((yield _reading(settings.address, parameter)), wire.ANSWER_BYTES[wire.READ])
        period_us = -1 if byte is None or period_us < 0 else period_us << 8 | byte[0]
    if wire.PERIODS_US[0] <= period_us <= wire.PERIODS_US[1]:
        known["rate_Hz"] = 1e6 / period_us
    return FoundDevice(known, {"type": info.kind, "firmware": info.firmware, "serial": info.serial})


def _reading(address: int, parameter: int) -> IdentityRequest:
    size = wire.ANSWER_BYTES[wire.READ]
    message = wire.request(address, wire.READ, bytes([parameter]))
    return IdentityRequest(message, lambda data: answer_in(data, size) is not None)


def answer_in(data: bytes, size: int) -> bytes | None:
    """Return the data of the first answer of a length among received bytes; None without such an answer.

    Args:
        data: received bytes; results of a stream may be among them.
        size: length of the answer on the line, bytes.
    """
    run = next((found[0] for found in _RUNS.finditer(data) if len(found[0]) == size), None)
    if run is None:
        return None
    return bytes(low & 0x0F | (high & 0x0F) << 4 for low, high in zip(run[::2], run[1::2], strict=True))

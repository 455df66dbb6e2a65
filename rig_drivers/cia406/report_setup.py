"""Set-up of an encoder's reports (TPDO1 … 4): when it sends them, and what they contain.

An encoder that refuses a part of it keeps the reports that it had. The message names the setting that works with it:
`sync = false` for a fixed transmission type (1800h sub 2) of 254 or 255, `sync = true` for a fixed 1, a lower `rate_Hz`
for a refused period (6200h). A refused mapping (1A00h) is used as found if it contains the whole position at a byte
limit, such as 6030h (16 bits) + 6004h (`a_offset`, bytes, in the identity); otherwise it is an error.
"""

from __future__ import annotations

import logging

from daq.drivers.canopen import cia301
from daq.drivers.canopen.changes import PDO_NO_REMOTE, PDO_OFF, Changes
from daq.errors import DeviceError
from rig_basics.texts import number_of
from rig_drivers.cia406 import wire
from rig_drivers.cia406.settings import Encoder, EncoderBus

_log = logging.getLogger(__name__)

_OTHER_REPORTS = (1, 2, 3)  # TPDO2 … 4, after TPDO1
_MAX_ENTRIES = 8
_REPORT_BITS = 64


def set_reports(settings: EncoderBus, encoder: Encoder, objects: Changes) -> int:
    """Set an encoder's reports; return the place of the position in them, bytes.

    Raises:
        DeviceError: the encoder refuses it, or does not answer.
    """
    for number in _OTHER_REPORTS:  # an encoder's second report is sent at each SYNC by default
        own = objects.read(cia301.TPDO1 + number, 1)
        if own is not None and not own & PDO_OFF:
            objects.write(cia301.TPDO1 + number, 1, own | PDO_OFF, 4)
    own = objects.read(cia301.TPDO1, 1)
    remote = PDO_NO_REMOTE & (own or 0)
    identifier = remote | cia301.cob_tpdo(1, encoder.node)
    objects.write(cia301.TPDO1, 1, PDO_OFF | identifier, 4)
    _set_kind(settings, objects)
    if not settings.sync:
        _set_timer(settings, objects)
    offset = _set_mapping(objects)
    objects.write(cia301.TPDO1, 1, identifier, 4)
    return offset


def _set_kind(settings: EncoderBus, objects: Changes) -> None:
    kind = wire.EVERY_SYNC if settings.sync else wire.OWN_TIMER
    found = objects.read(cia301.TPDO1, 2)
    try:
        objects.write(cia301.TPDO1, 2, kind, 1)
    except DeviceError as error:
        other = "sync = false" if settings.sync else "sync = true"
        raise DeviceError(
            f"{error}. Its report TPDO1 has the transmission type {found}, which cannot be changed. Set {other} in the "
            "rig file if the type is " + ("254 or 255" if settings.sync else "1")
        ) from error


def _set_timer(settings: EncoderBus, objects: Changes) -> None:
    """Set the period of the reports. Both objects are the same timer, and some encoders have only one of them."""
    cyclic = objects.read(wire.CYCLIC_TIMER, 0) is not None
    try:
        objects.write(*((wire.CYCLIC_TIMER, 0) if cyclic else (cia301.TPDO1, 5)), settings.period_ms, 2)
    except DeviceError as error:
        raise DeviceError(
            f"{error}. This is the period of its reports, ms. Reduce rate_Hz in the rig file: its manual states the "
            "shortest period"
        ) from error
    if objects.read(cia301.TPDO1, 3):  # an inhibit time would hold reports back
        objects.write(cia301.TPDO1, 3, 0, 2)


def _set_mapping(objects: Changes) -> int:
    """Map the position alone. A mapping that cannot be changed is accepted if it contains the whole position."""
    mapped = [entry or 0 for entry in (objects.mapped(cia301.TPDO1_MAPPING, _MAX_ENTRIES) or [])[:_MAX_ENTRIES]]
    if mapped == [wire.POSITION_MAPPED]:
        return 0
    try:
        objects.map_entries(cia301.TPDO1_MAPPING, [wire.POSITION_MAPPED])
    except DeviceError as error:
        if (offset := _offset(mapped)) is not None:
            _log.info("mapping not accepted, so that of the encoder is used: %s", error)
            objects.write(cia301.TPDO1_MAPPING, 0, len(mapped), 1)
            return offset
        shown = " + ".join(
            f"{entry >> 16:04X}h sub {entry >> 8 & 0xFF}, {number_of(entry & 0xFF, 'bit')}" for entry in mapped
        )
        raise DeviceError(
            f"{error}. Its report TPDO1 contains {shown or 'nothing'}: expected the position (6004h, 32 bits) at a "
            "whole byte. Map it with the maker's tool"
        ) from error
    return 0


def _offset(mapped: list[int]) -> int | None:
    """Return the place of the position in a report, bytes; None if it is not contained at a whole byte."""
    if wire.POSITION_MAPPED not in mapped:
        return None
    bits = sum(entry & 0xFF for entry in mapped[: mapped.index(wire.POSITION_MAPPED)])
    return bits // 8 if bits % 8 == 0 and bits <= _REPORT_BITS - 8 * wire.POSITION_BYTES else None

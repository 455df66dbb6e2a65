# pyright: strict
"""What the drive and the host tell each other in every cycle: process data mapped as `wire` packs it.

Drives leave their makers with all kinds of mappings, many without a speed, and many report changes only, so that a
drive at rest is silent. What the drive has is read first and left alone where it is right already; a drive that does
not show its mapping is taken to have been set up by hand. Source: CiA 301, PDO communication and mapping parameters.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.canopen_node import NMT_PRE_OPERATIONAL
from daq.drivers.cia402.objects import NodeObjects
from daq.errors import DeviceError

REPORT_MS = 10
"""Period of the reports of a drive whose own is none or too long."""
_LONGEST_MS = 100  # of a drive's own period
_OFF, _NO_REMOTE = 1 << 31, 1 << 30  # in a COB-ID: this PDO is not used; nobody may ask for it
_OWN_EVENTS = 255  # transmission type: at once, or by the event timer
_EVENTS_FROM = 254  # types below wait for a SYNC or a remote request, which nobody sends here
_INHIBIT_PER_MS = 10  # inhibit times count in tenths of a millisecond
_MOST_ENTRIES = 64  # of a PDO: one for each bit


@dataclass(frozen=True)
class _Pdo:
    """A PDO: index of its communication parameters and of its mapping, what belongs into it, and its identifier."""

    travels: int
    mapping: int
    objects: tuple[int, ...]
    identifier: int
    more_behind: bool  # whether what is mapped behind the objects does no harm


def map_process_data(objects: NodeObjects, node_id: int) -> None:
    """Have controlword and target speed taken, statusword and actual speed reported, at least every `_LONGEST_MS`.

    A drive that refuses a change is told to leave network operation, where drives may refuse any, and asked again.

    Args:
        objects: of a drive that is not in operation.
        node_id: of the drive.

    Raises:
        DeviceError: it does not answer, or refuses the mapping; what it had is put back.
    """
    ordered, reported = (cia402.CONTROLWORD, cia402.TARGET_VELOCITY), (cia402.STATUSWORD, cia402.ACTUAL_VELOCITY)
    pdos = (
        _Pdo(cia402.RPDO1, cia402.RPDO1_MAPPING, ordered, cia402.cob_rpdo(1, node_id), more_behind=False),
        _Pdo(cia402.TPDO1, cia402.TPDO1_MAPPING, reported, cia402.cob_tpdo(1, node_id), more_behind=True),
    )
    try:
        try:
            _map_all(objects, pdos)
        except DeviceError:
            objects.send(0, bytes([NMT_PRE_OPERATIONAL, node_id]))
            _map_all(objects, pdos)
    except DeviceError as error:
        raise DeviceError(
            f"{error}. Process data is to be: {cia402.RPDO1_MAPPING:04X}h controlword and target speed (6040h, 6042h), "
            f"{cia402.TPDO1_MAPPING:04X}h statusword and actual speed (6041h, 6044h), 16 bits each, both of "
            "transmission type 255. Set the drive so with its maker's tool"
        ) from error
    period_ms = objects.read(cia402.TPDO1, 5)
    if period_ms is not None and not 0 < period_ms <= _LONGEST_MS:  # 0: it would report changes only
        with contextlib.suppress(DeviceError):  # its silence, if it is one, is told by who waits for the first report
            objects.write(cia402.TPDO1, 5, REPORT_MS, 2)


def _map_all(objects: NodeObjects, pdos: Sequence[_Pdo]) -> None:
    for pdo in pdos:
        _map(objects, pdo)


def _map(objects: NodeObjects, pdo: _Pdo) -> None:
    """Map a PDO where it is not right, in the standard's order: nothing of it is changed while it is used."""
    wanted = [cia402.mapped_word(index) for index in pdo.objects]
    own, kind, inhibit, count = (
        objects.read(*where) for where in ((pdo.travels, 1), (pdo.travels, 2), (pdo.travels, 3), (pdo.mapping, 0))
    )
    if count is None:
        return
    mapped = [objects.read(pdo.mapping, sub) for sub in range(1, min(count, _MOST_ENTRIES) + 1)]
    mapped_right = mapped[: len(wanted)] == wanted and (pdo.more_behind or count == len(wanted))
    own = pdo.identifier if own is None else own
    kind = _OWN_EVENTS if kind is None else kind
    too_rare = pdo.more_behind and (inhibit or 0) > _LONGEST_MS * _INHIBIT_PER_MS
    if mapped_right and own & ~_NO_REMOTE == pdo.identifier and kind >= _EVENTS_FROM and not too_rare:
        return
    objects.write(pdo.travels, 1, own | _OFF, 4)
    try:
        if kind < _EVENTS_FROM:
            objects.write(pdo.travels, 2, _OWN_EVENTS, 1)
        if too_rare:
            objects.write(pdo.travels, 3, 0, 2)
        if not mapped_right:
            _map_entries(objects, pdo, wanted)
        objects.write(pdo.travels, 1, own & _NO_REMOTE | pdo.identifier, 4)
    except DeviceError:
        with contextlib.suppress(DeviceError):
            if not mapped_right:
                _map_entries(objects, pdo, [entry for entry in mapped if entry is not None])
        with contextlib.suppress(DeviceError):
            objects.write(pdo.travels, 2, kind, 1)
        with contextlib.suppress(DeviceError):
            objects.write(pdo.travels, 1, own, 4)
        raise


def _map_entries(objects: NodeObjects, pdo: _Pdo, entries: Sequence[int]) -> None:
    objects.write(pdo.mapping, 0, 0, 1)
    for sub, entry in enumerate(entries, 1):
        objects.write(pdo.mapping, sub, entry, 4)
    objects.write(pdo.mapping, 0, len(entries), 1)

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
from daq.errors import DeviceError, LinkLost

REPORT_MS = 10
"""Period of the reports of a drive whose own is none or too long."""
_LONGEST_MS = 100  # of a drive's own period
_OFF, _NO_REMOTE = 1 << 31, 1 << 30  # in a COB-ID: this PDO is not used; nobody may ask for it
_OWN_EVENTS = 255  # transmission type: at once, or by the event timer
_EVENTS_FROM = 254  # types below wait for a SYNC or a remote request, which nobody sends here
_INHIBIT_PER_MS = 10  # inhibit times count in tenths of a millisecond
_MOST_ENTRIES = 64  # of a PDO: one for each bit
_OTHERS = 4  # PDOs of a kind that drives have


@dataclass(frozen=True)
class _Pdo:
    """A PDO: index of its communication parameters and of its mapping, what belongs into it, and its identifier."""

    travels: int
    mapping: int
    objects: tuple[int, ...]
    identifier: int
    reports: bool  # from the drive: what is mapped behind the objects does no harm


def map_process_data(objects: NodeObjects, node_id: int, *, in_torque: bool = False) -> None:
    """Have controlword and target speed taken, statusword and actual speed reported, at least every `_LONGEST_MS`.

    A drive that refuses a change is told to leave network operation, where drives may refuse any, and asked again.

    Args:
        objects: of the drive.
        node_id: of the drive.
        in_torque: it turns the rotor, or holds it: nothing is changed by which it could be stopped.

    Raises:
        DeviceError: it does not answer, refuses the mapping, or has torque and another one; what it had is put back.
    """
    ordered, reported = (cia402.CONTROLWORD, cia402.TARGET_VELOCITY), (cia402.STATUSWORD, cia402.ACTUAL_VELOCITY)
    pdos = (
        _Pdo(cia402.RPDO1, cia402.RPDO1_MAPPING, ordered, cia402.cob_rpdo(1, node_id), reports=False),
        _Pdo(cia402.TPDO1, cia402.TPDO1_MAPPING, reported, cia402.cob_tpdo(1, node_id), reports=True),
    )
    try:
        found = [had for pdo in pdos if (had := _Had.of(objects, pdo)) is not None]
        _check_others(objects, pdos)
        if in_torque and any(had.wrong for had in found):
            raise DeviceError("drive: it has torque, and its process data is another's. Stop it first")
        for had in found:
            had.set_period(objects)
        _map_all(objects, found)
    except DeviceError as error:
        raise DeviceError(
            f"{error}. Process data is to be: {cia402.RPDO1_MAPPING:04X}h controlword and target speed (6040h, 6042h), "
            f"{cia402.TPDO1_MAPPING:04X}h statusword and actual speed (6041h, 6044h), 16 bits each, both of "
            "transmission type 255. Set the drive so with its maker's tool"
        ) from error


class _Had:
    """What a PDO was when it was found, and what of that is wrong."""

    def __init__(self, pdo: _Pdo, own: int, kind: int, inhibit: int, mapped: list[int | None]) -> None:
        self.pdo, self.own, self.kind, self.inhibit, self.mapped = pdo, own, kind, inhibit, mapped
        self.wanted = [cia402.mapped_word(index) for index in pdo.objects]
        more = len(mapped) - len(self.wanted)
        self.entries_right = mapped[: len(self.wanted)] == self.wanted and (
            0 <= more <= _MOST_ENTRIES if pdo.reports else more == 0
        )
        self.too_rare = pdo.reports and inhibit > _LONGEST_MS * _INHIBIT_PER_MS
        travels = own & ~_NO_REMOTE == pdo.identifier and kind >= _EVENTS_FROM
        self.wrong = not (self.entries_right and travels) or self.too_rare
        self.changed = False

    @classmethod
    def of(cls, objects: NodeObjects, pdo: _Pdo) -> _Had | None:
        """Read it; None where the drive does not show it."""
        own, kind, inhibit, count = (
            objects.read(*where) for where in ((pdo.travels, 1), (pdo.travels, 2), (pdo.travels, 3), (pdo.mapping, 0))
        )
        if count is None:
            return None
        mapped = [objects.read(pdo.mapping, sub) for sub in range(1, min(count, _MOST_ENTRIES) + 1)]
        mapped += [None] * (count - len(mapped))  # no such mapping can be: 254 and 255 stand for other kinds of PDO
        own = pdo.identifier if own is None else own
        return cls(pdo, own, _OWN_EVENTS if kind is None else kind, inhibit or 0, mapped)

    def set_period(self, objects: NodeObjects) -> None:
        """Have a drive report often enough that would report changes only, or seldom; some take it only when off."""
        if not self.pdo.reports or self.wrong:
            return
        try:
            self._write_period(objects)
        except DeviceError:
            self.wrong = True

    def _write_period(self, objects: NodeObjects) -> None:
        period_ms = objects.read(self.pdo.travels, 5)
        if period_ms is not None and not 0 < period_ms <= _LONGEST_MS:
            objects.write(self.pdo.travels, 5, REPORT_MS, 2)

    def put_right(self, objects: NodeObjects) -> None:
        """Change what is wrong, in the standard's order: nothing of a PDO is changed while it is used."""
        if not self.wrong:
            return
        pdo, self.changed = self.pdo, True
        objects.write(pdo.travels, 1, self.own | _OFF, 4)
        if self.kind < _EVENTS_FROM:
            objects.write(pdo.travels, 2, _OWN_EVENTS, 1)
        if self.too_rare:
            objects.write(pdo.travels, 3, 0, 2)
        if pdo.reports:
            with contextlib.suppress(DeviceError):  # its silence, if it is one, is told by who waits for its word
                self._write_period(objects)
        if not self.entries_right:
            _map_entries(objects, pdo, self.wanted)
        objects.write(pdo.travels, 1, self.own & _NO_REMOTE | pdo.identifier, 4)

    def put_back(self, objects: NodeObjects) -> None:
        """As it was, as far as the drive takes it."""
        if not self.changed:
            return
        pdo = self.pdo
        entries = [entry for entry in self.mapped if entry is not None]
        for undo in (
            lambda: objects.write(pdo.travels, 1, self.own | _OFF, 4),
            lambda: None if self.entries_right else _map_entries(objects, pdo, entries),
            lambda: objects.write(pdo.travels, 2, self.kind, 1) if self.kind < _EVENTS_FROM else None,
            lambda: objects.write(pdo.travels, 3, self.inhibit, 2) if self.too_rare else None,
            lambda: objects.write(pdo.travels, 1, self.own, 4),
        ):
            with contextlib.suppress(DeviceError, LinkLost):
                undo()


def _check_others(objects: NodeObjects, pdos: Sequence[_Pdo]) -> None:
    """Raise when another PDO of the drive bears an identifier of ours: its bytes would be taken for speeds."""
    for pdo in pdos:
        for index in range(pdo.travels + 1, pdo.travels + _OTHERS):
            own = objects.read(index, 1)
            if own is not None and not own & _OFF and own & ~_NO_REMOTE == pdo.identifier:
                raise DeviceError(f"drive: {index:04X}h sub 1 has the identifier {pdo.identifier:03X}h too")


def _map_all(objects: NodeObjects, found: Sequence[_Had]) -> None:
    """Put each right; all are put back when one cannot be."""
    try:
        try:
            for had in found:
                had.put_right(objects)
        except DeviceError:
            objects.send(0, bytes([NMT_PRE_OPERATIONAL, objects.node_id]))
            for had in found:
                had.put_right(objects)
    except BaseException:
        for had in found:
            had.put_back(objects)
        raise


def _map_entries(objects: NodeObjects, pdo: _Pdo, entries: Sequence[int]) -> None:
    objects.write(pdo.mapping, 0, 0, 1)
    for sub, entry in enumerate(entries, 1):
        objects.write(pdo.mapping, sub, entry, 4)
    objects.write(pdo.mapping, 0, len(entries), 1)

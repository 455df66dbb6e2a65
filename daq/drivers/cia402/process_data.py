"""Set-up of the cyclic process data between drive and host: mapping and period as `wire` needs them.

Drives are delivered with different mappings, many without a speed. Many drives report changes only, so that a drive at
rest sends nothing. The drive's mapping is read first and not changed if it is correct. A drive whose mapping cannot be
read is assumed to be set up by hand. A wrong mapping is written in this order: PDO off (bit 31 of 1400h or 1800h
sub 1), type, inhibit time if above 100 ms, count 0, entries, count, PDO on. Source: CiA 301, PDO communication and
mapping parameters.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

from daq.drivers.canopen import cia301
from daq.drivers.canopen.changes import MAX_ENTRIES, PDO_NO_REMOTE, PDO_OFF, Changes, restoring
from daq.drivers.canopen.node import NMT_PRE_OPERATIONAL
from daq.drivers.canopen.objects import NoAnswer, NodeObjects
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.wire import VELOCITY, SpeedProfile
from daq.errors import DeviceError
from rig_basics.ignoring import ignoring
from rig_basics.texts import number_of

_log = logging.getLogger(__name__)

REPORT_MS = 10
"""Period, ms, that is set in a drive without a period or with a longer one than `_MAX_PERIOD_MS`."""
_MAX_PERIOD_MS = 100
_OWN_EVENTS = 255  # transmission type: immediately, or by the event timer
_MIN_EVENT_TYPE = 254  # smaller types wait for a SYNC or a remote request, which the host does not send
_INHIBIT_PER_MS = 10  # inhibit times are in units of 0.1 ms
_PDOS_OF_A_KIND = 4  # in a drive


@dataclass(frozen=True)
class _Pdo:
    """A PDO.

    Attributes:
        communication: index of its communication parameters.
        mapping: index of its mapping.
        entries: entries of the mapping that must be there.
        identifier: its COB-ID.
        reports: whether the drive sends it; then further mapped objects are allowed.
    """

    communication: int
    mapping: int
    entries: tuple[int, ...]
    identifier: int
    reports: bool


def map_process_data(
    objects: NodeObjects, node_id: int, profile: SpeedProfile = VELOCITY, *, in_torque: bool = False
) -> bool:
    """Map controlword and target speed, statusword and actual speed, with reports at least every `_MAX_PERIOD_MS`.

    Drives may refuse changes in network operation. A drive that refuses a change leaves network operation, and the
    changes are repeated.

    Args:
        objects: objects of the drive.
        node_id: node number of the drive.
        profile: mode of operation.
        in_torque: whether the drive turns or holds the rotor: then the process data that can stop it are not changed.

    Returns:
        Whether the drive may report changes only, but answers remote requests: its period can neither be read nor set.

    Raises:
        DeviceError: the drive does not answer, refuses the mapping, or has torque and another mapping. Changes that
            were made are reversed.
    """
    ordered = profile.mapping(cia402.CONTROLWORD, profile.target)
    reported = profile.mapping(cia402.STATUSWORD, profile.actual)
    pdos = (
        _Pdo(cia301.RPDO1, cia301.RPDO1_MAPPING, ordered, cia301.cob_rpdo(1, node_id), reports=False),
        _Pdo(cia301.TPDO1, cia301.TPDO1_MAPPING, reported, cia301.cob_tpdo(1, node_id), reports=True),
    )
    try:
        with restoring(objects) as changes:
            found = [state for pdo in pdos if (state := _FoundPdo.of(changes, pdo)) is not None]
            _check_others(changes, pdos)
            if in_torque and any(state.wrong for state in found):
                raise DeviceError("drive: it has torque, and its process data is another's. Stop it first")
            for state in found:
                state.set_period(changes)
            try:
                _correct_all(changes, found)
            except DeviceError as error:
                _log.info("mapping not accepted in this network state, so it is set in PRE-OPERATIONAL: %s", error)
                objects.send(0, bytes([NMT_PRE_OPERATIONAL, objects.node_id]))
                _correct_all(changes, found)
            return any(state.needs_requests for state in found)
    except NoAnswer:
        raise
    except DeviceError as error:
        raise DeviceError(
            f"{error}. Process data is to be: {cia301.RPDO1_MAPPING:04X}h controlword and target speed "
            f"(6040h, {profile.target:04X}h), {cia301.TPDO1_MAPPING:04X}h statusword and actual speed (6041h, "
            f"{profile.actual:04X}h), 16 and {number_of(profile.bits, 'bit')}, both of transmission type "
            f"255. Set the drive so with "
            "its maker's tool"
        ) from error


class _FoundPdo:
    """The configuration of a PDO when it was read, and whether it is wrong."""

    def __init__(self, pdo: _Pdo, own: int, kind: int, inhibit: int, mapped: list[int | None]) -> None:
        self.pdo, self.own, self.kind = pdo, own, kind
        self.wanted = list(pdo.entries)
        more = len(mapped) - len(self.wanted)
        self.entries_right = mapped[: len(self.wanted)] == self.wanted and (
            0 <= more <= MAX_ENTRIES if pdo.reports else more == 0
        )
        self.too_rare = pdo.reports and inhibit > _MAX_PERIOD_MS * _INHIBIT_PER_MS
        communication_right = own & ~PDO_NO_REMOTE == pdo.identifier and kind >= _MIN_EVENT_TYPE
        self.wrong = not (self.entries_right and communication_right) or self.too_rare
        self._has_period = False

    @property
    def needs_requests(self) -> bool:
        """Whether the PDO has no period, so that the drive may report changes only, and remote requests are allowed."""
        return self.pdo.reports and not self._has_period and not self.own & PDO_NO_REMOTE

    @classmethod
    def of(cls, objects: Changes, pdo: _Pdo) -> _FoundPdo | None:
        """Read a PDO; None if the drive does not provide its mapping."""
        mapped = objects.mapped(pdo.mapping)
        if mapped is None:
            return None
        own, kind, inhibit = (objects.read(pdo.communication, sub) for sub in (1, 2, 3))
        own = pdo.identifier if own is None else own
        return cls(pdo, own, _OWN_EVENTS if kind is None else kind, inhibit or 0, mapped)

    def set_period(self, objects: Changes) -> None:
        """Set the period of a drive that reports rarely or only changes. Some drives accept it only when off."""
        if not self.pdo.reports or self.wrong:
            return
        try:
            self._write_period(objects)
        except DeviceError as error:
            _log.info("period not accepted while the PDO is on, so it is set while the PDO is off: %s", error)
            self.wrong = True

    def _write_period(self, objects: Changes) -> None:
        period_ms = objects.read(self.pdo.communication, 5)
        if period_ms is not None and not 0 < period_ms <= _MAX_PERIOD_MS:
            objects.write(self.pdo.communication, 5, REPORT_MS, 2)
        self._has_period = period_ms is not None

    def correct(self, objects: Changes) -> None:
        """Correct the configuration in the order of the standard: a PDO is off while it is changed."""
        if not self.wrong:
            return
        pdo = self.pdo
        objects.write(pdo.communication, 1, self.own | PDO_OFF, 4)
        if self.kind < _MIN_EVENT_TYPE:
            objects.write(pdo.communication, 2, _OWN_EVENTS, 1)
        if self.too_rare:
            objects.write(pdo.communication, 3, 0, 2)
        if pdo.reports:
            # missing reports are detected when the drive is enabled
            with ignoring(_log, "setting the period of reports", DeviceError):
                self._write_period(objects)
        if not self.entries_right:
            objects.map_entries(pdo.mapping, self.wanted)
        objects.write(pdo.communication, 1, self.own & PDO_NO_REMOTE | pdo.identifier, 4)


def _check_others(objects: Changes, pdos: Sequence[_Pdo]) -> None:
    """Raise DeviceError if another PDO of the drive has the same identifier: its bytes would be decoded as speeds."""
    for pdo in pdos:
        for index in range(pdo.communication + 1, pdo.communication + _PDOS_OF_A_KIND):
            own = objects.read(index, 1)
            if own is not None and not own & PDO_OFF and own & ~PDO_NO_REMOTE == pdo.identifier:
                raise DeviceError(f"drive: {index:04X}h sub 1 has the identifier {pdo.identifier:03X}h too")


def _correct_all(objects: Changes, found: Sequence[_FoundPdo]) -> None:
    for state in found:
        state.correct(objects)

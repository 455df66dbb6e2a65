# pyright: strict
"""What the drive and the host tell each other in every cycle: process data mapped as `wire` packs it.

Drives leave their makers with all kinds of mappings, many without a speed, and many report changes only, so that a
drive at rest is silent. What the drive has is read first and left alone where it is right already; a drive that does
not show its mapping is taken to have been set up by hand. Source: CiA 301, PDO communication and mapping parameters.
"""

from __future__ import annotations

import contextlib

from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.objects import NodeObjects
from daq.errors import DeviceError

REPORT_MS = 10
"""Period of the reports of a drive that has none of its own."""
_OFF = 1 << 31  # in a COB-ID: this PDO is not used
_ID = 0x1FFF_FFFF
_OWN_EVENTS = 255  # transmission type: at once, or by the event timer; to 240 by a SYNC, which nobody sends here
_ON_SYNC = range(241)


def map_process_data(objects: NodeObjects, node_id: int) -> None:
    """Have controlword and target speed taken, statusword and actual speed reported, at least as often as `REPORT_MS`.

    Args:
        objects: of a drive that is not in operation.
        node_id: of the drive.

    Raises:
        DeviceError: it does not answer, or refuses the mapping.
    """
    ordered = [cia402.mapped_word(index) for index in (cia402.CONTROLWORD, cia402.TARGET_VELOCITY)]
    reported = [cia402.mapped_word(index) for index in (cia402.STATUSWORD, cia402.ACTUAL_VELOCITY)]
    orders, reports = cia402.cob_rpdo(1, node_id), cia402.cob_tpdo(1, node_id)
    try:
        _map(objects, cia402.RPDO1, cia402.RPDO1_MAPPING, ordered, orders, more_behind=False)
        _map(objects, cia402.TPDO1, cia402.TPDO1_MAPPING, reported, reports, more_behind=True)
        for travels in (cia402.RPDO1, cia402.TPDO1):
            if objects.read(travels, 2) in _ON_SYNC:
                objects.write(travels, 2, _OWN_EVENTS, 1)
    except DeviceError as error:
        raise DeviceError(
            f"{error}. Process data is to be: {cia402.RPDO1_MAPPING:04X}h controlword and target speed (6040h, 6042h), "
            f"{cia402.TPDO1_MAPPING:04X}h statusword and actual speed (6041h, 6044h), 16 bits each, both of "
            "transmission type 255. Set the drive so with its maker's tool"
        ) from error
    if objects.read(cia402.TPDO1, 5) == 0:  # it would report changes only
        with contextlib.suppress(DeviceError):  # its silence, if it is one, is told by who waits for the first report
            objects.write(cia402.TPDO1, 5, REPORT_MS, 2)


def _map(
    objects: NodeObjects, travels: int, mapping: int, wanted: list[int], identifier: int, *, more_behind: bool
) -> None:
    count = objects.read(mapping, 0)
    if count is None:
        return
    mapped = [objects.read(mapping, sub) for sub in range(1, min(count, len(wanted)) + 1)]
    own = objects.read(travels, 1)
    right = mapped == wanted and (more_behind or count == len(wanted))
    if right and (own is None or own & (_OFF | _ID) == identifier):
        return
    kept = (own or 0) & ~(_OFF | _ID)
    objects.write(travels, 1, kept | _OFF | identifier, 4)  # only a PDO that is not used can be mapped
    if not right:
        objects.write(mapping, 0, 0, 1)
        for sub, entry in enumerate(wanted, 1):
            objects.write(mapping, sub, entry, 4)
        objects.write(mapping, 0, len(wanted), 1)
    objects.write(travels, 1, kept | identifier, 4)

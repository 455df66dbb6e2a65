"""Sensors on CAN at the limits of their pipeline: identifiers, lengths, cut lines, and the seed of the clock."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from daq.items import RX, TX, Batch, DeviceEvent
from daq.transports.can_frames import AdapterMessage, CanFrame, adapter_message, encode
from rig_drivers.dbc.driver import DRIVER
from rig_drivers.dbc.example import DBC, SETTINGS
from rig_drivers.dbc.settings import CanSensors
from rig_drivers.dbc.stream import CanPipeline

MS = 1_000_000
START_NS = 1_700_000_000_000_000_000
SEED = {"device_ns": 1_000 * MS, "host_ns": START_NS, "rate": 0.0, "wrap_ns": 2**32 * 1000}
NO_LOSSES = dict.fromkeys(
    ("samples", "damaged_lines", "refused_lines", "short_frames", "doubtful_frames", "invalid", "foreign_frames"), 0
)
Items = list[Batch | DeviceEvent]


def pipeline(*without: str, identity: dict[str, Any] | None = None, **changes: Any) -> CanPipeline:
    """The example's pipeline without some of its tables."""
    table: dict[str, Any] = {"driver": "dbc", "port": "p", **copy.deepcopy(SETTINGS), **changes}
    settings = CanSensors.model_validate({key: value for key, value in table.items() if key not in without})
    found = DRIVER.pipeline("bus", settings, identity or {})
    assert isinstance(found, CanPipeline)
    return found


def joined(*without: str, **changes: Any) -> CanPipeline:
    return pipeline(*without, **changes)


def laser_x(count: int, micrometres: int = 100, time_us: int = 0, size: int = 8) -> bytes:
    """A frame of LaserX: 24 bits of 0.1 µm, a counter of 8 bits, a time of 32 bits, little-endian."""
    data = (10 * micrometres).to_bytes(3, "little") + bytes([count]) + time_us.to_bytes(4, "little")
    return encode(CanFrame(0x100, data[:size]))


def laser_y(count: int, size: int = 6) -> bytes:
    """A frame of LaserY: 16 bits of 0.5 µm, a counter of 12 bits, big-endian."""
    data = (32_000).to_bytes(2, "big") + (count << 4).to_bytes(2, "big") + bytes(4)
    return encode(CanFrame(0x200, data[:size], extended=True))


def counters(items: Items, topic: str) -> list[int]:
    found = [item for item in items if isinstance(item, Batch) and item.channel.topic == topic]
    return [number for batch in found for number in batch.sequence.tolist()]


def events(items: Items) -> list[tuple[str, str, dict[str, Any]]]:
    return [(item.kind, item.text, dict(item.facts)) for item in items if isinstance(item, DeviceEvent)]


def test_only_data_frames_with_the_identifier_of_a_message_are_its_own() -> None:
    """An identifier of 11 bits and one of 29 bits with the same number are different ones."""
    data = bytes.fromhex("0000000000000000")
    foreign = [
        *(CanFrame(number, data) for number in (0x0FF, 0x101, 0x200, 0x2FF, 0x301, 0x7FF)),
        *(CanFrame(number, data, extended=True) for number in (0x100, 0x1FF, 0x201, 0x300)),
        CanFrame(0x100, bytes(8), remote=True),
        CanFrame(0x200, bytes(6), extended=True, remote=True),
        CanFrame(0x300, bytes(4), remote=True),
    ]
    status = encode(CanFrame(0x300, bytes(4)))
    for own_first in (True, False):
        line = joined()
        own, others = laser_x(5) + laser_y(6) + status, b"".join(map(encode, foreign))
        found = line.feed(RX, own + others if own_first else others + own, MS)
        assert (counters(found, "laser/x"), counters(found, "laser/y")) == ([5], [6])
        assert counters(found, "can/temperatures") == [0]
        assert events(found) == []
        assert line.losses == NO_LOSSES | {"foreign_frames": len(foreign)}
        assert line.feed(RX, encode(foreign[0]), 2 * MS) == []
        assert line.losses["foreign_frames"] == len(foreign) + 1


def test_a_frame_may_be_longer_than_its_message_and_not_shorter() -> None:
    line = joined()
    found = line.feed(RX, laser_x(1, size=7) + laser_x(2, time_us=1000) + laser_x(3, size=3), MS)
    text = "2 frames of LaserX are shorter than the 8 bytes of the DBC file"
    assert events(found) == [("damage", text, {"frames": 2})]
    assert counters(found, "laser/x") == [2]
    found = line.feed(RX, laser_y(1) + laser_y(2, size=8) + laser_y(3, size=7), 2 * MS)
    assert (counters(found, "laser/y"), events(found)) == ([1, 2, 3], [])
    found = line.feed(RX, laser_y(4, size=5) + laser_y(5, size=5), 3 * MS)
    assert [type(item) for item in found] == [DeviceEvent]
    assert line.losses == NO_LOSSES | {"short_frames": 4}


def test_the_frames_of_a_displacement_have_the_length_of_its_own_message() -> None:
    """Two messages of a file may have the same identifier: a number behind the end of a frame would be 0."""
    other = 'BO_ 256 Other: 2 Laser\n SG_ Level : 0|8@1+ (1,0) [0|0] "" Host\n\nVAL_ 256'
    quantities = {"level": {"message": "Other", "fields": {"level": "Level"}}}
    line = joined("y", dbc_text=DBC.replace("VAL_ 256", other), quantities=quantities)
    found = line.feed(RX, laser_x(1, size=2) + laser_x(2), MS)
    assert [kind for kind, *_ in events(found)] == ["damage"]
    assert (counters(found, "laser/x"), line.losses["short_frames"]) == ([2], 1)


def test_a_silence_is_reported_by_the_next_frame_from_the_bus() -> None:
    """An empty read, the host's own bytes and the adapter's answers are not from the bus."""
    line = joined(timeout_s=0.5)
    line.feed(RX, laser_x(1) + laser_y(1), MS)
    assert line.feed(RX, b"", 900 * MS) == []
    assert line.feed(TX, laser_x(2), 900 * MS) == []
    assert line.feed(RX, adapter_message(AdapterMessage.OPENED), 900 * MS) == []
    foreign = encode(CanFrame(0x7E5, b"\x01"))
    assert line.feed(RX, foreign, 400 * MS) == []
    assert [kind for kind, *_ in events(line.feed(RX, foreign, 900 * MS))] == ["doubt", "doubt"]


@pytest.mark.parametrize(("without", "seeded"), [(("y",), True), ((), False)])
def test_the_clock_of_a_bus_with_one_continues_from_an_earlier_log(without: tuple[str, ...], seeded: bool) -> None:
    """The sensor's time is 1 s after the seed's, the read 3 ms late. Without a seed the first read has no delay."""
    line = joined(*without, identity={"clock_seed": SEED})
    found = line.feed(RX, laser_x(1, time_us=2_000_000), START_NS + 1_003 * MS)
    (batch,) = (item for item in found if isinstance(item, Batch))
    assert batch.time_ns.tolist() == [START_NS + (1_000 if seeded else 1_003) * MS]
    seed = line.status.clock_seed
    assert (seed is not None) == seeded
    assert seed is None or (seed.device_ns, seed.wrap_ns) == (2_000 * MS, 2**32 * 1000)


def test_a_bus_without_displacements_has_no_clock_and_uses_no_seed() -> None:
    line = joined("x", "y", identity={"clock_seed": "damaged"})
    assert line.status.clock_seed is None
    assert counters(line.feed(RX, encode(CanFrame(0x300, bytes(4))), MS), "can/temperatures") == [0]

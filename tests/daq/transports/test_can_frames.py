"""Records of CAN frames: round trips, any split, damage, and the adapter's messages."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from daq.drivers.can_lines import CanLines
from daq.items import DeviceEvent
from daq.transports.can_frames import (
    EXTENDED,
    RECORD_BYTES,
    REMOTE,
    AdapterMessage,
    CanFrame,
    FrameDecoder,
    adapter_message,
    decode,
    encode,
    error_frame,
    open_bus,
    opens_bus,
)

TIMES = st.integers(0, 2**63 - 1)
FRAMES = st.one_of(
    st.builds(CanFrame, st.integers(0, 0x7FF), st.binary(max_size=8), time_ns=TIMES),
    st.builds(CanFrame, st.integers(0, 0x1FFFFFFF), st.binary(max_size=8), st.just(True), time_ns=TIMES),
    st.builds(CanFrame, st.integers(0, 0x7FF), st.integers(0, 8).map(bytes), st.just(False), st.just(True)),
)
RECORDS = st.one_of(FRAMES.map(encode), st.builds(adapter_message, st.sampled_from(AdapterMessage)))


def test_a_record_is_as_documented() -> None:
    frame = CanFrame(0x1ABCDEF0, b"\x01\xff", True, True, 0x0102030405060708)
    assert encode(frame).hex(" ") == "43 41 4e 02 f0 de bc da 01 ff 00 00 00 00 00 00 08 07 06 05 04 03 02 01"
    assert EXTENDED | REMOTE | 0x1ABCDEF0 == 0xDABCDEF0


@given(st.lists(FRAMES))
def test_frames_have_the_content_of_their_records(frames: list[CanFrame]) -> None:
    found = decode(encode(*frames))
    assert found.frames == frames
    assert [frame.time_ns for frame in found.frames] == [frame.time_ns for frame in frames]
    assert bool(np.all(found.is_of_bus))
    assert found.damaged == 0
    assert found.rows["identifier"].tolist() == [f.arbitration_id | f.extended << 31 | f.remote << 30 for f in frames]
    assert [bytes(row)[:n] for row, n in zip(found.rows["data"], found.rows["length"], strict=True)] == [
        frame.data for frame in frames
    ]


@given(st.lists(st.one_of(RECORDS, st.binary(max_size=60)), max_size=12), st.integers(1, 50))
def test_frames_do_not_depend_on_the_split(pieces: list[bytes], size: int) -> None:
    data, whole, parts = b"".join(pieces), FrameDecoder(), FrameDecoder()
    expected = whole.feed(data)
    found = [parts.feed(data[at : at + size]) for at in range(0, len(data), size)]
    assert [each for part in found for each in part.messages] == expected.messages


@given(st.lists(FRAMES, min_size=1, max_size=5), st.binary(min_size=1, max_size=200), st.data())
def test_frames_behind_damage_are_found_again(frames: list[CanFrame], garbage: bytes, data: st.DataObject) -> None:
    records = encode(*frames)
    at = data.draw(st.integers(0, len(frames))) * RECORD_BYTES
    found = decode(records[:at] + garbage.replace(b"C", b"c") + records[at:])
    assert found.frames == frames
    assert found.damaged == (at < len(records) or len(garbage) >= RECORD_BYTES)


def test_damage_is_counted_once_and_the_memory_is_bounded() -> None:
    decoder = FrameDecoder()
    assert sum(decoder.feed(bytes(1000)).damaged for _ in range(100)) == 1
    assert decoder.feed(encode(CanFrame(1))).damaged == 0
    assert len(decoder._tail) < RECORD_BYTES


@pytest.mark.parametrize(
    "frame", [CanFrame(0x800), CanFrame(-1), CanFrame(1, bytes(9)), CanFrame(2**29, extended=True)]
)
def test_a_frame_that_cannot_be_is_refused(frame: CanFrame) -> None:
    with pytest.raises(ValueError, match="expected an identifier"):
        encode(frame)


def test_messages_of_the_adapter_are_no_frames() -> None:
    found = decode(open_bus(250_000) + error_frame(0x4, b"\x00\x01" + bytes(6), 5) + encode(CanFrame(1)))
    assert found.frames == [CanFrame(1)]
    assert found.of_adapter == [(AdapterMessage.OPEN, 250_000)], "an error frame of SocketCAN is kept in the log alone"
    assert found.is_of_bus.tolist() == [False, False, True]
    assert opens_bus(encode(CanFrame(1)) + open_bus(1))
    assert not opens_bus(encode(CanFrame(1)) + adapter_message(AdapterMessage.OPENED))


def test_losses_of_the_line_are_counted_and_reported() -> None:
    losses = dict[str, int]()
    lines = CanLines("bus", losses)
    assert losses == {"damaged_lines": 0, "refused_lines": 0}
    data = adapter_message(AdapterMessage.REFUSED, 2) + adapter_message(AdapterMessage.DAMAGED, 3)
    frames, events = lines.received(data + b"x" + encode(CanFrame(1)))
    assert frames == [CanFrame(1)]
    assert [(event.kind, event.facts) for event in events] == [("refused", {"lines": 2}), ("damage", {"lines": 4})]
    assert all(isinstance(event, DeviceEvent) for event in events)
    assert losses == {"damaged_lines": 4, "refused_lines": 2}
    for kind, refused in ((AdapterMessage.OPEN_REFUSED, True), (AdapterMessage.OPENED, False)):
        assert lines.received(adapter_message(kind)) == ([], [])
        assert lines.open_refused is refused

"""RotorLink v1: the specification's vectors, round trips, any chunking, hostile bytes."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from daq.drivers.rotorlink import wire as rl
from daq.drivers.rotorlink.line import FrameDecoder
from daq.drivers.rotorlink.sender import Place, Sender

U8, U16, U32 = st.integers(0, 255), st.integers(0, 2**16 - 1), st.integers(0, 2**32 - 1)
I8, I16 = st.integers(-128, 127), st.integers(-(2**15), 2**15 - 1)
COUNTS = st.lists(st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 2), min_size=1, max_size=29)

NODE_FRAMES = st.one_of(
    st.builds(rl.EncoderBlock, U8, U16, U32, U32, U16, U8, COUNTS.map(lambda rows: np.array(rows, np.int32))),
    st.builds(rl.NodeStatus, U8, U16, U32, U16, I16, U32, U16, U8, U8, U32),
    st.builds(rl.LockEvent, U8, U16, U32, U8, U8, U16),
    st.builds(rl.Pong, U8, U16, U32, U32, U16),
    st.builds(rl.IndexMark, U8, U16, U32, U32),
    st.builds(rl.Acknowledge, U8, U16, U16, U8),
)
FRAMES = st.one_of(
    NODE_FRAMES,
    st.builds(rl.DongleStatus, U8, U16, U32, U32, U32, I8),
    st.builds(rl.Wrapped, U8, U16, U32, I8, NODE_FRAMES),
    st.builds(rl.NodeCommand, U8, U16, U8),
    st.builds(rl.Ping, U8, U16),
)

ENCODER = rl.EncoderBlock(1, 7, 1000, 1_000_500, 1000, 0x60, np.array([[0, 1000], [-5, 1003]], np.int32))
INDEX = rl.IndexMark(1, 10, 2_050_000, 33)
VECTORS = {
    "11 01 07 00 e8 03 00 00 34 44 0f 00 e8 03 02 60 00 00 00 00 e8 03 00 00 fb ff ff ff eb 03 00 00 51 2d": ENCODER,
    "12 01 08 00 80 84 1e 00 80 0e 3b 01 08 00 00 00 00 00 01 04 00 10 00 00 8f 5c": rl.NodeStatus(
        1, 8, 2_000_000, 3712, 315, 8, 0, 1, 4, 4096
    ),
    "13 01 09 00 fb 84 1e 00 00 01 2a 00 56 fe": rl.LockEvent(1, 9, 2_000_123, 0, 1, 42),
    "15 01 0a 00 d0 47 1f 00 21 00 00 00 b0 9d": INDEX,
    "16 01 0b 00 2a 00 00 c8 8f": rl.Acknowledge(1, 11, 42, 0),
    "14 01 0c 00 c0 c6 2d 00 e8 c6 2d 00 03 00 3a e3": rl.Pong(1, 12, 3_000_000, 3_000_040, 3),
    "90 01 2a 00 05 00 f5 ca": rl.NodeCommand(1, 42, rl.ACTIONS["release both"]),
    "91 01 03 00 88 56": rl.Ping(1, 3),
    "21 01 f4 01 40 54 89 00 c3 15 01 0a 00 d0 47 1f 00 21 00 00 00 b0 9d e5 bc": rl.Wrapped(
        1, 500, 9_000_000, -61, INDEX
    ),
}
ENCODER_WIRE = (
    "04 11 01 07 03 e8 03 01 04 34 44 0f 05 e8 03 02 60 01 01 01 03 e8 03 01 07 fb ff ff ff eb 03 01 03 51 2d 00"
)


def decode(pieces):
    decoder = FrameDecoder()
    frames, bad = [], []
    for piece in pieces:
        found = decoder.feed(piece)
        frames += found.frames
        bad += found.bad
    return frames, bad


def test_crc_check_value():
    assert rl.crc16(b"123456789") == 0x29B1


@pytest.mark.parametrize(("text", "frame"), VECTORS.items(), ids=lambda value: type(value).__name__)
def test_vectors(text, frame):
    payload = bytes.fromhex(text)
    assert frame.pack() == payload
    assert rl.parse(payload) == frame
    assert decode([rl.wire(payload)]) == ([frame], [])


def test_wire_vectors():
    assert rl.wire(ENCODER.pack()) == bytes.fromhex(ENCODER_WIRE)
    assert rl.wire(rl.NodeCommand(1, 42, 5).pack()) == bytes.fromhex("04 90 01 2a 02 05 03 f5 ca 00")


@given(FRAMES)
def test_round_trip(frame):
    assert rl.parse(frame.pack()) == frame


@given(FRAMES, st.data())
def test_a_flipped_bit_never_passes(frame, data):
    payload = bytearray(frame.pack())
    bit = data.draw(st.integers(0, 8 * len(payload) - 1))
    payload[bit // 8] ^= 1 << bit % 8
    with pytest.raises(rl.BadFrame) as caught:
        rl.parse(bytes(payload))
    assert caught.value.reason in ("crc", "length")


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (b"\x77\x01\x00\x00", "type"),
        (b"\x15\x01\x00\x00\x00", "length"),
        (b"\x11\x01\x00\x00" + bytes(10) + b"\x02\x00" + bytes(8), "length"),
        (b"\x11\x01\x00\x00" + bytes(10) + b"\x00\x00", "length"),
        (b"\x11\x01", "length"),
        (b"\x21\x01\x00\x00", "length"),
    ],
)
def test_reasons(body, reason):
    with pytest.raises(rl.BadFrame) as caught:
        rl.parse(rl.encode_frame(body))
    assert caught.value.reason == reason


def test_a_damaged_inner_frame_is_bad_but_its_wrapper_counts():
    inner = bytearray(INDEX.pack())
    inner[5] ^= 1
    wrapped = rl.Wrapped(1, 500, 9, -61, None, bytes(inner), "crc")
    frames, bad = decode([rl.wire(wrapped.pack())])
    assert frames == [wrapped]
    assert bad == [("inner crc", bytes(inner))]


def test_a_wrapper_may_not_hold_a_wrapper():
    inner = rl.Wrapped(1, 1, 1, 1, INDEX).pack()
    frame = rl.parse(rl.Wrapped(1, 2, 3, 4, None, inner, "type").pack())
    assert isinstance(frame, rl.Wrapped)
    assert (frame.inner, frame.damage) == (None, "type")


def test_the_largest_block_fits_wrapped_too():
    block = rl.EncoderBlock(1, 0, 0, 0, 1000, 0, np.full((29, 2), 0x01020304, np.int32))
    assert len(block.pack()) == rl.MAX_PAYLOAD_BYTES
    wrapped = rl.Wrapped(1, 0, 0, 0, block)
    assert decode([rl.wire(wrapped.pack())]) == ([wrapped], [])


def test_an_endless_run_is_dropped_once_and_the_stream_goes_on():
    decoder = FrameDecoder()
    reports = [decoder.feed(b"\x55" * 100).bad for _ in range(50)]
    assert sum(map(len, reports)) == 1
    assert len(decoder._run) == 0
    assert decoder.feed(b"\x00" + rl.wire(INDEX.pack())).frames == [INDEX]


@given(st.integers(0, 2**16 - 1), st.lists(st.integers(1, 1000), max_size=50))
def test_sequence_counts_losses_across_the_wrap(start, steps):
    sender, seq = Sender(), start
    sender.feed(seq, None, 0)
    for step in steps:
        seq = (seq + step) % 2**16
        assert sender.feed(seq, None, 0) == Place(lost=step - 1)
        assert sender.feed(seq, None, 0) == Place(is_repeated=True)


def test_sequence_late_frame_and_restart():
    sender = Sender()
    for seq in (30_000, 30_001):
        sender.feed(seq, None, 0)
    assert sender.feed(29_999, None, 0) == Place(is_repeated=True)
    assert sender.feed(0, None, 0) == Place(is_restart=True)

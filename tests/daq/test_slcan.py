"""LAWICEL text: round trips, any chunking, damage."""

import pytest
from hypothesis import given, strategies as st

from daq.transports.slcan import BEL, CanFrame, DecodedLines, LineDecoder, encode

FRAMES = st.one_of(
    st.builds(CanFrame, st.integers(0, 0x7FF), st.binary(max_size=8)),
    st.builds(CanFrame, st.integers(0, 0x1FFFFFFF), st.binary(max_size=8), st.just(True)),
    st.builds(CanFrame, st.integers(0, 0x7FF), st.integers(0, 8).map(bytes), st.just(False), st.just(True)),
)


def decode(pieces):
    decoder = LineDecoder()
    frames, other, damaged = [], [], 0
    for piece in pieces:
        found = decoder.feed(piece)
        frames += found.frames
        other += found.other_lines
        damaged += found.damaged
    return DecodedLines(frames, other, damaged)


def test_known_lines():
    assert encode(CanFrame(0x205, bytes([0x0F, 0, 0x2C, 1]))) == b"t20540F002C01\r"
    assert encode(CanFrame(0x1ABCDEF0, b"\xff", extended=True)) == b"T1ABCDEF01FF\r"
    assert encode(CanFrame(0x185, bytes(4), remote=True)) == b"r1854\r"


@given(FRAMES)
def test_round_trip(frame):
    assert decode([encode(frame)]) == DecodedLines([frame], [], 0)


@given(FRAMES, st.integers(0, 0xEA5F))
def test_adapter_time_behind_the_data_is_ignored(frame, time_ms):
    assert decode([encode(frame)[:-1] + f"{time_ms:04X}\r".encode()]) == DecodedLines([frame], [], 0)


@given(
    st.lists(st.one_of(FRAMES.map(encode), st.binary(max_size=90), st.sampled_from([b"z\r", b"\r", b"\x07", b"\r\n"])))
)
def test_any_split_gives_the_same(pieces):
    data = b"".join(pieces)
    assert decode(data[i : i + 1] for i in range(len(data))) == decode(pieces) == decode([data])


@given(st.lists(st.one_of(FRAMES.map(encode), st.binary(max_size=200)), max_size=6))
def test_an_intact_line_is_decoded_after_any_bytes(pieces):
    wanted = CanFrame(0x123, b"\x01\x02")
    assert decode([*pieces, b"\r", encode(wanted)]).frames[-1] == wanted


@pytest.mark.parametrize(
    "line",
    [
        b"t12",
        b"t1239",
        b"t1232AABB0",
        b"t1232AA",
        b"t8001AA",
        b"T200000000",
        b"t1231G0",
        b"t1231\xff0",
        b"\x80",
        b"t" * 65,
        b"v1854370",  # a frame's letter with a flipped bit
        b"437022C01",
        b"4370",
        b"hello",
        b" ",
    ],
)
def test_damaged_lines_are_counted(line):
    assert decode([line + b"\r"]) == DecodedLines([], [], 1)


def test_answers_bell_and_crlf():
    found = decode([b"V1013\rz\r\r\x07t1230\r\nt1240\r"])
    assert found == DecodedLines([CanFrame(0x123), CanFrame(0x124)], ["V1013", "z", "", BEL], 0)


def test_an_endless_line_is_bounded():
    decoder = LineDecoder()
    for _ in range(100):
        decoder.feed(b"A" * 1000)
    assert len(decoder._line) <= 64
    assert decoder.feed(b"\r" + encode(CanFrame(1))) == DecodedLines([CanFrame(1)], [], 1)


@pytest.mark.parametrize(
    "frame", [CanFrame(0x800), CanFrame(-1), CanFrame(1, bytes(9)), CanFrame(2**29, extended=True)]
)
def test_a_frame_that_cannot_be_is_refused(frame):
    with pytest.raises(ValueError, match="expected an identifier"):
        encode(frame)


@pytest.mark.parametrize("line", ["V1013", "v0107", "NA123", "NA1230000", "F04", "z", "Z", ""])
def test_what_adapters_answer_is_no_damage(line):
    assert decode([line.encode() + b"\r"]) == DecodedLines([], [line], 0)


@pytest.mark.parametrize("line", ["", "C", "O", "L", "S6", "s031C", "Z1", "M00000000", "V", "F"])
def test_orders_are_a_host_s_and_no_adapter_s(line):
    data = line.encode() + b"\r"
    assert LineDecoder(of_host=True).feed(data) == DecodedLines([], [line], 0)
    assert LineDecoder().feed(data).damaged == (line != "")


LINES = st.one_of(
    FRAMES.map(encode),
    FRAMES.map(lambda frame: encode(frame).lower().replace(b"t", b"T")),
    st.builds(
        lambda frame, end: encode(frame)[:-1] + end, FRAMES, st.sampled_from([b"ABCD\r", b"\x07", b"\r\n", b"0\r"])
    ),
    st.binary(max_size=90),
    st.sampled_from([b"z\r", b"\r", b"\x07", b"\n\n", b"V1013\r", b"t8008\r", b"T200000000\r", b"t12398\r", b"x" * 70]),
)


READS = st.builds(
    lambda lines, times: b"".join(lines) * times, st.lists(LINES, max_size=6), st.sampled_from([1, 9, 90])
)


@given(st.lists(READS, max_size=5), st.booleans())
def test_arrays_have_the_content_of_the_lines_read_one_by_one(reads, of_host):
    lines, block, either = (LineDecoder(of_host=of_host) for _ in range(3))
    for data in reads:
        expected, found = lines.feed(data), block.feed_block(data)
        assert found.frames() == expected.frames
        assert either.feed_any(data) == expected
        assert len(found) == len(expected.frames)
        assert (found.other_lines, found.damaged) == (expected.other_lines, expected.damaged)
        assert not any(row[length:].any() for row, length in zip(found.data, found.length, strict=True))

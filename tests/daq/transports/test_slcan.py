"""LAWICEL text: round trips, any chunking, damage."""

import pytest
from hypothesis import given, strategies as st

from daq.transports.can_frames import (
    CLOSE_BUS,
    AdapterMessage,
    CanFrame,
    adapter_message,
    decode as decode_records,
    encode as record_of,
    open_bus,
)
from daq.transports.slcan import BEL, AdapterText, DecodedLines, HostText, LineDecoder, encode

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
    assert len(decoder._begun) <= 65
    assert decoder.feed(b"\r" + encode(CanFrame(1))) == DecodedLines([CanFrame(1)], [], 1)


@pytest.mark.parametrize("line", ["V1013", "v0107", "NA123", "NA1230000", "F04", "z", "Z", ""])
def test_what_adapters_answer_is_no_damage(line):
    assert decode([line.encode() + b"\r"]) == DecodedLines([], [line], 0)


@pytest.mark.parametrize("line", ["", "C", "O", "L", "S6", "s031C", "Z1", "M00000000", "V", "F"])
def test_orders_are_a_host_s_and_no_adapter_s(line):
    data = line.encode() + b"\r"
    assert LineDecoder(of_host=True).feed(data) == DecodedLines([], [line], 0)
    assert LineDecoder().feed(data).damaged == (line != "")


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        ("t7FF0", CanFrame(0x7FF)),
        ("t8000", None),
        ("t0008" + "11" * 8, CanFrame(0, b"\x11" * 8)),
        ("t0009" + "11" * 9, None),
        ("t0008" + "11" * 7, None),
        ("t000211", None),
        ("t00021122A", None),
        ("t00021122ABCD", CanFrame(0, b"\x11\x22")),
        ("t00021122ABCDEF", None),
        ("T1FFFFFFF0", CanFrame(0x1FFFFFFF, extended=True)),
        ("T200000000", None),
        ("r1233", CanFrame(0x123, bytes(3), remote=True)),
        ("r1233ABCD", CanFrame(0x123, bytes(3), remote=True)),
        ("r1233ABCDEF", None),
        ("R000001238", CanFrame(0x123, bytes(8), True, True)),
    ],
)
def test_frames_at_the_limits_of_identifier_and_length(line, frame):
    for ending in (b"\r", b"\x07"):
        bell = [BEL] if ending == b"\x07" else []
        assert decode([line.encode() + ending]) == DecodedLines([frame] if frame else [], bell, 0 if frame else 1)


def test_ends_of_lines():
    assert decode([b"\r\n\r\nz\r\n\x07"]).other_lines == ["", "", "z", BEL]
    assert decode([b"z\x07\x07\r"]).other_lines == ["z", BEL, BEL, ""]
    assert decode([b"x" * 500 + b"\rz\r"]) == DecodedLines([], ["z"], 1)


# --- the host's end ----------------------------------------------------------------------------------------------


def joined():
    host = HostText()
    assert host.received(b"\r") == b""
    return host


def messages(records):
    return decode_records(records).of_adapter


@given(st.lists(FRAMES))
def test_frames_cross_the_line_in_both_directions(frames):
    host, adapter = joined(), AdapterText()
    records, answers = adapter.received(host.sent(record_of(*frames)))
    assert records == record_of(*frames)
    assert host.received(answers) == b"", "every frame was sent"
    assert host.received(adapter.sent(record_of(*frames))) == record_of(*frames)


def test_the_bus_is_opened_and_closed():
    host, adapter = HostText(), AdapterText()
    text = host.sent(open_bus(500_000))
    assert text == b"\rC\rS6\rO\r"
    records, answers = adapter.received(text)
    assert messages(records) == [(AdapterMessage.CLOSE, 0), (AdapterMessage.OPEN, 500_000)]
    assert messages(host.received(answers)) == [(AdapterMessage.OPENED, 0)]
    assert host.sent(CLOSE_BUS) == b"C\r"
    assert messages(adapter.received(b"C\r")[0]) == [(AdapterMessage.CLOSE, 0)]


def test_the_first_line_may_be_cut_and_the_rest_is_decoded():
    whole = encode(CanFrame(0x185, b"1234"))
    for at in range(1, len(whole)):
        host = HostText()
        assert host.received(whole[at:] + whole) == record_of(CanFrame(0x185, b"1234"))
        assert messages(host.received(whole[3:] + whole)) == [(AdapterMessage.DAMAGED, 1)]
        assert messages(host.received(b"tq\rt12\r")) == [(AdapterMessage.DAMAGED, 2)]


def test_damaged_records_are_a_damaged_line():
    assert AdapterText().sent(b"x" * 30 + record_of(CanFrame(1))) == b"?\rt0010\r"


REFUSED, OPENED, CLOSED = AdapterMessage.REFUSED, AdapterMessage.OPENED, AdapterMessage.OPEN_REFUSED


@pytest.mark.parametrize(
    ("orders", "answers", "found"),
    [
        (b"", b"\x07", [(REFUSED, 1)]),
        (b"", b"\r\r\x07\x07", [(REFUSED, 2)]),
        (CLOSE_BUS, b"\x07", []),  # it was closed already
        (CLOSE_BUS, b"\x07\x07", [(REFUSED, 1)]),
        (open_bus(250_000), b"\r\x07\r\r", [(OPENED, 0)]),
        (open_bus(250_000), b"\r\x07\r\x07\x07", [(CLOSED, 0), (REFUSED, 1)]),
        (open_bus(250_000), b"z\r\x07", [(REFUSED, 1)]),  # a frame was sent: the bus is open
        (open_bus(250_000), b"Z\r\x07\x07", [(REFUSED, 2)]),
    ],
)
def test_refusals_are_those_beyond_the_orders(orders, answers, found):
    host = joined()
    host.sent(orders)
    assert messages(host.received(answers)) == found


def test_an_adapter_that_answers_no_order_is_not_excused_for_ever():
    host = joined()
    host.sent(open_bus(500_000))
    host.received(encode(CanFrame(0x185)))
    assert messages(host.received(b"\x07\x07")) == [(REFUSED, 2)]


def test_a_refusal_at_the_start_of_a_log_is_one():
    assert messages(HostText().received(b"\x07")) == [(REFUSED, 1)]


def test_messages_of_the_adapter_are_no_text():
    assert AdapterText().sent(adapter_message(OPENED)) == b""

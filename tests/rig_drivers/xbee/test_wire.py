"""XBee API frames: published examples, round trips, any split, garbage, damage in both modes."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest
from hypothesis import assume, given, strategies as st
from pydantic import ValidationError

from rig_drivers.xbee import framing, wire
from rig_drivers.xbee.settings import XBeeNode

MODES = pytest.mark.parametrize("escaped", [False, True], ids=["AP=1", "AP=2"])
FRAME_DATA = st.one_of(
    st.binary(min_size=1, max_size=60),
    st.lists(st.sampled_from([0x7E, 0x7D, 0x11, 0x13, 0x5E, 0x00]), min_size=1, max_size=20).map(bytes),
)

PUBLISHED = {  # examples in the maker's manuals
    "7E 00 12 90 00 13 A2 00 41 AE B5 4E FF FE C1 54 78 44 61 74 61 C4": wire.Received(
        0x0013A20041AEB54E, None, None, 0xC1, b"TxData"
    ),
    "7E 00 18 91 00 13 A2 00 40 52 2B AA 7D 84 E0 E0 22 11 C1 05 02 52 78 44 61 74 61 52": wire.Received(
        0x0013A20040522BAA, 0x7D84, None, 0x02, b"RxData"
    ),
    "7E 00 11 80 00 13 A2 00 12 34 56 78 5E 01 54 78 44 61 74 61 11": wire.Received(
        0x0013A20012345678, None, -94, 0x01, b"TxData"
    ),
    "7E 00 0B 81 12 34 5E 01 54 78 44 61 74 61 93": wire.Received(None, 0x1234, -94, 0x01, b"TxData"),
    "7E 00 07 8B 01 7D 84 00 00 01 71": wire.TransmitStatus(1, 0),
    "7E 00 03 89 01 7D F8": wire.TransmitStatus(1, 0x7D),
    "7E 00 02 8A 00 75": wire.ModemStatus(0),
    "7E 00 05 88 01 42 44 00 F0": wire.AtAnswer(1, "BD", 0, b""),
}


def decode(pieces: list[bytes], escaped: bool) -> list[bytes | framing.DamagedPart]:
    decoder = framing.ApiDecoder(escaped=escaped)
    return [found for piece in pieces for found in decoder.feed(piece)]


def split(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = sorted({0, len(data), *(cut % (len(data) + 1) for cut in cuts)})
    return [data[a:b] for a, b in pairwise(edges)]


def past_the_beginning(escaped: bool) -> bytes:
    """A sound frame, after which every damage counts."""
    return framing.encode(b"\xfe", escaped=escaped)


@pytest.mark.parametrize(("text", "frame"), PUBLISHED.items(), ids=[text[9:11] for text in PUBLISHED])
def test_published_frames(text: str, frame: wire.ApiFrame) -> None:
    line = bytes.fromhex(text)
    (data,) = decode([line], escaped=False)
    assert isinstance(data, bytes)
    assert wire.parse(data) == frame
    assert framing.encode(data, escaped=False) == line
    assert decode([framing.encode(data, escaped=True)], escaped=True) == [data]


def test_published_escapes() -> None:
    assert framing.encode(bytes.fromhex("23 11"), escaped=True) == bytes.fromhex("7E 00 02 23 7D 31 CB")
    request = wire.transmit_request(1, wire.Address.parse("0013A200400A0127"), b"TxData0A")
    assert framing.encode(request, escaped=True) == bytes.fromhex(
        "7E 00 16 10 01 00 7D 33 A2 00 40 0A 01 27 FF FE 00 00 54 78 44 61 74 61 30 41 7D 33"
    )


def test_requests_by_address() -> None:
    long, short = wire.Address.parse("0013A200400A0127"), wire.Address.parse("1234")
    assert wire.transmit_request(5, short, b"x").hex(" ") == "10 05 ff ff ff ff ff ff ff ff 12 34 00 00 78"
    assert wire.transmit_request(5, long, b"x", legacy=True).hex(" ") == "00 05 00 13 a2 00 40 0a 01 27 00 78"
    assert wire.transmit_request(5, short, b"x", legacy=True).hex(" ") == "01 05 12 34 00 78"
    assert (str(long), str(short)) == ("0013A200400A0127", "1234")
    assert wire.at_command(1, "AP").hex(" ") == "08 01 41 50"
    with pytest.raises(ValueError, match="16 or 4"):
        wire.Address.parse("12345")


@pytest.mark.parametrize("mode", [1, 2])
def test_the_question_for_the_mode_and_its_answer_need_no_escape(mode: int) -> None:
    for data in (wire.at_command(1, "AP"), bytes((0x88, 1)) + b"AP" + bytes((0, mode))):
        assert framing.encode(data, escaped=True) == framing.encode(data, escaped=False)


@given(st.lists(FRAME_DATA, max_size=6), st.lists(st.integers(0, 1000)), st.booleans())
def test_round_trip_in_any_split(frames: list[bytes], cuts: list[int], escaped: bool) -> None:
    line = b"".join(framing.encode(data, escaped=escaped) for data in frames)
    assert decode(split(line, cuts), escaped) == frames


@given(st.lists(FRAME_DATA, min_size=1, max_size=4))
def test_between_the_start_and_the_end_no_start_is_sent_with_escapes(frames: list[bytes]) -> None:
    line = b"".join(framing.encode(data, escaped=True) for data in frames)
    assert line.count(b"\x7e") == len(frames)
    assert b"\x11" not in line
    assert b"\x13" not in line


@given(st.lists(st.tuples(st.binary(max_size=30), FRAME_DATA), max_size=5), st.booleans())
def test_bytes_between_frames_cost_no_frame_and_are_counted(pieces: list[tuple[bytes, bytes]], escaped: bool) -> None:
    clean = [(garbage.replace(b"\x7e", b"\x00"), data) for garbage, data in pieces]
    line = past_the_beginning(escaped)
    line += b"".join(garbage + framing.encode(data, escaped=escaped) for garbage, data in clean)
    _, *found = decode([line], escaped)
    assert [item for item in found if isinstance(item, bytes)] == [data for _, data in clean]
    assert found.count(framing.DamagedPart("garbage")) == sum(bool(garbage) for garbage, _ in clean)


@given(st.lists(st.tuples(st.binary(max_size=60), FRAME_DATA), max_size=5))
def test_with_escapes_no_bytes_at_all_cost_a_frame_behind_them(pieces: list[tuple[bytes, bytes]]) -> None:
    line = b"".join(garbage + framing.encode(data, escaped=True) for garbage, data in pieces)
    found = iter(decode([line], escaped=True))
    assert all(data in found for _, data in pieces)


@MODES
@pytest.mark.parametrize("lost", range(1, 31))
def test_a_lost_byte_costs_its_frame_alone_and_is_one_damage(lost: int, escaped: bool) -> None:
    before, hit, behind = b"\x90" + bytes(range(1, 30)), b"\x90" + bytes(range(40, 66)), b"\x90" + bytes(range(3, 50))
    line = [framing.encode(data, escaped=escaped) for data in (before, hit, behind)]
    line[1] = line[1][:lost] + line[1][lost + 1 :]
    found = decode([b"".join(line), past_the_beginning(escaped), bytes(400)], escaped)
    damages = [item for item in found if item not in (framing.DamagedPart("garbage"), before, behind, b"\xfe")]
    assert [item for item in found if isinstance(item, bytes)] == [before, behind, b"\xfe"]
    assert len(damages) == 1
    assert found[:3] == [before, damages[0], behind]


@given(FRAME_DATA, st.integers(0, 10_000), st.booleans())
def test_a_flipped_bit_that_moves_no_byte_never_gives_other_data(data: bytes, bit: int, escaped: bool) -> None:
    """A flip in the length, into or out of an escape, or next to a start in the data: another sum fits once in 256."""
    line = bytearray(framing.encode(data, escaped=escaped))
    bit %= 8 * len(line)
    before = line[bit // 8]
    line[bit // 8] ^= 1 << bit % 8
    assume(bit // 8 not in (1, 2) and framing.ESCAPE not in (before, line[bit // 8]))
    assume(escaped or framing.START not in line[1:])
    found = decode([bytes(line) + past_the_beginning(escaped), bytes(2 * framing.MAX_FRAME_BYTES)], escaped)
    assert [item for item in found if isinstance(item, bytes)] in ([b"\xfe"], [data, b"\xfe"], [])


@pytest.mark.parametrize(
    ("line", "reason", "escaped"),
    [
        ("7E 00 02 23 11 CC", "checksum", False),
        ("7E 00 00 FF", "length", False),
        ("7E 01 2D 00", "length", False),
        ("7E 00 02 23", "cut", True),
        ("7E 00 02 23 7D", "cut", True),
        ("7E 00 02 23 11 CB", "escape", True),
        ("7E 00 02 7D 03 11", "escape", True),
        ("01 02 03", "garbage", True),
        ("7D 11", "garbage", False),
    ],
)
def test_reasons(line: str, reason: str, escaped: bool) -> None:
    sound = past_the_beginning(escaped)
    found = decode([sound, bytes.fromhex(line), sound], escaped)
    assert found == [b"\xfe", framing.DamagedPart(reason), b"\xfe"]


@MODES
def test_the_rest_of_a_frame_at_the_beginning_is_no_damage(escaped: bool) -> None:
    data = b"\x90" + bytes(range(100, 160))  # a start and an escape among them
    line = framing.encode(data, escaped=escaped)
    for cut in range(1, len(line)):
        assert decode([line[cut:] + line], escaped)[-1] == data
        assert decode([line[cut:] + line], escaped) == [data]


@MODES
def test_a_line_without_a_single_frame_is_counted_and_not_kept(escaped: bool) -> None:
    decoder = framing.ApiDecoder(escaped=escaped)
    found = [damage for _ in range(100) for damage in decoder.feed(bytes(100))]
    assert len(found) == (10_000 - 2 * framing.MAX_FRAME_BYTES) // framing.MAX_FRAME_BYTES
    assert found == decode([bytes(10_000)], escaped)
    found = [damage for _ in range(100) for damage in decoder.feed(b"\x7e\x02" + bytes(98))]
    assert framing.DamagedPart("length") in found
    assert len(decoder._line) < 2 * framing.MAX_FRAME_BYTES


@pytest.mark.parametrize(
    "data", ["90 00", "91" + " 00" * 16, "80 01", "81 12", "8B 01", "89 01", "8A", "8A 00 00", "88"]
)
def test_wrong_sizes_are_refused(data: str) -> None:
    with pytest.raises(ValueError, match="expected"):
        wire.parse(bytes.fromhex(data))


def test_other_types_are_named() -> None:
    assert wire.parse(b"\x97\x01") == wire.UnusedFrame(0x97)


def mutated(line: bytes, draw: random.Random) -> bytes:
    out = bytearray(line)
    for _ in range(draw.randint(1, 3)):
        at = draw.randrange(len(out))
        match draw.randrange(5):
            case 0:
                out[at] ^= 1 << draw.randrange(8)
            case 1:
                out[at] = draw.randrange(256)
            case 2:
                del out[at]
            case 3:
                out.insert(at, draw.choice((0x7E, 0x7D, draw.randrange(256))))
            case _:
                out[at : at + 4] = draw.randbytes(draw.randint(0, 6))
        out = out or bytearray(1)
    return bytes(out)


SETTINGS = {"driver": "xbee", "port": "COM3", "node_address": "0013a20041aeb54e"}


def test_settings() -> None:
    assert XBeeNode.model_validate(SETTINGS).node_address == "0013A20041AEB54E"
    assert XBeeNode.model_validate({**SETTINGS, "node_address": "12ab", "api_mode": 1}).node_address == "12AB"


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"node_address": "0013A2"}, "pattern"),
        ({"node_address": "000000000000FFFF"}, "broadcast"),
        ({"node_address": "fffe"}, "unknown"),
        ({"api_mode": 0}, "1 or 2"),
        ({"baud": 9600, "rate_Hz": 250}, "20000 baud"),
        ({"rate_hz": 100}, "Extra inputs"),
    ],
)
def test_settings_that_cannot_be(wrong: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        XBeeNode.model_validate({**SETTINGS, **wrong})


AT_ANSWERS = st.builds(
    wire.AtAnswer,
    st.integers(0, 255),
    st.binary(min_size=2, max_size=2).map(lambda command: command.decode("latin-1")),
    st.integers(0, 255),
    st.binary(max_size=20),
)


@given(AT_ANSWERS)
def test_the_text_of_an_answer_gives_the_answer_again(answer: wire.AtAnswer) -> None:
    assert wire.AtAnswer.of_text(answer.text) == answer


@pytest.mark.parametrize("text", ["", "1 AP 02", "x AP 02 ok", "1 AP 0 ok", "1 AP 02 status"])
def test_another_text_is_not_an_answer(text: str) -> None:
    with pytest.raises(ValueError, match=r"invalid literal|non-hexadecimal"):
        wire.AtAnswer.of_text(text)

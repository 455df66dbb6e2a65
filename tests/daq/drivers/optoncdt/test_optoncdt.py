"""optoNCDT: stream and text apart, any chunking, damage, scaling."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from daq.drivers.optoncdt import distance_words, sensor_answers, wire as nc
from daq.errors import DeviceError

WORDS = ("DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI")
BLOCKS = arrays(np.uint32, st.tuples(st.integers(0, 30), st.just(4)), elements=st.integers(0, 2**18 - 1))
LINES = st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E), min_size=1, max_size=60).filter(
    lambda line: "->" not in line and line == line.strip()
)


def decode(pieces, words=WORDS):
    decoder = nc.BlockDecoder(words)
    found = [decoder.feed(piece) for piece in pieces]
    values = np.concatenate([np.empty((0, len(words)), np.uint32), *(part.values for part in found)])
    return values, [line for part in found for line in part.text], sum(part.skipped_bytes for part in found)


def same(left, right):
    return np.array_equal(left[0], right[0]) and left[1:] == right[1:]


def test_known_bytes():
    assert nc.encode_block([[0x2A5F3, 0x3FFFF]]) == bytes([0x33, 0x57, 0xAA, 0x3F, 0x7F, 0xFF])


@given(BLOCKS)
def test_round_trip(blocks):
    assert same(decode([nc.encode_block(blocks)]), (blocks, [], 0))


@given(st.lists(LINES, max_size=5), BLOCKS)
def test_answer_then_stream(lines, blocks):
    data = b"".join(line.encode() + b"\r\n" for line in lines) + b"->" + nc.encode_block(blocks)
    assert same(decode([data]), (blocks, [*lines, "->"], 0))


@given(LINES.filter(lambda line: "-" not in line), BLOCKS, st.data())
def test_an_answer_scattered_between_values_is_put_together(line, blocks, data):
    stream = nc.encode_block(blocks)
    pieces = [bytes([byte]) for byte in line.encode() + b"\r\n"] + [b"->"]  # the prompt is sent in one go
    edges = st.lists(st.integers(0, len(stream) // 3), min_size=len(pieces), max_size=len(pieces))
    mixed, last = b"", 0
    for place, piece in zip(sorted(data.draw(edges)), pieces, strict=True):
        mixed += stream[3 * last : 3 * place] + piece
        last = place
    mixed += stream[3 * last :]
    assert same(decode([mixed]), (blocks, [line, "->"], 0))


def test_the_prompt_is_not_held_back():
    assert decode([b"OUTPUT NONE ok\r\n->"])[1] == ["OUTPUT NONE ok", "->"]


@given(BLOCKS.filter(lambda blocks: len(blocks) > 1), st.data())
def test_a_lost_byte_costs_its_block_only(blocks, data):
    stream = bytearray(nc.encode_block(blocks))
    place = data.draw(st.integers(0, len(stream) - 1))
    del stream[place]
    values, _, skipped = decode([bytes(stream)])
    lost = place // 12
    rest = np.delete(blocks, lost, axis=0)
    # the block behind may lose its first value to a prompt or a line end that the debris happens to look like
    assert len(values) >= len(rest) - 1
    assert all(row.tolist() in rest.tolist() for row in values)
    assert skipped <= 24


@given(BLOCKS)
def test_after_garbage_the_beat_is_found_again(blocks):
    garbage = bytes([0x80, 0x41, 0xC0, 0x01, 0x41, 0xC1, 0xFF, 0x7F])
    values, _, _ = decode([garbage, nc.encode_block(blocks)])
    assert np.array_equal(values, blocks)


def test_skipped_bytes_are_counted():
    stream = nc.encode_block(np.arange(12).reshape(3, 4))
    assert decode([stream[5:]])[2] == 7  # the rest of the first block
    assert decode([stream[:12] + b"\xff\xff" + stream[12:]])[2] == 2


def test_more_words_than_expected_show_as_skipped():
    values, _, skipped = decode([nc.encode_block(np.ones((10, 5), np.uint32))])
    assert (len(values), skipped) == (10, 30)


def test_an_endless_text_is_bounded():
    decoder = nc.BlockDecoder(WORDS)
    skipped = sum(decoder.feed(b"abcdefgh" * 1000).skipped_bytes for _ in range(10))
    assert len(decoder._line) <= 1024
    assert skipped + len(decoder._line) == 80_000


def test_words_can_change():
    decoder = nc.BlockDecoder(["DIST"])
    decoder.feed(nc.encode_block([[1]]))
    decoder.set_words(WORDS)
    assert decoder.feed(nc.encode_block([[1, 2, 3, 4]])).values.tolist() == [[1, 2, 3, 4]]
    with pytest.raises(ValueError, match="at least one"):
        decoder.set_words([])


def test_scaling_at_the_marks():
    marks = distance_words.metres([0, 642.3529411764706, 65520], 0.025)
    assert marks == pytest.approx([-0.00025, 0.0, 0.02525], abs=1e-12)
    assert distance_words.metres(np.array([[32760]]), 0.025) == pytest.approx(np.array([[0.0125]]))
    assert np.isnan(distance_words.metres([65521, *distance_words.ERROR_CODES], 0.025)).all()


@given(arrays(np.uint32, 20, elements=st.integers(0, distance_words.CODE_MAX)), st.sampled_from([0.01, 0.025, 0.5]))
def test_code_inverts_metres(codes, range_m):
    assert np.array_equal(distance_words.code(distance_words.metres(codes, range_m), range_m), codes)


def test_what_is_not_seen_has_its_error_code():
    assert distance_words.code([np.nan, -1.0, 1.0, -np.inf, np.inf], 0.025).tolist() == [
        262076,
        262077,
        262078,
        262077,
        262078,
    ]


def test_timestamp():
    assert nc.timestamp_ticks([1, 0xFFFF], [2, 0xFFFF]).tolist() == [2 * 65536 + 1, 2**32 - 1]
    assert round(nc.TIMESTAMP_WRAP * nc.TICK_S, 2) == 11 * 3600 + 55 * 60 + 49.67


def test_encode_refuses_what_does_not_fit():
    with pytest.raises(ValueError, match="18-bit"):
        nc.encode_block([[2**18]])
    with pytest.raises(ValueError, match="blocks, words"):
        nc.encode_block([1, 2])


def test_parse_info():
    lines = ["Name:       ILD1420-25", "Serial:  01234567", "Measuring range: 25.00mm", "Version: 001.013", "->"]
    assert sensor_answers.parse_info(lines) == {
        "name": "ILD1420-25",
        "serial": "01234567",
        "range_m": 0.025,
        "version": "001.013",
    }
    for broken in ([], ["Measuring range: wide"], ["Measuring range: 0.00mm"]):
        with pytest.raises(DeviceError, match="Measuring range"):
            sensor_answers.parse_info(broken)


def test_parse_outinfo():
    assert sensor_answers.parse_outinfo("GETOUTINFO_RS422 DIST COUNTER TIMESTAMP") == WORDS
    assert sensor_answers.parse_outinfo("GETOUTINFO_RS422 DIST1, TIMESTAMP ok") == (
        "DIST",
        "TIMESTAMP_LO",
        "TIMESTAMP_HI",
    )
    for broken in ("", "E202 Access denied", "GETOUTINFO_RS422", "GETOUTINFO_RS422 NONE"):
        with pytest.raises(DeviceError, match="GETOUTINFO_RS422"):
            sensor_answers.parse_outinfo(broken)

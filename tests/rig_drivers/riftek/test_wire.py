"""RF60x bytes: the examples of the manual, packets for any split of the bytes, damage found and counted."""

from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import given, strategies as st

from daq.errors import DeviceError
from rig_drivers.riftek import wire
from rig_drivers.riftek.decoder import DecodedResults, ResultDecoder

IDENTIFICATION = bytes.fromhex("9F 93 90 99 91 92 93 94 90 95 90 90 92 93 90 90")
MUTATIONS = 10_000


class Slow(ResultDecoder):
    """Takes every byte by itself."""

    @property
    def _at_boundary(self) -> bool:
        return False


def rows(found: list[DecodedResults]) -> list[tuple[int, bool, int, int]]:
    """Results with what belongs to them."""
    return [
        row
        for each in found
        for row in zip(
            each.code.tolist(), each.updated.tolist(), each.step.tolist(), each.skipped.tolist(), strict=True
        )
    ]


def doubted(found: list[DecodedResults]) -> list[int]:
    places, count = [], 0
    for each in found:
        places += [count + place for place in each.doubted]
        count += len(each.code)
    return places


def decode(data: bytes, cut: int | None = None, decoder: ResultDecoder | None = None) -> list[DecodedResults]:
    decoder = decoder or ResultDecoder()
    size = cut or max(1, len(data))
    return [decoder.feed(data[at : at + size]) for at in range(0, len(data), size)]


@pytest.mark.parametrize(
    ("encoded", "expected"),
    [
        (wire.request(1, wire.IDENTIFY), "01 81"),
        (wire.request(1, wire.READ, b"\x02"), "01 82 82 80"),
        (wire.request(1, wire.WRITE, b"\x02\x01"), "01 83 82 80 81 80"),
        (wire.request(1, wire.WRITE, b"\x09\x30"), "01 83 89 80 80 83"),
        (wire.request(1, wire.WRITE, b"\x08\x39"), "01 83 88 80 89 83"),
        (wire.request(1, wire.RESULT), "01 86"),
        (wire.request(wire.EVERYONE, wire.STOP), "00 88"),
    ],
)
def test_requests_of_the_manual(encoded: bytes, expected: str) -> None:
    assert encoded == bytes.fromhex(expected)


def test_a_result_of_the_manual() -> None:
    expected = bytes.fromhex("F5 FA F2 F0")
    assert wire.results([677], [3]) == expected == wire.packet(b"\xa5\x02", 3, updated=True)
    assert wire.metres(677, 0.05) == pytest.approx(2.066e-3, abs=1e-6)
    assert rows(decode(expected + b"\xc0")) == [(677, True, 1, 0)]


def test_an_identification_of_the_manual() -> None:
    decoder = ResultDecoder()
    decoder.expect(wire.awaited(wire.request(1, wire.IDENTIFY)))
    (answer,) = decoder.feed(IDENTIFICATION).answers
    assert wire.packet(answer, 1) == IDENTIFICATION
    info = wire.parse_info(answer)
    assert (info.base_m, info.range_m) == (0.08, 0.05)


@pytest.mark.parametrize("data", [b"", bytes(7), bytes(8), bytes(9)])
def test_an_identification_without_a_range_is_refused(data: bytes) -> None:
    with pytest.raises(DeviceError, match=r"expected (8 bytes|a measuring range)"):
        wire.parse_info(data)


@pytest.mark.parametrize(("address", "code"), [(128, 1), (-1, 1), (1, 16)])
def test_no_such_request(address: int, code: int) -> None:
    with pytest.raises(ValueError, match="expected an address"):
        wire.request(address, code)


def test_which_requests_are_answered() -> None:
    assert wire.awaited(wire.request(1, wire.READ, b"\x02")) == 2
    assert wire.awaited(wire.request(1, wire.READ, b"\x02") + wire.request(1, wire.START)) is None
    assert [wire.awaited(data) for data in (b"", b"\x01", b"\x81", wire.request(1, wire.WRITE, b"\x02\x01"))] == 4 * [
        None
    ]


@given(st.integers(0, 16_384), st.floats(1e-3, 1.0))
def test_codes_and_metres_are_inverse(code: int, range_m: float) -> None:
    assert wire.code(wire.metres(code, range_m), range_m) == code


def stream(count: int, first: int = 0, rng: random.Random | None = None) -> bytes:
    rng = rng or random.Random(count)
    return wire.results([rng.randrange(wire.FULL_SCALE) for _ in range(count)], np.arange(first, first + count))


pieces = st.one_of(
    st.builds(
        lambda n, first, seed: stream(n, first, random.Random(seed)),
        st.integers(0, 40),
        st.integers(0, 3),
        st.integers(0, 99),
    ),
    st.binary(max_size=12),
    st.builds(lambda n, updated: wire.packet(bytes([7, 9]), n, updated=updated), st.integers(0, 3), st.booleans()),
    st.builds(lambda byte, n: bytes([byte]) * n, st.integers(0, 255), st.integers(1, 20)),
    st.just(IDENTIFICATION),
)


@given(st.lists(pieces, max_size=8).map(b"".join), st.integers(1, 70), st.sampled_from([None, 2, 16]))
def test_neither_the_split_nor_the_fast_path_changes_anything(data: bytes, cut: int, wanted: int | None) -> None:
    results = []
    for decoder, size in ((ResultDecoder(), None), (ResultDecoder(), cut), (Slow(), None), (ResultDecoder(), 1)):
        decoder.expect(wanted)
        found = decode(data, size, decoder)
        answers = [answer for each in found for answer in each.answers]
        results.append((rows(found), doubted(found), answers, sum(each.skipped_bytes for each in found)))
    assert results[0] == results[1] == results[2] == results[3]


@given(st.lists(pieces, max_size=8).map(b"".join))
def test_every_byte_is_a_results_or_counted(data: bytes) -> None:
    found = decode(data)
    accounted = 4 * len(rows(found)) + sum(each.skipped_bytes for each in found)
    assert accounted <= len(data) <= accounted + 3 + 8  # a packet cut by joining; bytes of a run still under way


def test_a_stuck_line_gives_no_results_and_takes_no_memory() -> None:
    decoder = ResultDecoder()
    found = [decoder.feed(b"\xff" * 5000) for _ in range(20)]
    assert rows(found) == []
    assert sum(each.skipped_bytes for each in found) == 100_000 - 3
    assert len(decoder._run) <= 8


@pytest.mark.parametrize("lost", [0, 1, 2, 3])
@pytest.mark.parametrize("first", [0, 1, 2, 3])
def test_fewer_than_four_lost_results_are_counted_exactly(lost: int, first: int) -> None:
    data = stream(30, first)
    found = rows(decode(data[:48] + data[48 + 4 * lost :]))
    assert [row[2] for row in found] == 12 * [1] + [1 + lost] + (17 - lost) * [1]
    assert all(row[3] == 0 for row in found)


def test_an_answer_between_results_counts_as_a_packet_and_not_as_a_result() -> None:
    decoder = ResultDecoder()
    before = decoder.feed(stream(6, 0))
    decoder.expect(2)
    between = decoder.feed(wire.packet(b"\x5a", 8) + stream(6, 9))  # two results lost before the answer
    assert between.answers == (b"\x5a",)
    decoder.expect(2)
    behind = decoder.feed(wire.packet(b"\xa5", 15) + stream(6, 17))  # and one behind the next
    assert [row[2] for row in rows([before, between, behind])] == [*6 * [1], 3, *5 * [1], 2, *5 * [1]]


def test_an_old_result_is_one_that_is_not_new() -> None:
    found = rows(decode(wire.results([5, 6, 7], [0, 1, 2], updated=False) + stream(2, 3)))
    assert [row[1] for row in found] == [False, False, False, True, True]


def test_garbage_between_packets_is_counted_and_costs_no_result_behind_the_next() -> None:
    data = stream(20)
    found = decode(data[:40] + b"\x00\x11\x22" + data[40:])
    assert rows(found)[10][3] == 3
    assert len(rows(found)) == 20
    assert sum(each.skipped_bytes for each in found) == 3


def wrong(data: bytes, damaged: bytes) -> tuple[int, int]:
    """Results of damaged bytes that the sensor did not send: all, and those among them that are not in doubt.

    A result is the sensor's if it is in the original stream in the same order.
    """
    sent = [row[0] for row in rows(decode(data + b"\x00"))]
    found = decode(damaged + b"\x00")
    got, doubt, at, strange = rows(found), set(doubted(found)), 0, []
    for place, row in enumerate(got):
        try:
            at = sent.index(row[0], at) + 1
        except ValueError:
            strange.append(place)
    return len(strange), len([place for place in strange if place not in doubt])


def distinct(count: int, rng: random.Random) -> bytes:
    return wire.results(rng.sample(range(1, wire.FULL_SCALE), count), np.arange(count) + rng.randrange(4))


def test_a_flipped_bit_outside_the_data_gives_no_wrong_result() -> None:
    rng = random.Random(1)
    for _ in range(MUTATIONS // 5):
        data = distinct(12, rng)
        damaged = bytearray(data)
        damaged[rng.randrange(len(data))] ^= 1 << rng.randrange(4, 8)
        assert wrong(data, bytes(damaged)) == (0, 0)


def test_a_flipped_bit_of_the_data_is_an_undetected_wrong_result() -> None:
    """14 of 32: the two highest bits make a result beyond full scale, which is not a reading."""
    rng = random.Random(2)
    accepted = 0
    for _ in range(MUTATIONS):
        code, bit = rng.randrange(1, wire.FULL_SCALE), rng.randrange(32)
        damaged = bytearray(wire.results([1, 2, code, 3], [0, 1, 2, 3]))
        damaged[8 + bit // 8] ^= 1 << bit % 8
        found = decode(bytes(damaged) + b"\x00")
        strange = {row[0] for place, row in enumerate(rows(found)) if place not in doubted(found)} - {1, 2, 3, code}
        accepted += any(each <= wire.FULL_SCALE for each in strange)
    assert accepted / MUTATIONS == pytest.approx(14 / 32, abs=0.02)


def test_lost_bytes_give_a_wrong_result_only_where_sixteen_are_lost() -> None:
    """Cut anywhere, bytes of two packets fit together without a seam when a multiple of 16 bytes is missing."""
    rng = random.Random(3)
    for _ in range(MUTATIONS // 10):
        data, lost = distinct(40, rng), rng.randrange(1, 64)
        at = rng.randrange(4, len(data) - lost)
        _, accepted = wrong(data, data[:at] + data[at + lost :])
        assert accepted <= (lost % 16 == 0 and at % 4 != 0)

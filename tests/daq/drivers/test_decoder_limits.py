"""Decoders at their limits: the largest accepted and the smallest refused number, and codes of the standards."""

from __future__ import annotations

import struct

import pytest

from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia
from daq.drivers.optoncdt import wire as optoncdt
from daq.drivers.optoncdt.words import WordsTrial
from daq.drivers.rotorlink import wire as rotorlink
from rig_drivers.riftek import wire as riftek
from rig_drivers.riftek.decoder import ResultDecoder
from rig_drivers.vesc import wire as vesc
from rig_drivers.xbee import wire as xbee

WORDS = ("DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI")


# --- optoNCDT --------------------------------------------------------------------------------------------------


def trial(announced: tuple[str, ...] = ("DIST",)) -> WordsTrial:
    return WordsTrial(optoncdt.BlockDecoder(WORDS), announced)


def test_three_blocks_that_follow_one_another_decide_for_the_words() -> None:
    stream = optoncdt.encode_block([[5, i, 25 * i, 0] for i in range(5)])
    decision, lines, rest = trial(("DIST", "COUNTER")).feed(stream[:24])
    assert (decision, lines, rest) == (None, [], b"")
    decision, _, rest = trial(("DIST", "COUNTER")).feed(stream)
    assert decision is False
    assert rest == stream[36:]
    short = optoncdt.encode_block([[i] for i in range(9)])
    decision, _, rest = trial().feed(short)
    assert decision is True
    assert rest == short[9:]


def test_blocks_before_damage_do_not_count_for_the_decision() -> None:
    blocks = [optoncdt.encode_block([[5, i, 25 * i, 0]]) for i in range(5)]
    damaged = b"".join([*blocks[:2], b"\xff", *blocks[2:4]])
    undecided = trial(("DIST", "COUNTER", "TIMESTAMP_LO"))
    assert undecided.feed(damaged)[0] is None
    assert undecided.feed(blocks[4])[0] is False


def test_a_value_that_is_cut_is_counted_by_the_next_block() -> None:
    block = optoncdt.encode_block([[1, 2, 3, 4]])
    decoder = optoncdt.BlockDecoder(WORDS)
    decoder.feed(b"\x01")
    found = decoder.feed(2 * block)
    assert (found.skipped_bytes, found.values.tolist()) == (1, 2 * [[1, 2, 3, 4]])


def test_a_later_answer_replaces_the_announced_words() -> None:
    undecided = trial(("DIST",))
    blocks = [optoncdt.encode_block([[5, i]]) for i in range(4)]
    decision, lines, rest = undecided.feed(b"GETOUTINFO_RS422 DIST COUNTER\r\n->" + b"".join(blocks))
    assert (decision, undecided.announced, rest) == (True, ("DIST", "COUNTER"), blocks[3])
    assert lines == ["GETOUTINFO_RS422 DIST COUNTER", "->"]


def test_an_answer_changes_no_words_unless_it_is_to_be_followed() -> None:
    blocks = optoncdt.encode_block([[5, i, 25 * i, 0] for i in range(4)])
    data = b"GETOUTINFO_RS422 DIST COUNTER\r\n->" + blocks
    found = optoncdt.BlockDecoder(WORDS).feed(data)
    assert (found.announced, len(found.values), found.unread) == (None, 4, b"")
    follows = optoncdt.BlockDecoder(WORDS, follow_answers=True).feed(data)
    assert (follows.announced, len(follows.values), follows.unread) == (("DIST", "COUNTER"), 0, b">" + blocks)


# --- RIFTEK ----------------------------------------------------------------------------------------------------


def test_an_awaited_answer_is_that_of_the_last_complete_request() -> None:
    assert riftek.awaited(b"") is riftek.awaited(b"\x01") is riftek.awaited(b"\x81\x82") is None
    assert riftek.awaited(riftek.request(1, riftek.IDENTIFY) + riftek.request(1, riftek.READ, b"\x08")) == 2
    assert riftek.awaited(riftek.request(127, riftek.RESULT)) == 4


def test_lost_packets_before_an_answer_are_added_to_the_next_result() -> None:
    decoder = ResultDecoder()
    first = decoder.feed(riftek.results([1, 2], [0, 1]) + b"")
    assert first.step.tolist() == [1, 1]
    decoder.expect(2)
    data = riftek.packet(b"\x5a", 3) + riftek.results([7, 8], [1, 2])
    later = decoder.feed(data)
    assert later.answers == (b"\x5a",)
    assert (later.code.tolist(), later.step.tolist(), later.skipped_bytes) == ([7, 8], [3, 1], 0)


# --- RotorLink -------------------------------------------------------------------------------------------------


def test_an_unknown_frame_of_a_node_is_counted_and_one_of_another_sender_is_damage() -> None:
    for kind, known in ((0x10, True), (0x1F, True), (0x0F, False), (0x20, False)):
        inner = rotorlink.encode_frame(bytes([kind, 7, 0x34, 0x12]))
        wrapped = rotorlink.parse(rotorlink.Wrapped(32, 1, 2, -60, None, inner).pack())
        assert isinstance(wrapped, rotorlink.Wrapped)
        assert wrapped.inner == (rotorlink.Skipped(kind, 7, 0x1234) if known else None)
        assert (wrapped.damaged, wrapped.damage) == (inner, "type")
        assert wrapped == rotorlink.parse(wrapped.pack())


# --- XBee ------------------------------------------------------------------------------------------------------


def test_fields_of_frames_are_at_their_places() -> None:
    data = bytes(range(1, 24))
    eight, two = int.from_bytes(data[:8], "big"), 0x090A
    assert xbee.parse(b"\x90" + data) == xbee.Received(eight, two, None, 11, data[11:])
    assert xbee.parse(b"\x91" + data) == xbee.Received(eight, two, None, 17, data[17:])
    assert xbee.parse(b"\x80" + data) == xbee.Received(eight, None, -9, 10, data[10:])
    assert xbee.parse(b"\x81" + data) == xbee.Received(None, 0x0102, -3, 4, data[4:])
    assert xbee.parse(b"\x8b" + data[:6]) == xbee.TransmitStatus(1, 5)
    assert xbee.parse(b"\x89" + data[:2]) == xbee.TransmitStatus(1, 2)
    assert xbee.parse(b"\x8a\x06") == xbee.ModemStatus(6)
    assert xbee.parse(b"\x88\x01AP\x04\x02\x03") == xbee.AtAnswer(1, "AP", 4, b"\x02\x03")
    assert xbee.parse(b"\x92\x01") == xbee.UnusedFrame(0x92)


# --- VESC ------------------------------------------------------------------------------------------------------


def test_values_at_their_places_in_an_answer() -> None:
    """Offsets of firmware 5 and 6: motor current at 5, duty at 21, speed at 23, voltage at 27, charges from 29 on."""
    payload = bytearray(74)
    payload[0] = 4
    struct.pack_into(">i", payload, 5, -1234)
    struct.pack_into(">hih", payload, 21, -567, 40_000, 241)
    struct.pack_into(">4i", payload, 29, 11, 22, 33, 44)
    struct.pack_into(">iiB", payload, 45, 55, -2, 5)
    payload[73] = 3
    found = vesc.parse_values(bytes(payload))
    assert found == vesc.Values(40_000, -12.34, 24.1, -0.567, (11, 22, 33, 44), 2**32 - 2, 5, 3)
    assert vesc.parse_values(bytes(payload[:73])) == vesc.Values(
        40_000, -12.34, 24.1, -0.567, (11, 22, 33, 44), 2**32 - 2, 5, None
    )
    assert vesc.parse_values(bytes(payload[:54])) is not None
    assert vesc.parse_values(bytes(payload[:53])) is None
    assert vesc.parse_values(b"\x05" + bytes(payload[1:])) is None


@pytest.mark.parametrize(
    ("before", "after", "started"),
    [(0, 0, False), (0, 2**31 - 1, False), (0, 2**31, True), (1, 0, True), (2**32 - 1, 0, False)],
)
def test_a_count_of_turns_that_goes_back_shows_a_restart(before: int, after: int, started: bool) -> None:
    assert vesc.restarted(vesc.Values(turned=before), vesc.Values(turned=after)) is started


# --- CiA 402 ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "same_as"),
    [(0x3211, 0x3210), (0x2FFF, 0x2000), (0x7122, 0x7120), (0x8613, 0x8610), (0x8131, 0x8130), (0x1001, 0x1000)],
)
def test_a_code_outside_the_standards_has_the_words_of_its_class(code: int, same_as: int) -> None:
    def meaning(number: int) -> str:
        return cia301.emergency_words(number).partition(", ")[2]

    assert meaning(code) == meaning(same_as)


def test_requests_mappings_and_identifiers() -> None:
    assert cia.write_word(0x6042, 0x1234).hex() == "2b42600034120000"
    assert cia301.mapped_word(0x6041) == 0x60410010
    assert cia.consumer_heartbeat(1, 500) == 0x000101F4
    ids = (
        cia301.cob_emergency(5),
        cia301.cob_tpdo(1, 5),
        cia301.cob_tpdo(4, 5),
        cia301.cob_rpdo(1, 5),
        cia301.cob_rpdo(4, 5),
    )
    assert ids == (0x085, 0x185, 0x485, 0x205, 0x505)
    assert (cia301.cob_sdo_answer(5), cia301.cob_sdo_request(5), cia301.cob_heartbeat(5)) == (0x585, 0x605, 0x705)


@pytest.mark.parametrize(
    ("data", "state"),
    [("00", 0), ("04", 4), ("05", 5), ("7f", 0x7F), ("85", 5), ("ff", 0x7F), ("01", None), ("", None), ("0505", None)],
)
def test_states_in_a_heartbeat(data: str, state: int | None) -> None:
    assert cia301.heartbeat(bytes.fromhex(data)) == state

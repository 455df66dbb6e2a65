"""Decoders at their limits: the largest accepted and the smallest refused number, and codes of the standards."""

from __future__ import annotations

import binascii
import struct

import numpy as np
import pytest

from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia
from daq.drivers.optoncdt import wire as optoncdt
from daq.drivers.optoncdt.words import WordsTrial
from daq.drivers.rotorlink import wire as rotorlink
from daq.errors import DeviceError
from daq.transports.can_frames import CanFrame
from rig_drivers.riftek import wire as riftek
from rig_drivers.riftek.decoder import ResultDecoder
from rig_drivers.vesc import packets, wire as vesc
from rig_drivers.xbee import wire as xbee
from rig_drivers.xbee.framing import ApiDecoder, DamagedPart, encode

WORDS = ("DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI")


# --- optoNCDT --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("letters", "accepted"), [(1023, True), (1024, False)])
def test_a_line_of_text_has_at_most_1023_letters(letters: int, accepted: bool) -> None:
    found = optoncdt.BlockDecoder(WORDS).feed(b"a" * letters + b"\n" + b"b\n\0")
    assert found.text == (["a" * letters, "b"] if accepted else ["b"])
    assert found.skipped_bytes == (0 if accepted else letters + 1)


@pytest.mark.parametrize("byte", [0x20, 0x7E, 0x09])
def test_printable_bytes_and_a_tab_are_text(byte: int) -> None:
    found = optoncdt.BlockDecoder(WORDS).feed(b"a" + bytes([byte]) + b"b\r\n\0")
    assert found.text == ["a" + chr(byte) + "b"]
    assert found.skipped_bytes == 0


@pytest.mark.parametrize("byte", [0x00, 0x08, 0x0B, 0x0C, 0x1F, 0x7F])
def test_other_bytes_within_a_line_are_damage(byte: int) -> None:
    found = optoncdt.BlockDecoder(WORDS).feed(b"ab" + bytes([byte]) + b"c\r\n\0")
    assert found.text == ["c"]
    assert found.skipped_bytes == 3


@pytest.mark.parametrize(("blocks", "kept"), [(64, True), (65, False)])
@pytest.mark.parametrize("split", [False, True])
def test_an_unfinished_line_is_dropped_after_more_than_256_values(blocks: int, kept: bool, split: bool) -> None:
    """Four values a block. The bytes of the line are counted as skipped when it is dropped."""
    stream = optoncdt.encode_block(np.zeros((blocks, 4), np.uint32))
    decoder = optoncdt.BlockDecoder(WORDS)
    data = b"abcd" + stream + b"ef\r\n\0"
    parts = [data[at : at + 1] for at in range(len(data))] if split else [data]
    found = [decoder.feed(part) for part in parts]
    assert [line for part in found for line in part.text] == (["abcdef"] if kept else ["ef"])
    assert sum(part.skipped_bytes for part in found) == (0 if kept else 4)
    assert sum(len(part.values) for part in found) == blocks


def test_skipped_bytes_before_the_first_block_are_counted_apart() -> None:
    block = optoncdt.encode_block([[1, 2, 3, 4]])
    found = optoncdt.BlockDecoder(WORDS).feed(b"\xff\xff" + block + b"\xff" + block)
    assert (found.skipped_first, found.skipped_bytes, len(found.values)) == (2, 3, 2)
    alone = optoncdt.BlockDecoder(WORDS).feed(b"\xff\xff\xff")
    assert (alone.skipped_first, alone.skipped_bytes) == (3, 3)
    incomplete = optoncdt.BlockDecoder(WORDS)
    incomplete.feed(block[:6])
    incomplete.set_words(("DIST",))
    assert incomplete.feed(b"").skipped_bytes == 6


def test_unread_bytes_are_an_incomplete_part() -> None:
    decoder = optoncdt.BlockDecoder(WORDS)
    for data, unread in (
        (b"\x01", b"\x01"),
        (b"\x41", b"\x01\x41"),
        (b"\x80", b""),
        (b"ab", b"ab"),
        (b"\x05", b"ab\x05"),
    ):
        decoder.feed(data)
        assert decoder.unread == unread


@pytest.mark.parametrize(("low", "high"), [(0xFFFF, 0), (0, 1), (0xABCD, 0x1234), (0x3FFFF, 0x2FFFF)])
def test_a_timestamp_has_16_bits_of_each_word(low: int, high: int) -> None:
    assert int(optoncdt.timestamp_ticks(low, high)) == (low % 65536) + 65536 * (high % 65536)


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


def test_three_blocks_after_damage_decide_also_without_a_counter() -> None:
    undecided = trial(("DIST", "COUNTER"))
    blocks = [optoncdt.encode_block([[5, i]]) for i in range(3)]
    assert undecided.feed(b"\xff" + b"".join(blocks[:2]))[0] is None
    assert undecided.feed(blocks[2])[0] is True


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
    assert (found.announced, len(found.values), found.rest) == (None, 4, b"")
    follows = optoncdt.BlockDecoder(WORDS, follow_answers=True).feed(data)
    assert (follows.announced, len(follows.values), follows.rest) == (("DIST", "COUNTER"), 0, b">" + blocks)


@pytest.mark.parametrize(("count", "decision"), [(4095, None), (4096, False)])
def test_undecided_bytes_are_4096_at_most(count: int, decision: bool | None) -> None:
    undecided = trial()
    assert undecided.feed(b"\xff" * count)[0] is decision
    assert len(undecided.held) == count


# --- RIFTEK ----------------------------------------------------------------------------------------------------


def test_requests_at_the_limits_of_address_and_code() -> None:
    assert riftek.request(0, 0) == b"\x00\x80"
    assert riftek.request(127, 15, b"\x1f\xa0") == b"\x7f\x8f\x8f\x81\x80\x8a"
    for address, code in ((-1, 1), (128, 1), (1, -1), (1, 16)):
        with pytest.raises(ValueError, match=r"address 0 … 127 and a code 0 … 15"):
            riftek.request(address, code)


def test_codes_of_requests_and_parameters_of_the_manual() -> None:
    codes = (
        riftek.IDENTIFY,
        riftek.READ,
        riftek.WRITE,
        riftek.STORE,
        riftek.LATCH,
        riftek.RESULT,
        riftek.START,
        riftek.STOP,
    )
    assert codes == (1, 2, 3, 4, 5, 6, 7, 8)
    parameters = (riftek.POWER, riftek.CONTROL, riftek.AVERAGES, riftek.PERIOD, riftek.INTEGRATION, riftek.ZERO)
    assert parameters == (0, 2, 6, 8, 10, 23)
    assert (riftek.PERIODS_US, riftek.INTEGRATIONS_US, riftek.ZEROS) == ((100, 65535), (3, 3200), (0, 16383))
    assert f"{riftek.CONTROL_KEPT:08b}" == "10010010"
    answers = {code: riftek.awaited(riftek.request(1, code)) for code in range(1, 9)}
    assert answers == {1: 16, 2: 2, 3: None, 4: 2, 5: None, 6: 4, 7: None, 8: None}


def test_an_awaited_answer_is_that_of_the_last_complete_request() -> None:
    assert riftek.awaited(b"") is riftek.awaited(b"\x01") is riftek.awaited(b"\x81\x82") is None
    assert riftek.awaited(riftek.request(1, riftek.IDENTIFY) + riftek.request(1, riftek.READ, b"\x08")) == 2
    assert riftek.awaited(riftek.request(127, riftek.RESULT)) == 4


def test_an_identification_has_two_bytes_for_each_number() -> None:
    found = riftek.parse_info(bytes([61, 88, 0x34, 0x12, 0x40, 0x01, 0xF4, 0x01]))
    assert found == riftek.SensorIdentity(61, 88, 0x1234, 0.32, 0.5)
    for wrong in (bytes(7), bytes(9), bytes([1] * 6 + [0, 0])):
        with pytest.raises(DeviceError, match="expected"):
            riftek.parse_info(wrong)
    assert riftek.parse_info(bytes([0, 0, 0, 0, 0, 0, 1, 0])).range_m == 0.001


def test_the_numbers_of_packets_are_in_bits_4_and_5_and_a_new_result_in_bit_6() -> None:
    assert riftek.packet(b"\x21\x43", 5) == bytes([0x91, 0x92, 0x93, 0x94])
    assert riftek.packet(b"\x21\x43", 3, updated=True) == bytes([0xF1, 0xF2, 0xF3, 0xF4])
    assert riftek.results([0x4321], [3]) == bytes([0xF1, 0xF2, 0xF3, 0xF4])
    assert riftek.results([0x4321], [4], updated=False) == bytes([0x81, 0x82, 0x83, 0x84])
    assert riftek.metres(0x4000, 0.5) == 0.5
    assert riftek.code(0.25, 0.5) == 0x2000


def test_lost_packets_before_an_answer_are_added_to_the_next_result() -> None:
    decoder = ResultDecoder()
    first = decoder.feed(riftek.results([1, 2], [0, 1]) + b"")
    assert first.step.tolist() == [1, 1]
    decoder.expect(2)
    data = riftek.packet(b"\x5a", 3) + riftek.results([7, 8], [1, 2])
    later = decoder.feed(data)
    assert later.answers == (b"\x5a",)
    assert (later.code.tolist(), later.step.tolist(), later.skipped_bytes) == ([7, 8], [3, 1], 0)


def test_at_most_three_bytes_of_a_cut_packet_are_not_counted_at_the_beginning() -> None:
    whole = riftek.results([1, 2, 3, 4], [0, 1, 2, 3])
    for missing in (1, 2, 3):
        assert ResultDecoder().feed(whole[missing:]).skipped_bytes == 0
    assert ResultDecoder().feed(b"\x01" * 4 + whole).skipped_bytes == 1
    assert ResultDecoder().feed(b"\x01" * 3 + whole).skipped.tolist()[0] == 0


# --- RotorLink -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "reason"), [(5, "length"), (6, "type"), (250, "type"), (251, "length")])
def test_a_payload_has_6_to_250_bytes(count: int, reason: str) -> None:
    payload = rotorlink.encode_frame(b"\x77" * (count - 2))
    for parse in (rotorlink.parse, rotorlink.parse_node):
        with pytest.raises(rotorlink.BadFrame) as refused:
            parse(payload)
        assert refused.value.reason == reason


@pytest.mark.parametrize(("count", "fits"), [(11, True), (10, False), (261, True), (262, False)])
def test_a_wrapper_adds_11_bytes(count: int, fits: bool) -> None:
    payload = rotorlink.encode_frame(b"\x21" + b"\x05" * (count - 3))
    if fits:
        found = rotorlink.parse(payload)
        assert isinstance(found, rotorlink.Wrapped)
        assert (found.node, found.seq, found.damage) == (5, 0x0505, "length" if count == 11 else "crc")
    else:
        with pytest.raises(rotorlink.BadFrame) as refused:
            rotorlink.parse(payload)
        assert refused.value.reason == "length"


@pytest.mark.parametrize(("samples", "accepted"), [(0, False), (1, True), (29, True), (30, False)])
def test_a_block_has_1_to_29_samples(samples: int, accepted: bool) -> None:
    counts = np.arange(2 * samples).reshape(samples, 2)
    block = rotorlink.EncoderBlock(16, 1, 2, 3, 1000, 0, counts)
    if accepted:
        assert rotorlink.parse(block.pack()) == block
    else:
        with pytest.raises(ValueError, match=r"1 … 29"):
            block.pack()
    body = struct.pack("<BBHIIHBB", 0x11, 16, 1, 2, 3, 1000, samples, 0) + bytes(8 * samples)
    if not accepted:
        with pytest.raises(rotorlink.BadFrame) as refused:
            rotorlink.parse_node(rotorlink.encode_frame(body))
        assert refused.value.reason == "length"
        assert refused.value.skipped == rotorlink.Skipped(0x11, 16, 1) if samples == 0 else True


@pytest.mark.parametrize("shape", [(4,), (2, 3), (2, 2, 2), (2, 1)])
def test_samples_have_two_columns(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="expected counts of shape"):
        rotorlink.EncoderBlock(16, 1, 2, 3, 1000, 0, np.zeros(shape, np.int32)).pack()


def test_bits_codes_and_numbers_of_the_protocol() -> None:
    flags = (
        rotorlink.FLAG_FAULT_A,
        rotorlink.FLAG_FAULT_B,
        rotorlink.FLAG_SAMPLES_LOST,
        rotorlink.FLAG_LOW_BATTERY,
        rotorlink.FLAG_REPEATS,
        rotorlink.FLAG_LOCK_A_CLOSED,
        rotorlink.FLAG_LOCK_B_CLOSED,
    )
    assert flags == (1, 2, 4, 8, 16, 32, 64)
    assert list(rotorlink.ACTIONS.values()) == [1, 2, 3, 4, 5, 6, 7]
    assert rotorlink.NO_COMMAND == 65535
    assert (rotorlink.Skipped.NODES[0], rotorlink.Skipped.NODES[-1]) == (0x10, 0x1F)
    assert (rotorlink.Skipped.DONGLES[0], rotorlink.Skipped.DONGLES[-1]) == (0x20, 0x2F)


def test_an_unknown_frame_of_a_node_is_counted_and_one_of_another_sender_is_damage() -> None:
    for kind, known in ((0x10, True), (0x1F, True), (0x0F, False), (0x20, False)):
        inner = rotorlink.encode_frame(bytes([kind, 7, 0x34, 0x12]))
        wrapped = rotorlink.parse(rotorlink.Wrapped(32, 1, 2, -60, None, inner).pack())
        assert isinstance(wrapped, rotorlink.Wrapped)
        assert wrapped.inner == (rotorlink.Skipped(kind, 7, 0x1234) if known else None)
        assert (wrapped.damaged, wrapped.damage) == (inner, "type")
        assert wrapped == rotorlink.parse(wrapped.pack())


# --- XBee ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("escaped", [False, True])
@pytest.mark.parametrize(("count", "accepted"), [(1, True), (300, True), (301, False)])
def test_frame_data_have_1_to_300_bytes(count: int, accepted: bool, escaped: bool) -> None:
    data = bytes(range(0x20, 0x70)) * 4
    after = encode(b"\x8a\x06", escaped=escaped)
    decoder = ApiDecoder(escaped=escaped)
    decoder.feed(after)
    found = decoder.feed(encode(data[:count], escaped=escaped) + after)
    assert found[0] == (data[:count] if accepted else DamagedPart("length"))
    assert found[-1] == b"\x8a\x06"
    assert [part for part in found if isinstance(part, bytes)] == [data[:count]] * accepted + [b"\x8a\x06"]


def test_a_length_of_zero_is_damage() -> None:
    decoder = ApiDecoder(escaped=False)
    good = encode(b"\x8a\x06", escaped=False)
    assert decoder.feed(good + b"\x7e\x00\x00\xff" + b"\x00" * 400 + good)[:2] == [b"\x8a\x06", DamagedPart("length")]


@pytest.mark.parametrize("escaped", [False, True])
def test_bytes_between_frames_are_one_damage_for_every_300(escaped: bool) -> None:
    good = encode(b"\x8a\x06", escaped=escaped)
    for count, damages in ((0, 0), (1, 1), (300, 1), (301, 2), (600, 2), (601, 3)):
        found = ApiDecoder(escaped=escaped).feed(good + b"\x00" * count + good)
        assert found == [b"\x8a\x06", *[DamagedPart("garbage")] * damages, b"\x8a\x06"]


def test_bytes_before_the_first_frame_are_excused_up_to_600() -> None:
    good = encode(b"\x8a\x06", escaped=False)
    for count, damages in ((600, 0), (601, 1)):
        found = ApiDecoder(escaped=False).feed(b"\x00" * count + good)
        assert found == [*[DamagedPart("garbage")] * damages, b"\x8a\x06"]


@pytest.mark.parametrize(
    ("kind", "size", "fixed"),
    [
        (0x90, 12, False),
        (0x91, 18, False),
        (0x80, 11, False),
        (0x81, 5, False),
        (0x88, 5, False),
        (0x8B, 7, True),
        (0x89, 3, True),
        (0x8A, 2, True),
    ],
)
def test_frames_have_their_least_size(kind: int, size: int, fixed: bool) -> None:
    xbee.parse(bytes([kind]) + bytes(size - 1))
    with pytest.raises(ValueError, match=f"expected {size} bytes of type {kind:#04x}"):
        xbee.parse(bytes([kind]) + bytes(size - 2))
    if fixed:
        with pytest.raises(ValueError, match=f"expected {size} bytes"):
            xbee.parse(bytes([kind]) + bytes(size))
    else:
        xbee.parse(bytes([kind]) + bytes(size))


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


@pytest.mark.parametrize(("short", "known"), [(0xFFFD, True), (0xFFFE, False), (0xFFFF, False)])
def test_unknown_addresses(short: int, known: bool) -> None:
    found = xbee.parse(b"\x90" + b"\xff" * 8 + short.to_bytes(2, "big") + b"\0")
    assert found == xbee.Received(None, short if known else None, None, 0, b"")
    assert isinstance(found, xbee.Received)
    assert found.source == (f"{short:04X}" if known else "unknown")
    least = xbee.parse(b"\x90" + b"\xff" * 7 + b"\xfe" + b"\xff\xfe\0")
    assert isinstance(least, xbee.Received)
    assert least.source == "FFFFFFFFFFFFFFFE"
    assert least.comes_from(xbee.Address(2**64 - 2, 64))
    assert not least.comes_from(xbee.Address(2**64 - 2, 16))


def test_addresses_have_4_or_16_digits() -> None:
    assert str(xbee.Address.parse("0013A20040ABCDEF")) == "0013A20040ABCDEF"
    assert str(xbee.Address.parse("00ab")) == "00AB"
    for text in ("", "123", "12345", "0" * 15, "0" * 17):
        with pytest.raises(ValueError, match="16 or 4 hex digits"):
            xbee.Address.parse(text)


def test_requests_to_a_module() -> None:
    long, short = xbee.Address.parse("0013A20040ABCDEF"), xbee.Address.parse("00AB")
    assert xbee.at_command(7, "AP", b"\x02").hex() == "0807415002"
    assert xbee.transmit_request(3, long, b"\x55").hex() == "10030013a20040abcdeffffe000055"
    assert xbee.transmit_request(3, short, b"\x55").hex() == "1003ffffffffffffffff00ab000055"
    assert xbee.transmit_request(3, long, b"\x55", legacy=True).hex() == "00030013a20040abcdef0055"
    assert xbee.transmit_request(3, short, b"\x55", legacy=True).hex() == "010300ab0055"


DELIVERY_CODES = "00 01 02 03 15 18 21 22 23 24 25 31 32 74 75 BB"
MODEM_CODES = "00 01 02 03 04 05 06 07 0B 0C 0D 11"


def test_every_status_in_the_manufacturer_s_lists_has_words_and_no_other() -> None:
    for codes, kind, fallback in (
        (DELIVERY_CODES, lambda code: xbee.TransmitStatus(1, code), "not delivered"),
        (MODEM_CODES, xbee.ModemStatus, "modem status"),
    ):
        known = {int(code, 16) for code in codes.split()}
        for code in range(256):
            words = kind(code).words
            assert f"0x{code:02X}" in words
            assert words.startswith(f"{fallback} (") is (code not in known)
    assert {code for code in range(256) if code in xbee.RESTARTS} == {0, 1}
    assert xbee.TransmitStatus(1, xbee.DELIVERED).words.startswith("delivered")


# --- VESC ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "head"), [(1, "0201"), (255, "02ff"), (256, "030100"), (512, "030200")])
def test_the_length_of_a_packet_has_one_byte_up_to_255(count: int, head: str) -> None:
    made = packets.packet(b"\x55" * count)
    assert made.hex().startswith(head + "55")
    assert made.endswith(b"\x03")
    assert packets.PacketDecoder().feed(made) == packets.Found([b"\x55" * count], skipped=0)


@pytest.mark.parametrize("count", [0, 513])
def test_a_packet_has_1_to_512_bytes(count: int) -> None:
    with pytest.raises(ValueError, match="1 to 512 bytes"):
        packets.packet(b"\x55" * count)
    made = b"\x03" + count.to_bytes(2, "big") + b"\x55" * count
    made += struct.pack(">HB", binascii.crc_hqx(b"\x55" * count, 0), 3)
    assert packets.PacketDecoder().feed(made).payloads == []


@pytest.mark.parametrize("number", [-(2**31), 2**31 - 1])
def test_numbers_of_32_bits_are_commands_and_larger_ones_are_not(number: int) -> None:
    (payload,) = packets.PacketDecoder().feed(vesc.set_rpm(number)).payloads
    assert vesc.parse_command(payload) == vesc.MotorCommand(8, number)
    with pytest.raises(ValueError, match="number of 32 bits for command 8"):
        vesc.set_rpm(number + (1 if number > 0 else -1))


def test_brake_currents_are_in_milliamperes_and_not_negative() -> None:
    (payload,) = packets.PacketDecoder().feed(vesc.set_brake(1.2345)).payloads
    assert vesc.parse_command(payload) == vesc.MotorCommand(7, 1234)
    assert vesc.set_brake(0.0)
    for wrong in (-1e-9, float("nan")):
        with pytest.raises(ValueError, match="at least 0 A"):
            vesc.set_brake(wrong)


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


def test_a_packed_answer_is_plausible() -> None:
    payload = vesc.pack_values(vesc.Values(40_000, -12.34, 24.1, -0.5, (1, 2, 3, 4), 2**31, 5, 1))
    assert len(payload) == 74
    fet, motor_temperature, motor, supply = struct.unpack_from(">hhii", payload, 1)
    assert (fet, motor_temperature, motor, supply) == (250, 250, -1234, -617)
    direct, quadrature = struct.unpack_from(">ii", payload, 13)
    assert (direct, quadrature) == (0, -1234)
    assert struct.unpack_from(">ii", payload, 45) == (0, -(2**31))
    assert struct.unpack_from(">iB3hii", payload, 54) == (0, 0, 250, 250, 250, 0, 0)


@pytest.mark.parametrize(
    ("before", "after", "started"),
    [(0, 0, False), (0, 2**31 - 1, False), (0, 2**31, True), (1, 0, True), (2**32 - 1, 0, False)],
)
def test_a_count_of_turns_that_goes_back_shows_a_restart(before: int, after: int, started: bool) -> None:
    assert vesc.restarted(vesc.Values(turned=before), vesc.Values(turned=after)) is started


def test_firmware_has_a_name_and_a_serial_number_of_12_bytes() -> None:
    serial = bytes(range(12))
    found = vesc.parse_firmware(bytes([0, 6, 5]) + b"60\x7f\x1f~ \0" + serial + b"\x99")
    assert found == vesc.Firmware(6, 5, "60??~ ", serial.hex())
    assert vesc.parse_firmware(bytes([0, 6, 5, 0])) == vesc.Firmware(6, 5, "", "")
    assert vesc.parse_firmware(bytes([0, 6, 5])) is vesc.parse_firmware(bytes([0, 0, 0, 65])) is None
    assert vesc.parse_firmware(bytes([1, 6, 5]) + b"60\0" + serial) is None


def test_faults_of_the_firmware_s_list() -> None:
    unknown = [code for code in range(-1, 40) if "not in the list" in vesc.fault_words(code)]
    assert unknown == [-1, *range(26, 40)]
    for code, words in ((0, "none"), (3, "gate driver"), (4, "over-current"), (9, "processor"), (14, "memory")):
        assert words in vesc.fault_words(code)
    for code, words in ((17, "current sensor 3"), (18, "unbalanced"), (20, "resolver"), (25, "no magnet")):
        assert words in vesc.fault_words(code)
    assert (vesc.TIMED_OUT, vesc.KILL_SWITCH) == (1, 2)


# --- CiA 402 ---------------------------------------------------------------------------------------------------

EMERGENCIES = """
0000 1000 2000 2100 2200 2300 2310 2320 3000 3100 3110 3120 3130 3200 3210 3220 3300 4000 4100 4200 4210 4300 4310
5000 5100 5200 5300 5400 5500 6000 6100 6200 6300 7000 7100 7110 7120 7121 7200 7300 7305 7310 7320 7400 7500
8000 8100 8110 8120 8130 8140 8150 8200 8210 8220 8300 8311 8400 8500 8600 8611 8612 8700 8800 8900 9000 F000 FF00
"""


def test_every_code_of_the_standards_has_words_of_its_own() -> None:
    words = [cia301.emergency_words(int(code, 16)).partition(", ")[2] for code in EMERGENCIES.split()]
    assert len(set(words)) == len(words)
    assert "unknown to CiA 301 and 402" not in words


@pytest.mark.parametrize(
    ("code", "same_as"),
    [(0x3211, 0x3210), (0x2FFF, 0x2000), (0x7122, 0x7120), (0x8613, 0x8610), (0x8131, 0x8130), (0x1001, 0x1000)],
)
def test_a_code_outside_the_standards_has_the_words_of_its_class(code: int, same_as: int) -> None:
    def meaning(number: int) -> str:
        return cia301.emergency_words(number).partition(", ")[2]

    assert meaning(code) == meaning(same_as)


def test_objects_and_words_of_the_standards() -> None:
    objects = {
        "ERROR_REGISTER": 0x1001,
        "PREDEFINED_ERROR_FIELD": 0x1003,
        "CONSUMER_HEARTBEAT": 0x1016,
        "PRODUCER_HEARTBEAT": 0x1017,
        "RPDO1": 0x1400,
        "RPDO1_MAPPING": 0x1600,
        "TPDO1": 0x1800,
        "TPDO1_MAPPING": 0x1A00,
        "ERROR_CODE": 0x603F,
        "CONTROLWORD": 0x6040,
        "STATUSWORD": 0x6041,
        "TARGET_VELOCITY": 0x6042,
        "VELOCITY_DEMAND": 0x6043,
        "ACTUAL_VELOCITY": 0x6044,
        "VELOCITY_ACCELERATION": 0x6048,
        "VELOCITY_DECELERATION": 0x6049,
        "MODE_OF_OPERATION": 0x6060,
        "MODE_DISPLAY": 0x6061,
        "MODE_VELOCITY": 2,
        "REGISTER_COMMUNICATION": 1 << 4,
        "HEARTBEAT_ERROR": 0x8130,
        "DISABLE_VOLTAGE": 0b0000,
        "QUICK_STOP": 0b0010,
        "SHUTDOWN": 0b0110,
        "SWITCH_ON": 0b0111,
        "ENABLE_OPERATION": 0b1111,
        "FAULT_RESET": 1 << 7,
        "HALT": 1 << 8,
        "RAMP_BITS": 1 << 4 | 1 << 5 | 1 << 6,
    }
    known = vars(cia301) | vars(cia)
    assert {name: known[name] for name in objects} == objects


@pytest.mark.parametrize(("word", "number"), [(0x7FFF, 32767), (0x8000, -32768), (0xFFFF, -1), (0x1_0001, 1), (0, 0)])
def test_a_word_of_16_bits_has_a_sign(word: int, number: int) -> None:
    assert cia.signed(word) == number


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


def test_process_data_have_four_bytes() -> None:
    assert cia.unpack_tpdo1(bytes.fromhex("3702feff99")) == (0x0237, -2)
    for unpack, data in ((cia.unpack_tpdo1, b"abc"), (cia.unpack_rpdo1, b"abc"), (cia.unpack_rpdo1, b"abcde")):
        with pytest.raises(ValueError, match="expected 4 bytes"):
            unpack(data)
    for data in (bytes(7), bytes(9)):
        with pytest.raises(ValueError, match="expected 8 bytes"):
            cia301.unpack_emergency(data)


@pytest.mark.parametrize(
    ("data", "state"),
    [("00", 0), ("04", 4), ("05", 5), ("7f", 0x7F), ("85", 5), ("ff", 0x7F), ("01", None), ("", None), ("0505", None)],
)
def test_states_in_a_heartbeat(data: str, state: int | None) -> None:
    assert cia301.heartbeat(bytes.fromhex(data)) == state


def test_frames_of_other_protocols_on_the_bus_are_left_out() -> None:
    own = CanFrame(0x185, b"1234")
    others = [CanFrame(1, extended=True), CanFrame(1, remote=True), CanFrame(1, b"", True, True)]
    assert cia301.own_frames([others[0], own, *others[1:]]) == [own]

"""The pipelines of a VESC on both lines at their limits: every field of samples and events, numbers of controllers."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from daq.channels import MOTOR
from daq.items import RX, TX, Batch, DeviceEvent
from daq.transports.can_frames import AdapterMessage, CanFrame, adapter_message, encode, open_bus
from rig_drivers.vesc import packets, wire
from rig_drivers.vesc.settings import Vesc
from rig_drivers.vesc.stream import VescPipeline
from rig_drivers.vesc_can import wire as can
from rig_drivers.vesc_can.settings import VescCan
from rig_drivers.vesc_can.stream import VescCanPipeline
from tests.daq.can_text import rx
from tests.daq.motor_rows import rows

MS = 1_000_000
START_NS = 1_700_000_000_000_000_000
TURNS = wire.Values(erpm=2100, turned=1000, charges=(5, 0, 9, 0), status=0)
KNOWN = 1 << 24
Items = list[Batch | DeviceEvent]


def serial() -> VescPipeline:
    settings = Vesc(driver="vesc", port="-", pole_pairs=7, timeout_s=1.0, brake_A=10.0, follow_s=0.1)
    return VescPipeline("drive", settings, {})


def on_bus(**settings: Any) -> VescCanPipeline:
    table = {"driver": "vesc_can", "port": "p", "pole_pairs": 7, "timeout_s": 1.0, "brake_A": 5.0, "controller_id": 23}
    return VescCanPipeline("drive", VescCan.model_validate(table | {"host_id": 100, "status_Hz": 0.0} | settings), {})


def answer(values: wire.Values = TURNS) -> bytes:
    return packets.packet(wire.pack_values(values))


def can_answer(values: wire.Values = TURNS, sender: int = 23, host: int = 100) -> bytes:
    return text(*can.pieces(wire.pack_values(values), sender, host))


def text(*frames: CanFrame) -> bytes:
    return b"".join(encode(frame) for frame in frames)


def extended(command: int, number: int, data: str = "") -> CanFrame:
    return CanFrame(command << 8 | number, bytes.fromhex(data), extended=True)


def set_rpm(erpm: int, number: int = 23) -> CanFrame:
    return can.simple(can.SET_RPM, number, erpm)


def status(erpm: int, number: int = 23) -> CanFrame:
    return CanFrame(can.STATUS << 8 | number, struct.pack(">ihh", erpm, 0, 0), extended=True)


QUERY, VALUES = (extended(can.SHORT, 23, f"64 00 0{payload}") for payload in (0, 4))
"""The queries of this host, whose number is 100 = 64h."""
FIRMWARE = wire.pack_firmware(wire.Firmware(6, 5, "60", "01" * 12))


def events(items: Items, *kinds: str) -> list[tuple[str, str, dict[str, Any]]]:
    found = [item for item in items if isinstance(item, DeviceEvent)]
    return [(item.kind, item.text, dict(item.facts)) for item in found if not kinds or item.kind in kinds]


def kinds(items: Items) -> list[str]:
    return [kind for kind, *_ in events(items)]


# --- any line -----------------------------------------------------------------------------------------------------


def test_every_field_of_the_samples_before_the_first_command() -> None:
    line = serial()
    assert line.losses == {"damaged_bytes": 0, "unanswered": 0, "unreadable_answers": 0}
    found = line.feed(RX, answer() + answer(replace(TURNS, erpm=-700)), START_NS)
    (batch,) = (item for item in found if isinstance(item, Batch))
    assert batch.channel is MOTOR
    assert (batch.time_ns.tolist(), batch.sequence.tolist()) == ([START_NS, START_NS], [0, 0])
    assert (batch.time_ns.dtype, batch.sequence.dtype) == (np.int64, np.uint32)
    assert rows(found) == [(300.0, 0.0, KNOWN), (-100.0, 0.0, KNOWN)]
    assert events(found) == [("drive", "NOT COMMANDED", {"statusword": KNOWN})]
    assert [values.erpm for values in line.answers] == [2100, -700]
    assert line.feed(RX, b"", START_NS) == []
    assert line.answers == []


def test_speeds_of_the_rotor_are_not_rounded() -> None:
    line = serial()
    line.feed(TX, wire.set_rpm(-20_000), 0)
    found = line.feed(RX, answer(replace(TURNS, erpm=1000)) * 5, 0)
    assert [row[:2] for row in rows(found)] == [(pytest.approx(1000 / 7), pytest.approx(-20_000 / 7))] * 5
    facts = {"target_rpm": pytest.approx(-20_000 / 7), "speed_rpm": pytest.approx(1000 / 7)}
    assert [each for *_, each in events(found, "fault")] == [facts]


def test_the_state_of_an_answer_without_status_byte_is_that_of_the_command() -> None:
    line = serial()
    line.feed(TX, wire.set_rpm(700), 0)
    found = line.feed(RX, answer(replace(TURNS, status=None)) + answer(replace(TURNS, status=0xFC)), 0)
    assert [word for *_, word in rows(found)] == [1 << 8, KNOWN | 0xFC << 16 | 1 << 8]
    assert [text for _, text, _ in events(found, "drive")] == ["HOLDS SPEED"]


def test_a_brake_and_a_release_have_no_set_point_and_the_state_of_the_status_byte() -> None:
    line = serial()
    line.feed(TX, wire.set_rpm(700), 0)
    for command, name in ((wire.set_brake(7.0), "BRAKES"), (wire.release(), "RELEASED")):
        line.feed(TX, command, 0)
        found = line.feed(RX, b"".join(answer(replace(TURNS, status=byte)) for byte in (0, 1, 2, 3, 4, 1, 8, 16)), 0)
        assert [target_rpm for _, target_rpm, _ in rows(found)] == [0.0] * 8
        texts = [name, "TIMED OUT", "KILL SWITCH OPEN", name, "TIMED OUT", name]
        assert [text for _, text, _ in events(found, "drive")] == texts
        faults = [text.partition(":")[0] for _, text, _ in events(found, "fault")]
        assert faults == ["the rotor does not slow down"] * (name == "BRAKES"), "it need not follow a set-point"


def test_each_new_fault_and_the_end_of_faults_are_one_event() -> None:
    line = serial()
    codes = (0, 3, 3, 1, 1, 4, 0, 0, 255, 255, 0)
    found = line.feed(RX, b"".join(answer(replace(TURNS, fault=code)) for code in codes), 0)
    emergencies = events(found, "emergency")
    assert [facts for _, _, facts in emergencies] == [{"error_code": code} for code in (3, 1, 4, 0, 255, 0)]
    assert [text.split(",")[0] for _, text, _ in emergencies] == [
        *("fault 3", "fault 1", "fault 4", "no fault any more", "fault 255", "no fault any more")
    ]
    assert [text for _, text, _ in events(found, "drive")] == [*("NOT COMMANDED", "FAULT") * 2, "NOT COMMANDED"]


@pytest.mark.parametrize("code", [1, 2, 3, 5, 8, 50, 255])
def test_payloads_that_are_neither_values_nor_firmware_are_no_items(code: int) -> None:
    line = serial()
    assert line.feed(RX, packets.packet(bytes([code])) + packets.packet(bytes([code, 4, 0, 4])), 0) == []
    assert line.feed(RX, packets.packet(bytes([code, 0])) + packets.packet(bytes([code, 0, 0, 0])), 0) == []
    assert set(line.losses.values()) == {0}


def test_the_identity_is_a_reply_with_its_facts_if_it_can_be_read() -> None:
    line = serial()
    whole = {"firmware": "6.05", "hardware": "60", "serial": "01" * 12}
    assert events(line.feed(RX, packets.packet(FIRMWARE), 0)) == [("reply", FIRMWARE.hex(), whole)]
    assert events(line.feed(RX, packets.packet(b"\0"), 0)) == [("reply", "00", {})]


def test_an_answer_that_is_too_short_is_damage_and_not_a_sample() -> None:
    line = serial()
    short = wire.pack_values(TURNS)[: wire.VALUES_BYTES - 1]
    found = line.feed(RX, packets.packet(short) * 2, 0)
    words = f"an answer of {len(short)} bytes, expected at least {len(short) + 1}: is its firmware too old?"
    assert events(found) == [("damage", words, {"bytes": len(short)})] * 2
    assert line.losses == {"damaged_bytes": 0, "unanswered": 0, "unreadable_answers": 2}
    assert rows(found) == []


def test_damaged_bytes_are_counted_in_each_read() -> None:
    line = serial()
    line.feed(RX, answer(), 0)
    for count in (1, 2):
        found = line.feed(RX, b"\xff" * 3 + answer(), 0)
        assert events(found) == [("damage", "3 damaged bytes dropped", {"bytes": 3})]
        assert line.losses["damaged_bytes"] == 3 * count


def test_a_restart_is_one_event_also_in_a_read_with_damage() -> None:
    line = serial()
    line.feed(RX, answer(), 0)
    found = line.feed(RX, b"\xff" + answer(replace(TURNS, turned=7)) * 2, 0)
    words = "the controller started again: its counters are smaller than before"
    assert events(found, "restart") == [("restart", words, {"turned": 7})]


def test_commands_between_two_polls_do_not_answer_the_first() -> None:
    for command in (wire.set_rpm(700), wire.set_brake(1.0), wire.firmware_version(), wire.alive()):
        line = serial()
        line.feed(TX, wire.get_values() + command + wire.get_values(), 0)
        assert events(line.feed(RX, answer(), 0), "gap") == [("gap", "1 poll not answered", {"samples": 1})]
        assert line.losses["unanswered"] == 1


def test_queries_of_the_firmware_are_no_polls() -> None:
    line = serial()
    line.feed(TX, wire.firmware_version() * 3 + wire.get_values(), 0)
    assert events(line.feed(RX, answer(), 0), "gap") == []
    assert line.losses["unanswered"] == 0


def test_late_answers_take_losses_back() -> None:
    line = serial()
    line.feed(TX, wire.get_values() * 3, 0)
    found = events(line.feed(RX, answer() * 4, 0), "gap")
    back = ("gap", "an answer was late: its poll was counted as not answered", {"samples": -1})
    assert found == [("gap", "2 polls not answered", {"samples": 2})] + [back] * 2
    assert line.losses["unanswered"] == 0


@pytest.mark.parametrize("releases", [1, 2, 3])
def test_each_answer_to_a_poll_before_a_release_takes_no_loss_back(releases: int) -> None:
    """The polls of each release leave the answer to the one before open; the losses are two more polls."""
    line = serial()
    line.feed(TX, (wire.get_values() + wire.set_rpm(700) + wire.release()) * releases, 0)
    line.feed(TX, wire.get_values() * 3, 0)
    facts = [facts["samples"] for *_, facts in events(line.feed(RX, answer(), 0), "gap")]
    assert (facts, line.losses["unanswered"]) == ([2], 2)
    assert events(line.feed(RX, answer() * releases, 0), "gap") == []
    facts = [facts["samples"] for *_, facts in events(line.feed(RX, answer() * 4, 0), "gap")]
    assert (facts, line.losses["unanswered"]) == ([-1, -1], 0)


def test_surplus_answers_neither_count_nor_hide_later_ones() -> None:
    """A log may begin after a poll, or another program polls too."""
    line = serial()
    assert events(line.feed(RX, answer() * 3, 0), "gap") == []
    line.feed(TX, wire.get_values() * 2, 0)
    assert [facts["samples"] for *_, facts in events(line.feed(RX, answer() * 3, 0), "gap")] == [1, -1]
    assert line.losses["unanswered"] == 0


# --- the line on a bus ---------------------------------------------------------------------------------------------


def test_speeds_of_the_status_have_the_state_of_the_answer_before_them() -> None:
    line = on_bus()
    assert line.losses == {
        **dict.fromkeys(("damaged_lines", "refused_lines", "damaged_answers", "missing_status"), 0),
        **{"unanswered": 0, "unreadable_answers": 0},
    }
    line.feed(TX, text(set_rpm(2100)), 0)
    assert rows(line.feed(RX, text(status(700), status(1400)), MS)) == [(100.0, 300.0, 0), (200.0, 300.0, 0)]
    word = KNOWN | 1 << 8
    found = line.feed(RX, text(status(700)) + can_answer() + text(status(1400)), 2 * MS)
    assert rows(found) == [(100.0, 300.0, 0), (300.0, 300.0, word), (200.0, 300.0, word)]
    assert rows(line.feed(RX, text(status(-700)), 3 * MS)) == [(-100.0, 300.0, word)]
    assert line.status_watch.count == 5


def test_frames_of_controllers_with_other_numbers_are_not_its_own() -> None:
    line = on_bus()
    start = can_answer(replace(TURNS, turned=7))
    line.feed(RX, can_answer(), 0)
    others = [extended(can.BOOT, 22), extended(can.BOOT, 24), extended(can.BOOT - 1, 23), extended(can.BOOT + 1, 23)]
    others += [status(7, 22), status(7, 24), *can.pieces(FIRMWARE, 23, 99), *can.pieces(FIRMWARE, 23, 101)]
    others += [extended(can.SHORT, number, "17 01 00 06 05") for number in (22, 24, 99, 101)]
    others += [replace(status(7), remote=True, data=bytes(8)), CanFrame(0x717, bytes(8))]
    assert line.feed(RX, text(*others), MS) == []
    assert kinds(line.feed(RX, start, 2 * MS)) == ["restart"], "none of these was a start of this controller"


def test_a_start_is_reported_and_is_the_same_as_that_of_the_counters() -> None:
    line = on_bus()
    line.feed(RX, can_answer(), 0)
    found = [line.feed(RX, data, MS) for data in (text(extended(57, 23)), can_answer(replace(TURNS, turned=7)))]
    assert ["restart" in kinds(items) for items in found] == [True, False]
    start: tuple[str, str, dict[str, Any]] = (
        "restart",
        "the controller started again: it has sent the message of its start",
        {},
    )
    assert events(line.feed(RX, text(extended(57, 23)), 2 * MS)) == [start]


def test_other_events_of_a_read_do_not_hide_a_restart() -> None:
    """Missing status messages and damaged lines are events of the line, which come before those of the answers."""
    line = on_bus(status_Hz=50.0)
    line.feed(RX, can_answer(), 0)
    found: list[list[str]] = []
    for n in range(1, 30):
        damaged = rx(b"tq\r") if n == 9 else b""
        found.append(kinds(line.feed(RX, damaged + can_answer(replace(TURNS, turned=1000 - n)), n * 20 * MS)))
    assert found[8] == ["damage", "restart"]
    assert found[23] == ["status", "restart"], "the 25th answer, after half a second"
    assert [each for n, each in enumerate(found) if n not in (8, 23)] == [["restart"]] * 27


def test_only_frames_to_the_controller_are_commands_of_this_host() -> None:
    foreign = [set_rpm(700, 22), set_rpm(700, 24), CanFrame(0x317, bytes(4))]
    line = on_bus()
    line.feed(TX, text(*foreign), 0)
    assert rows(line.feed(RX, text(set_rpm(2100), status(0)), MS)) == [(0.0, 300.0, 0)], "it only receives"
    line.feed(TX, text(set_rpm(1400), *foreign), 2 * MS)
    assert kinds(line.feed(RX, text(set_rpm(1400)), 3 * MS)) == []
    assert kinds(line.feed(RX, text(set_rpm(2100)), 3 * MS)) == ["fault"]
    assert rows(line.feed(RX, text(status(0)), 4 * MS)) == [(0.0, 200.0, 0)]


def test_a_listening_session_takes_the_commands_and_queries_of_the_rig_s_host() -> None:
    """Its number is 100; queries of hosts with other numbers have answers that are not decoded."""
    line = on_bus()
    for number in ("63", "65", "00", "FF"):
        line.feed(RX, text(extended(can.SHORT, 23, number + "00 04"), extended(can.SHORT, 23, number + "00 04")), 0)
    line.feed(RX, text(extended(can.SHORT, 24, "64 00 04"), extended(can.SHORT, 22, "64 00 04")), 0)
    assert line.losses["unanswered"] == 0
    line.feed(RX, text(VALUES, VALUES), 0)
    assert line.losses["unanswered"] == 1
    to_all = extended(can.SET_RPM, can.EVERY, "00000834")
    assert rows(line.feed(RX, text(to_all, status(0)), MS)) == [(0.0, 300.0, 0)]
    assert rows(line.feed(RX, text(set_rpm(700, 22), set_rpm(700, 24), status(0)), MS)) == [(0.0, 300.0, 0)]
    assert kinds(line.feed(RX, text(extended(can.SET_RPM, 23, "00")), MS)) == [], "a command without a number"


def test_a_session_that_commands_ignores_the_queries_of_others() -> None:
    line = on_bus()
    line.feed(TX, text(VALUES), 0)
    assert kinds(line.feed(RX, text(VALUES), MS)) == []
    assert kinds(line.feed(RX, text(extended(can.SHORT, can.EVERY, "65 00 04")), MS)) == []
    assert kinds(line.feed(RX, text(extended(can.SHORT, 23, "65 00 04")), MS)) == []
    assert kinds(line.feed(RX, text(extended(0, 23, "00002710")), 2000 * MS)) == ["fault"]
    assert line.losses["unanswered"] == 0


def test_each_damaged_answer_is_one_event() -> None:
    line = on_bus()
    damage = ("damage", "a damaged answer dropped", {"answers": 1})
    pieces = can.pieces(wire.pack_values(TURNS), 23, 100)
    assert events(line.feed(RX, text(*pieces[:3], *pieces[4:], extended(can.STATUS, 23, "00")), 0)) == [damage] * 2
    assert line.losses["damaged_answers"] == 2
    assert len(rows(line.feed(RX, can_answer(), 0))) == 1


def test_the_status_of_other_controllers_is_a_reply_while_the_query_is_not_answered() -> None:
    line = on_bus()
    seen = text(status(0, 24), status(0, 22), status(0, 24))
    replies = [("reply", f"status messages of controller {number}", {"controller_id": number}) for number in (24, 22)]
    line.feed(TX, text(VALUES), 0)
    assert line.feed(RX, seen, 0) == [], "no query of the firmware"
    line.feed(TX, text(QUERY), 0)
    assert events(line.feed(RX, seen, 0)) == replies
    assert line.feed(RX, seen, 0) == []
    line.feed(TX, text(VALUES), 0)
    line.feed(RX, can_answer(), 0)
    assert kinds(line.feed(RX, text(status(0, 25)), 0)) == ["reply"], "the answer was another one"
    line.feed(RX, text(*can.pieces(FIRMWARE, 23, 100)) + can_answer(), 0)
    assert line.feed(RX, text(status(0, 26)), 0) == []
    line.feed(TX, text(QUERY), 0)
    assert kinds(line.feed(RX, text(status(0, 26)), 0)) == ["reply"]


def test_an_adapter_that_refuses_to_open_the_bus_is_one_reply_while_the_query_is_not_answered() -> None:
    line, other = on_bus(), encode(CanFrame(0x7E5))
    line.feed(TX, open_bus(500_000), 0)
    assert line.feed(RX, adapter_message(AdapterMessage.OPEN_REFUSED), 0) == [], "no query is open"
    line.feed(TX, text(QUERY), 0)
    assert events(line.feed(RX, other, 0)) == [("reply", "the adapter refused to open the bus", {})]
    assert line.feed(RX, other, 0) == []
    opened = on_bus()
    opened.feed(TX, open_bus(500_000) + text(QUERY), 0)
    assert opened.feed(RX, adapter_message(AdapterMessage.OPENED), 0) == []

"""The pipelines of a VESC on both lines at their limits: every field of samples and events, numbers of controllers."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any

from daq.items import RX, TX, Batch, DeviceEvent
from daq.transports.can_frames import CanFrame, encode
from rig_drivers.vesc import packets, wire
from rig_drivers.vesc.settings import Vesc
from rig_drivers.vesc.stream import VescPipeline
from rig_drivers.vesc_can import wire as can
from rig_drivers.vesc_can.settings import VescCan
from rig_drivers.vesc_can.stream import VescCanPipeline
from tests.daq.can_text import rx
from tests.daq.motor_rows import rows

MS = 1_000_000
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
    return can.frame(can.SET_RPM, number, erpm.to_bytes(4, "big", signed=True))


def status(erpm: int, number: int = 23) -> CanFrame:
    return CanFrame(can.STATUS << 8 | number, struct.pack(">ihh", erpm, 0, 0), extended=True)


QUERY, VALUES = (extended(can.SHORT, 23, f"64 00 0{payload}") for payload in (0, 4))
"""The queries of this host, whose number is 100 = 64h."""


def events(items: Items, *kinds: str) -> list[tuple[str, str, dict[str, Any]]]:
    found = [item for item in items if isinstance(item, DeviceEvent)]
    return [(item.kind, item.text, dict(item.facts)) for item in found if not kinds or item.kind in kinds]


def kinds(items: Items) -> list[str]:
    return [kind for kind, *_ in events(items)]


# --- any line -----------------------------------------------------------------------------------------------------


def test_the_state_of_an_answer_without_status_byte_is_that_of_the_command() -> None:
    line = serial()
    line.feed(TX, wire.set_rpm(700), 0)
    found = line.feed(RX, answer(replace(TURNS, status=None)) + answer(replace(TURNS, status=0xFC)), 0)
    assert [word for *_, word in rows(found)] == [1 << 8, KNOWN | 0xFC << 16 | 1 << 8]
    assert [text for _, text, _ in events(found, "drive")] == ["HOLDS SPEED"]


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

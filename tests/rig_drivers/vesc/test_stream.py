"""Bytes of a VESC to samples and events, live and replayed."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any

import pytest

from daq.channels import MOTOR
from daq.items import RX, TX, Batch, DeviceEvent
from daq.transports.can_frames import CanFrame, encode
from rig_drivers.vesc import packets, stream, wire
from rig_drivers.vesc.driver import DRIVER
from rig_drivers.vesc.settings import Vesc
from rig_drivers.vesc.stream import VescPipeline
from rig_drivers.vesc_can import wire as can
from rig_drivers.vesc_can.settings import VescCan
from rig_drivers.vesc_can.stream import VescCanPipeline
from tests.daq.can_text import rx
from tests.daq.motor_rows import rows

SETTINGS = Vesc(
    driver="vesc", port="/dev/x", pole_pairs=7, timeout_s=1.0, brake_A=10.0, min_erpm=700.0, follow_s=0.1
)  # follows within 5 reports
RUNNING = wire.Values(erpm=2100, turned=1000, charges=(5, 0, 9, 0), status=0)


def answer(values: wire.Values) -> bytes:
    return packets.packet(wire.pack_values(values))


def samples(items: list[Batch | DeviceEvent]) -> list[tuple[float, float, int]]:
    rows: list[tuple[float, float, int]] = []
    for item in items:
        if isinstance(item, Batch):
            assert item.channel is MOTOR
            columns = [item.columns[name].tolist() for name in ("speed_rpm", "target_rpm", "statusword")]
            rows += zip(*columns, strict=True)
    return rows


def events(items: list[Batch | DeviceEvent], kind: str) -> list[DeviceEvent]:
    return [item for item in items if isinstance(item, DeviceEvent) and item.kind == kind]


def test_speed_target_and_state() -> None:
    pipeline = VescPipeline("drive", SETTINGS, {})
    assert pipeline.feed(TX, wire.set_rpm(2800) + wire.get_values(), 1) == []
    out = pipeline.feed(RX, answer(RUNNING), 2)
    assert samples(out) == [(300.0, 400.0, stream.SPEED << 8 | stream.STATUS_KNOWN)]
    batch = next(item for item in out if isinstance(item, Batch))
    assert batch.time_ns.tolist() == [2]
    assert MOTOR.pack(batch.columns).shape == (1,)
    assert [event.text for event in events(out, "drive")] == ["HOLDS SPEED"]
    pipeline.feed(TX, wire.set_brake(10.0), 3)
    assert samples(pipeline.feed(RX, answer(RUNNING), 4))[0][1:] == (0, stream.BRAKE << 8 | stream.STATUS_KNOWN)
    pipeline.feed(TX, wire.release(), 5)
    old = replace(RUNNING, status=None)
    assert samples(pipeline.feed(RX, answer(old), 6))[0][1:] == (0, stream.FREE << 8)


def braked(erpms: list[int], command: bytes) -> list[DeviceEvent]:
    pipeline = VescPipeline("drive", SETTINGS, {})
    pipeline.feed(TX, command, 1)
    data = b"".join(answer(replace(RUNNING, erpm=erpm)) for erpm in erpms)
    return events(pipeline.feed(RX, data, 2), "fault")


def test_a_braked_rotor_that_does_not_slow_down_is_reported_once() -> None:
    """Another input of the controller commands the motor, or the brake current is too small."""
    (fault,) = braked([3000, -2996, 3003] * 5, wire.set_brake(10.0))
    assert "does not slow down: commanded to brake, it turns at" in fault.text
    assert "another input commands the motor" in fault.text
    assert fault.facts["target_rpm"] == 0.0


@pytest.mark.parametrize(
    ("erpms", "command"),
    [
        ([3000] * 15, wire.release()),
        ([210] * 15, wire.set_brake(10.0)),
        (list(range(3000, 2000, -8)), wire.set_brake(10.0)),
        ([3000, 3000, 3000, 2900] * 4, wire.release()),
    ],
    ids=["released", "near rest", "slowing down", "coasting"],
)
def test_what_may_turn_is_no_fault(erpms: list[int], command: bytes) -> None:
    assert braked(erpms, command) == []


@pytest.mark.parametrize(
    ("values", "command", "text"),
    [
        (wire.Values(), stream.NOTHING, "NOT COMMANDED"),
        (wire.Values(), stream.BRAKE, "BRAKES"),
        (wire.Values(), stream.FREE, "RELEASED"),
        (wire.Values(status=1), stream.SPEED, "TIMED OUT"),
        (wire.Values(status=3), stream.SPEED, "KILL SWITCH OPEN"),
        (wire.Values(status=3, fault=255), stream.SPEED, "FAULT"),
    ],
)
def test_states(values: wire.Values, command: int, text: str) -> None:
    assert stream.state(stream.statusword(values, command)) == text


def test_a_fault_is_an_emergency_with_its_meaning_and_its_end_has_none() -> None:
    pipeline = VescPipeline("drive", SETTINGS, {})
    pipeline.feed(RX, answer(RUNNING), 1)
    (fault,) = events(pipeline.feed(RX, answer(replace(RUNNING, fault=4)) * 3, 2), "emergency")
    assert "over-current" in fault.text
    assert DRIVER.words(fault) == "4, over-current"
    (passed,) = events(pipeline.feed(RX, answer(RUNNING), 3), "emergency")
    assert DRIVER.words(passed) == ""


def test_a_fault_in_the_first_report_is_an_event() -> None:
    assert events(VescPipeline("drive", SETTINGS, {}).feed(RX, answer(replace(RUNNING, fault=1)), 1), "emergency")


def test_a_restart_is_reported_once() -> None:
    pipeline = VescPipeline("drive", SETTINGS, {})
    later = replace(RUNNING, turned=3, charges=(0, 0, 0, 0))
    out = pipeline.feed(RX, answer(RUNNING) + answer(later) + answer(later), 1)
    assert len(events(out, "restart")) == 1
    assert len(samples(out)) == 3


def test_polls_without_an_answer_are_counted() -> None:
    pipeline = VescPipeline("drive", SETTINGS, {})
    for _ in range(4):
        pipeline.feed(TX, wire.get_values(), 1)
    (gap,) = events(pipeline.feed(RX, answer(RUNNING), 2), "gap")
    assert gap.facts["samples"] == pipeline.losses["unanswered"] == 3
    pipeline.feed(TX, wire.get_values(), 3)
    assert events(pipeline.feed(RX, answer(RUNNING), 4), "gap") == []
    assert pipeline.losses["unanswered"] == 3


def test_late_answers_are_no_loss() -> None:
    """After a stall of the host or the adapter each poll is answered, in order; no sample is missing."""
    pipeline = VescPipeline("drive", SETTINGS, {})
    pipeline.feed(RX, answer(RUNNING), 0)
    for _ in range(3):
        pipeline.feed(TX, wire.get_values(), 1)
    found = events(pipeline.feed(RX, answer(RUNNING) * 3, 2), "gap")
    assert [gap.facts["samples"] for gap in found] == [2, -1, -1]
    assert pipeline.losses["unanswered"] == 0
    pipeline.feed(RX, answer(RUNNING) * 3, 3)
    assert pipeline.losses["unanswered"] == 0, "a surplus answer takes nothing back"
    for n in range(1, 5):  # the first answer is lost, the others are not
        pipeline.feed(TX, wire.get_values() * (1 + (n == 1)), 2 * n + 3)
        pipeline.feed(RX, answer(RUNNING), 2 * n + 4)
    assert pipeline.losses["unanswered"] == 1


def test_the_poll_of_a_release_does_not_make_the_one_before_it_a_loss() -> None:
    """It is sent at once, while the answer to the one before may still be on its way; both are answered."""
    pipeline = VescPipeline("drive", SETTINGS, {})
    pipeline.feed(TX, wire.get_values(), 1)
    pipeline.feed(TX, wire.release() + wire.get_values(), 2)
    assert events(pipeline.feed(RX, answer(RUNNING) * 2, 3), "gap") == []
    for _ in range(3):
        pipeline.feed(TX, wire.release() + wire.get_values(), 4)
    assert events(pipeline.feed(RX, answer(RUNNING), 5), "gap")[0].facts["samples"] == 2


def test_a_rotor_that_does_not_follow_is_reported_once_until_it_does() -> None:
    pipeline = VescPipeline("drive", SETTINGS, {})
    pipeline.feed(TX, wire.set_rpm(7000), 1)
    assert not events(pipeline.feed(RX, answer(RUNNING) * 4, 2), "fault")
    (fault,) = events(pipeline.feed(RX, answer(RUNNING) * 10, 3), "fault")
    assert fault.facts == {"target_rpm": 1000.0, "speed_rpm": 300.0}
    near = replace(RUNNING, erpm=7000 - 7 * 225)
    assert not events(pipeline.feed(RX, answer(near) * 10, 4), "fault")
    assert events(pipeline.feed(RX, answer(RUNNING) * 5, 5), "fault")


@pytest.mark.parametrize("command", [wire.set_brake(1.0), wire.release(), b""])
def test_only_a_speed_is_followed(command: bytes) -> None:
    pipeline = VescPipeline("drive", SETTINGS, {})
    pipeline.feed(TX, command, 1)
    faults = events(pipeline.feed(RX, answer(RUNNING) * 20, 2), "fault")
    assert not [fault for fault in faults if "does not follow" in fault.text]
    assert len(faults) == (command == wire.set_brake(1.0)), "a braked rotor must slow down"


def test_who_it_is_comes_as_a_reply() -> None:
    firmware = wire.Firmware(5, 3, "60", "00" * 12)
    (reply,) = VescPipeline("drive", SETTINGS, {}).feed(RX, packets.packet(wire.pack_firmware(firmware)), 1)
    assert isinstance(reply, DeviceEvent)
    assert wire.parse_firmware(bytes.fromhex(reply.text)) == firmware
    assert reply.facts["firmware"] == "5.03"


def test_an_answer_of_old_firmware_is_counted_not_guessed() -> None:
    pipeline = VescPipeline("drive", SETTINGS, {})
    out = pipeline.feed(RX, packets.packet(bytes([wire.GET_VALUES, *range(20)])), 1)
    assert samples(out) == []
    assert pipeline.losses["unreadable_answers"] == 1
    assert events(out, "damage")


def test_damage_is_counted_and_the_rest_of_an_earlier_answer_is_not() -> None:
    pipeline = VescPipeline("drive", SETTINGS, {})
    whole = answer(RUNNING)
    assert not events(pipeline.feed(RX, whole[20:] + whole, 1), "damage")
    (damage,) = events(pipeline.feed(RX, b"\xff" * 5 + whole, 2), "damage")
    assert damage.facts["bytes"] == pipeline.losses["damaged_bytes"] == 5


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


def answer_of(values: wire.Values = TURNS) -> bytes:
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


def event_facts(items: Items, *kinds: str) -> list[tuple[str, str, dict[str, Any]]]:
    found = [item for item in items if isinstance(item, DeviceEvent)]
    return [(item.kind, item.text, dict(item.facts)) for item in found if not kinds or item.kind in kinds]


def kinds(items: Items) -> list[str]:
    return [kind for kind, *_ in event_facts(items)]


# --- any line -----------------------------------------------------------------------------------------------------


def test_the_state_of_an_answer_without_status_byte_is_that_of_the_command() -> None:
    line = serial()
    line.feed(TX, wire.set_rpm(700), 0)
    found = line.feed(RX, answer_of(replace(TURNS, status=None)) + answer_of(replace(TURNS, status=0xFC)), 0)
    assert [word for *_, word in rows(found)] == [1 << 8, KNOWN | 0xFC << 16 | 1 << 8]
    assert [text for _, text, _ in event_facts(found, "drive")] == ["HOLDS SPEED"]


def test_each_new_fault_and_the_end_of_faults_are_one_event() -> None:
    line = serial()
    codes = (0, 3, 3, 1, 1, 4, 0, 0, 255, 255, 0)
    found = line.feed(RX, b"".join(answer_of(replace(TURNS, fault=code)) for code in codes), 0)
    emergencies = event_facts(found, "emergency")
    assert [facts for _, _, facts in emergencies] == [{"error_code": code} for code in (3, 1, 4, 0, 255, 0)]
    assert [text.split(",")[0] for _, text, _ in emergencies] == [
        *("fault 3", "fault 1", "fault 4", "no fault any more", "fault 255", "no fault any more")
    ]
    assert [text for _, text, _ in event_facts(found, "drive")] == [*("NOT COMMANDED", "FAULT") * 2, "NOT COMMANDED"]


def test_commands_between_two_polls_do_not_answer_the_first() -> None:
    for command in (wire.set_rpm(700), wire.set_brake(1.0), wire.firmware_version(), wire.alive()):
        line = serial()
        line.feed(TX, wire.get_values() + command + wire.get_values(), 0)
        assert event_facts(line.feed(RX, answer_of(), 0), "gap") == [("gap", "1 poll not answered", {"samples": 1})]
        assert line.losses["unanswered"] == 1


def test_queries_of_the_firmware_are_no_polls() -> None:
    line = serial()
    line.feed(TX, wire.firmware_version() * 3 + wire.get_values(), 0)
    assert event_facts(line.feed(RX, answer_of(), 0), "gap") == []
    assert line.losses["unanswered"] == 0


def test_surplus_answers_neither_count_nor_hide_later_ones() -> None:
    """A log may begin after a poll, or another program polls too."""
    line = serial()
    assert event_facts(line.feed(RX, answer_of() * 3, 0), "gap") == []
    line.feed(TX, wire.get_values() * 2, 0)
    assert [facts["samples"] for *_, facts in event_facts(line.feed(RX, answer_of() * 3, 0), "gap")] == [1, -1]
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

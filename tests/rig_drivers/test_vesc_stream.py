"""Bytes of a VESC to samples and events, live and replayed."""

from __future__ import annotations

from dataclasses import replace

import pytest

from daq.channels import MOTOR
from daq.items import RX, TX, Batch, DeviceEvent
from rig_drivers.vesc import packets, stream, wire
from rig_drivers.vesc.driver import DRIVER
from rig_drivers.vesc.settings import Vesc
from rig_drivers.vesc.stream import VescPipeline

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

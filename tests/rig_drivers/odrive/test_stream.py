"""The pipeline of an ODrive at its limits, with every field of its samples and events."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from daq.items import RX, TX, Batch, DeviceEvent
from daq.transports.can_frames import CLOSE_BUS, CanFrame, encode, open_bus
from rig_drivers.odrive import stream
from rig_drivers.odrive.settings import Odrive
from rig_drivers.odrive.stream import OdrivePipeline
from rig_drivers.odrive.wire import CLOSED_LOOP, IDLE, Heartbeat
from tests.daq.motor_rows import rows

MS = 1_000_000
START_NS = 1_700_000_000_000_000_000
Items = list[Batch | DeviceEvent]


def pipeline(**settings: Any) -> OdrivePipeline:
    table = {"driver": "odrive", "port": "p", "node_id": 1, "firmware": "0.6", "watchdog_s": 0.5, **settings}
    return OdrivePipeline("drive", Odrive.model_validate(table), {})


def text(*frames: CanFrame) -> bytes:
    return b"".join(encode(frame) for frame in frames)


def to(command: int, data: bytes = b"", **kind: bool) -> CanFrame:
    return CanFrame(1 << 5 | command, data, **kind)


def beat(error: int = 0, state: int = IDLE, flags: bytes = bytes(3)) -> CanFrame:
    return to(0x01, struct.pack("<IB", error, state) + flags)


def estimates(position: float, speed: float) -> CanFrame:
    return to(0x09, struct.pack("<ff", position, speed))


def velocity(turns_per_s: float, node: int = 1) -> CanFrame:
    return CanFrame(node << 5 | 0x0D, struct.pack("<ff", turns_per_s, 0.0))


def events(items: Items, *kinds: str) -> list[tuple[str, str, dict[str, Any]]]:
    """The events of these kinds; without kinds all but the replies."""
    found = [item for item in items if isinstance(item, DeviceEvent)]
    wanted = [item for item in found if (item.kind in kinds if kinds else item.kind != "reply")]
    return [(item.kind, item.text, dict(item.facts)) for item in wanted]


def kinds(items: Items) -> list[str]:
    return [kind for kind, *_ in events(items)]


def target(line: OdrivePipeline) -> float:
    """The set-point of the next sample, rpm."""
    ((_, found, _),) = rows(line.feed(RX, text(estimates(0.0, 0.0)), 0))
    return found


# --- the state ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("firmware", "watchdog"), [("0.5", 0x800), ("0.6", 0x100_0000)])
@pytest.mark.parametrize(("state", "expired"), [(0, True), (1, True), (7, True), (8, False), (9, True), (14, True)])
def test_only_the_watchdog_alone_of_an_axis_that_does_not_drive_is_no_fault(
    firmware: str, watchdog: int, state: int, expired: bool
) -> None:
    assert stream.state(Heartbeat(watchdog, state), firmware) == ("WATCHDOG EXPIRED" if expired else "FAULT")
    for error in (watchdog - 1, watchdog + 1, watchdog >> 1, watchdog << 1):
        assert stream.state(Heartbeat(error, state), firmware) == "FAULT"


def test_every_change_of_the_state_is_one_event() -> None:
    line = pipeline()
    states = (1, 1, 8, 8, 1, 200, 200, 201, 11, 8)
    found = events(line.feed(RX, text(*(beat(state=state) for state in states)), 0))
    texts = ["IDLE", "CLOSED LOOP CONTROL", "IDLE", "STATE 200", "STATE 201", "HOMING", "CLOSED LOOP CONTROL"]
    numbers = (1, 8, 1, 200, 201, 11, 8)
    expected = [("drive", name, {"axis_state": number}) for name, number in zip(texts, numbers, strict=True)]
    assert found == expected
    assert [each.state for each in line.beats] == list(states)
    assert line.feed(RX, text(beat(state=8)), 1) == []
    assert len(line.beats) == 1


# --- samples -----------------------------------------------------------------------------------------------------


def test_only_data_frames_of_11_bits_of_its_node_are_its_own() -> None:
    line, own = pipeline(), struct.pack("<ff", 0.0, 9.0)
    others = [
        CanFrame(0 << 5 | 9, own),
        CanFrame(2 << 5 | 9, own),
        to(9, own, extended=True),
        to(9, bytes(8), remote=True),
        to(1, bytes(8), remote=True),
        to(9, bytes(8), remote=True, extended=True),
    ]
    assert line.feed(RX, text(*others), 0) == []
    assert rows(line.feed(RX, text(*others, estimates(0.0, 1.0), *others), 0)) == [(60.0, 0.0, 0)]


# --- a rotor that does not follow ---------------------------------------------------------------------------------


@pytest.mark.parametrize("end", [(), (to(0x02),), (to(0x07, struct.pack("<II", IDLE, 0)),)])
def test_a_rotor_without_a_command_need_not_follow(end: tuple[CanFrame, ...]) -> None:
    """Also after its command has ended: it runs down."""
    line = pipeline(follow_s=0.1)
    if end:
        line.feed(TX, text(velocity(50.0), *end), 0)
    found = line.feed(RX, 20 * text(estimates(0.0, 50.0)), 0)
    assert kinds(found) == []
    assert rows(found) == [(3000.0, 0.0, 0)] * 20


# --- set-points ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("direction", [TX, RX])
@pytest.mark.parametrize("command", [to(0x02), to(0x07, struct.pack("<II", IDLE, 0)), to(0x07, b"\1\0\0\0")])
def test_an_emergency_stop_and_the_idle_state_end_the_set_point(direction: int, command: CanFrame) -> None:
    line = pipeline()
    line.feed(direction, text(velocity(5.0)), 0)
    assert target(line) == 300.0
    line.feed(direction, text(command), 1)
    assert target(line) == 0.0
    line.feed(direction, text(velocity(-2.0)), 2)
    assert target(line) == -120.0


@pytest.mark.parametrize(
    "frame",
    [
        *(to(command, b"\1" + bytes(7)) for command in (0x00, 0x01, 0x03, 0x04, 0x06, 0x08, 0x0A, 0x0B, 0x0C)),
        *(to(command, b"\1" + bytes(7)) for command in (0x0E, 0x0F, 0x16, 0x18, 0x1F)),
        *(to(0x07, struct.pack("<II", state, 0)) for state in (0, 2, CLOSED_LOOP, 257)),
        to(0x07, b"\1\0\0"),
        to(0x0D, bytes(3)),
        to(0x0D, struct.pack("<ff", np.nan, 0.0)),
        to(0x02, remote=True),
        to(0x0D, bytes(8), remote=True),
        to(0x02, extended=True),
        to(0x0D, bytes(8), extended=True),
        velocity(9.0, node=0),
        velocity(9.0, node=2),
        velocity(9.0, node=13),
    ],
)
def test_no_other_frame_changes_the_set_point(frame: CanFrame) -> None:
    line = pipeline()
    line.feed(TX, text(velocity(5.0)), 0)
    assert line.feed(TX, text(frame), 1) == []
    assert target(line) == 300.0
    listening = pipeline()
    listening.feed(TX, text(velocity(9.0, node=0), velocity(9.0, node=2), to(0x0D, bytes(8), extended=True)), 0)
    listening.feed(RX, text(velocity(5.0)), 1)
    listening.feed(RX, text(frame), 2)
    assert target(listening) == 300.0, "commands to others do not replace the host that commands this axis"


def test_a_host_that_has_sent_anything_to_the_axis_has_replaced_the_other_one() -> None:
    line = pipeline()
    line.feed(TX, text(to(0x18, b"\0")), 0)
    assert kinds(line.feed(RX, text(velocity(5.0)), 1)) == ["fault"]
    assert target(line) == 0.0


# --- restarts -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("before", "after", "passed_ms", "restart"),
    [
        ((300.0, 0.0), (295.0, 0.0), 100, False),  # 5 turns
        ((300.0, 0.0), (294.9, 0.0), 100, True),
        ((300.0, 1.0), (293.95, 0.5), 100, False),  # 5 turns and 1.1 s at 1 turn/s
        ((300.0, 1.0), (293.85, 0.5), 100, True),
        ((300.0, 0.5), (292.85, -2.0), 100, False),  # the larger speed
        ((300.0, 0.5), (292.75, -2.0), 100, True),
        ((300.0, -2.0), (292.85, 0.5), 100, False),
        ((300.0, -2.0), (292.75, 0.5), 100, True),
        ((300.0, 1.0), (294.05, 1.0), -500, False),  # a clock that was set back: no time has passed
        ((300.0, 1.0), (293.9, 1.0), -500, True),
        ((300.0, 1.0), (284.1, 1.0), 9_950, False),
        ((300.0, 1.0), (283.9, 1.0), 9_950, True),
        ((300.0, 0.0), (400.0, 0.0), 100, False),  # not towards the position after a start, which is near 0
        ((300.0, 0.0), (-300.0, 0.0), 100, False),
        ((300.0, 0.0), (-299.9, 0.0), 100, True),
        ((-300.0, 0.0), (0.4, 0.0), 100, True),
        ((-300.0, 0.0), (-295.0, 0.0), 100, False),
    ],
)
def test_a_position_that_returns_farther_than_the_rotor_turns_is_a_restart(
    before: tuple[float, float], after: tuple[float, float], passed_ms: int, restart: bool
) -> None:
    line = pipeline()
    assert kinds(line.feed(RX, text(estimates(*before)), START_NS)) == []
    found = line.feed(RX, text(estimates(*after)), START_NS + passed_ms * MS)
    words = f"the controller started again: its position was {before[0]:.1f} turns and is {after[0]:.1f}"
    assert events(found) == [("restart", words, {})] * restart
    assert line.restarted is restart
    assert len(rows(found)) == 1
    assert kinds(line.feed(RX, text(estimates(*after)), START_NS + (passed_ms + 10) * MS)) == []
    assert not line.restarted


@pytest.mark.parametrize(
    ("firmware", "error", "state", "restart"),
    [
        ("0.5", 0, 0, True),
        ("0.6", 0, 0, True),
        ("0.6", 1, IDLE, True),
        ("0.5", 1, IDLE, False),
        ("0.6", 2, IDLE, False),
        ("0.6", 3, IDLE, False),
        ("0.6", 0, IDLE, False),
        ("0.6", 0, 2, False),
    ],
)
def test_an_axis_without_a_state_or_that_initializes_has_started(
    firmware: str, error: int, state: int, restart: bool
) -> None:
    line = pipeline(firmware=firmware)
    starting = text(beat(error, state))
    assert events(line.feed(RX, starting, 0), "restart") == [], "it may start before the log"
    assert not line.restarted
    line.feed(RX, text(beat()), 1)
    found = events(line.feed(RX, 3 * starting, 2), "restart")
    assert found == [("restart", "the controller started again: its axis has no state yet", {})] * restart
    assert line.restarted is restart


# --- errors -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("firmware", "before", "error", "emergency"),
    [
        ("0.5", None, 0x1, True),
        ("0.6", None, 0x1, False),  # it initializes
        ("0.6", None, 0x2, True),
        ("0.6", None, 0x3, True),
        ("0.6", None, 0x0100_0000, False),  # the watchdog, without commands
        ("0.6", None, 0x0100_0200, True),
        ("0.5", (0, CLOSED_LOOP), 0x1, True),
        ("0.5", (0, IDLE), 0x1, True),
        ("0.5", (0, IDLE), 0x800, False),
        ("0.5", (0, 7), 0x800, False),
        ("0.5", (0, CLOSED_LOOP), 0x800, True),
        ("0.5", (0, 9), 0x800, False),
        ("0.6", (0, IDLE), 0x0200_0000, True),
        ("0.6", (0, IDLE), 0x0080_0000, True),
        ("0.6", (0x200, IDLE), 0x200, False),
        ("0.6", (0x200, CLOSED_LOOP), 0x200, False),
        ("0.6", (0x300, IDLE), 0x200, False),
        ("0.6", (0x200, IDLE), 0x300, True),
        ("0.6", (0x200, IDLE), 0x100, True),
        ("0.6", (0x200, IDLE), 0x0100_0200, False),
    ],
)
def test_new_error_bits_that_are_not_expected_are_one_emergency(
    firmware: str, before: tuple[int, int] | None, error: int, emergency: bool
) -> None:
    line = pipeline(firmware=firmware)
    if before is not None:
        line.feed(RX, text(beat(*before)), 0)
    found = events(line.feed(RX, text(beat(error), beat(error)), 1), "emergency")
    facts = {"error_code": error, "axis_state": IDLE, "firmware": firmware}
    assert found == [("emergency", f"axis error 0x{error:08X}", facts)] * emergency


@pytest.mark.parametrize(
    ("error", "then", "ends"),
    [(0x200, 0, True), (0x0100_0000, 0, False), (0x0100_0200, 0, True), (0x300, 0x200, False), (0, 0, False)],
)
def test_the_end_of_all_errors_is_one_event(error: int, then: int, ends: bool) -> None:
    line = pipeline()
    line.feed(RX, text(beat(error)), 0)
    found = events(line.feed(RX, text(beat(then), beat(then)), 1), "emergency")
    assert found == [("emergency", "no axis error any more", {"error_code": 0})] * ends


# --- answers ------------------------------------------------------------------------------------------------------


def test_the_first_report_of_each_kind_after_the_bus_was_opened_is_a_reply() -> None:
    line = pipeline()
    reports = text(beat(), estimates(0.0, 0.0), estimates(0.0, 0.0))

    def replies() -> list[tuple[str, str, dict[str, Any]]]:
        return events(line.feed(RX, reports, 0), "reply")

    both: list[tuple[str, str, dict[str, Any]]] = [("reply", "heartbeat", {}), ("reply", "estimates", {})]
    assert [replies(), replies()] == [both, []]
    line.feed(TX, CLOSE_BUS + text(velocity(0.0)), 0)
    assert replies() == []
    line.feed(TX, open_bus(250_000), 0)
    assert [replies(), replies()] == [both, []]


def test_error_codes_of_firmware_0_5_are_events_by_name() -> None:
    line = pipeline(firmware="0.5")
    found = line.feed(RX, text(to(0x03, b"\2" + bytes(7)), to(0x04, b"\3\0\0\0"), to(0x1D, b"\4" + bytes(7))), 0)
    assert events(found) == [
        ("status", "motor_error 0x2", {"motor_error": 2}),
        ("status", "encoder_error 0x3", {"encoder_error": 3}),
        ("status", "controller_error 0x4", {"controller_error": 4}),
    ]
    assert line.errors == {"motor_error": 2, "encoder_error": 3, "controller_error": 4}
    assert line.feed(RX, text(to(0x04, b"\3\0\0\0")), 1) == []

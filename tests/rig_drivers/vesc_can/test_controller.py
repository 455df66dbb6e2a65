"""VESC on a CAN bus: frames against published vectors, pieces of answers, the line, and the rotor's command."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError

from daq.drivers.can_lines import OtherHost
from daq.drivers.driver import Driver
from daq.errors import DeviceError, LinkLost
from daq.items import RX, TX, Batch, DeviceEvent
from daq.transports.can_frames import CLOSE_BUS, AdapterMessage, CanFrame, adapter_message, encode, open_bus
from rig_basics.units import TO_RPM
from rig_drivers.vesc import wire as vesc
from rig_drivers.vesc_can import wire
from rig_drivers.vesc_can.driver import DRIVER
from rig_drivers.vesc_can.far_end import SimulatedVescCan
from rig_drivers.vesc_can.settings import VescCan
from rig_drivers.vesc_can.stream import VescCanPipeline
from rig_testing.bench import DriverBench
from tests.daq.can_text import rx

MS = 1_000_000
FIRMWARE = vesc.pack_firmware(vesc.Firmware(6, 5, "60_MK5", "2a0041000a51353338363731"))


def controller(**settings: Any) -> VescCan:
    table = {"driver": "vesc_can", "port": "p", "pole_pairs": 7, "timeout_s": 1.0, "brake_A": 5.0, "controller_id": 23}
    return VescCan.model_validate(table | settings)


def simple(command: int, number: int, value: int) -> CanFrame:
    return wire.frame(command, number, value.to_bytes(4, "big", signed=True))


def on_bus(command: bytes, number: int = 23) -> bytes:
    return wire.on_bus(command, number, 253)


def text(*frames: CanFrame) -> bytes:
    return encode(*(frame for frame in frames))


def extended(arbitration_id: int, data: str) -> CanFrame:
    return CanFrame(arbitration_id, bytes.fromhex(data), extended=True)


def kinds(items: list[Batch | DeviceEvent]) -> list[str]:
    return [item.kind for item in items if isinstance(item, DeviceEvent)]


def rows(items: list[Batch | DeviceEvent]) -> list[tuple[float, float]]:
    out: list[tuple[float, float]] = []
    for item in items:
        if isinstance(item, Batch):
            out += zip(item.columns["speed_rpm"].tolist(), item.columns["target_rpm"].tolist(), strict=True)
    return out


# --- the codec --------------------------------------------------------------------------------------------------


def test_commands_are_those_of_the_documents() -> None:
    """Vector: a current of 51 A to controller 23 is published; the others follow from the table of commands."""
    assert encode(simple(wire.SET_CURRENT, 23, 51_000)) == rx(b"T0000011740000C738\r")
    assert on_bus(vesc.set_rpm(3000)) == rx(b"T00000317400000BB8\r")
    assert on_bus(vesc.set_rpm(-1)) == rx(b"T000003174FFFFFFFF\r")
    assert on_bus(vesc.set_brake(5.0)) == rx(b"T00000217400001388\r")
    assert on_bus(vesc.release()) == rx(b"T00000117400000000\r")
    assert on_bus(vesc.get_values()) == rx(b"T000008173FD0004\r")
    assert on_bus(vesc.firmware_version()) == rx(b"T000008173FD0000\r")


def test_a_status_is_that_of_the_documents() -> None:
    """Electrical speed × 1, current × 10, duty cycle × 1000."""
    assert wire.parse_status(bytes.fromhex("00000BB8001E00FA")) == 3000
    assert wire.parse_status(bytes.fromhex("FFFFF448FFE2FF06")) == -3000
    assert wire.parse_status(bytes(7)) is None


def test_an_answer_in_pieces_is_that_of_the_documents() -> None:
    """9 bytes: two pieces with their offsets, then sender, 1, length, and CRC-16/XMODEM (31C3h for '1' … '9')."""
    frames = wire.pieces(b"123456789", sender=23, receiver=253)
    assert frames == [
        extended(0x05FD, "00 31323334353637"),
        extended(0x05FD, "07 3839"),
        extended(0x07FD, "17 01 0009 31C3"),
    ]
    assert wire.pieces(b"\x00\x06", 23, 253) == [extended(0x08FD, "17 01 0006")]


@given(st.binary(min_size=1, max_size=512))
def test_a_payload_survives_its_pieces(payload: bytes) -> None:
    assembly = wire.Pieces(23)
    found = [assembly.take(wire.split(f.arbitration_id)[0], f.data) for f in wire.pieces(payload, 23, 253)]
    assert found[-1] == (payload, False)
    assert all(part == (None, False) for part in found[:-1])


@given(st.binary(min_size=7, max_size=40), st.data())
def test_no_lost_changed_or_doubled_piece_gives_a_wrong_payload(payload: bytes, data: st.DataObject) -> None:
    frames = wire.pieces(payload, 23, 253)
    at = data.draw(st.integers(0, len(frames) - 1))
    what = data.draw(st.sampled_from(["lost", "changed", "exchanged"]))
    if what == "lost":
        del frames[at]
    elif what == "changed":
        spot = data.draw(st.integers(0, len(frames[at].data) - 1))
        changed = bytearray(frames[at].data)
        changed[spot] ^= 1 << data.draw(st.integers(0, 7))
        frames[at] = CanFrame(frames[at].arbitration_id, bytes(changed), extended=True)
    else:
        frames[at - 1], frames[at] = frames[at], frames[at - 1]
    assembly = wire.Pieces(23)
    found = [assembly.take(wire.split(f.arbitration_id)[0], f.data)[0] for f in frames]
    assert {part for part in found if part is not None} <= {payload}


@given(st.lists(st.tuples(st.sampled_from([5, 6, 7, 8]), st.binary(max_size=8)), max_size=200))
def test_no_frames_break_the_assembly_or_make_it_grow(frames: list[tuple[int, bytes]]) -> None:
    assembly = wire.Pieces(23)
    for command, data in frames:
        payload, _ = assembly.take(command, data)
        assert payload is None or 0 < len(payload) <= 512


# --- settings ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"host_id": 23}, "expected two numbers"),
        ({"bitrate": 125_000, "report_Hz": 50.0}, "reduce report_Hz"),
        ({"timeout_s": 0.1}, "timeout_s must be at least"),
        ({"baud": 115_200}, "baud"),
    ],
)
def test_impossible_settings_are_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        controller(**wrong)


# --- the line ---------------------------------------------------------------------------------------------------


def test_status_messages_become_samples() -> None:
    pipeline = VescCanPipeline("drive", controller(), {})
    pipeline.feed(TX, on_bus(vesc.set_rpm(2100)), 0)
    assert rows(pipeline.feed(RX, text(extended(0x0917, "0000083400000000")), MS)) == [(300.0, 300.0)]


def test_answers_become_samples_and_an_identity() -> None:
    pipeline = VescCanPipeline("drive", controller(), {})
    pipeline.feed(TX, on_bus(vesc.get_values()), 0)
    answer = vesc.pack_values(vesc.Values(erpm=700, status=0))
    items = pipeline.feed(RX, text(*wire.pieces(answer, 23, 253)), MS)
    assert rows(items) == [(100.0, 0.0)]
    assert pipeline.answers[0].erpm == 700
    (reply,) = pipeline.feed(RX, text(*wire.pieces(FIRMWARE, 23, 253)), 2 * MS)
    assert isinstance(reply, DeviceEvent)
    assert reply.facts["hardware"] == "60_MK5"


def test_other_controllers_and_other_hosts_are_ignored() -> None:
    pipeline = VescCanPipeline("drive", controller(), {})
    answer = vesc.pack_values(vesc.Values(erpm=700))
    foreign = [
        extended(0x0918, "0000083400000000"),  # status of another controller
        CanFrame(0x117, bytes(8)),  # identifier of 11 bits
        *wire.pieces(answer, 23, 252),  # to another host
        *wire.pieces(answer, 24, 253),  # from another controller
        *wire.pieces(b"\x00\x01", 24, 253),
    ]
    assert pipeline.feed(RX, text(*foreign), 0) == []
    assert not any(pipeline.losses.values())


def test_damaged_answers_are_counted_and_reported() -> None:
    pipeline = VescCanPipeline("drive", controller(), {})
    frames = wire.pieces(vesc.pack_values(vesc.Values(erpm=700)), 23, 253)
    assert kinds(pipeline.feed(RX, text(*frames[3:]), 0)) == [], "a log may begin within an answer"
    assert kinds(pipeline.feed(RX, text(*frames[:3], *frames[4:]), 0)) == ["damage"]
    assert kinds(pipeline.feed(RX, text(*frames[:5], *frames), 0))[:1] == ["damage"]
    assert kinds(pipeline.feed(RX, text(extended(0x0917, "00")), 0)) == ["damage"]
    assert pipeline.losses["damaged_answers"] == 3


def test_a_command_of_another_node_is_a_fault() -> None:
    pipeline = VescCanPipeline("drive", controller(), {})
    own, other = (simple(wire.SET_RPM, 23, erpm) for erpm in (2100, 2800))
    pipeline.feed(TX, text(own), 0)
    assert kinds(pipeline.feed(RX, text(own), MS)) == [], "an adapter may echo"
    assert kinds(pipeline.feed(RX, text(other), 2 * MS)) == ["fault"]
    assert rows(pipeline.feed(RX, text(extended(0x0917, "0000083400000000")), 3 * MS)) == [(300.0, 300.0)]


def test_commands_to_other_controllers_and_frames_without_data_are_no_fault() -> None:
    pipeline = VescCanPipeline("drive", controller(), {})
    pipeline.feed(TX, text(simple(wire.SET_RPM, 23, 2100)), 0)
    other = simple(wire.SET_RPM, 23, 2800)
    for frame in (
        simple(wire.SET_RPM, 22, 2800),
        simple(wire.SET_RPM, 24, 2800),
        CanFrame(0x317, other.data),  # identifier of 11 bits
        CanFrame(other.arbitration_id, other.data, extended=True, remote=True),
    ):
        assert pipeline.feed(RX, text(frame), MS) == []
    assert kinds(pipeline.feed(RX, text(other), MS)) == ["fault"]


@pytest.mark.parametrize(
    ("arbitration_id", "data"),
    [
        (0x0817, "30 00 04"),  # query of the values by a display
        (0x0817, "30 00 32 00000080"),  # query of one value
        (0x0817, "18 01 00 06"),  # answer of another controller, which this one has asked
        (0x0717, "18 01 0020 1234"),
        (0x1117, "30"),  # ping and its answer
        (0x1217, "18 00"),
        (0x1017, "0000000000000000"),  # other status messages, of this number
        (0x1B17, "000000000000"),
        (0x10317, "00000BB8"),  # an identifier with higher bits
    ],
)
def test_queries_of_another_node_are_no_fault(arbitration_id: int, data: str) -> None:
    pipeline = VescCanPipeline("drive", controller(), {})
    pipeline.feed(TX, text(simple(wire.SET_RPM, 23, 2100)), 0)
    assert pipeline.feed(RX, text(extended(arbitration_id, data)), MS) == []


def test_the_queries_of_a_display_are_not_those_of_the_rig() -> None:
    """A session that only receives counts the polls of the rig's host, whose answers it decodes."""
    pipeline = VescCanPipeline("drive", controller(), {})
    display, own = extended(0x0817, "30 00 04"), extended(0x0817, "FD 00 04")
    answer = wire.pieces(vesc.pack_values(vesc.Values(erpm=700)), 23, 253)
    for _ in range(3):  # one read each: another host's frames are taken after the answers of their read
        pipeline.feed(RX, text(own, display), 0)
        pipeline.feed(RX, text(*answer, display), MS)
    assert pipeline.losses["unanswered"] == 0
    pipeline.feed(RX, text(own, own), MS)
    assert pipeline.losses["unanswered"] == 1


def test_the_message_of_its_start_is_one_restart() -> None:
    """A controller sends it by itself, also one whose counters were 0 and so cannot decrease."""
    pipeline = VescCanPipeline("drive", controller(), {})
    before, after = (wire.pieces(vesc.pack_values(vesc.Values(turned=n)), 23, 253) for n in (500, 0))
    pipeline.feed(RX, text(*before), 0)
    boot, other = extended(0x3917, "36305F4D4B35"), extended(0x3918, "36305F4D4B35")
    assert kinds(pipeline.feed(RX, text(other), MS)) == []
    assert kinds(pipeline.feed(RX, text(boot), MS)) == ["restart"]
    assert kinds(pipeline.feed(RX, text(*after), 2 * MS)) == []
    assert kinds(pipeline.feed(RX, text(*before), 3 * MS)) == []
    assert kinds(pipeline.feed(RX, text(*after), 4 * MS)) == ["restart"], "counters alone show one too"


ANSWER = text(*wire.pieces(vesc.pack_values(vesc.Values(erpm=700)), 23, 253))
STATUS = text(extended(0x0917, "000002BC00000000"))


def of_kind(items: list[Batch | DeviceEvent], kind: str) -> list[DeviceEvent]:
    return [item for item in items if isinstance(item, DeviceEvent) and item.kind == kind]


def test_status_messages_that_stop_are_counted_and_reported() -> None:
    """The controller goes on answering: without a count their absence looks like a lower rate."""
    pipeline = VescCanPipeline("drive", controller(status_Hz=100.0, report_Hz=50.0), {})
    items: list[Batch | DeviceEvent] = []
    for n in range(100):  # 2 s
        items += pipeline.feed(RX, ANSWER + STATUS + STATUS, n * 20 * MS)
    items += pipeline.feed(RX, (ANSWER + STATUS + STATUS) * 100, 4000 * MS)  # the host was asleep
    assert kinds(items) == ["drive"]
    assert pipeline.losses["missing_status"] == 0
    items = []
    for n in range(1, 151):  # 3 s
        items += pipeline.feed(RX, ANSWER, (4000 + n * 20) * MS)
    (event,) = of_kind(items, "status")
    assert "expected 100 a second (status_Hz)" in event.text
    assert pipeline.losses["missing_status"] == 300
    (gap,) = of_kind(pipeline.feed(RX, STATUS, 7000 * MS), "gap")
    assert gap.facts["samples"] == pipeline.losses["missing_status"] == 300


def test_status_messages_that_are_off_are_reported_once_and_are_no_loss() -> None:
    for status_Hz, expected in ((50.0, 1), (0.0, 0)):
        pipeline = VescCanPipeline("drive", controller(status_Hz=status_Hz), {})
        items = [item for n in range(200) for item in pipeline.feed(RX, ANSWER, n * 20 * MS)]
        assert len(of_kind(items, "status")) == expected
        assert not any(pipeline.losses.values())


def test_a_session_that_only_receives_takes_the_set_point_from_the_bus() -> None:
    pipeline = VescCanPipeline("drive", controller(), {})
    frames = text(simple(wire.SET_RPM, 23, 2100), extended(0x0917, "0000083400000000"))
    assert rows(pipeline.feed(RX, frames, 0)) == [(300.0, 300.0)]


def test_another_host_is_reported_once_in_a_second() -> None:
    watch, frame = OtherHost("drive"), simple(wire.SET_RPM, 23, 1)
    assert not watch.received(frame, 0)
    watch.sent(simple(wire.SET_RPM, 23, 2))
    assert watch.replaced
    assert [len(watch.received(frame, n * 400 * MS)) for n in range(6)] == [1, 0, 0, 1, 0, 0]


# --- the command ------------------------------------------------------------------------------------------------


def variant(**settings: Any) -> Driver:
    return replace(DRIVER, example={**DRIVER.example, **settings})


def runs(bench: DriverBench, rpm: float) -> None:
    bench.begin()
    bench.clock.wait(0.3)
    assert bench.control is not None
    bench.control.set_ramp(400.0)
    bench.control.enable()
    bench.control.set_speed(rpm)
    bench.clock.wait(abs(rpm) / 400.0 + 0.5)
    assert rpm_of(bench) == pytest.approx(rpm, rel=0.01)


def rpm_of(bench: DriverBench) -> float:
    return bench.motion.speed_rad_s * TO_RPM


@pytest.mark.parametrize("status_Hz", [0.0, 100.0])
def test_it_turns_and_stops_the_rotor(status_Hz: float) -> None:
    bench = DriverBench(variant(status_Hz=status_Hz))
    runs(bench, 200.0)
    assert bench.control is not None
    assert bench.control.actual_rpm == pytest.approx(rpm_of(bench), abs=2.0)
    assert bench.control.stop() is True
    bench.end()
    assert abs(rpm_of(bench)) < 1.0
    assert bench.reads[-1][:2] != (RX, b"")
    assert any(data == CLOSE_BUS for _, data, _ in bench.reads)


def test_the_timeout_stops_the_rotor_when_the_host_is_gone() -> None:
    bench = DriverBench(DRIVER)
    runs(bench, 200.0)
    bench.gone = True
    bench.clock.wait(0.9)
    assert rpm_of(bench) > 195.0
    bench.clock.wait(1.0)
    assert abs(rpm_of(bench)) < 1.0
    assert bench.control is not None
    with pytest.raises(LinkLost):
        bench.control.stop()


def test_a_fault_while_it_drives_drops_the_drive_out() -> None:
    bench = DriverBench(DRIVER)
    runs(bench, 200.0)
    bench.far.fail("fault", 4)
    bench.clock.wait(0.3)
    assert bench.control is not None
    assert bench.control.dropped_out == "FAULT"
    assert "over-current" in bench.control.why()
    assert "emergency" in kinds(bench.items)


def test_status_messages_alone_do_not_replace_answers() -> None:
    bench = DriverBench(DRIVER)
    runs(bench, 200.0)
    bench.far.fail("silent reports", 1)
    bench.clock.wait(0.7)
    assert bench.control is not None
    assert math.isnan(bench.control.actual_rpm)
    assert not bench.control.enabled


def test_power_loss_and_a_second_host_are_reported() -> None:
    bench = DriverBench(DRIVER)
    runs(bench, 200.0)
    bench.far.fail("second host", 1)
    bench.clock.wait(0.1)
    assert "fault" in kinds(bench.items)
    bench.far.fail("second host", 0)
    bench.far.power(False, bench.motion.time_s)
    bench.clock.wait(1.0)
    bench.far.power(True, bench.motion.time_s)
    bench.clock.wait(0.3)
    assert "restart" in kinds(bench.items)
    assert bench.control is not None
    assert bench.control.dropped_out is not None


def test_a_release_without_answer_is_an_error() -> None:
    bench = DriverBench(DRIVER)
    runs(bench, 200.0)
    assert bench.control is not None
    bench.control.quick_stop()
    bench.clock.wait(0.5)
    bench.far.fail("silent reports", 1)
    with pytest.raises(DeviceError, match="not confirmed"):
        bench.control.disable()


def test_a_controller_that_does_not_answer_is_explained() -> None:
    bench = DriverBench(DRIVER)
    bench.far.power(False, 0.0)
    with pytest.raises(DeviceError, match=r"its CAN mode VESC, are its number \(23\)"):
        bench.begin()


def test_an_error_of_the_opening_names_what_is_on_the_bus() -> None:
    bench = DriverBench(variant(controller_id=24))
    bench.far = SimulatedVescCan.of("motor", controller(), bench.world)
    with pytest.raises(DeviceError, match=r"in 3 tries, but status messages of controller 23\. Is the controller"):
        bench.begin()


def test_an_adapter_that_does_not_open_the_bus_is_named() -> None:
    class Refusing(SimulatedVescCan):
        def receive(self, data: bytes, now_s: float) -> bytes:
            return adapter_message(AdapterMessage.OPEN_REFUSED)

    bench = DriverBench(DRIVER)
    bench.far = Refusing.of("motor", controller(), bench.world)
    bench.far.power(False, 0.0)
    with pytest.raises(DeviceError, match="but the adapter refused to open the bus"):
        bench.begin()


@pytest.mark.parametrize(
    ("set_Hz", "stated_Hz", "fine"), [(50, 50, True), (100, 50, False), (0, 50, False), (0, 0, True)]
)
def test_the_rate_of_the_status_messages_is_checked(set_Hz: float, stated_Hz: float, fine: bool) -> None:
    bench = DriverBench(variant(status_Hz=stated_Hz))
    bench.far = SimulatedVescCan.of("motor", controller(status_Hz=set_Hz), bench.world)
    bench.begin()
    bench.clock.wait(3.0)
    check = DRIVER.checks(controller(status_Hz=stated_Hz), bench.pipeline, bench.control, [])["status_Hz"]
    assert check.value == pytest.approx(set_Hz, rel=0.1)
    assert check.passed is fine
    assert ("CAN Status Messages Rate 1" in check.note) is not fine
    by_default = DRIVER.checks(controller(), bench.pipeline, bench.control, [])["status_Hz"]
    assert by_default.passed is (set_Hz != 100), "without status_Hz in the rig file they may be off"


@pytest.mark.parametrize("identity", [{}, {"firmware": "5.03", "hardware": "H", "serial": "00" * 12}])
def test_the_stand_in_for_playing_accepts_any_identity(identity: dict[str, Any]) -> None:
    played = DRIVER.played(controller(), identity)
    assert not played.sending
    played.hear(open_bus(500_000))
    assert played.sending
    pipeline = VescCanPipeline("drive", controller(), {})
    query = on_bus(vesc.firmware_version())
    (reply,) = pipeline.feed(RX, played.hear(query), 0)
    assert isinstance(reply, DeviceEvent)
    assert reply.facts["firmware"] == identity.get("firmware", "6.05")
    played.hear(on_bus(vesc.set_rpm(1)) + on_bus(vesc.set_rpm(1), 24))
    assert played.unfollowed == 1
    assert played.play(TX, on_bus(vesc.set_rpm(1))) == b"", "only this host commands it now"

"""Heartbeats under the host's number that the host did not send are detected; an adapter's echo does not count."""

from __future__ import annotations

from pathlib import Path

import pytest

from daq.acquisition.session import Session
from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.stream import DrivePipeline
from daq.errors import DeviceError
from daq.items import RX, TX, DeviceEvent
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.replay import check
from daq.transports.can_frames import CanFrame, encode
from rig_configs import load_rig

CONFIG = load_rig("virtual").devices["drive"]
BEAT = encode(CanFrame(cia301.cob_heartbeat(CONFIG.host_node_id), b"\x05"))
ORDER = encode(CanFrame(cia301.cob_rpdo(1, CONFIG.node_id), cia402.VELOCITY.pack(cia402.SHUTDOWN, 0)))
REPORT = encode(CanFrame(cia301.cob_tpdo(1, CONFIG.node_id), cia402.VELOCITY.pack(0x0631, 0)))


class Bus:
    """The host's beats each 100 ms, with what else is on the bus."""

    def __init__(self) -> None:
        self.pipeline = DrivePipeline("drive", CONFIG, {})
        self.faults: list[DeviceEvent] = []
        self.now_ms = 0.0

    def at(self, ms: float, direction: int, data: bytes) -> None:
        found = self.pipeline.feed(direction, data, int((self.now_ms + ms) * 1e6))
        self.faults += [item for item in found if isinstance(item, DeviceEvent) and item.kind == "fault"]

    def period(self, *what: tuple[float, int, bytes]) -> None:
        for ms, direction, data in sorted([(0.0, TX, BEAT), (1.0, RX, REPORT), *what], key=lambda each: each[0]):
            self.at(ms, direction, data)
        self.now_ms += 100.0


@pytest.mark.parametrize("phase_ms", [40.0, 60.0, 99.0])
def test_another_node_with_the_host_s_number_is_a_fault_within_three_beats_and_reported_each_second(
    phase_ms: float,
) -> None:
    bus = Bus()
    for _ in range(3):
        bus.period((phase_ms, RX, BEAT))
    (fault,) = bus.faults
    assert "another node sends this host's heartbeat (node 1)" in fault.text
    assert fault.facts["foreign_heartbeats"] == 3
    for _ in range(10):
        bus.period((phase_ms, RX, BEAT))
    assert len(bus.faults) == 2


def test_one_in_step_with_the_host_is_seen_once_the_adapter_is_known_not_to_echo() -> None:
    bus = Bus()
    for _ in range(5):
        bus.period((3.0, RX, BEAT))
    assert not bus.faults  # it could be an echo
    for _ in range(8):
        bus.period((3.0, RX, BEAT), (50.0, TX, ORDER))
    assert bus.faults


@pytest.mark.parametrize("late_ms", [0.3, 25.0])
def test_the_echo_of_an_adapter_is_not_another_node(late_ms: float) -> None:
    bus = Bus()
    for count in range(200):
        stalled = 30.0 if count % 20 == 7 else 0.0  # a host that is late now and then
        bus.period((late_ms + stalled, RX, BEAT), (50.0, TX, ORDER), (50.0 + late_ms, RX, ORDER))
    assert not bus.faults


def test_late_echoes_are_not_another_node_once_the_adapter_is_known_to_echo() -> None:
    bus = Bus()
    for _ in range(4):
        bus.period((0.5, RX, BEAT), (50.0, TX, ORDER), (50.5, RX, ORDER))
    for _ in range(20):  # the host is busy: it reads late, but within 0.2 s
        bus.period((90.0, RX, BEAT), (5.0, TX, ORDER), (90.0, RX, ORDER))
    assert not bus.faults


@pytest.mark.parametrize("late_ms", [0.5, 25.0])
def test_another_node_behind_an_adapter_that_echoes_is_seen(late_ms: float) -> None:
    bus = Bus()
    for _ in range(6):
        bus.period((late_ms, RX, BEAT), (late_ms + 5.0, RX, BEAT), (50.0, TX, ORDER), (50.0 + late_ms, RX, ORDER))
    assert bus.faults


def test_an_adapter_that_stops_to_echo_does_not_hide_another_node() -> None:
    bus = Bus()
    bus.period((0.5, RX, BEAT), (50.0, TX, ORDER), (50.5, RX, ORDER))
    for _ in range(12):
        bus.period((3.0, RX, BEAT), (50.0, TX, ORDER))
    assert bus.faults


def test_a_session_that_only_receives_gets_the_host_s_heartbeat() -> None:
    bus = Bus()
    for count in range(30):
        bus.at(100.0 * count, RX, BEAT + REPORT)
    assert not bus.faults
    assert bus.pipeline.host_beats.foreign == 0


def test_nothing_is_turned_while_another_node_bears_the_host_s_number(tmp_path: Path) -> None:
    changes = ["virtual.seed=5"]
    sim = LockstepRig(load_rig("virtual", settings=changes))
    rig = load_rig("virtual", settings=[*changes, *sim.port_settings()])
    with (  # noqa: PT012 (the end of the block raises, and what is before it belongs to the test)
        pytest.raises(DeviceError, match="another node sends this host's heartbeat"),
        Session(rig, sim.clock, edge=sim.edge) as session,
    ):
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        session.drive.enable()
        session.drive.set_speed(300)
        session.wait_for(lambda: session.drive.actual_rpm > 250, 5.0, "the speed")
        sim.ask("fail", device="drive", what="second host", value=1)
        session.wait_for(lambda: False, 2.0, "the stop")
    assert abs(sim.far.motion.speed_rad_s) < 0.1
    with open_log(tmp_path / "a.mcap") as log:
        assert any(event["kind"] == "fault" for event in log.events)
    assert [row.topic for row in check(tmp_path / "a.mcap") if row.difference] == []

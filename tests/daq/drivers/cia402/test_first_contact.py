"""First contact with a node that was powered before the host opened its bus.

Its start message was not acknowledged until then (ISO 11898-1: it is repeated), so it is the node's first frame. The
set-up comes after it, and nothing is lost. The same message later is a restart.
"""

from __future__ import annotations

import pytest

from daq.acquisition.session import Session
from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia402
from daq.errors import DeviceError
from daq.items import RX, TX, Batch, DeviceEvent
from daq.lockstep.rig import LockstepRig
from daq.transports.can_frames import open_bus, opens_bus
from rig_configs import load_rig
from tests.daq.can_text import rx
from tests.daq.drivers.cia402 import test_cia402 as drive
from tests.daq.drivers.cia402.test_drive_setup import MappedDrive
from tests.rig_drivers.cia406 import test_encoders as encoders
from tests.rig_drivers.microstrain import test_node as radio
from tests.rig_drivers.vesc_can import test_controller as vesc

OPENING = open_bus(500_000)
MS = 1_000_000
NODE = drive.NODE


@pytest.mark.parametrize(("rig_name", "device"), [("virtual", "drive"), ("ethernet_lasers", "angle_bus")])
def test_the_first_session_with_a_rig_that_was_just_powered_is_as_the_second(rig_name: str, device: str) -> None:
    """The simulated bus repeats the boot-up message until the adapter is open, as a real one does."""
    sim, observed = LockstepRig(load_rig(rig_name)), list[list[DeviceEvent]]()
    for _ in range(2):
        session = Session(load_rig(rig_name, settings=sim.port_settings()), sim.clock, edge=sim.edge)
        observed.append([])
        session.device_event_observers.append(observed[-1].append)
        with session:
            session.drive.enable()
            session.drive.set_speed(60.0)
            sim.clock.wait(3.0)
            assert session.rotor.rpm() == pytest.approx(60.0, abs=3.0)
            assert len(session.channels.recent.last("motor", (), 0)[0]) > 100
            assert len(session.channels.recent.last("pendulums", (), 0)[0]) > 500
    first, second = ([e.text for e in events if e.device == device and "boot-up" in e.text] for events in observed)
    assert first
    assert all("had started before the bus was opened" in text for text in first)
    assert not second
    assert not [event for events in observed for event in events if event.kind in ("restart", "fault")]


class JustPowered(MappedDrive):
    """A drive whose boot-up message waits until an adapter acknowledges it."""

    waits = True

    def hear(self, data: bytes) -> None:
        if self.waits and opens_bus(data):
            self.waits = False
            self.shows(cia301.Heartbeat.BOOT_UP)
        super().hear(data)


def test_the_first_session_after_a_drive_was_powered_commands_it() -> None:
    far = JustPowered({})
    try:
        far.host.start()
        far.reports()
        assert far.host.state == cia402.SWITCH_ON_DISABLED
        far.host.enable()
        assert far.host.enabled
    finally:
        far.host.stop()


def test_a_drive_that_starts_again_after_its_set_up_is_not_commanded() -> None:
    far = JustPowered({})
    far.host.start()
    far.shows(cia301.Heartbeat.BOOT_UP)
    with pytest.raises(DeviceError, match="started again"):
        far.host.enable()
    far.host.stop()


def kinds(items: list[Batch | DeviceEvent]) -> list[str]:
    return [item.kind for item in items if isinstance(item, DeviceEvent)]


BOOT_UP = drive.beat(0)
SDO_ANSWER = drive.line(cia301.cob_sdo_answer(NODE), bytes.fromhex("60 16 10 01 00 00 00 00"))
OVER = drive.line(cia301.cob_emergency(NODE), bytes(8))


@pytest.mark.parametrize("heard", [SDO_ANSWER, drive.report(), drive.beat(0x7F)])
def test_a_boot_up_is_a_restart_once_the_drive_was_heard(heard: bytes) -> None:
    pipeline = drive.joined()
    pipeline.feed(TX, OPENING, 0)
    first = pipeline.feed(RX, OVER + BOOT_UP + BOOT_UP, MS)
    assert kinds(first) == ["emergency", "network", "network"], "an emergency may be as old as the boot-up"
    assert all(event.facts.get("operational") is not False for event in drive.events(first)), "nothing is stopped"
    pipeline.feed(RX, heard, 2 * MS)
    assert kinds(pipeline.feed(RX, BOOT_UP, 3 * MS)) == ["restart"]
    pipeline.feed(TX, OPENING, 4 * MS)
    assert kinds(pipeline.feed(RX, BOOT_UP, 5 * MS)) == ["network"], "the set-up is done again after the opening"


def test_a_boot_up_in_a_log_without_the_opening_is_a_restart() -> None:
    assert kinds(drive.joined().feed(RX, BOOT_UP, MS)) == ["restart"]


def test_positions_of_an_encoder_that_was_just_powered_are_samples() -> None:
    line = encoders.Line()
    line.at(0, TX, OPENING)
    line.at(0, RX, rx(b"t703100\rt704100\rt705100\r"))
    line.all_answer()
    line.all_answer()
    assert sum(len(batch.time_ns) for batch in line.batches()) > 0
    assert line.pipeline.status.complaint == ""
    assert line.events("network")
    line = encoders.Line()
    line.all_answer()
    line.at(0, RX, rx(b"t703100\r"))
    assert len(line.events("restart")) == 1
    assert "its set-up is gone" in line.pipeline.status.complaint


@pytest.mark.parametrize("heard", [vesc.ANSWER, vesc.STATUS])
def test_the_start_message_of_a_vesc_is_a_restart_once_it_was_heard(heard: bytes) -> None:
    boot = vesc.text(vesc.extended(0x3917, "36305F4D4B35"))
    pipeline = vesc.VescCanPipeline("drive", vesc.controller(), {})
    pipeline.feed(TX, OPENING, 0)
    assert kinds(pipeline.feed(RX, boot, MS)) == ["network"]
    pipeline.feed(RX, heard, 2 * MS)
    assert kinds(pipeline.feed(RX, boot, 3 * MS)) == ["restart"]


def test_a_radio_node_that_was_switched_on_before_its_first_sample_has_not_started_again() -> None:
    """It reports its start before its first sample, and once more after it."""
    line, start = radio.pipeline(), radio.packet(0x18, bytes(17))
    data = [start, radio.sweeps(0, [(1, 1)]), start]
    found = [item for n, each in enumerate(data) for item in line.feed(RX, each, n * MS)]
    assert [kind for kind in kinds(found) if kind in ("status", "restart")] == ["status", "restart"]

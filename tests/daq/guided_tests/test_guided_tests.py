"""Guided tests on a virtual rig: refusals before anything turns, and reports of tests that miss their end."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from daq.acquisition.rotor_command import RotorCommand
from daq.acquisition.session import Session
from daq.drivers.canopen import cia301
from daq.drivers.canopen.node import SdoServer
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.far_end import drive_objects
from daq.errors import DeviceError, ProcedureError
from daq.guided_tests.procedure import Procedures, zero_counters
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.log.outcome import not_reached_of
from daq.signals.completeness import missing_warnings
from daq.signals.run import load_run
from daq.transports import HostClock
from daq.transports.can_frames import CanFrame, FrameDecoder
from daq.virtual_rig.simulated_operator import SimulatedOperator
from rig_cli.main import run
from rig_configs import load_rig
from rig_configs.schema import Rig
from tests.conftest import join
from tests.daq.simulated_sessions import quiet


def test_counters_zeroed_elsewhere_are_refused_until_they_are_zeroed_at_the_locks(
    simulated: LockstepRig, cabled: Rig, tmp_path: Path
) -> None:
    with Session(cabled, simulated.clock, edge=simulated.edge) as session:
        tests = Procedures(session, SimulatedOperator(simulated), tmp_path, quiet)
        session.rotor.command_locks("release both")
        session.clock.wait(0.5)
        simulated.ask("flick", pendulum=0, speed_rad_s=9.0)
        session.clock.wait(3.0)
        session.rotor.command_locks("zero")  # A is anywhere now
        for test in (lambda: tests.run_up(900.0, 10.0), tests.spin_down, lambda: tests.point("A", 15.0)):
            with pytest.raises(
                ProcedureError, match=r"pendulum A reads .* zero the counters there.*Nothing was turned"
            ):
                test()
        assert session.drive.state != cia402.OPERATION_ENABLED
        assert list(tmp_path.iterdir()) == []
        zero_counters(session)
        assert tests.run_up(900.0, 10.0).missed == ""


def test_a_speed_beyond_the_limit_is_refused_before_the_drive_is_enabled(
    simulated: LockstepRig, cabled: Rig, tmp_path: Path
) -> None:
    with Session(cabled, simulated.clock, edge=simulated.edge) as session:
        tests = Procedures(session, SimulatedOperator(simulated), tmp_path / "out", quiet)
        for test in (
            lambda: tests.run_up(5000.0, 40.0),
            lambda: tests.run_down(5000.0, 40.0),
            lambda: tests.point("A", 500.0),
            lambda: tests.run_up(900.0, float("nan")),
        ):
            with pytest.raises(ProcedureError, match="nothing was turned"):
                test()
        assert simulated.ask("state")["drive"] == cia402.SWITCH_ON_DISABLED
        assert not (tmp_path / "out").exists()


def test_an_end_that_is_not_reached_is_reported_kept_and_exits_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    slips = ["virtual.drive.slip=0.05"]  # never at 98.5 % of the top
    rig = LockstepRig(load_rig("virtual", settings=slips))
    join(monkeypatch, "rig_cli.guided_test", rig)
    ports = [word for setting in rig.port_settings() for word in ("--set", setting)]
    common = ["test", "virtual", "run-up", "--out", str(tmp_path), "--duration", "5"]
    code = run([*common, "--json", *ports])
    result = json.loads(capsys.readouterr().out)
    assert code == 1
    assert result["reached"] is False
    assert result["ended"].startswith("not reached: the top speed: 85")
    code = run([*common, *ports])
    assert code == 1
    assert "run-up did not reach its end: the top speed" in capsys.readouterr().err
    log = tmp_path / "01-run-up.mcap"
    with open_log(log) as opened:
        assert not_reached_of(opened).startswith("the top speed: 85")
    assert missing_warnings([load_run(log)])[0].startswith("01-run-up.mcap: the test did not reach its end: the top")
    assert run(["log", str(log)]) == 0
    assert "not reached  the top speed" in capsys.readouterr().out


def test_check_exits_3_if_the_drive_has_not_confirmed_its_release(
    simulated: LockstepRig, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    join(monkeypatch, "rig_cli.acquire", simulated)
    rest = RotorCommand.bring_to_rest
    monkeypatch.setattr(RotorCommand, "bring_to_rest", lambda *given: rest(*given) and False)
    ports = [word for setting in simulated.port_settings() for word in ("--set", setting)]
    assert run(["check", "virtual", "--seconds", "2", *ports, "--json"]) == 3
    captured = capsys.readouterr()
    left = "drive: the rotor is at rest, but the drive may not have released it"
    assert left in json.loads(captured.out)["warnings"][0]
    assert f"warning: {left}" in captured.err


def test_check_gives_a_verdict_per_device_and_exits_3_when_one_fails(
    simulated: LockstepRig, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    join(monkeypatch, "rig_cli.acquire", simulated)
    ports = [word for setting in simulated.port_settings() for word in ("--set", setting)]
    command = ["check", "virtual", "--seconds", "2", *ports]
    assert run([*command, "--json", "--set", "suspension.zeta1=2.0"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found) >= {"rig", "devices", "identities", "rates_Hz", "losses"}
    assert found["warnings"] == ["suspension.zeta1 is 2: per cent? Usual is 0 to 0.5"]
    assert {name: device["verdict"] for name, device in found["devices"].items()} == dict.fromkeys(
        ("laser_x", "laser_y", "encoder", "drive"), "pass"
    )
    for device in found["devices"].values():
        assert all(set(check) >= {"value", "expected", "verdict"} for check in device["checks"].values())
    assert run([*command, "--set", "devices.encoder.counts_per_revolution=2048"]) == 3
    shown = capsys.readouterr().out
    assert "encoder  FAIL" in shown
    assert "laser_x  pass" in shown
    assert "every angle would be scaled wrongly" in shown
    other = load_rig("virtual", settings=[*simulated.port_settings(), "devices.encoder.counts_per_revolution=2048"])
    with (
        pytest.raises(DeviceError, match="4096 counts per revolution, the rig file states 2048"),
        Session(other, simulated.clock, edge=simulated.edge) as session,
    ):
        Procedures(session, SimulatedOperator(simulated), Path("never"), quiet).spin_down()
    assert not Path("never").exists()


class FaultyDrive:
    """A drive that stands in FAULT for a reason; its host's frames in, its answers out."""

    def __init__(self, reason: dict[tuple[int, int], tuple[int, str]]) -> None:
        from daq.drivers.cia402.control import DriveControl

        rig = load_rig("virtual")
        self.state, self.control = cia402.FAULT, 0
        watched = {(cia301.CONSUMER_HEARTBEAT, 1): (cia402.consumer_heartbeat(1, 500), "<I")}
        self._sdo = SdoServer(drive_objects(5) | watched | reason, {}, lambda index, sub, value: None)
        self._lines = FrameDecoder()
        self.host = DriveControl(rig.devices["drive"], self._hear, HostClock())
        self._report()

    def _hear(self, data: bytes) -> None:
        for frame in self._lines.feed(data).frames:
            if frame.arbitration_id == cia301.cob_sdo_request(5):
                self.host.take_frames([CanFrame(cia301.cob_sdo_answer(5), self._sdo.answer(frame.data))])
            elif frame.arbitration_id == cia301.cob_rpdo(1, 5):
                word, before = cia402.VELOCITY.unpack(frame.data)[0], self.control
                self.control = word
                if self.state == cia402.FAULT:  # left by the bit's rising edge alone
                    self.state = cia402.SWITCH_ON_DISABLED if word & 0x80 and not before & 0x80 else self.state
                else:
                    self.state = {6: cia402.READY, 7: cia402.SWITCHED_ON, 15: cia402.OPERATION_ENABLED}.get(
                        word, self.state
                    )
                self._report()

    def _report(self) -> None:
        word = cia402.STATES[self.state][1]
        self.host.take_frames([CanFrame(cia301.cob_tpdo(1, 5), cia402.VELOCITY.pack(word, 0))])


@pytest.mark.parametrize(
    "reason", [{(0x603F, 0): (0x8130, "<H")}, {(0x1003, 1): (0x00008130, "<I")}, {(0x1001, 0): (0x11, "<B")}]
)
def test_a_fault_by_the_lost_heartbeat_of_a_host_is_reset_and_reported(reason: dict) -> None:
    drive = FaultyDrive(reason)
    drive.host.enable()
    assert drive.state == cia402.OPERATION_ENABLED
    assert "a host's heartbeat had stayed away (0x8130)" in drive.host.was_reset


@pytest.mark.parametrize(
    ("reason", "words"),
    [({(0x603F, 0): (0x3220, "<H")}, "error code is 0x3220"), ({(0x1001, 0): (0x05, "<B")}, "reports no cause")],
)
def test_any_other_fault_is_its_operators_to_mend(reason: dict, words: str) -> None:
    drive = FaultyDrive(reason)
    with pytest.raises(DeviceError, match=words):
        drive.host.enable()
    assert drive.state == cia402.FAULT

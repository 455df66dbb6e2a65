"""Sessions on a virtual rig: recording, replay, losses, unplugged cable, killed host, full disk, intruder."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader

from daq.acquisition.session import Session
from daq.errors import DeviceError, LinkLost, ProcedureError
from daq.guided_tests.procedure import Procedures
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.replay import check
from daq.virtual_rig.control import OperatorLine
from daq.virtual_rig.simulated_operator import SimulatedOperator
from rig_cli.demo import _radio_check
from rig_cli.simulated import VirtualRigProcess
from rig_configs import load_rig
from rig_configs.schema import Rig
from tests.daq.simulated_sessions import guided, quiet, turn
from tests.effort import thorough

needs_posix = pytest.mark.skipif(sys.platform == "win32", reason="signals and ptys need POSIX")


Happening = Callable[[Session, LockstepRig], object]


def test_a_recorded_test_holds_raw_and_decoded_and_replays_exactly(
    simulated: LockstepRig, cabled: Rig, tmp_path: Path
) -> None:
    with Session(cabled, simulated.clock, edge=simulated.edge) as session:
        tests = Procedures(session, SimulatedOperator(simulated), tmp_path, quiet, note="<b>note</b>")
        done = tests.ring_down("x")
        spun = tests.spin_down()
    radio = simulated.ask("state")
    for path in (done.log, spun.log):
        rows = check(path)
        assert [r.topic for r in rows if r.difference] == []
        assert all(r.live > 0 for r in rows if r.topic not in ("tacho",))
        counted, last = _radio_check(path, radio)
        assert counted["counted"] == counted["dropped"]
        later = {"dropped": [number + 65536 for number in radio["dropped"]]}  # the same when the numbers have wrapped
        assert _radio_check(path, later, 65536) == (counted, last + 65536)
        with open(path, "rb") as file:
            topics = {channel.topic for _, channel, _ in make_reader(file, validate_crcs=True).iter_messages()}
        assert {"raw/laser_x", "raw/laser_y", "raw/encoder", "raw/drive", "laser/x", "laser/y", "pendulums"} <= topics
        with open_log(path) as log:
            assert log.complete
            losses = json.loads(log.metadata["summary"]["losses"])
            assert losses["laser_x"].keys() >= {"samples", "bytes", "damaged", "invalid", "suspect", "unusable"}
            assert not any(losses["laser_x"].values())
            assert log.metadata["run"]["note"] == "<b>note</b>"
            assert b"virtual" not in log.attachments["rig.json"].replace(b'"name":"virtual"', b"")


def test_a_run_down_is_recorded_from_the_top_almost_to_rest(
    simulated: LockstepRig, cabled: Rig, tmp_path: Path
) -> None:
    with Session(cabled, simulated.clock, edge=simulated.edge) as session:
        done = guided(session, simulated, tmp_path).run_down(600.0, 20.0)
    assert done.summary["reached_rest"] is True
    assert done.missed == ""
    assert simulated.ask("state")["speed_rpm"] < 1
    with open_log(done.log) as log:
        assert log.metadata["run"]["test"] == "run-down"
        speed = log["motor"]["speed_rpm"]
        assert speed[0] > 590
        assert 0 < speed[-1] < 20
        turns = log["tacho"]["revolutions"]
        assert 80 < int(turns[-1]) - int(turns[0]) < 130  # 10 rev/s for 1 s, then falling over 20 s


def test_locking_is_refused_while_the_rotor_turns(simulated: LockstepRig, cabled: Rig) -> None:
    with Session(cabled, simulated.clock, edge=simulated.edge) as session:
        session.rotor.command_locks("release both")
        turn(session, 120)
        with pytest.raises(DeviceError, match="refused"):
            session.rotor.command_locks("lock both")
        session.drive.set_speed(0)
        session.wait_for(lambda: session.drive.actual_rpm == 0, 5.0, "the rotor to stop")
        session.rotor.command_locks("lock both")


_RECORD_SPINNING = """
import sys, time
from pathlib import Path
from daq.acquisition.session import Session
from daq.transports import HostClock
from rig_configs import load_rig
rig = load_rig("virtual", settings=sys.argv[2:])
session = Session(rig, HostClock()).open()
session.drive.enable()
session.drive.set_ramp(1000)
session.drive.set_speed(1050)
session.wait_for(lambda: session.drive.actual_rpm > 1040, 30, "speed")
session.start_recording(Path(sys.argv[1]), {"test": "record"})
print("recording", flush=True)
while True:
    session.check()
    time.sleep(0.05)
"""


def recording_host(path: Path, rig: VirtualRigProcess, *wrapper: str) -> subprocess.Popen[str]:
    command = [*wrapper, sys.executable, "-c", _RECORD_SPINNING, str(path), *rig.port_settings()]
    host = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert host.stdout.readline().strip() == "recording"
    return host


@needs_posix
@pytest.mark.parametrize("after_s", [pytest.param(0.3, marks=thorough), 0.06, 1.1])
def test_a_killed_host_loses_little_and_the_drive_stops_by_itself(after_s: float, tmp_path: Path) -> None:
    with VirtualRigProcess("virtual", []) as rig:
        path = tmp_path / "killed.mcap"
        host = recording_host(path, rig)
        time.sleep(after_s)
        host.send_signal(signal.SIGKILL)
        killed = time.monotonic()
        killed_rig_s = rig.line.ask("state")["time_s"]
        while rig.line.ask("state")["speed_rpm"] > 0.5 and time.monotonic() < killed + 5:
            time.sleep(0.01)
        stopped_after = time.monotonic() - killed
        host.communicate()
        assert stopped_after < 1.0
        with open_log(path.with_name("killed.mcap.part")) as log:
            assert not log.complete
            arrived = [log[t].log_time_ns for t in ("laser/x", "pendulums")]
            # the recording ran `after_s` at least, and may have been killed before its first flush
            kept_s = max((int(t[-1] - t[0]) * 1e-9 for t in arrived if len(t)), default=0.0)
            assert kept_s > after_s - 0.5
        assert killed_rig_s > 0
        rows = check(path.with_name("killed.mcap.part"))
        # what was decoded live from raw bytes that are in the file is there too, up to the cut
        assert all(abs(r.live - r.again) < 4000 for r in rows)


@needs_posix
def test_a_full_disk_ends_the_run_with_a_readable_log_and_a_stopped_rotor(tmp_path: Path) -> None:
    with VirtualRigProcess("virtual", []) as rig:
        path = tmp_path / "full.mcap"
        limit = "import resource, os, sys, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); " + (
            "resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, 400_000)); os.execv(sys.argv[1], sys.argv[1:])"
        )
        host = recording_host(path, rig, sys.executable, "-c", limit)
        _, stderr = host.communicate(timeout=30)
        assert host.returncode != 0
        assert "File too large" in stderr or "OSError" in stderr
        deadline = time.monotonic() + 5
        while rig.line.ask("state")["speed_rpm"] > 0.5 and time.monotonic() < deadline:
            time.sleep(0.02)
        assert rig.line.ask("state")["speed_rpm"] < 0.5
        with open_log(path.with_name("full.mcap.part")) as log:
            assert len(log["laser/x"]) > 1000


def test_the_control_port_requires_its_token(virtual_rig: VirtualRigProcess) -> None:
    intruder = OperatorLine(virtual_rig.line._socket.getpeername()[1], "wrong")
    with pytest.raises(ValueError, match="token"):
        intruder.ask("truth")
    intruder.close()
    for line, answer in ((b'{"token": "\xc3\xa9"}', "token"), (b"[" * 60_000, "one JSON object")):
        with socket.create_connection(virtual_rig.line._socket.getpeername(), timeout=5) as other:
            other.sendall(line + b"\n")
            assert answer in other.makefile().readline()
    assert set(virtual_rig.line.ask("truth")["truth"]) == {
        "k1_N_per_m",
        "k2_N_per_m",
        "zeta1",
        "zeta2",
        "c3_Nms_per_rad",
        "c4_Nms_per_rad",
        "SP_kg_m",
    }


@needs_posix
def test_ptys_and_tcp_ports_carry_the_same_rig(tmp_path: Path) -> None:
    with VirtualRigProcess("virtual", [], "tcp") as rig:
        assert all(port.startswith("socket://127.0.0.1:") for port in rig.ports.values())
        plugged = load_rig("virtual", settings=rig.port_settings())
        with Session(plugged, rig.clock) as session:
            done = Procedures(session, SimulatedOperator(rig.line), tmp_path, quiet).spin_down()
        assert [r.topic for r in check(done.log) if r.difference] == []


@pytest.mark.parametrize(
    ("rpm", "happens", "error", "words"),
    [
        (300, lambda session, sim: sim.ask("unplug", device="laser_y"), LinkLost, "cable"),
        (300, lambda session, sim: session.drive._repeated["heartbeat"].stop(), ProcedureError, "without a command"),
        (300, lambda session, sim: session.devices.send("laser_x", b"OUTPUT NONE\n"), DeviceError, "laser/x: silent"),
        (
            60,
            lambda session, sim: sim.ask("pluck", x_mm=12.2, y_mm=0, hold_s=1.0),
            ProcedureError,
            r"laser/x: .* mm, limits\.amplitude_m is 11 mm",
        ),
    ],
)
def test_what_happens_to_a_device_stops_a_turning_rotor(
    simulated: LockstepRig, cabled: Rig, rpm: float, happens: Happening, error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words), Session(cabled, simulated.clock, edge=simulated.edge) as session:  # noqa: PT012
        turn(session, rpm)
        happens(session, simulated)
        session.wait_for(lambda: False, 10.0, "nothing")
    assert simulated.ask("state")["speed_rpm"] < 0.5


@needs_posix
def test_the_virtual_rig_ends_with_its_parent_process() -> None:
    script = (
        "import sys, time\nfrom rig_cli.simulated import VirtualRigProcess\n"
        "rig = VirtualRigProcess('virtual', [])\nprint(rig._process.pid, flush=True)\ntime.sleep(60)"
    )
    starter = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    child = int(starter.stdout.readline())
    starter.kill()
    starter.communicate()
    deadline = time.monotonic() + 5
    while Path(f"/proc/{child}").exists() and time.monotonic() < deadline:
        if Path(f"/proc/{child}/stat").read_text().split()[2] == "Z":
            break
        time.sleep(0.05)
    assert not Path(f"/proc/{child}").exists() or Path(f"/proc/{child}/stat").read_text().split()[2] == "Z"


def recording_command(rig: VirtualRigProcess, log: Path) -> list[str]:
    """Return the command line of a recording from a virtual rig."""
    command = [sys.executable, "-m", "rig_cli.main", "record", "virtual", "-o", str(log)]
    return command + [word for setting in rig.port_settings() for word in ("--set", setting)]


def wait_until_recorded(log: Path) -> None:
    """Wait until a part of a log is on the disk."""
    part, deadline = log.with_name(f"{log.name}.part"), time.monotonic() + 120
    while not (part.exists() and part.stat().st_size > 100_000) and time.monotonic() < deadline:
        time.sleep(0.02)


@needs_posix
def test_a_recording_goes_on_when_its_terminal_is_gone(virtual_rig: VirtualRigProcess, tmp_path: Path) -> None:
    """The page of the recording is shown four times a second on a terminal that is closed meanwhile."""
    log, (ours, theirs) = tmp_path / "run.mcap", os.openpty()
    command = [*recording_command(virtual_rig, log), "--duration", "4", "--json"]
    host = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=theirs, text=True, env={**os.environ, "TERM": "xterm"}
    )
    os.close(theirs)
    wait_until_recorded(log)
    os.close(ours)
    out, _ = host.communicate(timeout=120)
    assert host.returncode == 0
    assert json.loads(out)["ended"] == "duration"
    with open_log(log) as opened:
        assert opened.complete
        times = opened["laser/x"].time_s
        assert times[-1] - times[0] > 3.5


@needs_posix
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", pytest.param("SIGHUP", marks=thorough)])
def test_ctrl_c_a_polite_kill_and_a_hang_up_end_a_recording_with_a_whole_log(
    virtual_rig: VirtualRigProcess, tmp_path: Path, name: str
) -> None:
    log = tmp_path / "run.mcap"
    command = recording_command(virtual_rig, log)
    chosen = signal.Signals[name]
    # tests that were started in the background may have this signal ignored, which a child would inherit
    before = signal.signal(chosen, signal.SIG_DFL)
    host = subprocess.Popen([*command, "--json"], stdout=subprocess.PIPE, text=True)
    signal.signal(chosen, before)
    wait_until_recorded(log)
    host.send_signal(chosen)
    out, _ = host.communicate(timeout=120)
    assert host.returncode == 0
    assert json.loads(out)["log"] == str(log)
    assert json.loads(out)["ended"] == ("Ctrl-C" if name == "SIGINT" else name)
    with open_log(log) as opened:
        assert opened.complete
        assert opened.missing == []
        assert len(opened["laser/x"]) > 1000

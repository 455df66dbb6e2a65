"""Hands at a virtual rig that runs: found by its note, heard with its token, refused in words."""

from __future__ import annotations

import json
import socket
import stat
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from daq.errors import DeviceError
from daq.transports import open_link
from daq.virtual_rig.run import VirtualRig, serve
from daq.virtual_rig.running import NoRigRuns, Running, SeveralRigsRun, leave_note, notes_folder, reach, read_note
from rig_cli.main import run
from rig_configs import RigConfigError, load_rig

posix = pytest.mark.skipif(sys.platform == "win32", reason="modes of files are POSIX")


class Served:
    """A virtual rig in a thread, in place of another terminal."""

    def __init__(self, name: str, note: Path | None = None) -> None:
        self.virtual = VirtualRig(load_rig(name))
        begun = threading.Event()
        self.note = Path()

        def ready(path: Path | None) -> None:
            assert path is not None
            self.note = path
            begun.set()

        self.thread = threading.Thread(target=serve, args=(self.virtual, ready, note, True, False))
        self.thread.start()
        assert begun.wait(30)

    def end(self) -> None:
        self.virtual._running = False
        self.thread.join()


@pytest.fixture
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A runtime folder of one's own."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path))
    return tmp_path


@pytest.fixture
def by_hand(runtime: Path) -> Iterator[Served]:
    served = Served("by_hand")
    yield served
    served.end()


def answer_of(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    capsys.readouterr()
    assert run(["virtual", *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    capsys.readouterr()
    code = run(["virtual", *words])
    return code, capsys.readouterr().err


def test_hands_do_what_a_person_does_and_an_onlooker_sees_it(
    by_hand: Served, capsys: pytest.CaptureFixture[str]
) -> None:
    assert answer_of(capsys, "state")["pendulums_held"] == [True, True]
    assert answer_of(capsys, "clamp", "--release") == {"done": True}
    answer_of(capsys, "flick")
    answer_of(capsys, "turn", "120", "--ramp", "1000")
    deadline = time.monotonic() + 30
    while (seen := answer_of(capsys, "state"))["speed_rpm"] < 1:
        assert time.monotonic() < deadline
    assert seen["pendulums_held"] == [False, False]
    answer_of(capsys, "turn", "0", "--ramp", "1000")
    answer_of(capsys, "clamp")
    assert answer_of(capsys, "state")["pendulums_held"] == [True, True]
    answer_of(capsys, "pluck", "y", "--mm", "12")
    by_hand.virtual.rig.do({"do": "pluck", "x_mm": 0, "y_mm": 0, "hold_s": 0}, 0.0)  # it would be released
    answer_of(capsys, "set", "suspension.k1_N_per_m=3000")
    assert by_hand.virtual.rig.motion.physics.identified()["k1_N_per_m"] == 3000
    assert set(answer_of(capsys, "state")) == {
        "time_s",
        "speed_rpm",
        "displacement_mm",
        "pendulums_deg",
        "pendulums_held",
        "devices",
    }


def test_faults_are_placed_by_their_words_on_the_one_device_that_can_have_them(
    by_hand: Served, capsys: pytest.CaptureFixture[str]
) -> None:
    kinds = answer_of(capsys, "fault", "--list")["devices"]
    assert "marks lost" in kinds["encoder"]
    assert answer_of(capsys, "fault", "marks-lost")["device"] == "encoder"
    answer_of(capsys, "fault", "garbage", "laser_y", "--value", "50")
    devices = answer_of(capsys, "state")["devices"]
    assert (devices["encoder"]["faults"], devices["laser_y"]["faults"]) == ({"marks lost": 1}, {"garbage": 50.0})
    answer_of(capsys, "fault", "marks lost", "encoder", "--end")
    assert answer_of(capsys, "state")["devices"]["encoder"]["faults"] == {}
    assert run(["virtual", "fault", "--list"]) == 0
    page = capsys.readouterr().out
    assert page.count("garbage") == 1
    assert page.count("blocked  ") == 2
    assert run(["virtual", "state"]) == 0
    assert "faults: garbage (50)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["flick"], "pendulum A is held: release it first"),
        (["fault"], "expected a fault; `rig virtual fault --list`"),
        (["fault", "blocked"], "of which device? laser_x, laser_y"),
        (["fault", "blocked", "encoder"], "encoder cannot have 'blocked', only laser_x, laser_y"),
        (["fault", "tired"], "no device can have 'tired'; they can have: blocked, code,"),
        (["fault", "mute", "laser_z"], "no device 'laser_z'; this rig has laser_x, laser_y, encoder"),
        (["fault", "bit-errors", "laser_x", "--value", "3"], "takes share of its bytes, 0 to 1; got 3"),
        (["unplug", "laser_z"], "no device 'laser_z'"),
        (["plug", "laser_x"], "laser_x is plugged in, at "),
        (["set", "suspension.k3=1"], "unknown key"),
        (["set", "nothing"], "expected key=value"),
        (["pluck", "x", "--mm", "90"], "at most 50 mm"),
        (["turn", "1e8"], "at most 20000 rpm"),
    ],
)
def test_what_a_hand_cannot_do_is_bad_use_and_states_what_it_can(
    by_hand: Served, capsys: pytest.CaptureFixture[str], words: list[str], expected: str
) -> None:
    code, err = refused(capsys, *words)
    assert code == 2
    assert expected in err


def test_a_device_that_is_plugged_in_again_speaks_at_the_port_that_is_reported(
    by_hand: Served, capsys: pytest.CaptureFixture[str]
) -> None:
    before = read_note(by_hand.note).ports["laser_x"]
    host = open_link(before, 921600)  # still open when the device is plugged in again: its name is in use
    answer_of(capsys, "unplug", "laser_x")
    assert answer_of(capsys, "state")["devices"]["laser_x"]["plugged"] is False
    port = answer_of(capsys, "plug", "laser_x")["port"]
    host.close()
    assert port != before
    assert read_note(by_hand.note).ports["laser_x"] == port
    link = open_link(port, 921600)
    try:
        link.write(b"GETINFO\n")
        heard = b""
        while b"ILD1420" not in heard:
            more = link.read(30.0)
            assert more, heard
            heard += more
    finally:
        link.close()


def test_a_hand_stops_the_rig_and_its_note_goes_with_it(by_hand: Served, capsys: pytest.CaptureFixture[str]) -> None:
    assert by_hand.note.exists()
    assert answer_of(capsys, "stop") == {"done": True}
    by_hand.thread.join()
    assert not by_hand.note.exists()
    code, err = refused(capsys, "pluck", "x")
    assert code == 3
    assert "no virtual rig runs; start one first, in another terminal: rig virtual" in err


def test_of_several_rigs_one_is_chosen(by_hand: Served, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = Served("one_laser")
    chosen = Served("one_laser", tmp_path / "mine.json")
    try:
        code, err = refused(capsys, "state")
        assert code == 2
        assert "2 virtual rigs run; choose one:" in err
        assert f"--control {other.note}   (one_laser)" in err
        with pytest.raises(SeveralRigsRun, match="2 virtual rigs run") as several:
            reach()
        assert (other.note, "one_laser") in several.value.choices
        assert list(answer_of(capsys, "state", "--control", str(other.note))["devices"]) == ["probe"]
        assert list(answer_of(capsys, "state", "--control", str(chosen.note))["devices"]) == ["probe"]
    finally:
        other.end()
        chosen.end()
    code, err = refused(capsys, "state", "--control", str(tmp_path / "mine.json"))
    assert (code, f"in another terminal: rig virtual --control {tmp_path / 'mine.json'}" in err) == (3, True)


def test_access_needs_the_token(by_hand: Served, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    true = read_note(by_hand.note)
    forged = leave_note(Running(true.rig, true.pid, true.control_port, "guessed", true.ports), tmp_path / "f.json")
    before = answer_of(capsys, "state")["pendulums_held"]
    code, err = refused(capsys, "clamp", "--release", "--control", str(forged))
    assert (code, "expected the token" in err) == (2, True)
    assert answer_of(capsys, "state")["pendulums_held"] == before
    with pytest.raises(RigConfigError, match="expected the note of a virtual rig"):
        reach(Path(__file__))


@posix
def test_a_note_is_its_users_alone(by_hand: Served, runtime: Path) -> None:
    assert stat.S_IMODE(by_hand.note.stat().st_mode) == 0o600
    assert stat.S_IMODE(by_hand.note.parent.stat().st_mode) == 0o700
    by_hand.note.parent.chmod(0o755)
    with pytest.raises(DeviceError, match="expected a folder that only you can access"):
        notes_folder()
    by_hand.note.parent.chmod(0o700)


def test_notes_of_rigs_that_were_killed_are_removed(runtime: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        dead_port = free.getsockname()[1]
    dead = leave_note(Running("virtual", 1, dead_port, "t", {}))
    other = socket.create_server(("127.0.0.1", 0))  # another program has the port now, and hangs up

    def hang_up() -> None:
        other.accept()[0].close()

    thread = threading.Thread(target=hang_up)
    thread.start()
    taken = leave_note(Running("virtual", 2, other.getsockname()[1], "t", {}))
    strange = notes_folder() / "virtual-3.json"
    strange.write_text("[]")
    with pytest.raises(NoRigRuns, match="no virtual rig runs"):
        reach()
    thread.join()
    other.close()
    assert (dead.exists(), taken.exists(), strange.exists()) == (False, False, True)


def test_the_rig_file_is_the_operators_own(runtime: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from rig_cli.plugged_rig_file import need_free, write_plugged

    mine = runtime / "my.toml"
    ports = {name: f"/dev/{name}" for name in load_rig("virtual").devices}
    write_plugged("virtual", ["limits.speed_rpm=900", "virtual.seed=3", "suspension.zeta1=*2"], ports, mine)
    rig = load_rig(mine)
    assert rig.virtual is None
    assert {name: device.port for name, device in rig.devices.items()} == ports
    assert rig.limits.speed_rpm == 900
    assert rig.suspension.zeta1 == 2 * load_rig("virtual").suspension.zeta1
    need_free(mine)
    mine.write_text("# mine\n")
    code, err = refused(capsys, "-o", str(mine))
    assert (code, "a file of this name exists" in err) == (2, True)
    assert mine.read_text() == "# mine\n"

"""`rig test`: plans without a device, refusals before one, keys while a test runs, start-ups, what a campaign lacks."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from rich.console import Console

from daq.acquisition.recorder import Recorder
from daq.acquisition.session import Session
from daq.guided_test_kinds import KINDS
from daq.guided_tests.controls import Controls
from daq.guided_tests.procedure import Procedures
from daq.guided_tests.start_ups import summed
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.log.outcome import ending, not_reached_of
from daq.transports import HostClock
from daq.virtual_rig.simulated_operator import SimulatedOperator
from rig_cli import guided_test
from rig_cli.guided_test_page import TestPage, readings
from rig_cli.keyboard import Keys
from rig_cli.main import run
from rig_cli.simulated import VirtualRigProcess
from rig_configs import RigFileError, load_rig
from rig_configs.schema import Rig
from tests.conftest import join

needs_posix = pytest.mark.skipif(sys.platform == "win32", reason="keys are read from a pty")


@pytest.fixture
def no_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Session, "open", lambda session: pytest.fail("a device was opened"))


def run_rig(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = run(list(arguments))
    captured = capsys.readouterr()
    return code, captured.out, " ".join(captured.err.split())


@pytest.mark.usefixtures("no_device")
@pytest.mark.parametrize("test", [*(name for name in KINDS if name != "point"), "point-A"])
def test_a_plan_gives_states_times_speeds_and_who_acts_without_a_device(
    test: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = (
        ["start-ups", "B", "--count", "3"] if test == "start-ups" else test.split("-") if "point" in test else [test]
    )
    code, out, _ = run_rig(capsys, "test", "virtual", *words, "--plan", "--json")
    plan = json.loads(out)
    assert code == 0
    assert plan["test"] == test
    assert plan["repeats"] == (3 if test == "start-ups" else 1)
    assert plan["usual_s"] == pytest.approx(plan["repeats"] * sum(s["usual_s"] for s in plan["states"]))
    assert plan["top_rpm"] <= plan["limit_rpm"] == 1200
    assert {state["who"] for state in plan["states"]} <= {"program", "operator", "drive", "encoder"}
    code, shown, _ = run_rig(capsys, "test", "virtual", *words, "--plan")
    assert code == 0
    assert all(state["name"] in shown for state in plan["states"])


@pytest.mark.usefixtures("no_device")
def test_a_plan_gives_what_this_rig_s_sensors_can_show(capsys: pytest.CaptureFixture[str]) -> None:
    gives = {}
    for rig in ("virtual", "one_laser"):
        _, out, _ = run_rig(capsys, "test", rig, "ring-down-x", "--plan", "--json")
        gives[rig] = json.loads(out)["gives"]
    assert gives == {
        "virtual": ["k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2"],
        "one_laser": ["k1_N_per_m", "zeta1"],
    }


@pytest.mark.usefixtures("no_device")
@pytest.mark.parametrize(
    "words", ["check virtual", "test virtual ring-down-x --plan", "test virtual", "predict virtual --point B"]
)
def test_two_devices_on_one_port_are_both_named(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    ports = [f"--set=devices.{name}.port=/dev/one" for name in ("laser_x", "laser_y")]
    code, _, err = run_rig(capsys, *words.split(), *ports)
    assert code == 2
    assert "devices.laser_x.port and devices.laser_y.port are both '/dev/one'" in err


@pytest.mark.usefixtures("no_device")
def test_a_rig_that_no_file_was_read_for_is_refused_by_its_session() -> None:
    rig = load_rig("virtual")
    devices = {name: device.model_copy(update={"port": "/dev/one"}) for name, device in rig.devices.items()}
    with pytest.raises(RigFileError, match=r"laser_x\.port and devices\.laser_y\.port are both '/dev/one'"):
        Session(rig.model_copy(update={"devices": devices}), HostClock())


@pytest.mark.parametrize(("words", "code"), [("check virtual", 3), ("test virtual ring-down-x --plan", 0)])
def test_a_slip_of_a_unit_warns_before_a_device_is_opened(
    words: str, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    slips = ["--set", "pendulums.a.mass_kg=75", "--set", "devices.laser_x.port=/dev/ttyUSB?"]
    found, _, err = run_rig(capsys, *words.split(), *slips)
    assert found == code
    assert "warning: pendulums.a.mass_kg is 75 kg: grams?" in err
    assert "warning: devices.laser_x.port is '/dev/ttyUSB?': a placeholder?" in err


@pytest.mark.parametrize(
    ("words", "code", "why"),
    [
        ("check no.toml", 2, "no such rig file"),
        ("log nosuch.mcap", 2, "nosuch.mcap"),
        ("predict virtual --pont A", 2, "--pont"),
        ("predikt virtual", 2, "predikt"),
        ("predict", 2, "requires an argument"),
        ("test virtual run-up --top-rpm fast", 2, "fast"),
        ("driver chek cia402", 2, "chek"),
    ],
)
def test_an_error_is_one_json_object_too(words: str, code: int, why: str, capsys: pytest.CaptureFixture[str]) -> None:
    found, out, err = run_rig(capsys, *words.split(), "--json")
    answer = json.loads(out)
    assert found == answer["exit_code"] == code
    assert why in answer["error"]
    assert why in err


def test_an_interrupted_command_is_one_json_object_too(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> Rig:
        raise KeyboardInterrupt("SIGTERM")

    monkeypatch.setattr("rig_cli.guided_test.load_rig", interrupted)
    code, out, _ = run_rig(capsys, "test", "virtual", "--json")
    assert (code, json.loads(out)) == (130, {"error": "interrupted by SIGTERM", "exit_code": 130})
    assert run_rig(capsys, "test", "virtual")[:2] == (130, "")


def test_a_bar_ends_its_line(monkeypatch: pytest.MonkeyPatch) -> None:
    controls = Controls()
    controls.status = replace(controls.status, test="run-up", state="ramp", words="ramping", share=0.4)
    monkeypatch.setattr(TestPage, "_losses", lambda page: "nothing lost")
    monkeypatch.setattr("rig_cli.guided_test_page.readings", lambda session: [])
    session = cast("Session", None)
    console = Console(file=io.StringIO(), force_terminal=True, width=80, color_system=None)
    console.print(TestPage(session, controls, None, lambda: "")._page())
    lines = console.file.getvalue().splitlines()
    assert lines[-1] == "nothing lost"
    assert set(lines[-2]) <= set("━╸╺ ")


@pytest.mark.usefixtures("no_device")
def test_a_plan_names_what_the_operator_of_a_rig_without_a_drive_will_be_asked(
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, out, _ = run_rig(capsys, "test", "by_hand", "point", "B", "--plan", "--json")
    plan = json.loads(out)
    assert not any(state["who"] == "drive" for state in plan["states"])
    assert any(prompt.startswith("turn the rotor to 2") for prompt in plan["prompts"])
    assert "release both pendulums at the same time" in plan["prompts"]
    _, out, _ = run_rig(capsys, "test", "virtual", "point", "B", "--plan", "--json")
    assert json.loads(out)["prompts"] == []


@pytest.mark.usefixtures("no_device")
@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("ring-down-x --top-rpm 900", "ring-down-x takes no top_rpm; the numbers it takes: pre_trigger_s"),
        ("run-up --number top_rpm=5000", "5000 rpm requested, limits.speed_rpm is 1200: nothing was turned"),
        ("run-up --number top_rpm", "expected NAME=VALUE"),
        ("run-up A", "the test takes no point"),
        ("start-ups", "expected speed_rpm (speed, rpm) or a point of the rig, got none"),
        ("start-ups Q", "takes one of A, B, C, D, E"),
        ("start-ups B --count 0", "expected a whole number from 1 to 10000 as count"),
        ("start-ups B --speed-rpm 4000", "limits.speed_rpm is 1200"),
        ("point Z", "'point-Z': no such test"),
        ("spin-down --pre-trigger 90", "expected a number from 0 to 30 as pre_trigger_s"),
    ],
)
@pytest.mark.parametrize("plan", [True, False])
def test_what_cannot_be_run_is_refused_before_a_device_is_opened_also_its_plan(
    words: str, why: str, plan: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = run_rig(capsys, "test", "virtual", *words.split(), *(["--plan"] if plan else []))
    assert code == 2
    assert why in err


@pytest.mark.usefixtures("no_device")
def test_an_interrupted_campaign_shows_which_tests_are_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "03-bad.mcap").write_bytes(b"no log")
    for name, rig, missed in (
        ("ring-down-x", "virtual", ""),
        ("run-up", "virtual", "the top speed"),
        ("spin-down", "another", ""),
    ):
        recorder = Recorder(tmp_path / f"01-{name}.mcap", HostClock(), {"test": name, "rig": rig}, {}, ())
        recorder.close(ending(missed))
    code, out, err = run_rig(capsys, "test", "virtual", "--out", str(tmp_path), "--json")
    states = {row["test"]: row["state"] for row in json.loads(out)["tests"]}
    assert code == 0
    assert (states["ring-down-x"], states["run-up"], states["spin-down"]) == ("done", "not reached", "missing")
    assert states["point-A"] == "missing"
    assert "03-bad.mcap is skipped" in err
    _, out, _ = run_rig(capsys, "test", "one_laser", "--json", "--out", str(tmp_path))
    assert {row["state"] for row in json.loads(out)["tests"]} == {"missing", "refused"}


def test_keys_pause_resume_abort_note_and_confirm() -> None:
    controls = Controls()
    keys = Keys(controls)
    for key in "pxrn p\x7fqä\nn\nnlost\x1b\na":
        keys.press(key)
    requests = [(request.verb, request.text) for request in controls.take()]
    assert requests == [("pause", ""), ("resume", ""), ("note", "qä"), ("abort", "by the key a")]
    assert keys.confirmed.is_set()  # by the Enter after Esc


def test_an_abort_in_a_ramp_keeps_a_log_with_notes_and_leaves_the_rotor_at_rest(
    simulated: LockstepRig, cabled: Rig, tmp_path: Path
) -> None:
    controls = Controls()
    seen: list[dict[str, float]] = []

    def progress(text: str, share: float | None) -> None:
        if controls.status.state == "ramp" and (share or 0.0) > 0.4 and not seen:
            seen.append({reading.name: reading.used for reading in readings(session)})
            controls.note("it hums")
            controls.abort("it hums too much")

    with Session(cabled, simulated.clock, edge=simulated.edge) as session:
        tests = Procedures(session, SimulatedOperator(simulated), tmp_path, progress, controls=controls)
        done = tests.run_up(900.0, 20.0)
        assert session.rotor.at_rest() is True
        assert simulated.ask("state")["speed_rpm"] < 1
    assert (done.aborted, done.missed) == (True, "aborted by the operator in 'ramp': it hums too much")
    assert 0.2 < seen[0]["speed"] < 0.7
    assert 0 < seen[0]["x"] < 1
    assert np.isnan(seen[0]["θ3"])
    with open_log(done.log) as log:
        assert not_reached_of(log) == done.missed
        (note,) = [event for event in log.events if event["kind"] == "note"]
        assert note["text"] == "it hums"
        assert log["motor"]["speed_rpm"].max() < 800


@pytest.mark.lengthy
def test_start_ups_are_recorded_one_by_one_and_classed(
    simulated: LockstepRig,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    join(monkeypatch, "rig_cli.guided_test", simulated)
    ports = [word for setting in simulated.port_settings() for word in ("--set", setting)]
    words = [
        "test",
        "virtual",
        "start-ups",
        "B",
        "--count",
        "2",
        "--out",
        str(tmp_path),
    ]
    code, out, _ = run_rig(capsys, *words, "--json", *ports)
    result = json.loads(out)
    assert (code, result["warnings"]) == (0, [])
    assert result["classes"] == {"balanced": 2, "slipping": 0, "other": 0}
    assert [Path(each["log"]).name for each in result["runs"]] == ["01-start-ups.mcap", "02-start-ups.mcap"]
    model = load_rig("virtual").true_physics
    for each in result["runs"]:
        with open_log(each["log"]) as log:
            assert log.metadata["run"]["test"] == "start-ups"
            assert log.metadata["run"]["point"] == "B"
        thetas = np.radians([each["theta3_deg"], each["theta4_deg"]])
        moments = [model.a.first_moment_kg_m, model.b.first_moment_kg_m]
        assert abs(model.imbalance_moment_kg_m + np.sum(moments * np.exp(1j * thetas))) < 0.02 * moments[0]
    assert simulated.ask("state")["speed_rpm"] < 1


def test_the_whole_of_start_ups_counts_classes_and_takes_angles_as_directions() -> None:
    runs = [
        {"class": "balanced", "state": "I", "theta3_deg": 359.0, "amplitude_x_mm": 0.1},
        {"class": "balanced", "state": "I", "theta3_deg": 3.0, "amplitude_x_mm": 0.3},
        {"class": "slipping", "state": "slipping"},
        {"class": "other", "state": "not settled"},
        {"reached": False},
    ]
    whole = summed(runs)
    assert whole["start_ups"] == 4
    assert whole["classes"] == {"balanced": 2, "slipping": 1, "other": 1}
    angle, amplitude = whole["measured"]["I"]["theta3_deg"], whole["measured"]["I"]["amplitude_x_mm"]
    assert [round(angle[key], 6) % 360 for key in ("mean", "least", "largest")] == [1.0, 359.0, 3.0]
    assert amplitude == pytest.approx({"mean": 0.2, "least": 0.1, "largest": 0.3})


@needs_posix
def test_keys_at_a_terminal_note_and_abort_a_test_that_waits_for_a_person(
    virtual_rig: VirtualRigProcess, tmp_path: Path
) -> None:
    ports = [word for setting in virtual_rig.port_settings() for word in ("--set", setting)]
    words = ["test", "virtual", "ring-down-x", "--out", str(tmp_path), "--json"]
    ours, theirs = os.openpty()
    command = [sys.executable, "-m", "rig_cli.main", *words, *ports]
    test = subprocess.Popen(command, stdin=theirs, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert test.stderr is not None
        while ">>> displace" not in (line := test.stderr.readline()):
            assert line, "the test ended without asking for the pluck"
        os.write(ours, b"nwind outside\n")
        os.write(ours, b"a")
        out, err = test.communicate(timeout=60)
    finally:
        test.kill()
        test.wait()
        os.close(ours)
        os.close(theirs)
    result = json.loads(out)
    assert test.returncode == 1, err
    assert (result["aborted"], result["reached"]) == (True, False)
    assert result["ended"] == "not reached: aborted by the operator in 'pluck': by the key a"
    with open_log(result["log"]) as log:
        assert [event["text"] for event in log.events if event["kind"] == "note"] == ["wind outside"]


@pytest.mark.parametrize(
    ("log", "warning", "words"),
    [
        (Path("out/05-run-up.mcap"), "", "the rotor is at rest; the log is kept: out/05-run-up.mcap"),
        (None, "the rotor may turn", "the rotor may turn; no log had begun"),
    ],
)
def test_a_stop_by_ctrl_c_states_rotor_and_log(
    capsys: pytest.CaptureFixture[str], log: Path | None, warning: str, words: str
) -> None:
    def stopped() -> None:
        with guided_test.stop_stated() as opened:
            recording = SimpleNamespace(path=log)
            opened.append(cast("Session", SimpleNamespace(recording=recording, rotor_warning=warning)))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert capsys.readouterr().err == f"the test was stopped; {words}\n"

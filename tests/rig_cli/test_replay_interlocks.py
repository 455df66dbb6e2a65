"""`rig replay --interlocks` and the trip on `rig log`'s page: what is printed, what is refused, exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cyclopts import App

from daq.acquisition.interlock_table import INTERLOCKS
from daq.errors import LogError
from daq.items import DeviceEvent
from daq.log import open_log
from daq.log.file import LogFile
from rig_cli.log_facts import log_facts
from rig_cli.log_page import print_log
from rig_cli.replay import replay
from rig_cli.trip_page import sparkline, trip_lines
from rig_configs.errors import RigFileError
from tests.daq.far_ends import START_NS
from tests.daq.recorded_bench import RecordedBench


def run_rig(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    app = App()
    app.default(replay)
    code = app([*arguments, "--interlocks"], exit_on_error=False, result_action="return_value")
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with RecordedBench(tmp_path_factory.mktemp("logs") / "sound.mcap") as bench:
        bench.beat()
        bench.turn(600)
        return bench.finish()


@pytest.fixture(scope="module")
def blind(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with RecordedBench(tmp_path_factory.mktemp("logs") / "blind.mcap") as bench:
        bench.beat()
        bench.turn(600)
        bench.fails("laser_x", "code", 262076)
        bench.pass_time(0.5)
        bench.note(DeviceEvent("stop", "host", f"{bench.why()}; the rotor was commanded to stop"))
        return bench.finish(bench.why())


def test_a_sound_log_shows_every_row_and_ends_with_0(capsys: pytest.CaptureFixture[str], sound: Path) -> None:
    code, out, err = run_rig(capsys, str(sound))
    assert code == 0
    assert "nothing would have tripped" in err
    lines = out.splitlines()
    for row in INTERLOCKS:
        (line,) = [line for line in lines if line.startswith(f"{row.name} ")]
        assert ("quiet" in line) == (row.judge == "channels")
        assert row.reaction in line
    assert "11 mm" in out
    assert "limits.amplitude_m" in out


def test_a_trip_is_shown_with_its_reason_and_values_and_ends_with_1(
    capsys: pytest.CaptureFixture[str], blind: Path
) -> None:
    code, out, err = run_rig(capsys, str(blind))
    assert code == 1
    assert "would have tripped at 3.1" in err
    assert "blind sensor: laser/x: most samples" in out
    assert "commanded 600 rpm; newest: " in out
    assert "the session itself stopped at 3.5" in out
    assert [line for line in out.splitlines() if line.startswith("blind sensor") and "trips at 3.1" in line]


def test_json_has_it_all(capsys: pytest.CaptureFixture[str], blind: Path) -> None:
    code, out, _ = run_rig(capsys, str(blind), "--json")
    found = json.loads(out)
    (trip,) = found["trips"]
    assert (code, found["tripped"], trip["interlock"], trip["cause"]) == (1, True, "blind sensor", "device")
    assert trip["time_s"] == pytest.approx(3.14, abs=0.05)
    assert trip["newest"]["laser/x"]["displacement_m"] is None  # JSON has no NaN
    assert trip["told_rpm"] == 600
    states = {row["name"]: row["in_this_log"] for row in found["interlocks"]}
    assert len(states) == len(INTERLOCKS)
    assert states["amplitude"] == "quiet"
    assert states["blind sensor"].startswith("trips at")
    assert found["session_stops"][0]["text"].endswith("the rotor was commanded to stop")
    assert found["limits"]["amplitude_m"] == 0.011


def test_other_limits_and_all_trips(capsys: pytest.CaptureFixture[str], sound: Path) -> None:
    code, out, err = run_rig(capsys, str(sound), "--set", "limits.amplitude_m=0.0001", "--set", "limits.speed_rpm=500")
    assert code == 1
    assert "what if limits.amplitude_m=0.0001, limits.speed_rpm=500" in err
    assert "0.1 mm, by two" in out
    assert "overspeed: the drive reports" not in out
    code, out, _ = run_rig(
        capsys, str(sound), "--set", "limits.amplitude_m=0.0001", "--set", "limits.speed_rpm=500", "--all"
    )
    assert code == 1
    assert "overspeed: the drive reports" in out
    assert "(until " in out


def test_a_narrow_terminal_gets_the_columns_that_fit(
    capsys: pytest.CaptureFixture[str], sound: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig_cli.replay_interlocks.stdout_console", lambda: type("Narrow", (), {"width": 60}))
    _, out, _ = run_rig(capsys, str(sound))
    *_, left_out = [line for line in out.splitlines() if line.startswith("left out")]
    assert "threshold" in left_out
    assert max(len(line) for line in out.splitlines() if line != left_out) <= 60
    assert "amplitude" in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--check"], "one job at a time"),
        (["--to", "tcp"], "one job at a time"),
        (["--speed", "1"], "one job at a time"),
        (["-o", "x.mcap"], "one job at a time"),
        (["--set", "limits.amplitude=1"], r"did you mean limits\.amplitude_m"),
        (["--set", "nonsense"], "expected key=value"),
    ],
)
def test_what_does_not_go_together_is_explained(
    capsys: pytest.CaptureFixture[str], sound: Path, arguments: list[str], words: str
) -> None:
    with pytest.raises((LogError, RigFileError), match=words):
        run_rig(capsys, str(sound), *arguments)


@pytest.mark.parametrize("alone", [["--all"], ["--set", "limits.amplitude_m=0.004"]])
def test_what_only_interlocks_take_is_refused_without_them(sound: Path, alone: list[str]) -> None:
    app = App()
    app.default(replay)
    with pytest.raises(LogError, match=f"{alone[0]}: expected --interlocks"):
        app([str(sound), *alone], exit_on_error=False, result_action="return_value")


# --- a trip on a log's page ----------------------------------------------------------------------------------------

TRIP = {
    "time_ns": START_NS + 2_000_000_000,
    "interlocks": ["amplitude", "runaway"],
    "reasons": [
        {"interlock": "amplitude", "text": "laser/x: 12.1 mm, limits.amplitude_m is 11 mm", "after_ms": 0.0},
        {"interlock": "runaway", "text": "the drive reports 700 rpm", "after_ms": 120.0},
    ],
    "later": ["silent angles"],
    "speed_rpm": 612.4,
    "from_ms": -1000.0,
    "until_ms": 1000.0,
    "excerpt": {
        "laser/x": {
            "displacement_m": {"t_ms": [-1000, -500, 0, 500, 1000], "value": [0.0, 1e-3, 12.1e-3, None, -1e-3]},
            "counter": {"t_ms": [-1000, 1000], "value": [1, 8000]},
        }
    },
}


def page(capsys: pytest.CaptureFixture[str], path: Path, facts: dict) -> str:
    with LogFile(path, {"test": "record"}, {}, (), START_NS) as log:
        log.event(DeviceEvent("drive", "drive", "READY"), START_NS)
        log.event(DeviceEvent("trip", "host", "amplitude, runaway: …", facts), START_NS)
        made = log.finish({"ended": "x"})
    with open_log(made) as opened:
        print_log(log_facts(opened, made, None))
    return capsys.readouterr().out


def test_a_trip_stands_on_the_page_with_all_its_reasons(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    lines = [line.rstrip() for line in page(capsys, tmp_path / "a.mcap", TRIP).splitlines()]
    (first,) = [number for number, line in enumerate(lines) if line.startswith("trip ")]
    assert "2.000 s, rotor 612 rpm" in lines[first]
    assert "amplitude: laser/x: 12.1 mm" in lines[first + 1]
    assert lines[first + 2].endswith("runaway: the drive reports 700 rpm (120 ms later)")
    assert lines[first + 3].split() == ["after", "it", "silent", "angles"]
    assert "displacement_m -0.001 … 0.0121" in lines[first + 4]
    assert "█" in lines[first + 4]
    assert lines[first + 5].endswith("↑ -1 s … 1 s")
    assert lines[first + 4].index("█") == lines[first + 5].index("↑")
    assert not any("counter" in line for line in lines)


@pytest.mark.parametrize(
    "hostile",
    [
        {},
        {"reasons": 3, "excerpt": [1], "from_ms": "x", "speed_rpm": True, "later": {"a": 1}},
        {"reasons": [3, {}], "excerpt": {"x": {"y_m": {"t_ms": [None, 1], "value": 3}}}, "from_ms": 0, "until_ms": 0},
        {"excerpt": {"x": {"y_m": {"t_ms": [1e300] * 4, "value": [1, 2, 3, "4"]}}}, "from_ms": -1, "until_ms": 1},
        {"excerpt": {"x": {"y_m": {"t_ms": [0] * 4, "value": [1] * 4}}}, "from_ms": 5, "until_ms": 9},
    ],
)
def test_a_page_is_printed_for_any_content_of_a_trip_s_event(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, hostile: dict
) -> None:
    assert "\ntrip " in page(capsys, tmp_path / "a.mcap", hostile)


def test_a_line_of_blocks_shows_peaks_and_places_without_a_value() -> None:
    line = sparkline([(0.0, 0.0), (1.0, None), (2.0, 1.0), (2.001, 0.5), (10.0, 0.0)], 0.0, 10.0)
    assert len(line) == 61
    assert (line[0], line[6], line[12], line[60]) == ("▁", "×", "█", "▁")
    assert set(line[13:60]) == {" "}
    assert list(trip_lines({"time_ns": 5}, 5)) == [("trip", "      0.000 s", "bold red")]

"""Every number that a command takes: what it cannot be is refused in words, before anything is started."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from cyclopts import App

from rig_cli.main import commands as command_line, run

ABSENT = "/nowhere/absent"
NEEDED = {  # what else a command needs to come as far as its numbers; nothing of it is there
    "test": (f"{ABSENT}.toml", "spin-down"),
    "record": (f"{ABSENT}.toml", "-o", f"{ABSENT}.mcap"),
    "validate": (f"{ABSENT}.toml", f"{ABSENT}.mcap", "--parameters", f"{ABSENT}.toml"),
    "identify": (f"{ABSENT}.mcap",),
    "export": (f"{ABSENT}.mcap", "-o", f"{ABSENT}.csv"),
    "import": (f"{ABSENT}.csv", "-o", f"{ABSENT}.mcap", "--rig", f"{ABSENT}.toml", "--test", "t", "--x", "1:mm"),
    "replay": (f"{ABSENT}.mcap", "--to", "pty"),
    "map": (f"{ABSENT}.toml", "--x", "speed_ratio=1:2:3", "--y", "stiffness_ratio=1:2:3"),
    "demo": ("--rig", f"{ABSENT}.toml"),
    "diff": (f"{ABSENT}.toml", f"{ABSENT}.toml"),
    "plan": (f"{ABSENT}.toml", "--want", "zeta1=1%"),
    "calibrate": (f"{ABSENT}.toml", "encoder"),
    "devices": (),
    "pluck": ("x", "--control", f"{ABSENT}.json"),
    "turn": ("60", "--control", f"{ABSENT}.json"),
    "fault": ("mute", "laser_x", "--control", f"{ABSENT}.json"),
}
TEXTS = ["nan", "-inf", "1e999", "*e", "%", "=", ":", "a=b", "1:2:nan", "[" * 3000, "9" * 5000]


def commands(of: App, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], App]]:
    for name in of:
        if name.startswith("-"):
            continue
        if any(not below.startswith("-") for below in of[name]):
            yield from commands(of[name], (*path, name))
        else:
            yield (*path, name), of[name]


def options(*kinds: str) -> list[tuple[tuple[str, ...], str]]:
    """Every option whose type speaks of one of the kinds."""
    return [
        (path, argument.name)
        for path, command in commands(command_line())
        for argument in command.assemble_argument_collection(parse_docstring=False)
        if any(kind in str(argument.hint) for kind in kinds) and argument.name.startswith("-")
    ]


def needed(path: tuple[str, ...], option: str) -> tuple[str, ...]:
    words = list(NEEDED.get(path[-1], (f"{ABSENT}.toml",)))
    if option in words:
        del words[words.index(option) : words.index(option) + 2]
    return tuple(words)


def test_the_sweep_sees_the_options() -> None:
    found = {option for _, option in options("float", "int")}
    assert found >= {"--seconds", "--duration", "--level", "--seed", "--from", "--rate", "--linger"}


@pytest.mark.parametrize(("path", "option"), options("float", "int"))
def test_no_number_breaks_a_command(capsys: pytest.CaptureFixture[str], path: tuple[str, ...], option: str) -> None:
    for value in ("nan", "inf", "-inf", "1e308", "-1", "0", "", "1_0", "0x10", "true", "9" * 5000):
        code = run([*path, *needed(path, option), f"{option}={value}"])
        err = capsys.readouterr().err
        assert code in (2, 3), (value, err)
        if value in ("nan", "inf", "-inf", "1e308"):
            assert code == 2, value
            assert option in err, value


@pytest.mark.parametrize(("path", "option"), options("str"))
def test_no_text_breaks_a_command(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, path: tuple[str, ...], option: str
) -> None:
    words = (str(tmp_path),) if path == ("logs",) else needed(path, option)
    for value in TEXTS:
        code = run([*path, *words, f"{option}={value}"])
        err = capsys.readouterr().err
        assert code in ((0, 2) if path == ("logs",) else (2, 3)), (value, err)


@pytest.mark.parametrize(
    "words",
    [
        "check virtual --seconds -1",
        "check virtual --seconds 0",
        "record virtual -o x.mcap --duration -5",
        "record virtual -o x.mcap --duration 0",
        "record virtual -o x.mcap --until-silent -1",
        "test virtual run-up --duration 0",
        "test virtual run-up --top-rpm -1",
        "predict virtual --speed-rpm -1",
        "predict virtual --speed-ratio 0",
        "predict virtual --point A --accuracy 0",
        "parameters diff a b --level 0",
        "parameters history --level 1",
    ],
)
def test_a_number_out_of_its_range_is_refused_by_name(capsys: pytest.CaptureFixture[str], words: str) -> None:
    assert run(words.split()) == 2
    err = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert "expected a number" in err
    assert words.split()[-2] in err


@pytest.mark.parametrize(
    "fault",
    [
        "suspension.k1_N_per_m=*x@point-A",
        "suspension.k1_N_per_m=*1.2.3@point-A",
        "suspension.k1_N_per_m=true@B",
        "suspension.k1_N_per_m=-5@run-up",
        "suspension.k1=5@run-up",
        "suspension.k1_N_per_m=*1e999@A",
        "=@A",
        "pendulums.a=3@A",
        "suspension.k1_N_per_m=nan@A",
    ],
)
def test_a_fault_that_cannot_be_is_refused_before_the_first_test(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, fault: str
) -> None:
    assert run(["demo", "--out", str(tmp_path / "out"), "--fault", fault]) == 2
    err = capsys.readouterr().err
    assert any(words in err for words in ("expected", "should be", "unknown key")), err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("number", ["0", "-1", "two", ""])
def test_an_impossible_number_of_threads_is_named(
    number: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", number)
    assert run(["predict", "virtual", "--speed-rpm", "500", "--json"]) == 2
    printed = capsys.readouterr()
    assert "NUMBA_NUM_THREADS: expected a number of threads" in printed.err
    assert json.loads(printed.out)["exit_code"] == 2

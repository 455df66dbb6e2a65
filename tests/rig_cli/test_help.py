"""`rig --help`, the help of every command, and the reference in docs/commands.md, which is made from them."""

from __future__ import annotations

import importlib.util
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from cyclopts import App

from rig_cli.command_groups import COMMANDS, GROUPS
from rig_cli.main import commands, run

DOCS = Path(__file__).parents[2] / "docs"
EXAMPLE = re.compile(r"^Example: `?(rig .*?)`?$", re.MULTILINE)
WORK = ["Set up", "Run", "Identify", "Understand", "Data", "Develop"]


def all_commands(app: App, path: tuple[str, ...] = ("rig",)) -> Iterator[tuple[str, ...]]:
    """Path of every command, also of those that have commands of their own."""
    for name in app:
        if not name.startswith("-"):
            yield (*path, name)
            yield from all_commands(app[name], (*path, name))


PATHS = list(all_commands(commands(COMMANDS)))


def shown(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """Help on a terminal wide enough for every line."""
    assert run([*words, "--help"]) == 0
    return capsys.readouterr().out


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "300")


def test_the_overview_lists_the_commands_in_the_order_of_the_work(capsys: pytest.CaptureFixture[str]) -> None:
    assert list(GROUPS) == WORK
    text = shown(capsys)
    titles = re.findall(r"^╭─ (.+?) ─", text, re.MULTILINE)
    assert titles == [*WORK, "This program"]
    rows = re.findall(r"^│ ([a-z]+) +(\S.*?) *│$", text, re.MULTILINE)
    assert rows == [(name, each.sentence) for group in GROUPS.values() for name, each in group.items()]


def test_each_command_has_one_short_sentence() -> None:
    for name, command in COMMANDS.items():
        assert re.fullmatch(r"[A-Z][a-z]+,? [^;]+[^.;]\.", command.sentence), name
        assert len(command.sentence) <= 90, name


def test_the_overview_imports_no_command() -> None:
    code = (
        "import sys\nfrom rig_cli.main import run\nrun(['--help'])\n"
        "heavy = {'numpy', 'numba', 'scipy', 'matplotlib', 'pydantic', 'rig_cli.model'} & set(sys.modules)\n"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("path", PATHS, ids=" ".join)
def test_the_help_of_a_command_has_one_example_that_it_accepts(
    capsys: pytest.CaptureFixture[str], path: tuple[str, ...]
) -> None:
    overview = commands()
    assert overview[path[1]].help == COMMANDS[path[1]].sentence, "another command line of this process"
    examples = EXAMPLE.findall(re.sub(r" +$", "", shown(capsys, *path[1:]), flags=re.MULTILINE))
    assert len(examples) == 1
    words = shlex.split(examples[0])
    assert words[: len(path)] == list(path)
    commands(words[1:]).parse_args(words[1:], exit_on_error=False, print_error=False)


def documented() -> Any:
    """The module that makes docs/commands.md."""
    spec = importlib.util.spec_from_file_location("command_reference", DOCS / "_ext/command_reference.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_documented_reference_has_the_same_groups() -> None:
    module = documented()
    reference = module.reference()
    expected: list[str] = []
    for title, group in GROUPS.items():
        expected += [f"## {title}", *(f"### rig {name}" for name in group)]
    assert re.findall(r"^###? .*", reference, re.MULTILINE) == expected
    assert len(EXAMPLE.findall(reference)) == len(PATHS)
    assert re.findall(r"`rig ([a-z]+)`\]\(#", module.overview()) == list(COMMANDS)


@pytest.mark.parametrize("path", PATHS, ids=" ".join)
def test_no_help_shows_an_option_or_a_default_that_means_nothing(
    capsys: pytest.CaptureFixture[str], path: tuple[str, ...]
) -> None:
    text = shown(capsys, *path[1:])
    assert "--empty-" not in text
    assert not re.search(r'default: *(""|False|None|\[\])', text)


@pytest.mark.parametrize("path", PATHS, ids=" ".join)
def test_no_group_of_options_is_longer_than_a_glance(capsys: pytest.CaptureFixture[str], path: tuple[str, ...]) -> None:
    options = [re.findall(r"^│ .*?--[a-z]", panel, re.MULTILINE) for panel in shown(capsys, *path[1:]).split("╭─")]
    assert max(map(len, options)) <= 11


def test_the_options_of_a_test_stand_in_groups(capsys: pytest.CaptureFixture[str]) -> None:
    titles = re.findall(r"^╭─ (.+?) ─", shown(capsys, "test"), re.MULTILINE)
    assert titles == ["Parameters", "Numbers of the test", "Displays", "Numbers of the rig", "Output"]


def test_every_argument_has_a_description() -> None:
    rows = re.findall(r"^(#+ rig .*|\* `[^`]*`(?:: .*)?)$", documented().reference(), re.MULTILINE)
    bare = [row for row in rows if re.fullmatch(r"\* `[^`]*`:?( *\*+\[.*?\]\*+)*", row)]
    assert len(rows) > 200
    assert bare == []

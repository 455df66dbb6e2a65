"""The operator's how-tos, word by word: the commands of their rehearsals run as processes, on ports of the system.

The indented commands of a guided test are the second person's: each is given when the test prompts for it. All run in
real time; without `RIG_TESTS_THOROUGH` the minutes of a run-up and of a point are left out.
"""

from __future__ import annotations

import glob
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.effort import THOROUGH

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "docs/how-to/operator" / name for name in ("rehearse_without_hardware.md", "run_without_a_drive.md")]
MINUTES = ("run-up", "point")
PATIENCE_S = 300


@dataclass
class Line:
    """A command of the page, the exit code it is to have, and the hand's commands that belong to it."""

    words: list[str]
    code: int
    hands: list[list[str]] = field(default_factory=list)


def rehearsals() -> list[list[Line]]:
    """The commands of the pages' rehearsals; each rehearsal ends with the rig's."""
    found: list[list[Line]] = [[]]
    shown = "\n".join(page.read_text("utf-8") for page in PAGES)
    for indent, text in re.findall(r"^( {4,})(rig .*)$", shown, re.MULTILINE):
        command, _, comment = text.partition("#")
        words = shlex.split(command)[1:]
        if len(indent) > 4:
            found[-1][-1].hands.append(words)
            continue
        code = re.search(r"exit (\d)", comment)
        found[-1].append(Line(words, int(code[1]) if code else 0))
        if words == ["virtual", "stop"]:
            found.append([])
    return [each for each in found if each]


class Terminal:
    """A command in a terminal of its own, what it writes on standard error read as it comes.

    Attributes:
        result: the first line of its standard output, if requested; all of it is shown after a wrong end.
    """

    def __init__(self, folder: Path, words: list[str], answers: bool = False) -> None:
        self.words = words
        environment = {**os.environ, "XDG_RUNTIME_DIR": str(folder), "PYTHONUNBUFFERED": "1"}
        environment["PYTHONPATH"] = str(ROOT)
        expanded = [name for word in words for name in (sorted(glob.glob(word, root_dir=folder)) or [word])]
        self.written = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115 (closed with the terminal)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "rig_cli.main", *expanded],
            cwd=folder,
            env=environment,
            text=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE if answers else self.written,
            stderr=subprocess.PIPE,
        )
        self.watchdog = threading.Timer(PATIENCE_S, self.process.kill)
        self.watchdog.start()
        self.lines: list[str] = []
        self.result = ""
        if self.process.stdout is not None:
            with self.process.stdout:
                self.result = self.process.stdout.readline()

    def prompts(self) -> Iterator[str]:
        """Each prompt for a hand when it comes; ends with the command."""
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line)
            if line.startswith(">>>"):
                yield line

    def end(self) -> int:
        for _ in self.prompts():
            pass
        return self.process.wait()

    def shown(self) -> str:
        """Return the screen of the second terminal."""
        self.written.seek(0)
        return f"{self.written.read()}{''.join(self.lines)}"

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *_: object) -> None:
        self.watchdog.cancel()
        self.process.kill()
        self.process.wait()
        assert self.process.stderr is not None
        self.process.stderr.close()
        self.written.close()


def carried_out(folder: Path, line: Line) -> None:
    """One command, with the second person at hand; it ends as the page states."""
    words = line.words
    if words[0] == "check" and not THOROUGH:
        words = [*words, "--seconds", "4"]
    hands = iter(line.hands)
    with Terminal(folder, words) as terminal:
        for prompt in terminal.prompts():
            by_hand = next(hands, None)
            assert by_hand is not None, f"{' '.join(line.words)}: no hand for {prompt!r}"
            carried_out(folder, Line(by_hand, 0))
        code = terminal.end()
        assert code == line.code, f"rig {' '.join(line.words)}: exit {code}\n{terminal.shown()}"
    assert list(hands) == [], f"{' '.join(line.words)}: not every manual action was prompted for"


def test_the_pages_have_their_rehearsals() -> None:
    first, by_hand = rehearsals()
    assert [line.words[:2] for line in first[:3]] == [["virtual", "-o"], ["check", "my.toml"], ["test", "my.toml"]]
    assert len(by_hand[1].hands) == 4


@pytest.mark.lengthy
@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.skipif(sys.platform == "win32", reason="a page for ptys; TCP ports have tests of their own")
def test_the_rehearsal_can_be_followed_word_by_word(number: int, tmp_path: Path) -> None:
    start, *lines = rehearsals()[number]
    tmp_path.chmod(0o700)
    with Terminal(tmp_path, start.words, answers=True) as rig:
        ready = json.loads(rig.result)
        for line in lines:
            if THOROUGH or not set(MINUTES) & set(line.words):
                carried_out(tmp_path, line)
        assert rig.end() == 0
    assert not Path(ready["control"]).exists()
    assert (tmp_path / ready["rig_file"]).exists()

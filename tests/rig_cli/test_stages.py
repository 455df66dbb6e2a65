"""A command states within two seconds what it is doing, on a terminal, and only if it prints nothing else."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="terminals of POSIX")
QUIET = "rig logs: loading the program, which takes longer at the first start after an installation …"
# The work of a command, in place of loading it.
ENTRY = """
import sys, time, types
from rig_cli import entry, stages
def work():
    {work}
main = types.ModuleType("rig_cli.main")
main.main = work
sys.modules["rig_cli.main"] = main
sys.argv = ["rig", "logs"]
entry.main()
"""


def printed(work: str) -> list[tuple[float, str]]:
    """Run a command on a terminal; return the time since its start, s, and text of each output."""
    ours, theirs = os.openpty()
    began = time.monotonic()
    command = [sys.executable, "-c", ENTRY.format(work=work)]
    process = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=theirs, stderr=theirs)
    os.close(theirs)
    found: list[tuple[float, str]] = []
    try:
        while data := os.read(ours, 65536):
            found.append((time.monotonic() - began, data.decode()))
    except OSError:  # the terminal is closed at the end of the process
        pass
    os.close(ours)
    assert process.wait(20) == 0
    return found


def lines(found: list[tuple[float, str]]) -> list[str]:
    return "".join(text for _, text in found).split("\r\n")[:-1]


def test_a_command_that_loads_for_long_states_it_within_two_seconds_of_its_start() -> None:
    found = printed("time.sleep(3); print('done')")
    assert lines(found) == [QUIET, "done"]
    assert found[1][0] - found[0][0] > 0.8, "the line comes 1.2 s after the start of the 3 s"


def test_a_stage_is_stated_if_nothing_is_printed_since_it_began() -> None:
    work = "print('one'); stages.begin_stage('reading 3 logs'); time.sleep(2.5); print('two'); time.sleep(2)"
    assert lines(printed(work)) == ["one", "rig logs: reading 3 logs …", "two"]


def test_a_command_that_prints_in_time_states_no_stage() -> None:
    work = "stages.begin_stage('reading 3 logs'); print('one'); time.sleep(2.5)"
    assert lines(printed(work)) == ["one"]


def test_without_a_terminal_no_stage_is_stated() -> None:
    command = [sys.executable, "-c", ENTRY.format(work="time.sleep(2.5)")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")

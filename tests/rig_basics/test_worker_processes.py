"""Ctrl-C while the processes of a command begin: they ignore it from their first instruction and end with it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.pressed import begun, press_ctrl_c, until

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and process groups of POSIX")

# Python imports this module before all others: a worker process stays there, as in a long import, until the Ctrl-C.
BEGINNING = """
import os, pathlib, sys, time
if "--multiprocessing-fork" in sys.argv:
    pathlib.Path(os.environ["BEGUN"], str(os.getpid())).touch()
    while not os.path.exists("pressed"):
        time.sleep(0.01)
"""
COMMANDS = {
    "driver check vesc_can --thorough": 1,
    "reproduce 4.2 4.5 --jobs 2 -o book": 1,
    "map virtual --x speed_ratio=1:2:20 --scheduler local:2": 1,
    "demo --out campaign": 1,
    "demo --foxglove --foxglove-port 0 --out campaign": 2,
}
"""Commands with the number of processes that have begun when Ctrl-C is pressed."""


@pytest.mark.parametrize("command", COMMANDS)
def test_ctrl_c_while_worker_processes_begin_is_orderly(command: str, tmp_path: Path) -> None:
    modules, processes = tmp_path / "modules", tmp_path / "processes"
    modules.mkdir()
    processes.mkdir()
    (modules / "sitecustomize.py").write_text(BEGINNING)
    variables = {"PYTHONPATH": str(modules), "BEGUN": str(processes)}
    with begun(command.split(), tmp_path, environment=variables) as process:
        until(lambda: len(list(processes.iterdir())) >= COMMANDS[command], process)
        press_ctrl_c(process, tmp_path)

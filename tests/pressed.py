"""Ctrl-C as a terminal sends it: to a command and all its processes. Conditions have deadlines, there are no delays."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
_BEGIN_S, _END_S = 180.0, 20.0
_ENTRY = "import sys; from rig_cli.entry import main; sys.argv[0] = 'rig'; main()"


@contextlib.contextmanager
def begun(
    arguments: Sequence[str], folder: Path, before: str = "", environment: Mapping[str, str] | None = None
) -> Generator[subprocess.Popen[bytes]]:
    """Start a command as the foreground of a terminal of its own; the context kills what is left of it.

    Args:
        folder: working folder.
        before: Python statements that run first.
        environment: additional variables.
    """
    # a shell starts background jobs, and with them the tests, with an ignored Ctrl-C
    first = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    variables = {**os.environ, **(environment or {})}
    variables["PYTHONPATH"] = os.pathsep.join(filter(None, [variables.get("PYTHONPATH"), str(ROOT)]))
    process = subprocess.Popen(
        [sys.executable, "-c", f"{first}\n{before}\n{_ENTRY}", *arguments],
        cwd=folder,
        env=variables,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def until(happened: Callable[[], bool], process: subprocess.Popen[bytes]) -> None:
    """Wait for something that a command does."""
    deadline = time.monotonic() + _BEGIN_S
    while not happened():
        assert process.poll() is None, process.communicate()[0].decode()
        assert time.monotonic() < deadline
        time.sleep(0.01)


def press_ctrl_c(process: subprocess.Popen[bytes], folder: Path) -> str:
    """Press Ctrl-C, wait for the orderly end of a command and of all its processes, and return what it printed.

    Then the file `pressed` is in the folder.
    """
    os.killpg(process.pid, signal.SIGINT)
    (folder / "pressed").touch()
    printed = process.communicate(timeout=_END_S)[0].decode()  # each of its processes has the other end of the pipe
    assert process.returncode == 130, printed
    assert "Traceback" not in printed, printed
    assert "Fatal Python error" not in printed, printed
    assert printed.splitlines()[-1] == "rig: interrupted", printed
    return printed

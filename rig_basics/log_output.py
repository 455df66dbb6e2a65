"""Output of the program's log. Without a call of `show_log` the packages write no line anywhere.

Each module logs to `logging.getLogger(__name__)`. A program that imports the packages configures the output with the
standard library's `logging`, or with this module.
"""

from __future__ import annotations

import atexit
import logging
import os
import queue
import threading

from rig_basics.errors import RigError

_FINISH_S = 1.0
_STANDARD_ERROR = 2
_Lines = queue.SimpleQueue[logging.LogRecord | None]

LEVELS: tuple[str, ...] = ("debug", "info", "warning", "error")
"""Names of the levels, the most detailed first."""
VARIABLE = "RIG_LOG_LEVEL"
"""Environment variable through which child processes get the level."""
PACKAGES: tuple[str, ...] = (
    "analysis",
    "daq",
    "dynamics",
    "identification",
    "live",
    "reproduction",
    "rig_cli",
    "rig_configs",
    "rig_drivers",
    "rig_testing",
    "studies",
    "uncertainty",
)
"""Packages whose lines are shown."""


class UnknownLevel(RigError, ValueError):
    """The name is not that of a level. The message lists the levels."""


def show_log(level: str) -> None:
    """Write the packages' lines to standard error, also those of processes that are started afterwards.

    A thread of its own writes them: a terminal that is held (Ctrl-S) or a full pipe delays no reader of a device and no
    stop of a rotor. What it has not written at the end of the program is lost with a terminal that stays held.

    Args:
        level: least level of a line that is written, one of `LEVELS`.
    Raises:
        UnknownLevel: the level has another name.
    """
    name = level.lower()
    if name not in LEVELS:
        raise UnknownLevel(f"log level {level!r}: expected one of {', '.join(LEVELS)}")
    from logging.handlers import QueueHandler  # noqa: PLC0415 (imports sockets; only if lines are shown)

    os.environ[VARIABLE] = name
    lines: _Lines = queue.SimpleQueue()
    handler = QueueHandler(lines)
    writer = threading.Thread(target=_write, args=(lines,), name="log", daemon=True)
    writer.start()
    atexit.register(_finish, lines, writer)
    for package in PACKAGES:
        log = logging.getLogger(package)
        log.handlers = [handler]
        log.setLevel(name.upper())
        log.propagate = False


def _write(lines: _Lines) -> None:
    """Write lines to the descriptor itself: a lock of `sys.stderr` or of a handler would be held with the terminal."""
    words = logging.Formatter("%(asctime)s %(levelname)s %(processName)s %(name)s: %(message)s")
    while (line := lines.get()) is not None:
        try:
            os.write(_STANDARD_ERROR, f"{words.format(line)}\n".encode(errors="replace"))
        except OSError:  # usual: no program reads standard error any more
            return


def _finish(lines: _Lines, writer: threading.Thread) -> None:
    """Write what is left, for a second at the most: a held terminal must not keep the program."""
    lines.put(None)
    writer.join(_FINISH_S)


def show_log_as_parent() -> None:
    """In a child process, write lines as the parent process does."""
    if level := os.environ.get(VARIABLE):
        show_log(level)

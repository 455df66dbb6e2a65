"""Output of the program's log. Without a call of `show_log` the packages write no line anywhere.

Each module logs to `logging.getLogger(__name__)`. A program that imports the packages configures the output with the
standard library's `logging`, or with this module.
"""

from __future__ import annotations

import logging
import os
import sys

from rig_basics.errors import RigError

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
    "rig_testing",
    "studies",
    "uncertainty",
)
"""Packages whose lines are shown."""


class UnknownLevel(RigError, ValueError):
    """The name is not that of a level. The message lists the levels."""


def show_log(level: str) -> None:
    """Write the packages' lines to standard error, also those of processes that are started afterwards.

    Args:
        level: least level of a line that is written, one of `LEVELS`.
    Raises:
        UnknownLevel: the level has another name.
    """
    name = level.lower()
    if name not in LEVELS:
        raise UnknownLevel(f"log level {level!r}: expected one of {', '.join(LEVELS)}")
    os.environ[VARIABLE] = name
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(processName)s %(name)s: %(message)s"))
    for package in PACKAGES:
        log = logging.getLogger(package)
        log.handlers = [handler]
        log.setLevel(name.upper())
        log.propagate = False


def show_log_as_parent() -> None:
    """In a child process, write lines as the parent process does."""
    if level := os.environ.get(VARIABLE):
        show_log(level)

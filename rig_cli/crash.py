"""Handling of unexpected errors: exit code 70, one line, and a file for the developers."""

from __future__ import annotations

import contextlib
import os
import platform
import re
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Sequence
from pathlib import Path

from rig_cli import answer

UNEXPECTED = 70
"""EX_SOFTWARE of sysexits.h: an error of the program, not of the input, the rig or the verdict."""

_PACKAGES = ("pendulum-balancer-rig", "numpy", "scipy", "numba", "pydantic", "cyclopts", "mcap", "h5py", "pyarrow")
_SECRET = re.compile(r"(?i)((?:token|password|passwd|secret|api[-_]?key)[=: ]+)\S+|(?<=://)[^/@\s]+@")
_LONGEST_ARGUMENT = 500


def report(error: BaseException, arguments: Sequence[str]) -> int:
    """Print one line about an unexpected error and write a file with all that a developer needs. Never raises.

    Args:
        error: the unexpected error.
        arguments: the command line.
    Returns:
        The exit code, 70.
    """
    with contextlib.suppress(Exception):  # usual: the fault is noted below
        text = _page(error, arguments)
        path = _write(text)
        what = f"unexpected error: {_one_line(error)}"
        sent = f"{what}; this is an error of the program. Please send {path}"
        if path is None:
            print(f"rig: {what}; no report could be written, please send this:\n{text}", file=sys.stderr, flush=True)
            sent = f"{what}; this is an error of the program. Please send the text on standard error"
        else:
            print(f"rig: {sent}", file=sys.stderr, flush=True)
        answer.note_fault(sent, UNEXPECTED)
    answer.note_fault(f"unexpected error: {type(error).__name__}", UNEXPECTED)
    return UNEXPECTED


def watch_threads(arguments: Sequence[str]) -> None:
    """Report errors that end a thread in the same way; the command then ends with 70 instead of 0."""

    def ended(what: threading.ExceptHookArgs) -> None:
        error = what.exc_value
        if error is None or isinstance(error, SystemExit):
            return
        name = what.thread.name if what.thread is not None else "a thread"
        error.add_note(f"in the thread {name!r}")
        report(error, arguments)

    threading.excepthook = ended


def _one_line(error: BaseException) -> str:
    try:
        text = " ".join(str(error).split())
    except Exception:  # usual: the error's own __str__ raises
        text = ""
    return _SECRET.sub(_masked, f"{type(error).__name__}: {text[:200]}" if text else type(error).__name__)


def _masked(found: re.Match[str]) -> str:
    return f"{found[1] or ''}***" if found[1] else "***@"


def _page(error: BaseException, arguments: Sequence[str]) -> str:
    shown = [a if len(a) <= _LONGEST_ARGUMENT else f"{a[:_LONGEST_ARGUMENT]}…" for a in arguments]
    versions = ", ".join(f"{name} {_version(name)}" for name in _PACKAGES)
    try:
        trace = "".join(traceback.format_exception(error))
    except Exception as fault:  # the error's own __str__ raises
        trace = f"{type(error).__name__} (no traceback: {type(fault).__name__})\n"
    text = (
        "The `rig` command ended with an unexpected error. Please send this file to the developers, with the\n"
        "rig file and, if a log was read, the log.\n\n"
        f"command line  rig {' '.join(map(repr, shown))}\n"
        f"when          {time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime())}\n"
        f"versions      {versions}\n"
        f"python        {platform.python_version()} on {platform.platform()}\n\n"
        f"{trace}"
    )
    return _SECRET.sub(_masked, text)


def _version(name: str) -> str:
    try:
        from importlib import metadata  # needed by no command that works

        return metadata.version(name)
    except Exception:  # usual: an optional package is not installed
        return "absent"


def _write(text: str) -> Path | None:
    """Write a new file to the folder for temporary files, else to the current folder, readable by the user alone.

    Returns:
        Its path; None if neither folder can be written to. Existing files are never overwritten.
    """
    for folder in (tempfile.gettempdir, os.getcwd):
        with contextlib.suppress(Exception):  # usual: the folder cannot be written to
            number, name = tempfile.mkstemp(time.strftime("-%Y%m%d-%H%M%S.txt"), "rig-error-", folder())
            with open(number, "w", encoding="utf-8", errors="backslashreplace") as file:
                file.write(text)
            return Path(name)
    return None

"""Quantities and texts as people read them on a terminal."""

from __future__ import annotations

import sys
from datetime import datetime

from rich.console import Console

_PLAIN_WIDTH = 400  # where no terminal sets one


class _Stdout(Console):
    """A console that leaves a closed pipe to the command, which knows the exit code."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


def stdout_console() -> Console:
    """Standard output: as wide as the terminal, or without an end where there is none."""
    return _Stdout(highlight=False, markup=False, width=None if sys.stdout.isatty() else _PLAIN_WIDTH)


def printable(text: object) -> str:
    """Text of any origin in one line, without what would move the cursor or change colours."""
    return "".join(letter if letter.isprintable() else " " for letter in str(text))


def local_time(text: str) -> str:
    """An instant in local time; what is none stays as it is."""
    try:
        return f"{datetime.fromisoformat(text).astimezone():%Y-%m-%d %H:%M:%S}"
    except (ValueError, OverflowError, OSError):
        return text


def length(seconds: float) -> str:
    """A duration for people."""
    for unit, name in ((3600.0, "h"), (60.0, "min")):
        if seconds >= 1.5 * unit:
            return f"{seconds / unit:.2f} {name}"
    return f"{seconds:.1f} s"


def size(count: int) -> str:
    """Bytes for people."""
    value, unit = float(count), "B"
    for unit in ("B", "kB", "MB", "GB"):
        if value < 1000 or unit == "GB":
            break
        value /= 1000
    return f"{value:.0f} {unit}" if unit == "B" else f"{value:.1f} {unit}"


def percent(share: float) -> str:
    """A share as people read it: two digits, no exponent while that is short."""
    value = 100 * share
    if not value < float("inf"):
        return "—"
    return f"{value:.2g} %" if value >= 1e-4 or value == 0 else f"{value:.1e} %"

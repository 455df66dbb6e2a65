"""Table of many logs on the terminal, with the columns that fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.cells import cell_len, set_cell_size
from rich.text import Text

from daq.catalogue.entry import Entry
from daq.log.outcome import not_reached
from rig_basics.texts import number_of
from rig_cli.console import notify
from rig_cli.words import length, local_time, printable, size, stdout_console

STATES = {
    "finished": ("finished", "green"),
    "recovered": ("recovered", "yellow"),
    "unfinished": ("unfinished", "bold yellow"),
    "damaged": ("damaged", "bold red"),
    "foreign": ("foreign", "dim"),
    "unreadable": ("unreadable", "bold red"),
}
VERDICTS = {"pass": "green", "": "dim", "stale": "yellow"}
_GAP = 2  # between columns


@dataclass(frozen=True)
class _Column:
    """A column of the table.

    Attributes:
        of: returns text and style of an entry.
        least: width to which it can be shortened; 0 if it cannot.
        keep: priority; the column with the lowest is left out first if the terminal is too narrow.
    """

    title: str
    of: Callable[[Entry], tuple[str, str]]
    least: int = 0
    keep: int = 0
    right: bool = False


def _lost(entry: Entry) -> tuple[str, str]:
    if entry.lost is None:
        return "?", "dim"
    return (str(entry.lost), "bold red") if entry.lost else ("0", "dim")


_COLUMNS = (
    _Column("started", lambda e: (local_time(e.started)[:16], ""), keep=8),
    _Column("log", lambda e: (e.path, "bold"), least=22, keep=10),
    _Column("test", lambda e: (e.test, ""), keep=5),
    _Column("point", lambda e: (e.point, ""), keep=4),
    _Column("length", lambda e: (length(e.duration_s), ""), keep=6, right=True),
    _Column("size", lambda e: (size(e.size_bytes), ""), keep=2, right=True),
    _Column("state", lambda e: STATES[e.state], keep=9),
    _Column("lost", _lost, keep=9, right=True),
    _Column("verdict", lambda e: (e.verdict, VERDICTS.get(e.verdict, "bold red")), keep=7),
    _Column("rig", lambda e: (e.rig, ""), keep=3),
    _Column("parameters", lambda e: (e.parameters, ""), least=16, keep=1),
    _Column("note", lambda e: (e.note or e.why, "" if e.note else "dim"), least=12, keep=4),
    _Column("not reached", lambda e: (not_reached(e.test, e.outcome), "bold red"), least=14, keep=7),
)


def print_logs(entries: Sequence[Entry], files: int, folder: Path) -> None:
    """Print the table on standard output in the requested order, and a closing line on standard error."""
    if not entries:
        notify(f"{folder}: no logs" if files == 0 else f"{folder}: none of {number_of(files, 'log')} matches")
        return
    console = stdout_console()
    columns = _that_fit(entries, console.width)
    table = Text(end="")
    _add_row(table, [(column.title, "bold") for column, _ in columns], columns)
    table.append("─" * (sum(width + _GAP for _, width in columns) - _GAP) + "\n", "dim")
    for entry in entries:
        _add_row(table, [column.of(entry) for column, _ in columns], columns)
    console.print(table, soft_wrap=True, end="")  # rich's own table takes half a second for a thousand logs
    notify(_closing(entries, files))


def _add_row(table: Text, cells: Sequence[tuple[str, str]], columns: Sequence[tuple[_Column, int]]) -> None:
    for number, ((text, style), (column, width)) in enumerate(zip(cells, columns, strict=True)):
        shown = set_cell_size(_shortened(printable(text), width), width)
        shown = " " * (len(shown) - len(shown.rstrip())) + shown.rstrip() if column.right else shown
        table.append(shown, style)
        table.append("\n" if number == len(columns) - 1 else " " * _GAP)


def _shortened(text: str, width: int) -> str:
    return text if cell_len(text) <= width else set_cell_size(text, width - 1).rstrip() + "…"


def _that_fit(entries: Sequence[Entry], room: int) -> list[tuple[_Column, int]]:
    """Return the columns with contents and their widths; those of low priority are left out, then others shortened."""
    widths: dict[_Column, int] = {}
    for column in _COLUMNS:
        widest = max(cell_len(printable(column.of(entry)[0])) for entry in entries)
        if widest:
            widths[column] = max(widest, len(column.title))
    least = {column: min(width, column.least or width) for column, width in widths.items()}
    while len(least) > 1 and sum(least.values()) + _GAP * (len(least) - 1) > room:
        del least[min(least, key=lambda column: column.keep)]
    left = room - sum(least.values()) - _GAP * (len(least) - 1)
    chosen: list[tuple[_Column, int]] = []
    for column, width in least.items():
        more = max(0, min(widths[column] - width, left))
        left -= more
        chosen.append((column, width + more))
    return chosen


def _closing(entries: Sequence[Entry], files: int) -> str:
    broken = sum(not entry.complete for entry in entries)
    lossy = sum(bool(entry.lost) for entry in entries)
    parts = [f"{len(entries)} of {number_of(files, 'log')}" if len(entries) != files else number_of(files, "log")]
    parts += [f"{broken} not whole"] if broken else []
    parts += [f"{lossy} with losses"] if lossy else []
    return ", ".join(parts)

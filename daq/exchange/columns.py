"""What a file recorded elsewhere is once it is open: columns of numbers by their names."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from daq.exchange.errors import ExchangeError
from daq.exchange.unit_words import name_and_unit

_NAMES_SHOWN = 40


@dataclass(frozen=True)
class Column:
    """One column as it stands in the file.

    Attributes:
        name: in the file.
        values: int64 where every value is a whole number, otherwise float64, shape (n,); NaN where the file says that
            there is no number; anything where it is absent.
        absent: true where the file holds nothing at all, shape (n,).
        lines: line of each row in a text file, its number in another, shape (n,); None: rows are counted from 1.
        counted: what `lines` counts, "line" or "row".
    """

    name: str
    values: NDArray[Any]
    absent: NDArray[np.bool_]
    lines: NDArray[np.int64] | None = None
    counted: str = "line"

    def place(self, row: int) -> str:
        """Where a row is, for messages."""
        return f"row {row + 1}" if self.lines is None else f"{self.counted} {self.lines[row]}"

    def keep(self, rows: NDArray[Any]) -> Column:
        """The rows of a mask or of indices."""
        lines = np.arange(1, len(self.values) + 1) if self.lines is None else self.lines
        counted = "row" if self.lines is None else self.counted
        return Column(self.name, self.values[rows], self.absent[rows], lines[rows], counted)


class Recording(Protocol):
    """An open file of columns."""

    path: Path

    @property
    def others(self) -> Mapping[str, str]:
        """What else the file holds and is no column of numbers: what each is, by name."""
        ...

    @property
    def names(self) -> Sequence[str]:
        """Every column's name, in the file's order."""
        ...

    @property
    def units(self) -> Mapping[str, str]:
        """Units by name, words of daq.exchange.units, as far as the file gives them where its columns are named."""
        ...

    def read(self, names: Iterable[str]) -> Mapping[str, Column]:
        """Columns by their names in the file.

        Raises:
            ExchangeError: a column holds something other than numbers; the message says where.
        """
        ...


def pick(recording: Recording, wanted: str, option: str) -> str:
    """The name in the file that was meant: the name itself, or the column's number counted from 1.

    Raises:
        ExchangeError: no such column; the message lists what there is.
    """
    names = list(recording.names)
    if wanted in names:
        return wanted
    if wanted.isascii() and wanted.isdigit() and 1 <= int(wanted) <= len(names):
        return names[int(wanted) - 1]
    if wanted in recording.others:
        raise ExchangeError(
            f"{recording.path}: {option}: expected a column of numbers, {wanted!r} is {recording.others[wanted]}"
        )
    without_unit = [name for name in names if name_and_unit(name) == (wanted, recording.units.get(name, ""))]
    if len(without_unit) == 1:
        return without_unit[0]
    near = difflib.get_close_matches(wanted, names, 1, 0.4)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    shown = ", ".join(repr(name) for name in names[:_NAMES_SHOWN]) + (" …" if len(names) > _NAMES_SHOWN else "")
    shown = shown or "(the file has none)"
    raise ExchangeError(f"{recording.path}: {option}: expected one of the columns {shown}, got {wanted!r}{hint}")


def as_column(name: str, values: NDArray[Any], absent: NDArray[np.bool_] | None = None) -> Column:
    """A column of numbers from an array (n,) of any integers or floats.

    Raises:
        ExchangeError: the array holds no numbers.
    """
    if values.dtype.kind in "iub":
        whole = values.dtype.kind == "b" or not len(values) or int(values.max()) < 2**63
        values = values.astype(np.int64 if whole else np.float64)
    elif values.dtype.kind == "f":
        values = values.astype(np.float64)
    else:
        raise ExchangeError(f"{name}: expected numbers, got {values.dtype}; times too must be numbers, say seconds")
    return Column(name, values, np.zeros(len(values), bool) if absent is None else absent)

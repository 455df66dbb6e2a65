"""An open recording of another program: columns of numbers by name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.exchange.errors import ExchangeError
from daq.exchange.units import name_and_unit
from rig_basics.texts import did_you_mean

_NAMES_SHOWN = 40
_NAMES_COMPARED = 1000  # each comparison takes some 30 µs


@dataclass(frozen=True)
class Column:
    """One column of a file.

    Attributes:
        name: name in the file.
        values: int64 if every value is a whole number, otherwise float64, shape (n,); NaN for a text such as "n/a";
            undefined for absent values.
        absent: True for values that are missing in the file, shape (n,).
        lines: line of each row in a text file, its number in another file, shape (n,); None: rows count from 1.
        counted: unit of `lines`, "line" or "row".
    """

    name: str
    values: NDArray[Any]
    absent: NDArray[np.bool_]
    lines: NDArray[np.int64] | None = None
    counted: str = "line"

    def place(self, row: int) -> str:
        """Return the position of a row, for messages."""
        return f"row {row + 1}" if self.lines is None else f"{self.counted} {self.lines[row]}"

    def keep(self, rows: NDArray[Any]) -> Column:
        """Return the rows of a mask or of indices."""
        lines = np.arange(1, len(self.values) + 1) if self.lines is None else self.lines
        counted = "row" if self.lines is None else self.counted
        return Column(self.name, self.values[rows], self.absent[rows], lines[rows], counted)


class ColumnFile(ABC):
    """An open file of columns.

    Attributes:
        path: path of the file.
        names: names of all columns, in the file's order.
        units: units by name, words of daq.exchange.units, for columns whose unit is in the file.
        others: contents that are not columns of numbers: description by name.
        remarks: parts of the file that were left out when columns were read, as sentences.
    """

    def __init__(self, path: Path) -> None:
        self.path: Path = path
        self.names: tuple[str, ...] = ()
        self.units: Mapping[str, str] = {}
        self.others: dict[str, str] = {}
        self.remarks: list[str] = []

    @abstractmethod
    def read(self, names: Iterable[str]) -> Mapping[str, Column]:
        """Read columns by their names in the file.

        Raises:
            ExchangeError: a column contains something other than numbers; the message contains the place.
        """


def pick(recording: ColumnFile, wanted: str, field: str) -> str:
    """Return the name of a column in the file, given the name or its number counted from 1.

    Raises:
        ExchangeError: the column does not exist; the message lists the existing ones.
    """
    names = recording.names
    if wanted in names:
        return wanted
    if wanted.isascii() and wanted.isdigit() and 1 <= int(wanted) <= len(names):
        return names[int(wanted) - 1]
    if wanted in recording.others:
        raise ExchangeError(
            f"{recording.path}: {field}: expected a column of numbers, {wanted!r} is {recording.others[wanted]}"
        )
    without_unit = [name for name in names if name_and_unit(name) == (wanted, recording.units.get(name, ""))]
    if len(without_unit) == 1:
        return without_unit[0]
    hint = did_you_mean(wanted, names[:_NAMES_COMPARED])
    shown = ", ".join(repr(name) for name in names[:_NAMES_SHOWN]) + (" …" if len(names) > _NAMES_SHOWN else "")
    shown = shown or "(the file has none)"
    raise ExchangeError(f"{recording.path}: {field}: expected one of the columns {shown}, got {wanted!r}{hint}")


def as_column(name: str, values: NDArray[Any], absent: NDArray[np.bool_] | None = None) -> Column:
    """Convert an array (n,) of any integers or floats to a column.

    Raises:
        ExchangeError: the array does not contain numbers.
    """
    if values.dtype.kind in "iub":
        whole = values.dtype.kind == "b" or not len(values) or int(values.max()) < 2**63
        values = values.astype(np.int64 if whole else np.float64)
    elif values.dtype.kind == "f":
        values = values.astype(np.float64)
    else:
        raise ExchangeError(
            f"{name}: expected numbers, got {values.dtype}; times must be numbers too, for example seconds"
        )
    return Column(name, values, np.zeros(len(values), bool) if absent is None else absent)

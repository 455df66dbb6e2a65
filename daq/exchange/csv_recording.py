"""Text files of numbers: csv, tsv, semicolons and decimal commas, blanks; comments, names and units above."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq.exchange.columns import Column, ColumnFile
from daq.exchange.csv_dialect import LONGEST_LINE, DecimalEvidence, Dialect, is_comment, need_end, sniff
from daq.exchange.errors import ExchangeError
from rig_basics.texts import number_of

_BLOCK_ROWS = 50_000
_LONGEST_SHOWN = 40

_Block = tuple[NDArray[Any], NDArray[np.bool_], NDArray[np.int64]]
"""Values of some rows, which of them are absent, and their lines."""


class CsvRecording(ColumnFile):
    """Text file, read in blocks of rows of which only the requested columns are kept.

    A last line without a line end was cut while it was written, perhaps within a number: it is left out.
    """

    def __init__(self, path: Path, decimal: str | None = None) -> None:
        super().__init__(path)
        self._dialect = sniff(path, decimal)
        self.names: tuple[str, ...] = self._dialect.names
        self.units: Mapping[str, str] = self._dialect.units

    @override
    def read(self, names: Iterable[str]) -> Mapping[str, Column]:
        wanted = {name: self.names.index(name) for name in names}
        parts: dict[str, list[_Block]] = {name: [] for name in wanted}
        evidence = DecimalEvidence(self._dialect)
        for lines, rows in self._blocks(list(wanted.values())):
            for position, name in enumerate(wanted):
                cells = [row[position] for row in rows]
                if not evidence.is_shown:
                    evidence.add(name, cells, lines)
                parts[name].append(self._block(name, cells, lines))
        self._refuse_doubt(evidence)
        return {name: _joined(name, blocks) for name, blocks in parts.items()}

    def _refuse_doubt(self, evidence: DecimalEvidence) -> None:
        doubt = evidence.doubt()
        if doubt is not None:
            line, cell = doubt
            sign = {",": "comma", ".": "point"}[self._dialect.decimal]
            raise ExchangeError(
                f"{self.path}: line {line}: expected to know whether the {sign} in {cell!r} is the decimal sign or "
                "separates thousands, and no number of these columns shows it; state the decimal sign, "
                'decimal = "." or ","'
            )

    def _blocks(self, wanted: list[int]) -> Iterator[tuple[list[int], list[list[str]]]]:
        """Yield line numbers and the cells of the wanted columns, a block of rows at a time."""
        dialect, width = self._dialect, len(self.names)
        numbers: list[int] = []
        rows: list[list[str]] = []
        with open(self.path, encoding=dialect.encoding, errors="replace", newline=None) as file:
            for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE), ""), 1):
                need_end(line, self.path, number)
                if number < dialect.first_line or is_comment(line):
                    continue
                if not line.endswith("\n"):
                    self.remarks[:] = [
                        f"{self.path}: line {number}, the last one, has no line end: it was cut while it was written, "
                        "and is left out"
                    ]
                    break
                cells = self._cells(dialect, line, number)
                if len(cells) != width:
                    raise ExchangeError(
                        f"{self.path}: line {number}: expected {number_of(width, 'column')} as in line "
                        f"{dialect.first_line}, "
                        f"got {len(cells)}; is the file cut there?"
                    )
                numbers.append(number)
                rows.append([cells[index] for index in wanted])
                if len(rows) >= _BLOCK_ROWS:
                    yield numbers, rows
                    numbers, rows = [], []
        if rows:
            yield numbers, rows

    def _cells(self, dialect: Dialect, line: str, number: int) -> list[str]:
        try:
            return dialect.split(line)
        except csv.Error as fault:
            raise ExchangeError(f"{self.path}: line {number}: expected a row of a csv file ({fault})") from fault

    def _block(self, name: str, cells: list[str], lines: list[int]) -> _Block:
        values = _plain_numbers(cells) if self._dialect.decimal == "." else None
        values = self._any_numbers(name, cells, lines) if values is None else values
        return values, np.array([not cell for cell in cells], bool), np.array(lines, np.int64)

    def _any_numbers(self, name: str, cells: list[str], numbers: list[int]) -> NDArray[Any]:
        values: list[float | int] = []
        for cell, number in zip(cells, numbers, strict=True):
            try:
                values.append(self._dialect.number(cell) if cell else 0)
            except ValueError:
                shown = cell if len(cell) <= _LONGEST_SHOWN else f"{cell[:_LONGEST_SHOWN]}…"
                raise ExchangeError(
                    f"{self.path}: line {number}: expected a number in column {name!r} with "
                    f"{'a decimal comma' if self._dialect.decimal == ',' else 'a decimal point'}, got {shown!r}"
                ) from None
        return _array(values)


def _joined(name: str, blocks: list[_Block]) -> Column:
    if not blocks:
        return Column(name, np.empty(0), np.empty(0, bool), np.empty(0, np.int64))
    values, absent, lines = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    return Column(name, values, absent, lines)


def _array(values: list[float | int]) -> NDArray[Any]:
    """Return int64 if all values are whole numbers in range, otherwise float64."""
    if all(type(value) is int for value in values):
        try:
            return np.array(values, np.int64)
        except OverflowError:  # usual: larger than int64
            pass
    try:
        return np.array(values, np.float64)
    except OverflowError:  # usual: larger than float64
        return np.array([float(str(value)) for value in values])


def _plain_numbers(cells: list[str]) -> NDArray[Any] | None:
    """Convert cells that are all plain numbers, the usual case, in a third of the time; None for others."""
    if any("_" in cell for cell in cells):
        return None
    try:
        if cells[0].lstrip("+-").isdecimal():
            return np.array([int(cell) for cell in cells], np.int64)
    except (ValueError, OverflowError):  # usual: not whole numbers of 64 bits
        pass
    try:
        return np.array([float(cell) for cell in cells])
    except ValueError:  # usual: the cells are read one by one
        return None

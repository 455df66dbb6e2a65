"""Dialect of a text file of numbers: encoding, delimiter, decimal sign, position of the names and of the numbers."""

from __future__ import annotations

import codecs
import csv
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from daq.exchange.errors import ExchangeError
from daq.exchange.units import is_unit_row, name_and_unit, unit_word
from rig_basics.texts import number_of

_SAMPLE_LINES = 400
_FEWEST_SAMPLE_LINES = 8  # names, units, and numbers in the second half
LONGEST_LINE = 1_000_000
_LONGEST_SAMPLE = 2 * LONGEST_LINE  # characters, each of which is read once for each dialect
_COMMENTS = ("#", "%", "//", "!")
_BOMS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),  # it begins with the next one
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
    (codecs.BOM_UTF32_BE, "utf-32"),
)
_DIALECTS = (
    ("\t", "."),
    (";", "."),
    (";", ","),
    (",", "."),
    ("|", "."),
    ("\t", ","),
    ("|", ","),
    (None, "."),
    (None, ","),
)
_SPLIT_WRONGLY = re.compile(r"[0-9][^A-Za-z]*[;|\t^&~][^A-Za-z]*[0-9]")  # two numbers and a delimiter between them
_GROUPED = {  # a number that may be grouped by thousands: 2,995 or 1,234,567; no group begins with 0
    sign: re.compile(rf"[+-]?[1-9][0-9]{{0,2}}(?:{re.escape(sign)}[0-9]{{3}})+") for sign in ",."
}
_WHOLE_GROUP = re.compile(r"[+-]?[0-9]{1,3}")  # a number that has no separator of thousands
_GROUPED_FRACTION = {
    ".": re.compile(r"[+-]?[1-9][0-9]{0,2}(?:,[0-9]{3})+(?:\.[0-9]+)?"),
    ",": re.compile(r"[+-]?[1-9][0-9]{0,2}(?:\.[0-9]{3})+(?:,[0-9]+)?"),
}
_NO_NUMBER = frozenset(("nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "---"))


@dataclass(frozen=True)
class Dialect:
    """Dialect of one file.

    Attributes:
        encoding: Python's name of the encoding.
        delimiter: one character; None: any run of blanks.
        decimal: decimal sign, "." or ",".
        names: names of the columns; "1", "2" … if the file has none.
        first_line: first line of numbers, counted from 1.
        units: units by column name, words of daq.exchange.units, if the file contains them.
        stated: whether the decimal sign was stated, so that the other sign separates thousands.
    """

    encoding: str
    delimiter: str | None
    decimal: str
    names: tuple[str, ...]
    first_line: int
    units: Mapping[str, str] = field(default_factory=dict[str, str])
    stated: bool = False

    def split(self, line: str) -> list[str]:
        """Return the cells of a line, without surrounding blanks and quotes."""
        if self.delimiter is None:
            return line.split()
        if '"' in line:
            cells = next(csv.reader([line], delimiter=self.delimiter, skipinitialspace=True), list[str]())
        else:
            cells = line.split(self.delimiter)
        return [cell.strip() for cell in cells]

    def number(self, cell: str) -> float | int:
        """Return the number in a cell; NaN for a text that means "no number".

        Raises:
            ValueError: the cell contains something else.
        """
        if "_" in cell:
            raise ValueError(cell)  # Python accepts 1_000, other programs do not
        if self.stated and _GROUPED_FRACTION[self.decimal].fullmatch(cell):
            cell = cell.replace("." if self.decimal == "," else ",", "")
        if self.decimal == ",":
            if "." in cell:
                raise ValueError(cell)
            cell = cell.replace(",", ".")
        try:
            return int(cell)
        except ValueError:  # usual: not a whole number
            pass
        try:
            return float(cell)
        except ValueError:
            if cell.lower() in _NO_NUMBER:
                return math.nan
            raise


class DecimalEvidence:
    """Evidence on whether the decimal sign of a file may be a separator of thousands.

    Numbers such as 0,985 and 12,5 show a decimal sign. 2,995 does not, if every other number with the sign has groups
    of three digits as well and every number without it has at most three digits: then it may be two thousand nine
    hundred and ninety-five. A point is taken for a separator of thousands only if a column has numbers with and
    without it, because programs write all values of a column with the same number of decimals.
    """

    def __init__(self, dialect: Dialect) -> None:
        self._sign = dialect.decimal
        self._grouped = _GROUPED[dialect.decimal]
        self._without: set[str] = set()
        self._with: dict[str, tuple[int, str]] = {}
        self.is_shown: bool = dialect.stated or dialect.delimiter == ","

    def add(self, column: str, cells: Sequence[str], lines: Sequence[int]) -> None:
        """Add cells of a column with their lines; texts that are not numbers are passed over."""
        for cell, line in zip(cells, lines, strict=True):
            if self._sign in cell:
                self.is_shown = self.is_shown or not self._grouped.fullmatch(cell)
                self._with.setdefault(column, (line, cell))
            elif _WHOLE_GROUP.fullmatch(cell):
                self._without.add(column)
            else:
                self.is_shown = self.is_shown or cell.lstrip("+-").isdecimal()
            if self.is_shown:
                return

    def doubt(self) -> tuple[int, str] | None:
        """Return line and cell of a number whose size is uncertain; None if there is none."""
        doubtful = self._with if self._sign == "," else {c: at for c, at in self._with.items() if c in self._without}
        return None if self.is_shown else next(iter(doubtful.values()), None)


def is_comment(line: str) -> bool:
    """Return True for an empty line or a comment."""
    return not line.strip() or line.lstrip().startswith(_COMMENTS)


def need_end(line: str, path: Path, number: int) -> None:
    """Raise for a line that fills the memory before it ends.

    Raises:
        ExchangeError: the line is as long as `LONGEST_LINE`, at which reading stopped.
    """
    if len(line) >= LONGEST_LINE:
        raise ExchangeError(
            f"{path}: line {number}: expected a row of numbers, this line has more than {LONGEST_LINE:,} characters"
        )


def sniff(path: Path, decimal: str | None = None) -> Dialect:
    """Determine the dialect of a file from its first lines.

    Args:
        decimal: the decimal sign, "." or ","; None: it is found.
    Raises:
        ExchangeError: the file is not text, or contains no columns of numbers.
    """
    encoding = _encoding(path)
    lines = _sample(path, encoding)
    best: tuple[tuple[float, int, int], Dialect] | None = None
    for place, (delimiter, sign) in enumerate(_DIALECTS):
        if decimal not in (None, sign):
            continue
        dialect = Dialect(encoding, delimiter, sign, (), 1, stated=decimal is not None)
        share, width = _fit(dialect, lines)
        score = (round(share, 2), width, -place)
        if share > 0 and (best is None or score > best[0]):
            best = score, dialect
    if best is None:
        raise ExchangeError(
            f"{path}: expected columns of numbers, found none in the first {number_of(len(lines), 'line')}"
        )
    dialect = _with_names(best[1], lines)
    is_doubtful = dialect.names == ("1", "2") and dialect.delimiter == "," and not dialect.stated
    if is_doubtful and _could_be_decimal(dialect, lines):
        raise ExchangeError(
            f"{path}: line {dialect.first_line}: expected to know whether a comma is a decimal comma or a second "
            "column begins there; put a line with the names of the columns, such as t,x, above the numbers"
        )
    return dialect


def _sample(path: Path, encoding: str) -> list[str]:
    """Return the first lines of a file; fewer if they are long."""
    lines, size = list[str](), 0
    with open(path, encoding=encoding, errors="replace", newline=None) as file:
        while len(lines) < _SAMPLE_LINES and (size < _LONGEST_SAMPLE or len(lines) < _FEWEST_SAMPLE_LINES):
            line = file.readline(LONGEST_LINE)
            need_end(line, path, len(lines) + 1)
            if not line:
                break
            size += len(line)
            lines.append(line.rstrip("\n"))
    return lines


def _could_be_decimal(dialect: Dialect, lines: Sequence[str]) -> bool:
    """Return True if both of two columns contain whole numbers only, the second without a sign."""
    rows = [_cells(dialect, line) for line in lines[dialect.first_line - 1 :] if not is_comment(line)]
    return all(row[0].lstrip("+-").isdecimal() and row[-1].isdecimal() for row in rows if len(row) == 2)


def _encoding(path: Path) -> str:
    with open(path, "rb") as file:
        start = file.read(4)
        for mark, name in _BOMS:
            if start.startswith(mark):
                return name
        file.seek(0)
        decoder, is_utf8 = codecs.getincrementaldecoder("utf-8")(), True
        while block := file.read(1 << 20):
            if b"\0" in block:
                raise ExchangeError(f"{path}: expected text, parquet, mat or hdf5, got other bytes")
            if is_utf8:
                try:
                    decoder.decode(block)
                except UnicodeDecodeError:  # usual: the other encoding
                    is_utf8 = False
    return "utf-8" if is_utf8 else "latin-1"


def _numbers(dialect: Dialect, cells: Sequence[str]) -> int:
    """Return the number of cells that are numbers or mean "no number"."""
    count = 0
    for cell in cells:
        try:
            dialect.number(cell)
        except ValueError:  # usual: a cell that is not counted
            continue
        count += 1
    return count


def _cells(dialect: Dialect, line: str) -> list[str]:
    try:
        return dialect.split(line)
    except csv.Error:  # usual: the line is of another dialect
        return []


def _fit(dialect: Dialect, lines: Sequence[str]) -> tuple[float, int]:
    """Share of filled cells that are numbers in the second half of the sample, and the usual number of cells."""
    rows = [_cells(dialect, line) for line in lines if not is_comment(line)]
    rows = rows[len(rows) // 2 :]
    if not rows:
        return 0.0, 0
    width = Counter(len(row) for row in rows).most_common(1)[0][0]
    fitting = [row for row in rows if len(row) == width]
    filled = [cell for row in fitting for cell in row if cell]
    if any(_SPLIT_WRONGLY.fullmatch(cell) for cell in filled):
        return 0.0, width
    share = _numbers(dialect, filled) / max(1, len(filled)) * len(fitting) / len(rows)
    return share, width


def _with_names(dialect: Dialect, lines: Sequence[str]) -> Dialect:
    """Return the dialect with the columns' names, their units and the first line of numbers."""
    rows = [(number, line, _cells(dialect, line)) for number, line in enumerate(lines, 1) if line.strip()]
    data = [row for row in rows if not is_comment(row[1])]
    width = Counter(len(cells) for _, _, cells in data[len(data) // 2 :]).most_common(1)[0][0]
    first = next(
        number
        for number, _, cells in data
        if len(cells) == width and _numbers(dialect, cells) and not is_unit_row(cells)
    )
    names, units = _heads(dialect, rows, first, width)
    distinct = _distinct(names or [str(i) for i in range(1, width + 1)])
    known_units = {
        name: unit
        for name, given, below in zip(distinct, names or distinct, units, strict=True)
        if (unit := unit_word(below) if below else name_and_unit(given)[1]) is not None
    }
    return replace(dialect, names=distinct, first_line=first, units=known_units)


def _heads(
    dialect: Dialect, rows: Sequence[tuple[int, str, list[str]]], first: int, width: int
) -> tuple[list[str], list[str]]:
    """Return names and units of the columns from the lines above the numbers; empty if the file has none.

    Units may be below or above the names, also in a comment. A single line of units is used as names too.
    """
    names: list[str] = []
    remarked: list[str] | None = None
    units: list[str] = []
    for number, line, plain in reversed(rows):
        if number >= first:
            continue
        remark = is_comment(line)
        cells = _cells(dialect, line.lstrip().lstrip("#%/! ")) if remark else plain
        fits = len(cells) == width
        if fits and not units and is_unit_row(cells):
            units = cells
        elif remark:
            if remarked is None:  # the comment nearest to the numbers, or none
                remarked = cells if fits and not _numbers(dialect, cells) else []
        elif not fits or names:
            break  # a title, or a line above the names that does not contain units
        else:
            names = cells
    return names or remarked or units, units or [""] * width


def _distinct(names: Sequence[str]) -> tuple[str, ...]:
    """Return unique names: names that occur twice get the column's number."""
    times = Counter(names)
    return tuple(
        name if name and times[name] == 1 else f"{name} (column {i})".lstrip() for i, name in enumerate(names, 1)
    )

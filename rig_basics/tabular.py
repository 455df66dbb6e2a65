"""Results that print as a table of one screen and become a data frame."""

from __future__ import annotations

import textwrap
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rig_basics.errors import RigError
from rig_basics.texts import number_of

Column: TypeAlias = Sequence[object] | NDArray[Any]
_WIDTH, _LINES, _ROWS = 100, 24, 14  # of a screen: characters, lines, and rows of the table
_GAP, _MORE = "  ", "…"


class Tabular(ABC):
    """Result with a table, a heading and remarks.

    `print(result)` shows a summary of at most 24 lines of 100 characters; the data frame contains every row.
    """

    @abstractmethod
    def columns(self) -> Mapping[str, Column]:
        """Return the table: name of a column, with its unit → values of all rows, the same number for each."""

    @property
    def heading(self) -> str:
        """First line of the summary."""
        return type(self).__name__

    @property
    def remarks(self) -> Sequence[str]:
        """Sentences below the table."""
        return ()

    def summary(self) -> str:
        """Return heading, table and remarks; rows, columns and remarks beyond a screen are counted."""
        lines = [*textwrap.wrap(self.heading, _WIDTH, max_lines=2), *_table(self.columns())]
        for number, remark in enumerate(self.remarks):
            more = textwrap.wrap(remark, _WIDTH, initial_indent="- ", subsequent_indent="  ")
            if len(lines) + len(more) >= _LINES:
                return "\n".join([*lines, f"{_MORE} {number_of(len(self.remarks) - number, 'more remark')}"])
            lines += more
        return "\n".join(lines)

    def __str__(self) -> str:
        """Summary."""
        return self.summary()

    def to_dataframe(self) -> Any:
        """Return the table as a pandas.DataFrame.

        Raises:
            RigError: pandas is not installed.
        """
        try:
            import pandas as pd  # noqa: PLC0415  # optional
        except ImportError as error:
            raise RigError("a data frame needs pandas: pip install pandas") from error
        return pd.DataFrame({name: list(values) for name, values in self.columns().items()})


def _table(columns: Mapping[str, Column]) -> list[str]:
    """Return the lines of a table that fits a screen: the first and the last rows, and the first columns."""
    blocks = [_block(name, values) for name, values in columns.items()]
    shown, width = list[list[str]](), 0
    for block in blocks:
        width += len(block[0]) + len(_GAP)
        if width > _WIDTH:
            break
        shown.append(block)
    lines = [_GAP.join(cells).rstrip() for cells in zip(*shown, strict=True)]
    left = len(blocks) - len(shown)
    return [*lines, f"{_MORE} {number_of(left, 'more column')}"] if left else lines


def _block(name: str, values: Column) -> list[str]:
    """Return the cells of a column with its name, of one width; numbers stand at the right."""
    half, count = _ROWS // 2, len(values)
    rows = range(count) if count <= _ROWS else [*range(half), *range(count - half, count)]
    cells = [_text(values[row]) for row in rows]
    if count > _ROWS:
        cells.insert(half, _MORE)
    numbers = all(isinstance(values[row], Real) for row in rows)
    width = max(map(len, [name, *cells]))
    return [cell.rjust(width) if numbers else cell.ljust(width) for cell in (name, *cells)]


def _text(value: object) -> str:
    return f"{value:.8g}" if isinstance(value, float | np.floating) else str(value)

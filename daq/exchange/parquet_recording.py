"""Parquet recordings of other programs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.compute
import pyarrow.parquet

from daq.exchange.bombs import refuse_bomb
from daq.exchange.columns import Column, as_column
from daq.exchange.errors import ExchangeError

pa: Any = pyarrow  # has no types
pc: Any = pyarrow.compute
pq: Any = pyarrow.parquet


class ParquetRecording:
    """See daq.exchange.columns.ColumnFile; nulls are absent."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.units: Mapping[str, str] = {}
        self.remarks: Sequence[str] = ()
        self.others: Mapping[str, str] = {}
        try:
            with open(path, "rb") as file:  # pyarrow refuses names that are not UTF-8
                self._schema = pq.read_schema(file)
        except (pa.ArrowException, OSError) as fault:
            raise _unreadable(path, fault) from fault
        self.names: tuple[str, ...] = tuple(self._schema.names)

    def read(self, names: Iterable[str]) -> Mapping[str, Column]:
        """See ColumnFile."""
        wanted = list(names)
        for name in wanted:
            self._need_numbers(name)
        try:
            with open(self.path, "rb") as opened, pq.ParquetFile(opened) as file:
                refuse_bomb(self.path, "", 8 * file.metadata.num_rows * len(wanted))
                table = file.read(columns=wanted)
        except MemoryError:
            raise
        except (pa.ArrowException, OSError) as fault:
            raise _unreadable(self.path, fault) from fault
        return {name: self._column(name, table.column(name)) for name in wanted}

    def _need_numbers(self, name: str) -> None:
        """Check the type before any data of a column is read: texts and lists may have any size."""
        count = self.names.count(name)
        if count > 1:
            raise ExchangeError(f"{self.path}: expected one column {name!r}, got {count}; rename them")
        kind = self._schema.field(name).type
        if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)):
            raise ExchangeError(
                f"{self.path}: expected numbers in column {name!r}, got {kind}; times must be numbers too, for example "
                "seconds"
            )

    def _column(self, name: str, values: Any) -> Column:
        if pa.types.is_decimal(values.type):
            values = values.cast(pa.float64())
        absent = np.asarray(values.is_null())
        return as_column(name, np.asarray(pc.fill_null(values, 0)), absent)


def _unreadable(path: Path, fault: Exception) -> ExchangeError:
    return ExchangeError(f"{path}: expected a whole parquet file, it cannot be read ({fault}): is it cut or damaged?")

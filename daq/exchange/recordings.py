"""Opening of recordings of other programs, in any supported format; parquet is read here."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.compute
import pyarrow.parquet
from typing_extensions import override

from daq.exchange.bombs import refuse_bomb
from daq.exchange.columns import Column, ColumnFile, as_column
from daq.exchange.csv_recording import CsvRecording
from daq.exchange.errors import ExchangeError
from daq.exchange.matlab_recording import Hdf5Recording, MatRecording
from daq.mcap.writer import MAGIC
from rig_configs.regular_file import need_regular

pa: Any = pyarrow  # has no types
pc: Any = pyarrow.compute
pq: Any = pyarrow.parquet


class ParquetRecording(ColumnFile):
    """Parquet file; nulls are absent."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            with open(path, "rb") as file:  # pyarrow refuses names that are not UTF-8
                self._schema = pq.read_schema(file)
        except (pa.ArrowException, OSError) as fault:
            raise _unreadable(path, fault) from fault
        self.names: tuple[str, ...] = tuple(self._schema.names)

    @override
    def read(self, names: Iterable[str]) -> Mapping[str, Column]:
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


def open_recording(path: Path, decimal: str | None = None) -> ColumnFile:
    """Open a file according to its content and the ending of its name.

    Args:
        path: the file.
        decimal: decimal sign of a text file, "." or ","; None: it is found.

    Raises:
        ExchangeError: the file does not exist, is empty, or is not csv, parquet, mat or hdf5.
    """
    try:
        need_regular(path)
        with open(path, "rb") as file:
            start = file.read(1024)
    except OSError as fault:
        raise ExchangeError(f"{path}: cannot be read ({fault.strerror}): check the path") from fault
    if not start:
        raise ExchangeError(f"{path}: expected a recording, the file is empty")
    if start.startswith(MAGIC):
        raise ExchangeError(
            f"{path}: expected csv, parquet, mat or hdf5, this is a log already (MCAP); if another program wrote it, "
            "save its topics as one of these first"
        )
    if start.startswith(b"PAR1"):
        return ParquetRecording(path)
    if b"\x89HDF\r\n\x1a\n" in (start[:8], start[512:520]):
        return Hdf5Recording(path)
    if path.suffix.lower() == ".mat":
        return MatRecording(path)
    if path.suffix.lower() in (".parquet", ".h5", ".hdf5"):
        raise ExchangeError(f"{path}: expected {path.suffix.lower()[1:]} as in its name, got another content")
    return CsvRecording(path, decimal)

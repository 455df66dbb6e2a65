"""CSV: one file per table, one header line, units in the column names; the provenance is in a separate .json file.

Numbers are the shortest text that reads back to the same float64; a missing number is ``nan``.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow
import pyarrow.csv
from typing_extensions import override

from daq.exchange.tables import Columns, Layout, TableWriter

pa: Any = pyarrow  # has no types
csv: Any = pyarrow.csv
_OPTIONS = csv.WriteOptions(include_header=False, batch_size=65536)


class CsvFiles(TableWriter):
    """See daq.exchange.tables.TableWriter.

    Args:
        layouts: the tables.
        places: file of each table, by name.
    """

    def __init__(self, layouts: Sequence[Layout], places: Mapping[str, Path]) -> None:
        self._names = {layout.name: list(layout.dtypes) for layout in layouts}
        self._files: dict[str, BinaryIO] = {}
        self._open = ExitStack()
        try:
            for name, columns in self._names.items():
                self._files[name] = self._open.enter_context(io.BufferedWriter(io.FileIO(places[name], "w")))
                self._files[name].write((",".join(columns) + "\n").encode())
        except BaseException:
            self.close()
            raise

    @override
    def append(self, table: str, columns: Columns) -> None:
        names = self._names[table]
        rows = pa.table([pa.array(columns[name]) for name in names], names=names)
        csv.write_csv(rows, self._files[table], _OPTIONS)

    @override
    def finish(self, provenance: Mapping[str, Any]) -> None:
        """The provenance is written elsewhere."""
        self.close()

    @override
    def close(self) -> None:
        self._open.close()

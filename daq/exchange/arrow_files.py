"""Parquet and CSV: one file per table.

The schema of a parquet file contains units and provenance as metadata, which every reader provides. A CSV file has one
header line and units in the column names; its provenance is in a separate .json file. Its numbers are the shortest text
that reads back to the same float64; a missing number is ``nan``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO, Literal

import pyarrow
import pyarrow.csv
import pyarrow.parquet
from typing_extensions import override

from daq.exchange.tables import Columns, Layout, TableWriter
from rig_basics.texts import storable

pa: Any = pyarrow  # has no types
csv: Any = pyarrow.csv
pq: Any = pyarrow.parquet
_CSV = csv.WriteOptions(include_header=False, batch_size=65536)  # pyarrow's own header has quotes


class ArrowFiles(TableWriter):
    """See daq.exchange.tables.TableWriter.

    Args:
        layouts: the tables.
        places: file of each table, by name.
        format: of all files.
    """

    def __init__(
        self, layouts: Sequence[Layout], places: Mapping[str, Path], format: Literal["parquet", "csv"]
    ) -> None:
        self._layouts, self._format = layouts, format
        self._schemas = {layout.name: _schema(layout) for layout in layouts}
        self._writers: dict[str, Any] = {}
        self._open = ExitStack()
        try:
            for name, schema in self._schemas.items():
                # pyarrow refuses names that are not UTF-8
                file = self._open.enter_context(open(places[name], "wb"))  # noqa: SIM115 (entered on the stack)
                self._writers[name] = self._open.enter_context(self._writer(file, schema))
        except BaseException:
            self.close()
            raise

    def _writer(self, file: BinaryIO, schema: Any) -> Any:
        if self._format == "csv":
            file.write((",".join(schema.names) + "\n").encode())
            return csv.CSVWriter(file, schema, write_options=_CSV)
        # a stored arrow schema would hide the metadata added at the end, when the missing parts are known
        return pq.ParquetWriter(file, schema, compression="zstd", store_schema=False)

    @override
    def append(self, table: str, columns: Columns) -> None:
        schema = self._schemas[table]
        rows = pa.table([pa.array(columns[name]) for name in schema.names], schema=schema)
        self._writers[table].write_table(rows)

    @override
    def finish(self, provenance: Mapping[str, Any]) -> None:
        """The provenance of CSV files is written elsewhere."""
        text = storable(json.dumps(provenance, ensure_ascii=False))
        for layout in self._layouts if self._format == "parquet" else ():
            units = json.dumps(layout.units, ensure_ascii=False)
            facts = {"table": layout.name, "units": units, "provenance": text}
            self._writers[layout.name].add_key_value_metadata(facts)
        self.close()

    @override
    def close(self) -> None:
        self._open.close()


def _schema(layout: Layout) -> Any:
    fields = [pa.field(name, pa.from_numpy_dtype(dtype), nullable=False) for name, dtype in layout.dtypes.items()]
    return pa.schema(fields)

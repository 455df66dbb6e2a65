"""Parquet: one file per table; units and provenance are in the schema's metadata, which every reader provides."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pyarrow
import pyarrow.parquet
from typing_extensions import override

from daq.exchange.tables import Columns, Layout, TableWriter
from rig_basics.texts import storable

pa: Any = pyarrow  # has no types
pq: Any = pyarrow.parquet
_ROW_GROUP = 500_000


class ParquetFiles(TableWriter):
    """See daq.exchange.tables.TableWriter.

    Args:
        layouts: the tables.
        places: file of each table, by name.
    """

    def __init__(self, layouts: Sequence[Layout], places: Mapping[str, Path]) -> None:
        self._layouts = {layout.name: layout for layout in layouts}
        self._schemas = {layout.name: _schema(layout) for layout in layouts}
        self._writers: dict[str, Any] = {}
        self._files = ExitStack()
        try:
            for name, schema in self._schemas.items():
                # pyarrow refuses names that are not UTF-8
                file = self._files.enter_context(open(places[name], "wb"))  # noqa: SIM115 (entered on the stack)
                # a stored arrow schema would hide the metadata added at the end, when the missing parts are known
                self._writers[name] = pq.ParquetWriter(file, schema, compression="zstd", store_schema=False)
        except BaseException:
            self.close()
            raise

    @override
    def append(self, table: str, columns: Columns) -> None:
        schema = self._schemas[table]
        rows = pa.table([pa.array(columns[name]) for name in schema.names], schema=schema)
        self._writers[table].write_table(rows, row_group_size=_ROW_GROUP)

    @override
    def finish(self, provenance: Mapping[str, Any]) -> None:
        for name, writer in self._writers.items():
            units = json.dumps(self._layouts[name].units, ensure_ascii=False)
            facts = {"table": name, "units": units, "provenance": storable(json.dumps(provenance, ensure_ascii=False))}
            writer.add_key_value_metadata(facts)
        self.close()

    @override
    def close(self) -> None:
        while self._writers:
            self._writers.popitem()[1].close()
        self._files.close()


def _schema(layout: Layout) -> Any:
    fields = [pa.field(name, pa.from_numpy_dtype(dtype), nullable=False) for name, dtype in layout.dtypes.items()]
    return pa.schema(fields)

"""An item's files: figures as SVG and PNG, tables as parquet, the rest as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from analysis.figures.style import save, to_svg
from reproduction.catalogue import Item
from reproduction.results import Reproduced, SourceTable
from rig_basics.whole_file import write_whole_text

_RECORD = "item.json"
_MAX_ROWS = 200  # printed rows of a table in the book


@dataclass(frozen=True)
class Written:
    """An item as stored in its folder.

    Attributes:
        item: the item.
        folder: its folder.
        record: item.json: seconds, parameters, assumed, claims, panels, tables.
    """

    item: Item
    folder: Path
    record: Mapping[str, Any]

    @property
    def failed(self) -> str:
        """Why it could not be reproduced; "" if it was."""
        return str(self.record.get("failed", ""))

    @property
    def claims(self) -> list[dict[str, str]]:
        """Claims as dictionaries, see Claim.to_json."""
        return list(self.record["claims"])

    def svg(self, name: str) -> str:
        """Return a figure as one SVG element whose ids differ from those of other items."""
        return (self.folder / f"{name}.inline.svg").read_text(encoding="utf-8")


def write_item(item: Item, found: Reproduced, folder: Path, seconds: float) -> Written:
    """Write an item's files into its folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for panel in found.panels:
        save(folder / f"{panel.name}.svg", panel.figure)
        save(folder / f"{panel.name}.png", panel.figure)
        ids = f"f{item.id}-{panel.name}".replace(".", "-")
        inline = to_svg(panel.figure, ids, panel.description)
        write_whole_text(folder / f"{panel.name}.inline.svg", inline)
    for table in found.tables:
        _write_table(folder / f"{table.name}.parquet", item, table, found.parameters)
    record = {
        "id": item.id,
        "title": item.title,
        "seconds": round(seconds, 2),
        "parameters": dict(found.parameters),
        "assumed": list(found.assumed),
        "claims": [claim.to_json() for claim in found.claims],
        "panels": [{"name": panel.name, "description": panel.description} for panel in found.panels],
        "tables": [_table_json(table) for table in found.tables],
    }
    text = json.dumps(record, ensure_ascii=False, indent=1, allow_nan=False)
    write_whole_text(folder / _RECORD, text + "\n")
    return Written(item, folder, record)


def write_failure(item: Item, folder: Path, fault: Exception) -> None:
    """Write a record of an item that could not be reproduced."""
    folder.mkdir(parents=True, exist_ok=True)
    record: dict[str, Any] = {
        "id": item.id,
        "title": item.title,
        "seconds": 0.0,
        "parameters": {},
        "assumed": [],
        "claims": [],
        "panels": [],
        "tables": [],
        "failed": f"{type(fault).__name__}: {fault}",
    }
    write_whole_text(folder / _RECORD, json.dumps(record, ensure_ascii=False, indent=1) + "\n")


def read_item(item: Item, folder: Path) -> Written:
    """Read an item's record from its folder."""
    return Written(item, folder, json.loads((folder / _RECORD).read_text(encoding="utf-8")))


def _write_table(path: Path, item: Item, table: SourceTable, parameters: Mapping[str, float | str]) -> None:
    lengths = {name: len(values) for name, values in table.columns.items()}
    if len(set(lengths.values())) != 1:
        raise ValueError(f"{item.id} {table.name}: expected columns of one length, got {lengths}")
    about = {"item": item.id, "title": table.title, "parameters": json.dumps(dict(parameters), allow_nan=False)}
    arrow: Any = pa
    columns = arrow.table({name: np.asarray(values) for name, values in table.columns.items()})
    pq.write_table(columns.replace_schema_metadata(about), path)


def _table_json(table: SourceTable) -> dict[str, Any]:
    columns = {name: [_plain(value) for value in np.asarray(values).tolist()] for name, values in table.columns.items()}
    rows = [list(row) for row in zip(*columns.values(), strict=True)][:_MAX_ROWS] if table.shown else []
    return {"name": table.name, "title": table.title, "columns": list(columns), "rows": rows}


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not np.isfinite(value) else value

"""A map as a table with one row per point, and its borders as a second table with one row per point of a line."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.maps.file_parts import keys_of
from analysis.maps.records import MapRecord, RecordedBorder
from rig_basics.whole_file import written_whole

_KEY = b"rig map"


def borders_path(path: Path) -> Path:
    """Return the path of a map's borders: map.borders.parquet for map.parquet."""
    return path.with_suffix(".borders.parquet")


def write_parquet(path: Path, kept: MapRecord) -> list[Path]:
    """Write the map and its borders; without borders the borders file of an earlier map is removed."""
    x_keys, y_keys = keys_of(kept.provenance)
    x, y = np.meshgrid(kept.x, kept.y)
    columns = {key: x.ravel() for key in x_keys} | {key: y.ravel() for key in y_keys}
    columns |= {name: values.ravel() for name, values in kept.grid.items()}
    shape = {"columns": len(kept.x), "rows": len(kept.y), "borders": len(kept.borders)}
    lines = _lines(kept.borders, x_keys, y_keys)
    borders = borders_path(path)
    if kept.borders:
        with written_whole(borders) as part:
            _write(part, lines, kept.provenance, {})
    else:
        borders.unlink(missing_ok=True)
    with written_whole(path) as part:
        _write(part, columns, kept.provenance, shape)
    return [path, borders] if kept.borders else [path]


def read_parquet(path: Path) -> MapRecord:
    """Read the map and its borders.

    Raises:
        KeyError, ValueError: the file does not contain a map.
        FileNotFoundError: the file of its borders is missing.
    """
    columns, provenance, shape = _read(path)
    x_keys, y_keys = keys_of(provenance)
    size = int(shape["rows"]), int(shape["columns"])
    grid = {name: column.reshape(size) for name, column in columns.items() if name not in {*x_keys, *y_keys}}
    borders: tuple[RecordedBorder, ...] = ()
    if shape["borders"]:
        lines, _, _ = _read(borders_path(path))
        borders = tuple(_line(lines, lines["border"] == n, x_keys[0], y_keys[0]) for n in np.unique(lines["border"]))
    x, y = (columns[keys[0]].reshape(size) for keys in (x_keys, y_keys))
    return MapRecord(provenance, x[0], y[:, 0], grid, borders)


def _arrow(name: str) -> Any:
    """Return a module of Arrow, which takes a while to load and has no complete types."""
    return import_module(name)


def _write(
    path: Path, columns: Mapping[str, NDArray[Any]], provenance: Mapping[str, Any], shape: dict[str, int]
) -> None:
    held = json.dumps({"provenance": provenance, "shape": shape})
    arrow = _arrow("pyarrow")
    table = arrow.table({name: arrow.array(values) for name, values in columns.items()})
    with open(path, "wb") as file:  # Arrow refuses names that are not UTF-8
        _arrow("pyarrow.parquet").write_table(
            table.replace_schema_metadata({_KEY: held.encode()}), file, compression="zstd"
        )


def _read(path: Path) -> tuple[dict[str, NDArray[Any]], dict[str, Any], dict[str, Any]]:
    with open(path, "rb") as file:
        table = _arrow("pyarrow.parquet").read_table(file)
    about: dict[bytes, bytes] = table.schema.metadata or {}
    held = json.loads(about[_KEY])
    return {name: table[name].to_numpy() for name in table.column_names}, held["provenance"], held["shape"]


def _lines(borders: tuple[RecordedBorder, ...], x_keys: tuple[str, ...], y_keys: tuple[str, ...]) -> dict[str, Any]:
    """Return one row per point: number of the border, family value (NaN: the rig itself), x, y, multiplier."""
    sizes = [len(line.x) for line in borders]

    def joined(parts: list[NDArray[Any]]) -> NDArray[Any]:
        return np.concatenate(parts) if parts else np.zeros(0)

    x, y = joined([line.x for line in borders]), joined([line.y for line in borders])
    multiplier = np.asarray(joined([line.multiplier for line in borders]), np.complex128)
    return {
        "border": np.repeat(np.arange(1, len(borders) + 1), sizes),
        "family_value": np.repeat([np.nan if line.value is None else line.value for line in borders], sizes),
        "closed": np.repeat([line.closed for line in borders], sizes),
        **dict.fromkeys(x_keys, x),
        **dict.fromkeys(y_keys, y),
        "multiplier_real": multiplier.real,
        "multiplier_imag": multiplier.imag,
    }


def _line(lines: Mapping[str, NDArray[Any]], here: NDArray[np.bool_], x_key: str, y_key: str) -> RecordedBorder:
    value = float(lines["family_value"][here][0])
    multiplier = lines["multiplier_real"][here] + 1j * lines["multiplier_imag"][here]
    closed = bool(lines["closed"][here][0])
    return RecordedBorder(
        lines[x_key][here], lines[y_key][here], multiplier, closed, None if np.isnan(value) else value
    )

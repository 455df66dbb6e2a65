"""A map as a zarr store of format 3: arrays with the names of their dimensions, as xarray reads them."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.errors import NoMapFile
from analysis.maps.file_parts import keys_of
from analysis.maps.records import MapRecord, RecordedBorder

_CHUNK = 512  # points per side


def need_zarr(path: Path) -> None:
    """Check that a store can be written.

    Raises:
        NoMapFile: the package is missing, or the folder is not a zarr store.
    """
    if find_spec("zarr") is None:
        raise NoMapFile(
            f"{path}: a .zarr store needs the package zarr; install it with "
            "`pip install 'pendulum-balancer-rig[studies]'`, or give a name ending in .npz or .parquet"
        )
    if path.is_file() or (path.is_dir() and any(path.iterdir()) and not (path / "zarr.json").is_file()):
        raise NoMapFile(f"{path}: expected a new name or a zarr store to replace, this is something else")


def _zarr() -> Any:
    """Return the module zarr, which is an optional package without complete types."""
    return import_module("zarr")


def write_zarr(path: Path, kept: MapRecord) -> None:
    """Write a store."""
    x_keys, y_keys = keys_of(kept.provenance)
    x, y = x_keys[0], y_keys[0]
    group: Any = _zarr().open_group(str(path), mode="w", zarr_format=3)
    group.attrs["rig map"] = dict(kept.provenance)

    def put(name: str, values: NDArray[Any], dimensions: tuple[str, ...], where: Any = group) -> None:
        chunks = tuple(max(1, min(size, _CHUNK)) for size in values.shape)
        array = where.create_array(
            name, shape=values.shape, dtype=values.dtype, chunks=chunks, dimension_names=dimensions
        )
        array[...] = values

    put(x, kept.x, (x,))
    put(y, kept.y, (y,))
    for name, values in kept.grid.items():
        put(name, values, (y, x))
    for number, line in enumerate(kept.borders, 1):
        one = group.create_group(f"borders/{number}")
        one.attrs.update({"closed": line.closed, "family_value": line.value})
        for name, values in ((x, line.x), (y, line.y), ("multiplier", line.multiplier)):
            put(name, values, ("point",), one)


def read_zarr(path: Path) -> MapRecord:
    """Read a store written by `write_zarr`.

    Raises:
        NoMapFile: the package is missing.
        KeyError, ValueError: the store does not contain a map.
        FileNotFoundError: the store does not exist.
    """
    if find_spec("zarr") is None:
        need_zarr(path)
    group: Any = _zarr().open_group(str(path), mode="r", zarr_format=3)
    provenance: dict[str, Any] = dict(group.attrs["rig map"])
    x_keys, y_keys = keys_of(provenance)
    x, y = x_keys[0], y_keys[0]
    arrays: dict[str, NDArray[Any]] = {name: np.asarray(array[...]) for name, array in group.arrays()}
    borders = list[RecordedBorder]()
    while f"borders/{len(borders) + 1}" in group:
        one = group[f"borders/{len(borders) + 1}"]
        line = [np.asarray(one[name][...]) for name in (x, y, "multiplier")]
        borders.append(RecordedBorder(line[0], line[1], line[2], one.attrs["closed"], one.attrs["family_value"]))
    grid = {name: array for name, array in arrays.items() if name not in (x, y)}
    return MapRecord(provenance, arrays[x], arrays[y], grid, tuple(borders))

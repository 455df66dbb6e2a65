"""Files of maps: .npz, .parquet and .zarr, each with its borders and its provenance."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from analysis.errors import NoMapFile
from analysis.maps.file_parts import keys_of, replaced
from analysis.maps.parquet_files import read_parquet, write_parquet
from analysis.maps.records import MapRecord, RecordedBorder
from analysis.maps.zarr_store import need_zarr, read_zarr, write_zarr
from rig_basics.whole_file import written_whole
from rig_configs import RigConfigError

SUFFIXES = (".npz", ".parquet", ".zarr")


def need_map_suffix(path: Path) -> None:
    """Check before the computation that a map can be written under a name.

    Raises:
        NoMapFile: an unsupported suffix, a .zarr without its package, or a folder that is not a zarr store.
    """
    if path.suffix not in SUFFIXES:
        raise NoMapFile(f"{path}: expected a name ending in {', '.join(SUFFIXES)}")
    if path.suffix == ".zarr":
        need_zarr(path)
    elif path.is_dir():
        raise NoMapFile(f"{path}: expected a file's name, this is a folder; give another name")


def write_map(path: str | Path, kept: MapRecord) -> list[Path]:
    """Write a map in the format of the name's suffix. The files appear only when they are complete.

    .npz: x and y under their keys, `multiplier_max`, `error_estimate`, `decay_rate_per_s` over (y, x); `border_1` …
    (x, y) and `border_1_multiplier` …; `provenance` is JSON. .parquet: one row per point, x and y under all their keys;
    borders, one row per point of a line, in NAME.borders.parquet; the schema's metadata `rig map` is JSON. .zarr:
    dimensions named by the keys; `borders/1` … are groups; the attribute `rig map` is the provenance.

    Returns:
        Paths written: the file or the store, and NAME.borders.parquet for a .parquet with borders.
    Raises:
        NoMapFile: see `need_map_suffix`.
        OSError: an error of the disk.
    """
    path = Path(path)
    need_map_suffix(path)
    if path.suffix == ".parquet":
        return write_parquet(path, kept)
    if path.suffix == ".zarr":
        replaced(path, lambda part: write_zarr(part, kept))
    else:
        with written_whole(path) as part:
            _write_npz(part, kept)
    return [path]


def load_map(path: str | Path) -> MapRecord:
    """Read a file written by `write_map`.

    Raises:
        NoMapFile: an unsupported suffix, or a file that does not contain a map.
        OSError: the file is missing or cannot be read.
    """
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise NoMapFile(f"{path}: expected a name ending in {', '.join(SUFFIXES)}")
    try:
        if path.suffix == ".parquet":
            return read_parquet(path)
        if path.suffix == ".zarr":
            return read_zarr(path)
        return _read_npz(path)
    except (KeyError, ValueError, TypeError, RigConfigError, zipfile.BadZipFile) as error:
        raise NoMapFile(f"{path}: expected a map as `write_map` writes it; problem: {error!r}") from error


def _write_npz(path: Path, kept: MapRecord) -> None:
    x_keys, y_keys = keys_of(kept.provenance)
    arrays: dict[str, NDArray[Any]] = {x_keys[0]: kept.x, y_keys[0]: kept.y, **kept.grid}
    for number, line in enumerate(kept.borders, 1):
        arrays[f"border_{number}"] = np.column_stack([line.x, line.y])
        arrays[f"border_{number}_multiplier"] = line.multiplier
    lines = [{"closed": line.closed, "value": line.value} for line in kept.borders]
    arrays["provenance"] = np.array(json.dumps({**kept.provenance, "borders": lines}))
    with open(path, "wb") as file:
        np.savez_compressed(file, allow_pickle=False, **cast(dict[str, Any], arrays))


def _read_npz(path: Path) -> MapRecord:
    with np.load(path, allow_pickle=False) as opened:
        held: dict[str, NDArray[Any]] = {name: opened[name] for name in opened.files}
    provenance: dict[str, Any] = json.loads(str(held.pop("provenance")))
    lines: list[dict[str, Any]] = provenance.pop("borders")
    x_keys, y_keys = keys_of(provenance)
    borders = tuple(
        RecordedBorder(
            held[f"border_{n}"][:, 0],
            held[f"border_{n}"][:, 1],
            held[f"border_{n}_multiplier"],
            bool(line["closed"]),
            line["value"],
        )
        for n, line in enumerate(lines, 1)
    )
    x, y = held.pop(x_keys[0]), held.pop(y_keys[0])
    return MapRecord(provenance, x, y, {k: v for k, v in held.items() if not k.startswith("border_")}, borders)

"""MAT and HDF5 recordings: MAT versions 5 and 7 through scipy, version 7.3 (which is HDF5) and other HDF5 through h5py.

A variable is identified by its path: ``data.time`` for a field of a struct, ``data.2`` for the second column of a
matrix.
"""

from __future__ import annotations

import math
import warnings
from collections import deque
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy import io
from typing_extensions import override

from daq.exchange.bombs import refuse_bomb, refuse_mat_bomb
from daq.exchange.columns import Column, ColumnFile, as_column
from daq.exchange.errors import ExchangeError

matlab: Any = io  # scipy has no types
_MATLAB_CELLS = "#refs#"  # group of the cells of MATLAB's cell arrays, which are no columns
_MAX_OBJECTS = 10_000  # in an HDF5 file; listing one takes some 0.1 ms
_MAX_DEPTH = 64  # of groups, as of a MAT file
_MAX_COLUMNS = 256  # of a matrix; with more it is an image or similar
_FILTERS = frozenset((1, 2, 3, 4, 5, 6, 32000))  # deflate, shuffle, Fletcher32, szip, nbit, scale-offset; h5py's lzf


class MatRecording(ColumnFile):
    """MAT file of version 4, 5 or 7."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # scipy warns of skipped variables; they are not among the names
                refuse_mat_bomb(path)
                listed: list[tuple[str, tuple[int, ...], str]] = matlab.whosmat(path, appendmat=False)
                refuse_bomb(path, "", sum(_bytes(shape) for _, shape, _ in listed))
                found: dict[str, Any] = matlab.loadmat(path, appendmat=False, simplify_cells=True)
        except (ExchangeError, MemoryError):
            raise
        except Exception as fault:  # scipy raises many kinds of errors for damaged files
            raise _unreadable(path, fault) from fault
        self._columns: dict[str, NDArray[Any]] = {}
        for name, value in found.items():
            if not name.startswith("__"):
                self._collect(name, value)
        self.names: tuple[str, ...] = tuple(self._columns)

    @override
    def read(self, names: Iterable[str]) -> Mapping[str, Column]:
        return {name: as_column(f"{self.path}: {name}", self._columns[name]) for name in names}

    def _collect(self, name: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, inner in cast("dict[str, Any]", value).items():
                self._collect(f"{name}.{key}", inner)
        elif _is_array(value) and value.dtype.kind in "iufb" and (columns := _columns_of(name, value.shape, along=1)):
            self._columns |= {key: value.reshape(-1) if i is None else value[:, i] for key, i in columns.items()}
        else:
            self.others[name] = _described(value)


class Hdf5Recording(ColumnFile):
    """HDF5 file; groups are written with dots."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._places: dict[str, tuple[str, int | None]] = {}
        try:
            with h5py.File(path, "r") as file:
                self._list(file)
        except ExchangeError:
            raise
        except Exception as fault:  # h5py raises many kinds of errors
            raise _unreadable(path, fault) from fault
        self.names: tuple[str, ...] = tuple(self._places)

    @override
    def read(self, names: Iterable[str]) -> Mapping[str, Column]:
        columns: dict[str, Column] = {}
        try:
            with h5py.File(self.path, "r") as file:
                wanted = {name: self._places[name] for name in names}
                datasets: dict[str, Any] = {place: file[place] for place, _ in wanted.values()}
                for place, dataset in datasets.items():
                    _refuse_foreign(self.path, place.replace("/", "."), dataset)
                refuse_bomb(self.path, "", sum(_bytes(dataset.shape) for dataset in datasets.values()))
                for name, (place, index) in wanted.items():
                    dataset = datasets[place]
                    values = dataset[()] if index is None else dataset[index]
                    columns[name] = as_column(f"{self.path}: {name}", values.reshape(-1))
        except (ExchangeError, MemoryError):
            raise
        except Exception as fault:
            raise _unreadable(self.path, fault) from fault
        return columns

    def _list(self, file: Any) -> None:
        """List the datasets of all groups. Only hard links are followed, so that the file is not left.

        Raises:
            ExchangeError: the file has too many objects, or groups are nested too deeply.
        """
        groups: deque[tuple[str, Any]] = deque([("", file)])
        visited: set[Any] = set()  # a group that has several hard links, or contains itself, is listed once
        objects = 0
        while groups:
            within, group = groups.popleft()
            for name in group:
                place = f"{within}{name}"
                objects += 1
                if objects > _MAX_OBJECTS or place.count("/") > _MAX_DEPTH:
                    raise ExchangeError(
                        f"{self.path}: expected columns of numbers, got more than {_MAX_OBJECTS} groups and datasets, "
                        f"or more than {_MAX_DEPTH} levels of groups; save the columns separately"
                    )
                link = group.get(name, getlink=True)
                if not isinstance(link, h5py.HardLink):
                    kind = "soft link, name what it points to" if isinstance(link, h5py.SoftLink) else None
                    self.others[place.replace("/", ".")] = f"a {kind or 'link to another file'}"
                elif not place.startswith(_MATLAB_CELLS):
                    item = group[name]
                    self._visit(place, item)
                    if isinstance(item, h5py.Group) and item.id not in visited:
                        visited.add(item.id)
                        groups.append((f"{place}/", item))

    def _visit(self, place: str, item: Any) -> None:
        if not _is_array(item):
            return
        name, shape = place.replace("/", "."), item.shape
        if shape is None or item.dtype.kind not in "iuf":
            self.others[name] = "without values" if shape is None else _described(item)
        elif columns := _columns_of(name, shape, along=0):  # MATLAB's columns are HDF5's rows
            self._places |= {key: (place, i) for key, i in columns.items()}
        else:
            self.others[name] = _described(item)


def _is_array(value: Any) -> bool:
    """Return True for an array or a dataset."""
    return isinstance(value, np.ndarray | h5py.Dataset)


def _described(value: Any) -> str:
    """Describe a variable that is not a column of numbers."""
    if _is_array(value):
        return f"an array of shape {value.shape} of {value.dtype}"
    return f"of type {type(value).__name__}"


def _columns_of(name: str, shape: tuple[int, ...], along: int) -> dict[str, int | None]:
    """Return the names of an array's columns with their indices along an axis, None for a vector; empty for others."""
    if len(shape) == 1 or (len(shape) == 2 and 1 in shape):
        return {name: None}
    if len(shape) == 2 and shape[along] <= _MAX_COLUMNS:
        return {f"{name}.{i + 1}": i for i in range(shape[along])}
    return {}


def _bytes(shape: tuple[int, ...]) -> int:
    """Return the largest size of an array in memory, bytes."""
    return 8 * math.prod(shape)


def _refuse_foreign(path: Path, name: str, dataset: Any) -> None:
    """Raise for a dataset whose numbers are not in the file, or need additional software to be unpacked.

    Raises:
        ExchangeError: the numbers are in another file, composed of other datasets, or packed with a plug-in filter.
    """
    if dataset.external:
        where = f"in other files ({', '.join(repr(str(part[0])) for part in dataset.external[:3])})"
    elif dataset.is_virtual:
        where = "composed of other datasets"
    else:
        created = dataset.id.get_create_plist()
        filters = [created.get_filter(i)[0] for i in range(created.get_nfilters())]
        foreign = [number for number in filters if number not in _FILTERS]
        if not foreign:
            refuse_bomb(path, f"{name}, a chunk", _bytes(dataset.chunks or (0,)))
            return
        where = f"packed by a filter that is not part of HDF5 (number {foreign[0]})"
    raise ExchangeError(
        f"{path}: {name}: expected numbers in the file itself, these are {where}; "
        "copy them into one plain file (h5repack)"
    )


def _unreadable(path: Path, fault: Exception) -> ExchangeError:
    return ExchangeError(f"{path}: expected a whole MAT or HDF5 file, it cannot be read ({fault}): is it damaged?")

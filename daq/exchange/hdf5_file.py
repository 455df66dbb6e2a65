"""HDF5: one file, a group per table with a compressed dataset per column; units and facts as attributes."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import h5py
from typing_extensions import override

from daq.exchange.tables import Columns, Layout, TableWriter
from rig_basics.texts import storable

_CHUNK_ROWS = 16_384
_LONGEST_ATTRIBUTE = 4000  # characters; HDF5 limits attributes to 64 kB, and viewers do not show long ones
_TEXT: Any = cast("Any", h5py).string_dtype()  # h5py has no types


class Hdf5File(TableWriter):
    """See daq.exchange.tables.TableWriter.

    Args:
        layouts: the tables.
        place: path of the file.
    """

    def __init__(self, layouts: Sequence[Layout], place: Path) -> None:
        self._disk = _Disk(io.FileIO(place, "w+"))  # closed by `close`
        self._file: Any = h5py.File(self._disk, "w")
        self._rows = dict.fromkeys((layout.name for layout in layouts), 0)
        for layout in layouts:
            group = self._file.create_group(layout.name)
            for name, dtype in layout.dtypes.items():
                dataset = group.create_dataset(
                    name,
                    (0,),
                    dtype,
                    maxshape=(None,),
                    chunks=(_CHUNK_ROWS,),
                    shuffle=True,
                    compression="gzip",
                    compression_opts=4,
                )
                dataset.attrs["units"] = layout.units[name]

    @override
    def append(self, table: str, columns: Columns) -> None:
        group: Any = self._file[table]
        done = self._rows[table]
        for name, values in columns.items():
            group[name].resize((done + len(values),))
            group[name][done:] = values
        self._rows[table] = done + len(next(iter(columns.values())))
        self._disk.check()

    @override
    def finish(self, provenance: Mapping[str, Any]) -> None:
        notes = {name: provenance[name] for name in ("events", "health") if name in provenance}
        facts = {key: value for key, value in provenance.items() if key not in notes}
        for name, value in {"provenance": facts, **notes}.items():
            self._file.create_dataset(name, data=storable(json.dumps(value, ensure_ascii=False)), dtype=_TEXT)
        for key, value in facts.items():
            if isinstance(value, str | int | float) and len(str(value)) <= _LONGEST_ATTRIBUTE:
                self._file.attrs[key] = storable(value) if isinstance(value, str) else value
        self.close()
        self._disk.check()

    @override
    def close(self) -> None:
        self._file.close()
        self._disk.close()


class _Disk(io.RawIOBase):
    """The file as seen by HDF5: writing never fails. A failed write is stored for `check`, because HDF5 (2.0 as bundled
    with h5py 3.16) crashes the process when it has to close a file on a full disk.
    """

    def __init__(self, file: io.FileIO) -> None:
        self._file = file
        self._fault: OSError | None = None

    def check(self) -> None:
        """Raise the error of a failed write.

        Raises:
            OSError: the disk is full or gone.
        """
        if self._fault is not None:
            raise self._fault

    def write(self, data: Any) -> int:
        """Write all data, or store the error."""
        tail = memoryview(data).cast("B")
        size = len(tail)
        try:
            while len(tail) and self._fault is None:
                tail = tail[self._file.write(tail) or 0 :]
        except OSError as fault:
            self._fault = fault
        return size

    @override
    def readinto(self, buffer: Any) -> int:
        return self._file.readinto(buffer) or 0

    @override
    def seek(self, offset: int, whence: int = 0) -> int:
        return self._file.seek(offset, whence)

    @override
    def tell(self) -> int:
        return self._file.tell()

    def truncate(self, size: int | None = None) -> int:
        """As `write`."""
        try:
            return self._file.truncate(size)
        except OSError as fault:
            self._fault = self._fault or fault
            return size or 0

    @override
    def close(self) -> None:
        self._file.close()
        super().close()

"""MAT version 5, for MATLAB and Octave: a struct of columns per table, a struct of units, and the provenance.

The format is limited to 2 GB per variable and needs each as a whole, so the tables are in memory until the end.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy import io
from typing_extensions import override

from daq.exchange.errors import ExchangeError
from daq.exchange.tables import Columns, Layout, TableWriter
from rig_basics.texts import storable

_LARGEST_VARIABLE = 2**31 - 2**20  # bytes; the rest is reserved for the names of the fields


class MatFile(TableWriter):
    """See daq.exchange.tables.TableWriter.

    Args:
        layouts: the tables.
        place: path of the file.
    """

    def __init__(self, layouts: Sequence[Layout], place: Path) -> None:
        self._place = place
        self._layouts = {layout.name: layout for layout in layouts}
        self._parts: dict[str, list[Columns]] = {layout.name: [] for layout in layouts}
        self._bytes = dict.fromkeys(self._parts, 0)

    def append(self, table: str, columns: Columns) -> None:
        """See TableWriter.

        Raises:
            ExchangeError: the table exceeds the largest size of a variable.
        """
        self._bytes[table] += sum(values.nbytes for values in columns.values())
        if self._bytes[table] > _LARGEST_VARIABLE:
            raise ExchangeError(
                f"{table}: expected less than 2 GB, the limit of a MAT file per variable, got more: "
                "export as hdf5 (MATLAB: h5read), or a part between two times"
            )
        self._parts[table].append(columns)

    @override
    def finish(self, provenance: Mapping[str, Any]) -> None:
        variables: dict[str, Any] = {}
        for name, layout in self._layouts.items():
            parts = self._parts.pop(name)
            variables[layout.plain_name] = {
                column: np.concatenate([np.empty(0, dtype), *(part[column] for part in parts)])
                for column, dtype in layout.dtypes.items()
            }
        variables["units"] = {layout.plain_name: layout.units for layout in self._layouts.values()}
        variables["provenance"] = {key: _plain(value) for key, value in provenance.items()}
        with open(self._place, "wb") as file:
            cast("Any", io).savemat(file, variables, long_field_names=True, oned_as="column")  # scipy.io has no types

    @override
    def close(self) -> None:
        self._parts.clear()


def _plain(value: Any) -> Any:
    """Return texts and numbers unchanged, everything else as JSON (MATLAB: jsondecode)."""
    if isinstance(value, int | float):
        return value
    return storable(value if isinstance(value, str) else json.dumps(value, ensure_ascii=False))

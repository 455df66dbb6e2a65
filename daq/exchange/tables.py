"""Tables for export: columns with units, and the interface of a format's writer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from daq.exchange.units import unit_of
from daq.log import Log
from daq.log.samples import Samples
from daq.signals.run import Run

Columns = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Layout:
    """Layout of one table.

    Attributes:
        name: topic of the channel, or name of the signal.
        dtypes: column name → dtype, in order.
    """

    name: str
    dtypes: Mapping[str, np.dtype[Any]]

    @property
    def units(self) -> dict[str, str]:
        """Column name → unit."""
        return {column: unit_of(column) for column in self.dtypes}

    @property
    def plain_name(self) -> str:
        """The name as part of a file's or a variable's: letters, digits and underscores."""
        plain = "".join(c if c.isascii() and c.isalnum() else "_" for c in self.name)
        return plain if plain[:1].isalpha() else f"t{plain}"


class TableWriter(Protocol):
    """Writer of tables to the files of one format; slices of different tables may come in any order."""

    def append(self, table: str, columns: Columns) -> None:
        """Add rows: every column of the table's layout, all of one length."""

    def finish(self, provenance: Mapping[str, Any]) -> None:
        """Write the provenance and the ends of the files."""

    def close(self) -> None:
        """Close the files, finished or not."""


def sample_columns(samples: Samples, start_ns: int) -> dict[str, NDArray[Any]]:
    """Return a channel's columns: times, sequence, then its fields; `time_s` counts from the log's start."""
    return {
        "time_ns": samples.time_ns,
        "time_s": (samples.time_ns - start_ns) / 1e9,
        "log_time_ns": samples.log_time_ns,
        "sequence": samples.sequence,
        **samples.columns,
    }


def sample_layout(log: Log, topic: str) -> Layout:
    """Return the table of a channel without reading samples."""
    channel = log.channel(topic)
    times = {"time_ns": np.int64, "time_s": np.float64, "log_time_ns": np.int64, "sequence": np.uint32}
    fields = {name: channel.dtype[name] for name in channel.names}
    return Layout(topic, {name: np.dtype(dtype) for name, dtype in {**times, **fields}.items()})


def signal_tables(run: Run, from_s: float | None, to_s: float | None) -> dict[str, dict[str, NDArray[Any]]]:
    """Return a run's signals on the common clock: x, y, angles, marks, each with its own times."""
    tables = {
        "x": {"time_s": run.x_time_s, "displacement_m": run.x_m},
        "y": {"time_s": run.y_time_s, "displacement_m": run.y_m},
        "angles": {"time_s": run.angle_time_s, "theta3_rad": run.angle_rad[:, 0], "theta4_rad": run.angle_rad[:, 1]},
        "marks": {"time_s": run.mark_time_s, "phase_rad": run.mark_phase_rad},
    }
    start, end = -np.inf if from_s is None else from_s, np.inf if to_s is None else to_s
    kept: dict[str, dict[str, NDArray[Any]]] = {}
    for name, table in tables.items():
        inside = (table["time_s"] >= start) & (table["time_s"] < end)
        kept[name] = {column: np.ascontiguousarray(values[inside]) for column, values in table.items()}
    return kept

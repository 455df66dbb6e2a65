"""Stored samples of a log, read in order in blocks of a requested size."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.log import Log
from daq.log.samples import Samples

_ROWS = 60_000  # approximate number of samples in memory


class StoredRows:
    """One channel of a log from its beginning on.

    Attributes:
        names: its fields; empty if the log does not have the channel.
    """

    def __init__(self, log: Log, topic: str) -> None:
        exists = topic in log and log.count(topic) > 0
        self.names: tuple[str, ...] = log.channel(topic).names if exists else ()
        self._parts = log.parts(topic, _ROWS) if exists else iter(())
        heads = {"time_ns": np.int64, "log_time_ns": np.int64, "sequence": np.uint32}
        self._rows = {name: np.empty(0, kind) for name, kind in heads.items()}

    def read_next(self, count: int, until_ns: int | None = None) -> dict[str, NDArray[Any]]:
        """Return the next samples: time_ns, log_time_ns, sequence and every field, each of shape (n ≤ count,).

        The number is smaller only at the channel's end, or if the next log time is not before `until_ns`.
        """
        while len(self._rows["log_time_ns"]) < count and (part := next(self._parts, None)) is not None:
            new = _rows_of(part)
            self._rows = {name: np.concatenate([self._rows.get(name, new[name][:0]), new[name]]) for name in new}
        before = self._rows["log_time_ns"][:count]
        end = len(before) if until_ns is None else int(np.searchsorted(before, until_ns))
        found = {name: values[:end] for name, values in self._rows.items()}
        self._rows = {name: values[end:] for name, values in self._rows.items()}
        return found


def _rows_of(samples: Samples) -> dict[str, NDArray[Any]]:
    heads = {"time_ns": samples.time_ns, "log_time_ns": samples.log_time_ns, "sequence": samples.sequence}
    return heads | samples.columns

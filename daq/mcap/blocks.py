"""Equally long records in a block of bytes: their places, and one field of all at once."""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray


def fields(data: bytes | memoryview, offsets: NDArray[np.int64], dtype: str) -> NDArray[Any]:
    """Return one field of n records: the values of type `dtype` at byte `offsets`, (n,), all within `data`."""
    size = np.dtype(dtype).itemsize
    return np.ndarray(max(0, len(data) - size + 1), dtype, data, 0, (1,))[offsets]


def times(data: bytes | memoryview, offsets: NDArray[np.int64]) -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
    """Return log and publish times, (n,) each, ns, of the messages whose records are at byte `offsets`."""
    both = fields(data, offsets + 15, "V16").view("<u8")
    return both[::2], both[1::2]


class Runs:
    """Records found or written one after the other; those that are equally long are kept as one run."""

    def __init__(self) -> None:
        self._table = array("q")

    def add(self, offset: int, count: int, size: int, channel_id: int = 0) -> None:
        """Add `count` records of `size` bytes each from `offset` on."""
        self._table.extend((offset, count, size, channel_id))

    def places(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Return offset, size and channel id of each of the n records, (n,)."""
        starts, counts, sizes, channel_ids = np.frombuffer(self._table, np.int64).reshape(-1, 4).T
        each = np.repeat(sizes, counts)
        offsets = np.arange(len(each))
        offsets *= each
        offsets += np.repeat(starts - sizes * (np.cumsum(counts) - counts), counts)
        return offsets, each, np.repeat(channel_ids, counts)

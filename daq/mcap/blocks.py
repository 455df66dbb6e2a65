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
    """Records found one after the other, in less than 2^32 bytes; equally long ones are kept as one run."""

    def __init__(self) -> None:
        self._table = array("I")  # half the memory of larger numbers: a hostile chunk has two million runs

    def add(self, offset: int, count: int, size: int) -> None:
        """Add `count` records of `size` bytes each from `offset` on."""
        self._table.extend((offset, count, size))

    def places(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return offset and size of each of the n records, (n,)."""
        starts, counts, sizes = np.frombuffer(self._table, np.uint32).reshape(-1, 3).T
        firsts = np.cumsum(counts, dtype=np.int64)
        firsts -= counts
        firsts *= sizes
        np.subtract(starts, firsts, out=firsts)  # offset of a record of this run's size with the number 0
        each = np.repeat(sizes, counts).astype(np.int64)
        offsets = np.arange(len(each))
        offsets *= each
        offsets += np.repeat(firsts, counts)
        return offsets, each

"""Contents returned by a log: samples of a channel as arrays, raw bytes as transmitted, and missing parts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from daq.errors import ChannelMissing


class RawChunk(NamedTuple):
    """Bytes of one read from, or one write to, a device.

    Attributes:
        host_ns: host time, ns since 1970.
        direction: 0 from the device, 1 to it (`daq.channels.RX`, `TX`).
        data: the bytes as transmitted.
    """

    host_ns: int
    direction: int
    data: bytes


class Samples:
    """Samples of one channel in file order. Each field is an attribute and an item: an array (n,), read-only because
    the log returns the same array again. `in` and iteration go over the names of the fields, `len` is n.

    Attributes:
        time_ns: sample time on the common clock, ns since 1970, int64.
        log_time_ns: host time of arrival, ns since 1970, int64.
        sequence: the device's counter, modulo 2**32, uint32.
    """

    def __init__(
        self,
        topic: str,
        time_ns: NDArray[np.int64],
        log_time_ns: NDArray[np.int64],
        sequence: NDArray[np.uint32],
        columns: dict[str, NDArray[Any]],
    ) -> None:
        for array in (time_ns, log_time_ns, sequence, *columns.values()):
            array.setflags(write=False)
        self.topic = topic
        self.time_ns: NDArray[np.int64] = time_ns
        self.log_time_ns: NDArray[np.int64] = log_time_ns
        self.sequence: NDArray[np.uint32] = sequence
        self.columns = columns

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Sample time, s since 1970 (float64: exact to 0.24 µs; take differences of `time_ns` for better)."""
        return self.time_ns / 1e9

    def __len__(self) -> int:
        return len(self.time_ns)

    def __getitem__(self, field: str) -> NDArray[Any]:
        """Return a field by name.

        Raises:
            ChannelMissing: the channel has no such field; the text lists the existing ones.
            TypeError: the key is not a name.
        """
        if not isinstance(cast("object", field), str):  # callers without a type checker pass rows
            name = next(iter(self.columns), "time_ns")
            raise TypeError(
                f"{self.topic}: expected the name of a field, one of {list(self.columns)}, got {field!r}; "
                f"rows are taken of a field, like samples[{name!r}][:5]"
            )
        if field not in self.columns:
            raise ChannelMissing(f"{self.topic}: expected one of the fields {list(self.columns)}, got {field!r}")
        return self.columns[field]

    def __contains__(self, field: object) -> bool:
        return field in self.columns

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.columns]

    def __getattr__(self, field: str) -> NDArray[Any]:
        if field.startswith("_") or field == "columns":
            raise AttributeError(field)
        try:
            return self[field]
        except ChannelMissing as fault:
            raise AttributeError(str(fault)) from None

    def __repr__(self) -> str:
        return f"<Samples {self.topic}: {len(self)} × {', '.join(self.columns)}>"

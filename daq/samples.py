"""What a log hands out: the samples of a channel as arrays, and raw bytes as they were on a device's line."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.errors import ChannelMissing


class RawChunk(NamedTuple):
    """Bytes of one read from, or write to, a device.

    Attributes:
        host_ns: host time, ns since 1970.
        direction: 0 from the device, 1 to it (`daq.channels.RX`, `TX`).
        data: the bytes as they were on the line.
    """

    host_ns: int
    direction: int
    data: bytes


class Samples:
    """Samples of one channel in file order; each field is an attribute and an item: an array (n,).

    Attributes:
        time_ns: sample time on the common clock, ns since 1970, int64.
        log_time_ns: host time of arrival, ns since 1970, int64.
        sequence: the device's counter, modulo 2**32, uint32.
    """

    def __init__(self, topic: str, heads: NDArray[Any], columns: dict[str, NDArray[Any]]) -> None:
        self.topic = topic
        self.time_ns = heads["publish_time"].astype(np.int64)
        self.log_time_ns = heads["log_time"].astype(np.int64)
        self.sequence = heads["sequence"].astype(np.uint32)
        self.columns = columns

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Sample time, s since 1970 (float64: exact to 0.24 µs; take differences of `time_ns` for better)."""
        return self.time_ns / 1e9

    def __len__(self) -> int:
        return len(self.time_ns)

    def __getitem__(self, field: str) -> NDArray[Any]:
        """Field by name.

        Raises:
            ChannelMissing: the channel has no such field; the text lists those it has.
        """
        if field not in self.columns:
            raise ChannelMissing(f"{self.topic}: expected one of the fields {list(self.columns)}, got {field!r}")
        return self.columns[field]

    def __getattr__(self, field: str) -> NDArray[Any]:
        if field.startswith("_") or field == "columns":
            raise AttributeError(field)
        try:
            return self[field]
        except ChannelMissing as fault:
            raise AttributeError(str(fault)) from None

    def __repr__(self) -> str:
        return f"<Samples {self.topic}: {len(self)} × {', '.join(self.columns)}>"

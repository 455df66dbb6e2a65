# pyright: strict
"""What of a session's samples has not been handed over yet: copies, for a process that shows them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.recent import Recent

MOST_S = 10.0
"""Seconds of samples that are handed over at once; older ones are left out and counted."""
Rows = tuple[str, NDArray[np.int64], dict[str, NDArray[Any]]]
"""Topic, sample times (n,) in ns since 1970, columns (n,) by field."""


class Newest:
    """Looks at the newest samples; for one thread.

    Args:
        topics: the channels, each with its fields.

    Attributes:
        left_out: samples that nobody took in time.
    """

    def __init__(self, topics: Mapping[str, tuple[str, ...]]) -> None:
        self.left_out = 0
        self._topics, self._seen_ns = dict(topics), dict[str, int]()

    def take(self, recent: Recent, heard_ns: int, until_ns: int | None = None) -> list[Rows]:
        """Samples since the last call.

        Args:
            heard_ns: the session's clock, ns since 1970.
            until_ns: samples taken after it are left for the next call; None for all.
        """
        oldest_ns = heard_ns - int(MOST_S * 1e9)
        rows: list[Rows] = []
        for topic, fields in self._topics.items():
            since_ns = self._seen_ns.get(topic, oldest_ns) + 1
            if since_ns < oldest_ns:
                self.left_out += len(recent.last(topic, (), since_ns)[0]) - len(recent.last(topic, (), oldest_ns)[0])
                since_ns = oldest_ns
            time_ns, columns = recent.last(topic, fields, since_ns)
            count = len(time_ns) if until_ns is None else int(np.searchsorted(time_ns, until_ns, "right"))
            if count:
                self._seen_ns[topic] = int(time_ns[count - 1])
                rows.append((topic, time_ns[:count], {n: c[:count] for n, c in zip(fields, columns, strict=True)}))
        return rows

"""Samples of a session that have not been handed over yet, as copies for a displaying process."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.recent import Recent

MOST_S = 10.0
"""Largest interval of samples per call, s; older samples are omitted and counted."""
Rows = tuple[str, NDArray[np.int64], dict[str, NDArray[Any]]]
"""Topic, sample times (n,) in ns since 1970, columns (n,) by field."""


class Newest:
    """Collects the newest samples; for one thread.

    Args:
        topics: channels with their fields.

    Attributes:
        left_out: number of samples that were omitted because they were too old.
    """

    def __init__(self, topics: Mapping[str, tuple[str, ...]]) -> None:
        self.left_out: int = 0
        self._topics, self._seen_ns = dict(topics), dict[str, int]()

    def take(self, recent: Recent, heard_ns: int, until_ns: int | None = None) -> list[Rows]:
        """Return the samples since the last call.

        Args:
            recent: newest samples of the session.
            heard_ns: time of the session's clock, ns since 1970.
            until_ns: time after which samples are kept for the next call; None for all.
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

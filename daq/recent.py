"""The last seconds of every channel, for whoever has to know now: procedures, interlocks, the terminal."""

from __future__ import annotations

import threading
from collections import deque
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq import channels
from daq.stream_items import Batch


class Recent:
    """The last seconds of every channel; several threads may add and look."""

    def __init__(self, keep_s: float) -> None:
        self._keep_ns = int(keep_s * 1e9)
        self._batches: dict[str, deque[Batch]] = {topic: deque() for topic in channels.CHANNELS}
        self._lock = threading.Lock()

    def add(self, batch: Batch) -> None:
        """Append one batch and forget what is too old."""
        with self._lock:
            kept = self._batches[batch.channel.topic]
            kept.append(batch)
            oldest = int(batch.time_ns[-1]) - self._keep_ns
            while len(kept) > 1 and int(kept[0].time_ns[-1]) < oldest:
                kept.popleft()

    def last(self, topic: str, fields: tuple[str, ...], since_ns: int = 0) -> tuple[NDArray[np.int64], list[Any]]:
        """Times (ns) and columns of a channel since an instant; empty arrays when there is nothing."""
        with self._lock:
            kept = list(takewhile(lambda b: int(b.time_ns[-1]) >= since_ns, reversed(self._batches[topic])))
        if not kept:
            return np.empty(0, np.int64), [np.empty(0) for _ in fields]
        kept.reverse()
        time_ns = np.concatenate([b.time_ns for b in kept])
        take = time_ns >= since_ns
        return time_ns[take], [np.concatenate([b.columns[f] for b in kept])[take] for f in fields]

    def clear(self) -> None:
        """Forget everything (the clock maps begin anew with each log)."""
        with self._lock:
            for kept in self._batches.values():
                kept.clear()

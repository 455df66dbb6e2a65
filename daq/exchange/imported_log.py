"""Writer of imported samples as a log: one time axis, everything in order of time."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.channels import Channel
from daq.items import Batch, DeviceEvent
from daq.log.file import LogFile

_ROWS_PER_STEP = 8192


@dataclass(frozen=True)
class Part:
    """Samples of one channel.

    Attributes:
        channel: channel in the log.
        time_ns: sample times, ns since 1970, ascending, shape (n,).
        columns: fields of the channel, each (n,).
    """

    channel: Channel
    time_ns: NDArray[np.int64]
    columns: Mapping[str, NDArray[Any]]


def write_log(
    path: Path,
    parts: Sequence[Part],
    events: Sequence[DeviceEvent],
    metadata: Mapping[str, str],
    attachments: Mapping[str, bytes],
    summary: Mapping[str, Any],
    progress: Callable[[float], None],
) -> Path:
    """Write a log of parts and events, sorted by their own times; an unfinished log is removed.

    Raises:
        LogError: the name is taken or does not end in .mcap.
        RecordingError, OSError: the disk failed.
    """
    log = LogFile(path, metadata, attachments, (), time.time_ns(), [part.channel for part in parts])
    with log.or_nothing():
        _write(log, parts, events, progress)
        return log.finish(summary)


def _write(
    log: LogFile, parts: Sequence[Part], events: Sequence[DeviceEvent], progress: Callable[[float], None]
) -> None:
    start = min(int(part.time_ns[0]) for part in parts)
    end = max(int(part.time_ns[-1]) for part in parts) + 1
    steps = max(1, sum(len(part.time_ns) for part in parts) // _ROWS_PER_STEP)
    done = [0] * len(parts)
    waiting = deque(events)
    for i in range(1, steps + 1):
        until = start + (end - start) * i // steps
        for number, part in enumerate(parts):
            stop = int(np.searchsorted(part.time_ns, until))
            rows = slice(done[number], stop)
            if stop > done[number]:
                columns = {name: values[rows] for name, values in part.columns.items()}
                sequence = np.arange(done[number], stop).astype(np.uint32)
                log.batch(Batch(part.channel, part.time_ns[rows], sequence, columns), part.time_ns[rows])
            done[number] = stop
        while waiting and (waiting[0].facts["time_ns"] < until or i == steps):
            event = waiting.popleft()
            log.event(event, event.facts["time_ns"])
        progress(i / steps)

"""Releases of the pendulums in a log: from the node's messages, or from the encoder blocks' lock flags."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from daq.channels import LOCK_A_CLOSED, LOCK_B_CLOSED
from daq.clock import ClockLine
from daq.log import Log
from daq.signals.run_clocks import samples_of, since_start

_LOCK_FLAGS = (LOCK_A_CLOSED, LOCK_B_CLOSED)


@dataclass(frozen=True)
class Release:
    """Release of a pendulum during the run.

    Attributes:
        pendulum: 0 is A, 1 is B.
        time_s: time since the run's start, s.
        time_std_s: standard uncertainty of the time, s; large if the node's own message was lost and the time was taken
            from the encoder blocks' lock flags.
    """

    pendulum: int
    time_s: float
    time_std_s: float = 1e-4


def releases_of(log: Log, line: ClockLine, start_s: float) -> tuple[Release, ...]:
    """Return the releases from the node's messages, or from the encoder blocks' lock flags if a message was lost.

    One command releases both pendulums at once. If the flags change in the same block, a message about one pendulum
    gives the time of both.
    """
    reported = {
        int(e["pendulum"]): _reported_release(e, line, start_s)
        for e in log.events
        if e["kind"] == "lock" and e["state"] == "released"
    }
    seen = _seen_releases(log, line)
    releases: list[Release] = []
    for pendulum in sorted(set(reported) | set(seen)):
        other = 1 - pendulum
        if pendulum in reported:
            releases.append(reported[pendulum])
        elif other in reported and seen.get(other) == seen[pendulum]:
            releases.append(Release(pendulum, reported[other].time_s))
        else:
            releases.append(Release(pendulum, *seen[pendulum]))
    return tuple(releases)


def _reported_release(event: Mapping[str, Any], line: ClockLine, start_s: float) -> Release:
    """Return a release from the node's message, or from the import of the recording."""
    if "node_time_us" in event:
        return Release(int(event["pendulum"]), float(line.host_s(np.array([event["node_time_us"] * 1e-6]))[0]))
    time_s = float(since_start(np.array([event["time_ns"]], np.int64), start_s)[0])
    return Release(int(event["pendulum"]), time_s, float(event.get("time_std_s", Release.time_std_s)))


def _seen_releases(log: Log, line: ClockLine) -> dict[int, tuple[float, float]]:
    """Return time and its standard uncertainty by pendulum, from the encoder blocks' lock flags."""
    samples = samples_of(log, "pendulums")
    if samples is None or "flags" not in samples.columns:
        return {}
    seen: dict[int, tuple[float, float]] = {}
    for pendulum, flag in enumerate(_LOCK_FLAGS):
        closed = (samples.flags & flag) != 0
        opened = np.flatnonzero(closed[:-1] & ~closed[1:])
        if len(opened):
            i = int(opened[-1])
            before, after = line.host_s(samples.node_time_us[i : i + 2] * 1e-6)
            # flags are a block's state when it is sent: the lock opened within the block before `after`, or in a gap
            blocks = np.unique(samples.log_time_ns, return_counts=True)[1]
            block = int(np.percentile(blocks, 5))  # a read has one or more
            last = min(i + max(1, block), len(samples) - 1)
            end = after + (samples.node_time_us[last] - samples.node_time_us[i + 1]) * 1e-6
            seen[pendulum] = (0.5 * (before + end), (end - before) / math.sqrt(12))
    return seen

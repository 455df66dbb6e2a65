"""A trip as one event: all reasons within a short time, and an excerpt of every channel around it.

Interlocks report the same fault repeatedly, and stopping the rotor causes further findings. Findings within
`TOGETHER_S` of the first reason belong to the trip. Later findings are listed by name only. The module has no clock and
no I/O; all times are arguments.
"""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.channel_watch import HOST
from daq.acquisition.interlock_table import TOGETHER_S
from daq.acquisition.recent import Recent
from daq.channels import Channel
from daq.items import DeviceEvent
from daq.log.outcome import TRIP

BEFORE_S, AFTER_S = 1.0, 1.0
"""Length of the excerpt before and after the first reason, s."""
POINTS = 99
"""Maximum number of points of one field."""
_MAX_READ_DELAY_S = 0.1  # of the last samples of the excerpt, s
_MAX_REASONS = 24
_NUMBER = re.compile(r"-?\d+(\.\d+)?")


@dataclass(frozen=True)
class Reason:
    """One reason of a trip.

    Attributes:
        interlock: name of its row in `daq.acquisition.interlock_table`.
        text: the finding with its values.
        host_ns: time of the finding, ns since 1970.
        speed_rpm: speed of the rotor at that time, rpm; NaN if unknown.
    """

    interlock: str
    text: str
    host_ns: int
    speed_rpm: float = math.nan

    @property
    def of(self) -> tuple[str, str]:
        """Key of the finding; see `finding_of`."""
        return finding_of(self.interlock, self.text)


def finding_of(interlock: str, text: str) -> tuple[str, str]:
    """Return the key of a finding: repeated findings differ only in the numbers of their texts."""
    return interlock, _NUMBER.sub("#", text)


class Trips:
    """Collects the trip of one log and makes its event; thread-safe.

    Args:
        channels: channels of the excerpt.

    Attributes:
        reasons: reasons of the trip so far in their order; empty without a trip.
    """

    def __init__(self, channels: Iterable[Channel]) -> None:
        self._channels = tuple(channels)
        self._together_ns = int(TOGETHER_S * 1e9)
        self._due_ns = int((AFTER_S + _MAX_READ_DELAY_S) * 1e9)
        self._lock = threading.Lock()
        self._is_reported = False
        self._later: dict[str, None] = {}
        self.reasons: tuple[Reason, ...] = ()

    def tripped(self, reason: Reason) -> None:
        """Add a finding of an interlock. Repetitions of a finding are ignored."""
        with self._lock:
            if self._is_reported or any(known.of == reason.of for known in self.reasons):
                return
            if self.reasons and (
                reason.host_ns > self.reasons[0].host_ns + self._together_ns or len(self.reasons) == _MAX_REASONS
            ):
                self._later[reason.interlock] = None
                return
            self.reasons = (*self.reasons, reason)

    def tick(self, now_ns: int, recent: Recent) -> list[DeviceEvent]:
        """Return the event of the trip, once, when the excerpt is complete."""
        with self._lock:
            due = self.reasons and not self._is_reported and now_ns >= self.reasons[0].host_ns + self._due_ns
            return [self._event(now_ns, recent)] if due else []

    def end(self, now_ns: int, recent: Recent) -> list[DeviceEvent]:
        """Return the event of the trip at the end of the log, unless it has been returned."""
        with self._lock:
            return [self._event(now_ns, recent)] if self.reasons and not self._is_reported else []

    def _event(self, now_ns: int, recent: Recent) -> DeviceEvent:
        self._is_reported = True
        first_ns = self.reasons[0].host_ns
        until_ns = min(first_ns + int(AFTER_S * 1e9), now_ns)
        names = list(dict.fromkeys(reason.interlock for reason in self.reasons))
        facts: dict[str, Any] = {
            "time_ns": first_ns,
            "interlocks": names,
            "reasons": [
                {"interlock": reason.interlock, "text": reason.text, "after_ms": _ms(reason.host_ns, first_ns)}
                for reason in self.reasons
            ],
            "later": list(self._later),
            "speed_rpm": _number(self.reasons[0].speed_rpm),
            "from_ms": -BEFORE_S * 1e3,
            "until_ms": _ms(until_ns, first_ns),
            "excerpt": self._excerpt(first_ns, until_ns, recent),
        }
        return DeviceEvent(TRIP, HOST, f"{', '.join(names)}: {'; also '.join(r.text for r in self.reasons)}", facts)

    def _excerpt(self, first_ns: int, until_ns: int, recent: Recent) -> dict[str, dict[str, dict[str, list[Any]]]]:
        out: dict[str, dict[str, dict[str, list[Any]]]] = {}
        for channel in self._channels:
            time_ns, columns = recent.last(channel.topic, channel.names, first_ns - int(BEFORE_S * 1e9))
            count = int(np.searchsorted(time_ns, until_ns, side="right"))
            if count:
                out[channel.topic] = {
                    name: _series(time_ns[:count], column[:count], first_ns)
                    for name, column in zip(channel.names, columns, strict=True)
                }
        return out


def _series(time_ns: NDArray[np.int64], values: NDArray[Any], first_ns: int) -> dict[str, list[Any]]:
    """Return the points of a field: times relative to the trip, ms, and values, None for missing values."""
    rows = kept_rows(values)
    return {
        "t_ms": [_ms(int(at), first_ns) for at in time_ns[rows].tolist()],
        "value": [_number(value) for value in values[rows].tolist()],
    }


def kept_rows(values: NDArray[Any]) -> NDArray[np.intp]:
    """Return the rows of a field for the excerpt, at most `POINTS`.

    Each section of the field is reduced to its minimum, its maximum and its first missing value. Constant fields and
    strictly increasing counters are reduced to their ends.

    Args:
        values: shape (n,), n ≥ 1; NaN for missing values.

    Returns:
        Ascending row numbers.
    """
    n = len(values)
    counts = values.dtype.kind in "iu" and bool(np.all(values[1:] > values[:-1]))
    if n > 2 and (counts or bool(np.all(values == values[0]))):
        return np.array([0, n - 1])
    if n <= POINTS:
        return np.arange(n)
    kept: set[int] = set()
    edges = np.linspace(0, n, POINTS // 3 + 1).astype(int).tolist()
    for start, end in pairwise(edges):
        stretch = values[start:end].astype(float)
        missing = np.isnan(stretch)
        if missing.any():
            kept.add(start + int(np.argmax(missing)))
        if not missing.all():
            kept |= {start + int(np.nanargmin(stretch)), start + int(np.nanargmax(stretch))}
    return np.array(sorted(kept))


def _ms(time_ns: int, first_ns: int) -> float:
    return round((time_ns - first_ns) * 1e-6, 2)


def _number(value: float) -> float | int | None:
    """Convert a number to JSON: integers unchanged, floats with six digits, None if it is not finite."""
    if isinstance(value, int):
        return value
    return float(f"{value:.6g}") if math.isfinite(value) else None

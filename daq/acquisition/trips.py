# pyright: strict
"""A trip as one event: every reason that came together, and the two seconds around it of every channel.

Interlocks go on finding the same fault, and a stopped rotor makes others. What is found within `TOGETHER_S` of the
first reason belongs to the trip; what comes later is named beside it. No clock and no I/O here: every time is given.
"""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.channel_watch import HOST
from daq.acquisition.interlock_table import TOGETHER_S
from daq.acquisition.recent import Recent
from daq.channels import Channel
from daq.drivers.items import Event
from daq.log.outcome import TRIP
from rig_configs.roles import Roles

BEFORE_S, AFTER_S = 1.0, 1.0
"""Rig time around the first reason that a trip's event holds."""
POINTS = 99
"""The most points of one field."""
_READ_S = 0.1  # wall seconds that the last samples may be under way
_MOST_REASONS = 24
_NUMBER = re.compile(r"-?\d+(\.\d+)?")


@dataclass(frozen=True)
class Reason:
    """One of a trip.

    Attributes:
        interlock: name of its row in `daq.acquisition.interlock_table`.
        text: what was found, with the values.
        host_ns: when, ns since 1970.
    """

    interlock: str
    text: str
    host_ns: int

    @property
    def of(self) -> tuple[str, str]:
        """What tells it from others; see `finding_of`."""
        return finding_of(self.interlock, self.text)


def finding_of(interlock: str, text: str) -> tuple[str, str]:
    """What tells one finding from others: the same one, found again, has other numbers in its text."""
    return interlock, _NUMBER.sub("#", text)


class Trips:
    """Makes the trip of one log an event; several threads may call it.

    Args:
        channels: those whose samples are kept beside it.
        roles: of the rig; the speed comes from the speed source, without one from the index marks.
        patience: rig seconds of a time-out given in wall seconds (`HostClock.patience`).

    Attributes:
        reasons: of the trip so far, the first one first; empty as long as nothing tripped.
    """

    def __init__(self, channels: Iterable[Channel], roles: Roles, patience: Callable[[float], float]) -> None:
        self._channels, self._roles = tuple(channels), roles
        self._together_ns = int(patience(TOGETHER_S) * 1e9)
        self._due_ns = int((AFTER_S + patience(_READ_S)) * 1e9)
        self._lock = threading.Lock()
        self._told = False
        self._later: dict[str, None] = {}
        self.reasons: tuple[Reason, ...] = ()

    def tripped(self, interlock: str, text: str, host_ns: int) -> None:
        """An interlock found something; the same thing found again changes nothing.

        Args:
            interlock: name of its row.
            text: the reason.
            host_ns: when it was found.
        """
        reason = Reason(interlock, text, host_ns)
        with self._lock:
            if self._told or any(known.of == reason.of for known in self.reasons):
                return
            if self.reasons and (
                host_ns > self.reasons[0].host_ns + self._together_ns or len(self.reasons) == _MOST_REASONS
            ):
                self._later[interlock] = None
                return
            self.reasons = (*self.reasons, reason)

    def tick(self, now_ns: int, recent: Recent) -> list[Event]:
        """Time passes; returns the trip, once, as soon as the seconds behind it are there."""
        with self._lock:
            due = self.reasons and not self._told and now_ns >= self.reasons[0].host_ns + self._due_ns
            return [self._event(now_ns, recent)] if due else []

    def end(self, now_ns: int, recent: Recent) -> list[Event]:
        """The log ends; returns the trip where that is not done yet."""
        with self._lock:
            return [self._event(now_ns, recent)] if self.reasons and not self._told else []

    def _event(self, now_ns: int, recent: Recent) -> Event:
        self._told = True
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
            "speed_rpm": self._speed_rpm(first_ns, recent),
            "from_ms": -BEFORE_S * 1e3,
            "until_ms": _ms(until_ns, first_ns),
            "excerpt": self._excerpt(first_ns, until_ns, recent),
        }
        return Event(TRIP, HOST, f"{', '.join(names)}: {'; also '.join(r.text for r in self.reasons)}", facts)

    def _speed_rpm(self, at_ns: int, recent: Recent) -> float | None:
        """The speed source's last word before the trip, otherwise the speed between the last two index marks."""
        speed, phase = self._roles.speed, self._roles.phase
        if speed is not None:
            time_ns, (rpm,) = recent.last(speed.topic, ("speed_rpm",))
            before = int(np.searchsorted(time_ns, at_ns, side="right"))
            return _number(float(rpm[before - 1])) if before else None
        if phase is None:
            return None
        time_ns, (turns,) = recent.last(phase.topic, ("revolutions",))
        before = int(np.searchsorted(time_ns, at_ns, side="right"))
        if before < 2 or time_ns[before - 1] == time_ns[before - 2]:
            return None
        turned = int(turns[before - 1]) - int(turns[before - 2])
        return _number(60e9 * turned / float(time_ns[before - 1] - time_ns[before - 2]))

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
    """A field's points: times in ms from the trip, values, null where there is none."""
    rows = kept_rows(values)
    return {
        "t_ms": [_ms(int(at), first_ns) for at in time_ns[rows].tolist()],
        "value": [_number(value) for value in values[rows].tolist()],
    }


def kept_rows(values: NDArray[Any]) -> NDArray[np.intp]:
    """Rows of a field that are kept, at most `POINTS`: of each stretch its least, its greatest, the first that is none.

    Of a field that never changes, and of a counter that only rises, both ends say it all.

    Args:
        values: shape (n,), n ≥ 1.

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
        none = np.isnan(stretch)
        if none.any():
            kept.add(start + int(np.argmax(none)))
        if not none.all():
            kept |= {start + int(np.nanargmin(stretch)), start + int(np.nanargmax(stretch))}
    return np.array(sorted(kept))


def _ms(time_ns: int, first_ns: int) -> float:
    return round((time_ns - first_ns) * 1e-6, 2)


def _number(value: float) -> float | int | None:
    """As JSON can hold it: whole numbers as they are, others to six digits, null for none."""
    if isinstance(value, int):
        return value
    return float(f"{value:.6g}") if math.isfinite(value) else None

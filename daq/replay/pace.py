"""Replay at a pace: each item at its own time after the start, so that delays do not accumulate."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Protocol

from daq.drivers.calibrated import CalibratedPipeline
from daq.log import Log
from daq.replay.stream import Decoded, decoded, pipelines_of
from daq.transports.host_clock import HostClock


class Clock(Protocol):
    """Clock used by a pace; HostClock implements it."""

    def now_ns(self) -> int:
        """Return the present time, ns."""
        ...

    def wait(self, seconds: float) -> None:
        """Wait for this time, s."""
        ...


class Pace:
    """Schedule of recorded items.

    The first requested instant is due at once and starts the schedule. After a stall everything overdue is due at once,
    until the schedule is met again.

    Attributes:
        late_s: delay of the last item passed to `note`, s of the clock.
        most_late_s: largest delay so far, s of the clock.

    Args:
        speed: seconds of the log per second of the clock; infinite for no waiting.
        clock: clock of the schedule.
    """

    def __init__(self, speed: float, clock: Clock) -> None:
        if not speed > 0:
            raise ValueError(f"expected a speed above 0, got {speed}")
        self._speed, self._clock = speed, clock
        self._start: tuple[int, int] | None = None  # log time and clock time, ns
        self.late_s: float = 0.0
        self.most_late_s: float = 0.0

    def left_s(self, log_ns: int) -> float:
        """Return the time until an item is due, s of the clock; negative if it is overdue, 0 without a schedule."""
        if math.isinf(self._speed):
            return 0.0
        now = self._clock.now_ns()
        if self._start is None:
            self._start = (log_ns, now)
        log_start, start = self._start
        return ((log_ns - log_start) / self._speed - (now - start)) * 1e-9

    def note(self, log_ns: int) -> None:
        """Note that an item is processed now."""
        self.late_s = max(0.0, -self.left_s(log_ns))
        self.most_late_s = max(self.most_late_s, self.late_s)


class Paced(Iterator[Decoded]):
    """A log decoded again at a pace; made by `paced`.

    Attributes:
        pace: schedule with the delays.
        pipelines: pipelines by device, with the losses so far.
    """

    def __init__(self, log: Log, speed: float, clock: Clock) -> None:
        self.pipelines: dict[str, CalibratedPipeline] = pipelines_of(log)
        self.pace: Pace = Pace(speed, clock)
        self._clock = clock
        self._items = decoded(log, self.pipelines)

    def __next__(self) -> Decoded:
        item = next(self._items)
        host_ns = item[1].host_ns
        if (left := self.pace.left_s(host_ns)) > 0:
            self._clock.wait(left)
        self.pace.note(host_ns)
        return item


def paced(log: Log, speed: float = 1.0, clock: Clock | None = None) -> Paced:
    """Return every raw read and write of a log when it is due, with the items that the device's pipeline decodes.

    Args:
        log: the open log.
        speed: seconds of the log per second; `math.inf` for no waiting.
        clock: clock of the schedule; None for the host's clock.

    Returns:
        Iterator over (device, chunk, items).

    Raises:
        LogError: the log cannot be decoded again.
        ValueError: a speed of 0 or below.
    """
    return Paced(log, speed, clock or HostClock())

"""Time that a simulated rig and its host share. It stops while either of them is late.

A rig that runs faster than real time needs most of the processor time of a machine. If other programs take part of it,
the rig or the host falls behind, and the interlocks stop the run for missing data: at rate 8, 0.75 s without processor
are 6 s without samples. The bytes are late by the same factor. Device clocks that are mapped by the arrival of their
bytes then wander by milliseconds, and a constant speed seems to change.

Time therefore advances in steps of `_STEP_S`. It stops after each step until the rig has simulated the motion up to
that time and the host has fetched every byte. It does not wait for a side that has not responded for 2 s, nor for a
cable that no process reads for 0.5 s. Fetching every byte keeps the lag from which clock maps are estimated at 0.03 to
0.2 ms (2 to 6 ms if the clock stops only after 25 ms), for a sixth of the speed.

Both processes map one small file. The monotonic clock is common to all processes of a machine, so the words of the file
at one instant give the same time in both processes.
"""

from __future__ import annotations

import mmap
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from daq.transports.host_clock import HostClock

_STEP_S = 0.02  # wall s that time advances before it stops until rig and host have caught up
_HOST_LATE_S = 0.01  # wall s since the host's last reading of the clock after which the host is late
_HOST_GONE_S = 2.0  # wall s since that reading after which no host shares the clock, and time does not wait for one
_UNSHARED_STEP_S = 60.0  # step without such a host: other programs connected to the rig use a clock that never stops
_RIG_GONE_S = 2.0  # wall s without an update by the rig's process after which time runs on, so that every wait ends
_MIN_WAIT_S = 0.0005
_OFFSET, _END, _READ_AT, _WORDS = 0, 1, 2, 3  # indices of the 8-byte words in the file, and their number


class PacedClock(HostClock):
    """See the module.

    Args:
        rate: rig time per wall time while neither side is late, s/s.
        path: shared file, given to the rig's process. None: the host's clock, which creates the file.
    """

    def __init__(self, rate: float, path: Path | None = None) -> None:
        super().__init__(rate)
        self._leads = path is not None
        if path is None:
            descriptor, name = tempfile.mkstemp(prefix="rig-pace-")
            path = Path(name)
            os.write(descriptor, bytes(8 * _WORDS))
        else:
            descriptor = os.open(path, os.O_RDWR)
        self.path = path
        try:
            self._map = mmap.mmap(descriptor, 8 * _WORDS)
        finally:
            os.close(descriptor)
        self._page = memoryview(self._map).cast("q")  # each word is read and written atomically
        if not self._leads:
            now_ns = super().now_ns()
            self._page[_END] = now_ns + self._ns(_STEP_S)
            self._page[_OFFSET] = now_ns - self._ns(time.monotonic())

    def _ns(self, wall_s: float) -> int:
        """Rig time that corresponds to a wall time, ns."""
        return round(wall_s * 1e9 * self.rate)

    def now_ns(self) -> int:
        """See HostClock."""
        if not self._leads:
            self._page[_READ_AT] = round(time.monotonic() * 1e9)
        return self._times()[0]

    def _times(self) -> tuple[int, float]:
        """Return the rig time now, ns, and the reading of the monotonic clock, s."""
        while True:
            end_ns = self._page[_END]
            monotonic_s = time.monotonic()
            unhindered_ns = self._page[_OFFSET] + self._ns(monotonic_s)
            if self._page[_END] == end_ns:  # otherwise the rig's process has just written: read again
                return max(min(unhindered_ns, end_ns), unhindered_ns - self._ns(_RIG_GONE_S)), monotonic_s

    def wall_s(self) -> float:
        """See HostClock; it stops while rig time stops, so no timeout expires during a stop."""
        return self.now_ns() * 1e-9 / self.rate

    def sleep(self, seconds: float) -> None:
        """See HostClock. The wait is longer by the duration of the stops. `wait` is not: readers must keep fetching."""
        end_ns = self.now_ns() + round(max(0.0, seconds) * 1e9)
        while (left_ns := end_ns - self.now_ns()) > 0:
            time.sleep(max(_MIN_WAIT_S, left_ns * 1e-9 / self.rate))

    def go_on(self, held_up: Callable[[], bool]) -> bool:
        """Advance time by the next step if it has stopped and the host is not late.

        The rig's process calls this periodically.

        Args:
            held_up: returns whether bytes in a cable wait for the host; called when time has stopped.

        Returns:
            Whether time is running.
        """
        now_ns, monotonic_s = self._times()
        unread_s = monotonic_s - self._page[_READ_AT] * 1e-9
        shared = unread_s < _HOST_GONE_S
        end_ns = now_ns + self._ns(_STEP_S if shared else _UNSHARED_STEP_S)
        if now_ns < self._page[_END]:
            self._page[_END] = min(self._page[_END], end_ns) if shared else end_ns
            return True
        self._page[_END] = now_ns
        self._page[_OFFSET] = now_ns - self._ns(monotonic_s)
        if shared and (unread_s > _HOST_LATE_S or held_up()):
            return False
        self._page[_END] = end_ns
        return True

    def close(self) -> None:
        """Unmap the file. The process that created it also removes it."""
        self._page.release()
        self._map.close()
        if not self._leads:
            self.path.unlink(missing_ok=True)

# pyright: strict
"""Time that a simulated rig and its host share, and that stands while either of them is late.

A rig that runs faster than life asks for most of a machine. Where other programs want their part of it, rig or host
falls behind, and the interlocks stop what looks like a blind rig: in eightfold time three quarters of a second without
a processor are six seconds of silence. And eight times as late are the bytes: clocks that are told by their arrival
wander by milliseconds, and a steady speed seems to change. So here time passes a few hundredths of a second at a time,
and stands then until the rig has moved so far and the host has fetched every byte: the last ones never arrive late.

Both processes map one small file. What is read of it at one instant gives one time in both: the monotonic clock of a
machine is that of all its processes.
"""

from __future__ import annotations

import mmap
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from daq.transports.host_clock import HostClock

_AHEAD_S = 0.02  # wall s that time passes before it stands for those who are late
_LATE_S = 0.01  # wall s without a look at the clock: the host is late
_GONE_S = 2.0  # wall s without one: there is none that time would have to wait for …
_UNSHARED_S = 60.0  # … and whoever else talks to the rig has a clock that never stands
_ALONE_S = 2.0  # wall s without the rig's word: it is gone, and time passes again, so that waits come to their ends
_LEAST_WAIT_S = 0.0005
_FROM, _END, _LOOKED, _WORDS = 0, 1, 2, 3  # places in the file, 8 bytes each


class PacedClock(HostClock):
    """See the module.

    Args:
        rate: seconds of rig time per wall second, where nobody is late.
        path: of the file that is shared; None: a new one is made, and the clock is the host's.
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
        self._page = memoryview(self._map).cast("q")  # a word of it is read and written at once
        if not self._leads:
            now_ns = super().now_ns()
            self._page[_END] = now_ns + self._ns(_AHEAD_S)
            self._page[_FROM] = now_ns - self._ns(time.monotonic())

    def _ns(self, wall_s: float) -> int:
        """Rig time that passes meanwhile, ns."""
        return round(wall_s * 1e9 * self.rate)

    def now_ns(self) -> int:
        """See HostClock."""
        if not self._leads:
            self._page[_LOOKED] = round(time.monotonic() * 1e9)
        return self._seen()[0]

    def _seen(self) -> tuple[int, float]:
        """Time now, ns, and the monotonic clock's, s."""
        while True:
            end_ns = self._page[_END]
            monotonic_s = time.monotonic()
            unhindered_ns = self._page[_FROM] + self._ns(monotonic_s)
            if self._page[_END] == end_ns:  # else the rig has just written
                return max(min(unhindered_ns, end_ns), unhindered_ns - self._ns(_ALONE_S)), monotonic_s

    def wall_s(self) -> float:
        """See HostClock; it stands when rig time does, so nobody's patience ends meanwhile."""
        return self.now_ns() * 1e-9 / self.rate

    def sleep(self, seconds: float) -> None:
        """See HostClock; longer by the time that has stood. `wait` goes on then: who fetches bytes must not stand."""
        end_ns = self.now_ns() + round(max(0.0, seconds) * 1e9)
        while (left_ns := end_ns - self.now_ns()) > 0:
            time.sleep(max(_LEAST_WAIT_S, left_ns * 1e-9 / self.rate))

    def go_on(self, held_up: Callable[[], bool]) -> bool:
        """Let time pass on, as the rig's process, once it stands and the host is not late; call it again and again.

        Args:
            held_up: whether bytes wait in a cable for the host; asked when time stands.

        Returns:
            Whether time passes.
        """
        now_ns, monotonic_s = self._seen()
        unlooked_s = monotonic_s - self._page[_LOOKED] * 1e-9
        shared = unlooked_s < _GONE_S
        end_ns = now_ns + self._ns(_AHEAD_S if shared else _UNSHARED_S)
        if now_ns < self._page[_END]:
            self._page[_END] = min(self._page[_END], end_ns) if shared else end_ns
            return True
        self._page[_END] = now_ns
        self._page[_FROM] = now_ns - self._ns(monotonic_s)
        if shared and (unlooked_s > _LATE_S or held_up()):
            return False
        self._page[_END] = end_ns
        return True

    def close(self) -> None:
        """Let go of the file; who made it removes it."""
        self._page.release()
        self._map.close()
        if not self._leads:
            self.path.unlink(missing_ok=True)

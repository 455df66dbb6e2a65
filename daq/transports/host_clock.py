# pyright: strict
"""The host's time: the common clock of all device clocks, and every wait of the acquisition.

Whatever waits, repeats itself or takes answers out of a queue does it through a `HostClock`: drivers, sessions, guided
tests. So another clock (`daq.lockstep.clock`) runs them all on simulated time, in one thread.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from typing import Any, Protocol


class Repeated(Protocol):
    """Something that is done again and again."""

    def stop(self, wall_seconds: float | None = 2.0) -> None:
        """End it, and wait until it has ended.

        Args:
            wall_seconds: the longest wait; None: without limit.
        """
        ...


class HostClock:
    """Nanoseconds since 1970 that never step back, and waits by them.

    Args:
        rate: seconds of rig time per wall second; 1 on a rig, more where the rig behind the links runs faster.
    """

    def __init__(self, rate: float = 1.0) -> None:
        if not 0.01 <= rate <= 100:
            raise ValueError(f"clock rate must be between 0.01 and 100 rig seconds per second, got {rate}")
        self.rate = rate
        self._monotonic_ns = time.monotonic_ns()
        self._utc_ns = time.time_ns()

    # --- time --------------------------------------------------------------------------------------------------

    def now_ns(self) -> int:
        """Rig time now, ns since 1970."""
        return self._utc_ns + int((time.monotonic_ns() - self._monotonic_ns) * self.rate)

    def now_s(self) -> float:
        """Rig time now, s since 1970."""
        return self.now_ns() * 1e-9

    def wall_s(self) -> float:
        """Wall time since some instant, s; it never steps."""
        return time.monotonic()

    def wall(self, seconds: float) -> float:
        """How many wall seconds some rig time takes."""
        return seconds / self.rate

    def patience(self, wall_seconds: float) -> float:
        """A time-out that guards against a stalled host or cable, as rig time.

        Such a time-out is a promise in wall time (the host's scheduler does not run faster because the rig does).
        """
        return wall_seconds * max(1.0, self.rate)

    # --- waiting -----------------------------------------------------------------------------------------------

    def sleep(self, seconds: float) -> None:
        """Wait for some rig time."""
        self.wait(max(0.0, seconds) / self.rate)

    def wait(self, wall_seconds: float) -> None:
        """Wait for some wall time."""
        time.sleep(max(0.0, wall_seconds))

    def every(
        self, wall_seconds: float, do: Callable[[], object], name: str, failed: Callable[[Exception], None]
    ) -> Repeated:
        """Do something again and again, the first time after one period, beside whatever else is done.

        Args:
            wall_seconds: the period.
            do: what; it must not wait.
            name: of the thread.
            failed: called with the exception that `do` raised; it is not done any more then.
        """
        return _RepeatingThread(wall_seconds, do, name, failed)

    def queue(self) -> queue.Queue[Any]:
        """A queue whose `get` waits by this clock (its time-out: wall seconds)."""
        return queue.Queue()


class _RepeatingThread:
    """See HostClock.every."""

    def __init__(
        self, wall_seconds: float, do: Callable[[], object], name: str, failed: Callable[[Exception], None]
    ) -> None:
        self._period_s, self._do, self._failed = wall_seconds, do, failed
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            while not self._ending.wait(self._period_s):
                self._do()
        except Exception as error:
            if not self._ending.is_set():
                self._failed(error)

    def stop(self, wall_seconds: float | None = 2.0) -> None:
        """See Repeated."""
        self._ending.set()
        if threading.current_thread() is not self._thread:
            self._thread.join(wall_seconds)

"""The host's time: the common clock of all device clocks, and every wait of the acquisition.

Drivers, sessions and guided tests wait, repeat actions and take answers out of queues only through a `HostClock`.
Another clock (`daq.lockstep.clock`) therefore runs them all on simulated time, in one thread.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from typing import Any, Protocol


class Repeated(Protocol):
    """A periodic action."""

    def stop(self, wall_seconds: float | None = 2.0) -> None:
        """End the periodic action and wait until it has ended.

        Args:
            wall_seconds: maximum wait, wall s; None: no limit.
        """
        ...


class HostClock:
    """Time in nanoseconds since 1970 that never steps back, and waits on this time.

    Args:
        rate: rig time per wall time, s/s; 1 on a real rig, greater than 1 for a simulated rig that runs faster.
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
        """Wall time since an arbitrary fixed instant, s; it never steps."""
        return time.monotonic()

    def wall(self, seconds: float) -> float:
        """Convert a duration in rig seconds to wall seconds."""
        return seconds / self.rate

    def rig(self, wall_seconds: float) -> float:
        """Convert a measured duration in wall seconds to rig seconds."""
        return wall_seconds * self.rate

    def patience(self, wall_seconds: float) -> float:
        """Return the rig time, s, of a timeout that guards against a stalled host or cable.

        Such a timeout is defined in wall time, because the host's scheduler does not run faster with the rig.

        Args:
            wall_seconds: timeout, wall s.
        """
        return wall_seconds * max(1.0, self.rate)

    # --- waiting -----------------------------------------------------------------------------------------------

    def sleep(self, seconds: float) -> None:
        """Wait for a duration in rig seconds."""
        self.wait(max(0.0, seconds) / self.rate)

    def wait(self, wall_seconds: float) -> None:
        """Wait for a duration in wall seconds."""
        time.sleep(max(0.0, wall_seconds))

    def every(
        self, wall_seconds: float, do: Callable[[], object], name: str, failed: Callable[[Exception], None]
    ) -> Repeated:
        """Call a function periodically in the background, the first time after one period.

        Args:
            wall_seconds: period, wall s.
            do: function that is called; it must not wait.
            name: name of the thread.
            failed: called with the exception that `do` raised. `do` is not called again after an exception.
        """
        return _RepeatingThread(wall_seconds, do, name, failed)

    def queue(self) -> queue.Queue[Any]:
        """Return a queue whose `get` waits on this clock; the timeout of `get` is in wall seconds."""
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

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

from typing_extensions import override


class Repeated(Protocol):
    """A periodic action."""

    def stop(self, seconds: float | None = 2.0) -> None:
        """End the periodic action and wait until it has ended.

        Args:
            seconds: maximum wait, s; None: no limit.
        """
        ...


class HostClock:
    """Time in nanoseconds since 1970 that never steps back, and waits on this time."""

    def __init__(self) -> None:
        self._zero_ns = time.time_ns()
        self._ahead_ns = self._zero_ns - time.monotonic_ns()

    # --- time --------------------------------------------------------------------------------------------------

    def now_ns(self) -> int:
        """Time now, ns since 1970."""
        return self._ahead_ns + time.monotonic_ns()

    def now_s(self) -> float:
        """Time since the clock was made, s: a small number, exact to nanoseconds for days."""
        return (self.now_ns() - self._zero_ns) * 1e-9

    # --- waiting -----------------------------------------------------------------------------------------------

    def wait(self, seconds: float) -> None:
        """Wait for a duration; not at all if it is negative."""
        time.sleep(max(0.0, seconds))

    def every(
        self, seconds: float, do: Callable[[], object], name: str, failed: Callable[[Exception], None]
    ) -> Repeated:
        """Call a function periodically in the background, the first time after one period.

        Args:
            seconds: period, s.
            do: function that is called; it must not wait.
            name: name of the thread.
            failed: called with the exception that `do` raised. `do` is not called again after an exception.
        """
        return _RepeatingThread(seconds, do, name, failed)

    def queue(self) -> queue.Queue[Any]:
        """Return a queue whose `get` waits on this clock; the timeout of `get` is in seconds."""
        return queue.Queue()


class _RepeatingThread(Repeated):
    """See HostClock.every."""

    def __init__(
        self, seconds: float, do: Callable[[], object], name: str, failed: Callable[[Exception], None]
    ) -> None:
        self._period_s, self._do, self._failed = seconds, do, failed
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

    @override
    def stop(self, seconds: float | None = 2.0) -> None:
        self._ending.set()
        if threading.current_thread() is not self._thread:
            self._thread.join(seconds)

# pyright: strict
"""A host's clock that passes only while somebody waits for it, and does then what is due.

What is due is the world's (the rig moves, a cable is cut) or the host's (a reader wakes up, a tick). A host that is
busy with something else does its part late; the world goes on.
"""

from __future__ import annotations

import heapq
import queue
from collections.abc import Callable
from typing import Any

from daq.transports.host_clock import HostClock, Repeated

START_NS = 1_700_000_000_000_000_000
_LOOK_NS = 100_000  # the least that a wait takes: a loop around it comes to an end too
_FOREVER_S = 3600.0


class WaitedInVain(RuntimeError):
    """Something waits for what never comes, or inside of what is done while others wait."""


class SimulatedClock(HostClock):
    """See the module. Rig time and wall time are one."""

    def __init__(self, start_ns: int = START_NS) -> None:
        super().__init__()
        self._start_ns = self._now_ns = start_ns
        self._due: list[tuple[int, int, bool, Callable[[], object]]] = []
        self._count = 0
        self._doing = False
        self._busy_until_ns = start_ns

    # --- time --------------------------------------------------------------------------------------------------

    def now_ns(self) -> int:
        """See HostClock."""
        return self._now_ns

    def wall_s(self) -> float:
        """See HostClock; since the clock's beginning."""
        return (self._now_ns - self._start_ns) * 1e-9

    # --- what is due -------------------------------------------------------------------------------------------

    def at(self, when_ns: int, do: Callable[[], object], world: bool = False) -> None:
        """Do something at an instant; of two at the same instant the one that was asked for first.

        Args:
            when_ns: ns since 1970; one that has passed means at once.
            do: it must not wait.
            world: whether it happens however busy the host is.
        """
        self._count += 1
        heapq.heappush(self._due, (max(when_ns, self._now_ns), self._count, world, do))

    def after(self, seconds: float, do: Callable[[], object], world: bool = False) -> None:
        """The same, some time from now, s."""
        self.at(self._now_ns + round(seconds * 1e9), do, world)

    def busy(self, seconds: float) -> None:
        """The host does nothing of ours for so long, s."""
        self._busy_until_ns = max(self._busy_until_ns, self._now_ns + round(seconds * 1e9))

    def pass_until(self, when_ns: int, ready: Callable[[], bool] = lambda: False) -> None:
        """Let time pass up to an instant, or until something is ready; it is asked after each thing that is done.

        Raises:
            WaitedInVain: called by what is done meanwhile.
        """
        if self._doing:
            raise WaitedInVain("expected something that is done at once, it waits: only the one thread may wait")
        while not ready():
            end_ns = max(when_ns, self._busy_until_ns)  # who waits wakes up when the host does
            if not self._due or self._due[0][0] > end_ns:
                self._now_ns = max(self._now_ns, end_ns)
                return
            self._do_next()

    def _do_next(self) -> None:
        when_ns, count, world, do = heapq.heappop(self._due)
        if not world and when_ns < self._busy_until_ns:
            heapq.heappush(self._due, (self._busy_until_ns, count, world, do))
            return
        self._now_ns, self._doing = when_ns, True
        try:
            do()
        finally:
            self._doing = False

    # --- waiting -----------------------------------------------------------------------------------------------

    def wait(self, wall_seconds: float) -> None:
        """See HostClock."""
        self.pass_until(self._now_ns + max(round(wall_seconds * 1e9), _LOOK_NS))

    def every(
        self, wall_seconds: float, do: Callable[[], object], name: str, failed: Callable[[Exception], None]
    ) -> Repeated:
        """See HostClock."""
        return _Repeating(self, wall_seconds, do, failed)

    def queue(self) -> queue.Queue[Any]:
        """See HostClock."""
        return _Inbox(self)


class _Repeating:
    """See Repeated."""

    def __init__(
        self, clock: SimulatedClock, period_s: float, do: Callable[[], object], failed: Callable[[Exception], None]
    ) -> None:
        self._clock, self._period_s, self._do, self._failed = clock, period_s, do, failed
        self._ended = False
        clock.after(period_s, self._turn)

    def _turn(self) -> None:
        if self._ended:
            return
        try:
            self._do()
        except Exception as error:
            self._ended = True
            self._failed(error)
            return
        self._clock.after(self._period_s, self._turn)

    def stop(self, wall_seconds: float | None = 2.0) -> None:
        """See Repeated."""
        self._ended = True


class _Inbox(queue.Queue[Any]):
    """A queue whose wait lets time pass."""

    def __init__(self, clock: SimulatedClock) -> None:
        super().__init__()
        self._clock = clock

    def get(self, block: bool = True, timeout: float | None = None) -> Any:
        """See queue.Queue."""
        if block and self.empty():
            seconds = _FOREVER_S if timeout is None else max(timeout, 0.0)
            self._clock.pass_until(self._clock.now_ns() + round(seconds * 1e9), lambda: not self.empty())
            if timeout is None and self.empty():
                raise WaitedInVain(f"waited {_FOREVER_S:g} s, without a time-out, for an answer that never came")
        return super().get(block=False)

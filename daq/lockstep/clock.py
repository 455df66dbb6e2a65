"""A simulated host clock whose time advances only during waits, in which the scheduled actions are run.

An action belongs to the world (motion of the rig, a cable is unplugged) or to the host (a reader wakes up, a tick).
While the host is busy its actions are delayed; actions of the world are not. Ctrl-C ends a wait between two actions:
what they write and count remains whole, as in threads of their own.
"""

from __future__ import annotations

import heapq
import queue
from collections.abc import Callable
from typing import Any

from typing_extensions import override

from daq.transports.host_clock import HostClock, Repeated
from rig_basics.interruptions import interruptions_held

START_NS = 1_700_000_000_000_000_000
_MIN_WAIT_NS = 100_000  # least duration of a wait, so that loops of waits end
_MAX_GET_S = 120.0  # wait of a queue without timeout, after which an error is raised; above any device's time-out


class WaitNeverEnds(RuntimeError):
    """A wait without timeout did not end, or an action of the clock called a wait."""


class SimulatedClock(HostClock):
    """The simulated clock; see the module.

    Args:
        start_ns: initial time, ns since 1970.
    """

    def __init__(self, start_ns: int = START_NS) -> None:
        super().__init__()
        self._zero_ns = self._now_ns = start_ns
        self._due: list[tuple[int, int, bool, Callable[[], object]]] = []
        self._count = 0
        self._doing = False
        self._busy_until_ns = start_ns

    # --- time --------------------------------------------------------------------------------------------------

    @override
    def now_ns(self) -> int:
        return self._now_ns

    # --- actions -----------------------------------------------------------------------------------------------

    def at(self, when_ns: int, do: Callable[[], object], world: bool = False) -> None:
        """Schedule an action. Actions of the same time are run in the order of their scheduling.

        Args:
            when_ns: time of the action, ns since 1970; a past time means the present time.
            do: the action, which must not wait.
            world: whether the action belongs to the world, which a busy host does not delay.
        """
        self._count += 1
        heapq.heappush(self._due, (max(when_ns, self._now_ns), self._count, world, do))

    def after(self, seconds: float, do: Callable[[], object], world: bool = False) -> None:
        """Schedule an action after a number of seconds; see `at`."""
        self.at(self._now_ns + round(seconds * 1e9), do, world)

    def busy(self, seconds: float) -> None:
        """Delay all actions of the host for a number of seconds."""
        self._busy_until_ns = max(self._busy_until_ns, self._now_ns + round(seconds * 1e9))

    def pass_until(self, when_ns: int, ready: Callable[[], bool] = lambda: False) -> None:
        """Advance the time and run the actions.

        Args:
            when_ns: time at which to return, ns since 1970.
            ready: evaluated after each action; the method returns when it is true.

        Raises:
            WaitNeverEnds: the method was called by an action.
        """
        if self._doing:
            raise WaitNeverEnds("an action of the simulated clock waits: expected an action that returns at once")
        while not self._passed(when_ns, ready):
            pass  # an interruption that raises nothing does not end the wait

    def _passed(self, when_ns: int, ready: Callable[[], bool]) -> bool:
        """As `pass_until`, until an interruption; return whether it has ended without one."""
        with interruptions_held() as held:
            while not ready():
                end_ns = max(when_ns, self._busy_until_ns)  # a wait does not end while the host is busy
                if not self._due or self._due[0][0] > end_ns:
                    self._now_ns = max(self._now_ns, end_ns)
                    break
                self._do_next()
                if held:
                    return False
        return True

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

    @override
    def wait(self, seconds: float) -> None:
        self.pass_until(self._now_ns + max(round(seconds * 1e9), _MIN_WAIT_NS))

    @override
    def every(
        self, seconds: float, do: Callable[[], object], name: str, failed: Callable[[Exception], None]
    ) -> Repeated:
        return _Repeating(self, seconds, do, failed)

    @override
    def queue(self) -> queue.Queue[Any]:
        return _Inbox(self)


class _Repeating(Repeated):
    """A repeated action on the simulated clock; implements Repeated."""

    def __init__(
        self, clock: SimulatedClock, period_s: float, do: Callable[[], object], failed: Callable[[Exception], None]
    ) -> None:
        self._clock, self._period_s, self._do, self._failed = clock, period_s, do, failed
        self._ended = False
        clock.after(period_s, self._act)

    def _act(self) -> None:
        if self._ended:
            return
        try:
            self._do()
        except Exception as error:
            self._ended = True
            self._failed(error)
            return
        self._clock.after(self._period_s, self._act)

    @override
    def stop(self, seconds: float | None = 2.0) -> None:
        self._ended = True


class _Inbox(queue.Queue[Any]):
    """A queue whose `get` advances the simulated clock."""

    def __init__(self, clock: SimulatedClock) -> None:
        super().__init__()
        self._clock = clock

    @override
    def get(self, block: bool = True, timeout: float | None = None) -> Any:
        if block and self.empty():
            seconds = _MAX_GET_S if timeout is None else max(timeout, 0.0)
            self._clock.pass_until(self._clock.now_ns() + round(seconds * 1e9), lambda: not self.empty())
            if timeout is None and self.empty():
                raise WaitNeverEnds(f"waited {_MAX_GET_S:g} s without a timeout for an answer: none arrived")
        return super().get(block=False)

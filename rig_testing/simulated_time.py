"""Time that passes only while a thread waits.

Drivers wait: for an answer, for a quiet line, for a rotor at rest; some have a thread that sends a heartbeat. Under
`SimulatedTime` every such wait advances the simulated rig and takes only the time of its computation. One thread runs
at a time, each until it waits again, so that two runs give the same bytes.

Simulated are `time.sleep`, `time.monotonic` and `time.monotonic_ns` called through the module, `threading.Event.wait`,
`threading.Thread.start` and `.join`, and `queue.Queue.get`; for the thread that entered and for those that it starts.
Other waits (a `Condition`, a `SimpleQueue`, a name imported from `time`) are not simulated.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable, Generator
from typing import Any

STEP_S = 0.01
_LOOK_S = 1e-4  # simulated time of one reading of the clock, so that a loop around it ends
_FOREVER_S = 120.0  # simulated time after which a wait without a timeout is an error
_WALL_S = 2.0  # longest time to the next wait of a thread

_real_start, _real_join = threading.Thread.start, threading.Thread.join
_real_wait = threading.Event.wait
_real_get = queue.Queue[Any].get
_real_sleep, _real_monotonic, _real_monotonic_ns = time.sleep, time.monotonic, time.monotonic_ns


class EndlessWait(RuntimeError):
    """A thread waits without a timeout for an event that does not occur."""


class SimulatedTime:
    """Simulated time of a thread and those it starts, see the module.

    Args:
        moved: called with the new time, s, in the thread that entered, whenever time has passed.

    Attributes:
        now_s: time since the start, s.
    """

    def __init__(self, moved: Callable[[float], None]) -> None:
        self.now_s: float = 0.0
        self._moved = moved
        self._moving = False
        self._owner: threading.Thread | None = None
        self._ours: list[threading.Thread] = []
        self._turn = threading.Condition()
        self._parked: dict[threading.Thread, float] = {}
        self._waiting_really: set[threading.Thread] = set()
        self._over = self._starting = False

    def pass_time(self, seconds: float) -> None:
        """Advance the time in steps; threads whose wait has ended run."""
        until = self.now_s + seconds
        if self._moving:  # the function that moves the rig waits itself
            self.now_s = until
            return
        while self.now_s < until - 1e-12:
            due = min([self.now_s + STEP_S, until, *(d for d in self._parked.values() if d > self.now_s)])
            self.now_s = due
            self._moving = True
            try:
                self._moved(due)
            finally:
                self._moving = False
            self._run_due()

    def _run_due(self) -> None:
        for thread in [thread for thread, due in self._parked.items() if due <= self.now_s]:
            with self._turn:
                self._parked.pop(thread, None)
                self._turn.notify_all()
            self._run_until_wait(thread)

    def _run_until_wait(self, thread: threading.Thread) -> None:
        """Wait until a thread waits again, or has ended."""
        deadline = _real_monotonic() + _WALL_S
        with self._turn:
            while thread.is_alive() and thread not in self._parked and thread not in self._waiting_really:
                if _real_monotonic() > deadline:
                    return
                self._turn.wait(0.002)

    def _park(self, until_s: float) -> None:
        """Wait, in a thread that was started in the context, until time has passed."""
        me = threading.current_thread()
        with self._turn:
            if self._over:
                return
            self._parked[me] = until_s
            self._turn.notify_all()
            while me in self._parked and not self._over:
                self._turn.wait(0.5)

    def _wait(self, ready: Callable[[], bool], seconds: float | None) -> bool:
        """Wait on simulated time for a condition; return whether it became true."""
        due = self.now_s + (_FOREVER_S if seconds is None else max(0.0, seconds))
        while not ready():
            if self.now_s >= due - 1e-12:
                if seconds is None:
                    raise EndlessWait(
                        f"waited {_FOREVER_S:g} s of simulated time without a timeout, and nothing happened"
                    )
                return False
            if threading.current_thread() is self._owner:
                self.pass_time(min(STEP_S, due - self.now_s))
            elif self._over:
                return ready()
            else:
                self._park(min(due, self.now_s + STEP_S))
        return True

    def _is_ours(self) -> bool:
        me = threading.current_thread()
        return not self._over and (me is self._owner or me in self._ours)

    # --- replacements of the real functions -----------------------------------------------------------------------

    def _sleep(self, seconds: float) -> None:
        if not self._is_ours():
            _real_sleep(seconds)
        elif threading.current_thread() is self._owner:
            self.pass_time(max(seconds, _LOOK_S))
        else:
            self._park(self.now_s + max(seconds, _LOOK_S))

    def _monotonic(self) -> float:
        if not self._is_ours():
            return _real_monotonic()
        if threading.current_thread() is self._owner and not self._moving:
            self.now_s += _LOOK_S
        return self.now_s

    def _monotonic_ns(self) -> int:
        return round(self._monotonic() * 1e9) if self._is_ours() else _real_monotonic_ns()

    def _start(self, thread: threading.Thread) -> None:
        ours = self._is_ours()
        if ours:
            self._ours.append(thread)
        self._starting = True  # the wait inside is for the operating system
        try:
            _real_start(thread)
        finally:
            self._starting = False
        if ours:
            self._run_until_wait(thread)

    def _join(self, thread: threading.Thread, timeout: float | None = None) -> None:
        if threading.current_thread() is self._owner and thread in self._ours and not self._over:
            self._wait(lambda: not thread.is_alive(), timeout)
        else:
            _real_join(thread, timeout)

    def _event_wait(self, event: threading.Event, timeout: float | None = None) -> bool:
        if not self._is_ours() or self._starting or event.is_set():
            return _real_wait(event, timeout)
        if timeout is None and threading.current_thread() is not self._owner:
            return self._wait_really(lambda: _real_wait(event))
        return self._wait(event.is_set, timeout)

    def _wait_really(self, wait: Callable[[], Any]) -> Any:
        me = threading.current_thread()
        self._waiting_really.add(me)
        try:
            return wait()
        finally:
            self._waiting_really.discard(me)

    def _get(self, waited: queue.Queue[Any], block: bool = True, timeout: float | None = None) -> Any:
        if not block or not self._is_ours():
            return _real_get(waited, block, timeout)
        if timeout is None and threading.current_thread() is not self._owner:
            return self._wait_really(lambda: _real_get(waited))
        if not self._wait(lambda: not waited.empty(), timeout):
            raise queue.Empty
        return _real_get(waited, False)

    @contextlib.contextmanager
    def running(self) -> Generator[None]:
        """Simulate time for this thread and those it starts, inside of this context."""
        self._owner, self._over = threading.current_thread(), False

        def start(thread: threading.Thread) -> None:  # functions, so that they become methods
            self._start(thread)

        def join(thread: threading.Thread, timeout: float | None = None) -> None:
            self._join(thread, timeout)

        def wait(event: threading.Event, timeout: float | None = None) -> bool:
            return self._event_wait(event, timeout)

        def get(waited: queue.Queue[Any], block: bool = True, timeout: float | None = None) -> Any:
            return self._get(waited, block, timeout)

        replacements: list[tuple[object, str, Callable[..., Any]]] = [
            (time, "sleep", self._sleep),
            (time, "monotonic", self._monotonic),
            (time, "monotonic_ns", self._monotonic_ns),
            (threading.Thread, "start", start),
            (threading.Thread, "join", join),
            (threading.Event, "wait", wait),
            (queue.Queue, "get", get),
        ]
        real = [(owner, name, getattr(owner, name)) for owner, name, _ in replacements]
        try:
            for owner, name, replacement in replacements:
                setattr(owner, name, replacement)
            yield
        finally:
            for owner, name, was in real:
                setattr(owner, name, was)
            with self._turn:
                self._over = True
                self._parked.clear()
                self._turn.notify_all()

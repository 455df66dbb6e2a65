"""Calls of a driver that wait, or read a time, without the clock that it is given."""

from __future__ import annotations

import contextlib
import gc
import sys
import threading
import time
from collections.abc import Generator
from pathlib import Path
from types import CodeType, FrameType

_SLEEP = time.sleep
_READINGS = (time.time, time.time_ns, time.monotonic, time.monotonic_ns, time.perf_counter, time.perf_counter_ns)
_WAITS: frozenset[CodeType] = frozenset(
    wait.__code__ for wait in (threading.Condition.wait, threading.Thread.start, threading.Thread.join)
)  # events, semaphores and queues wait by a condition


@contextlib.contextmanager
def own_waits() -> Generator[list[str]]:
    """Collect the calls of this thread inside of the context that bypass a HostClock.

    These are waits, starts of threads, and readings of a clock. Readings by the standard library, as of the time of a
    log record, are not counted.

    Yields:
        The calls: function, file and line, in order.
    """
    found: list[str] = []

    def watch(frame: FrameType, event: str, called: object) -> None:
        if event == "call" and frame.f_code in _WAITS:
            found.append(_call(frame, ""))
        elif event == "c_call" and called is _SLEEP:
            found.append(_call(frame, "time.sleep"))
        elif event == "c_call" and called in _READINGS and not _is_standard(frame):
            found.append(_call(frame, f"time.{getattr(called, '__name__', '')}"))

    before, collects = sys.getprofile(), gc.isenabled()
    gc.disable()  # what is called by a collection, a finalizer for example, is not the driver's
    sys.setprofile(watch)
    try:
        yield found
    finally:
        sys.setprofile(before)
        if collects:
            gc.enable()


def _call(frame: FrameType | None, name: str) -> str:
    """Return the function of the standard library that was called, and the file and line of the call."""
    while frame is not None and _is_standard(frame):
        name, frame = f"{frame.f_globals['__name__']}.{frame.f_code.co_qualname}", frame.f_back
    return name if frame is None else f"{name} at {Path(frame.f_code.co_filename).name}:{frame.f_lineno}"


def _is_standard(frame: FrameType) -> bool:
    return str(frame.f_globals.get("__name__", "")).partition(".")[0] in sys.stdlib_module_names

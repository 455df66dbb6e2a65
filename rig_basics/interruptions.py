"""Interruptions of this process, Ctrl-C for example, that wait until what is under way has been completed."""

from __future__ import annotations

import signal
import threading
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from types import FrameType

FROM_TERMINALS: list[int] = [int(getattr(signal, name)) for name in ("SIGINT", "SIGHUP") if hasattr(signal, name)]
"""Signals that a terminal sends to all its processes."""
_INTERRUPTING = [*FROM_TERMINALS, signal.SIGTERM]


@contextmanager
def interruptions_held() -> Generator[Sequence[int]]:
    """Hold an interruption of this process until the end of the context; a second one is raised at once.

    Only the main thread receives them.

    Yields:
        The signals that are held, empty or one, so that long work can end its context early.
    """
    held = list[int]()
    if threading.current_thread() is not threading.main_thread():
        yield held
        return

    def hold(number: int, frame: FrameType | None) -> None:
        held.append(number)
        if len(held) > 1:
            handlers[number](number, frame)

    handlers = {int(number): each for number in _INTERRUPTING if callable(each := signal.getsignal(number))}
    try:
        for number in handlers:
            signal.signal(number, hold)
        yield held
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if len(held) == 1:
            signal.raise_signal(held[0])

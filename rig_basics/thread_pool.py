"""Threads for computation that an interruption does not wait for."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from types import TracebackType


class ThreadPool(ThreadPoolExecutor):
    """Threads whose `with` statement waits for the tasks in work, except after an interruption.

    Compiled code cannot be interrupted, and a task may take minutes. After Ctrl-C the tasks in work continue until the
    program ends, and nothing uses their results. After any error, waiting tasks are cancelled.
    """

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Cancel the waiting tasks after an error; wait for those in work, except after an interruption."""
        self.shutdown(wait=kind is None or issubclass(kind, Exception), cancel_futures=kind is not None)

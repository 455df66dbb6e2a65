"""Processes that compute or serve for this one. What a terminal sends to all its processes reaches this one alone.

Ctrl-C and the end of a terminal are sent to every process. Worker processes ignore both from their first instruction,
also while they import their modules; this process ends them.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Generator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from typing import Any

from rig_basics.interruptions import FROM_TERMINALS, interruptions_held
from rig_basics.lifeline import end_with_parent
from rig_basics.log_output import show_log_as_parent


class WorkerProcess(SpawnProcess):
    """A process that ignores what a terminal sends, and writes log lines as this one does."""

    def start(self) -> None:
        """Start the process. An interruption of this one is raised when the process has got its work."""
        with interruptions_held(), _children_deaf():
            super().start()

    def run(self) -> None:
        """Carry out the work, in the new process."""
        show_log_as_parent()
        for number in FROM_TERMINALS:  # for Windows, where no process inherits it
            signal.signal(number, signal.SIG_IGN)
        super().run()


class _Workers(SpawnContext):
    Process = WorkerProcess


WORKERS: SpawnContext = _Workers()
"""Context of `multiprocessing` whose processes are `WorkerProcess`."""


@contextmanager
def worker_pool(
    count: int, begin: Callable[..., object] | None = None, *arguments: Any
) -> Generator[ProcessPoolExecutor]:
    """Start processes. They end with the context, even if they hang or have not begun, and with this process.

    Args:
        count: number of processes.
        begin: called in each process before its first task.
        arguments: picklable arguments of `begin`.
    """
    ours, theirs = WORKERS.Pipe(duplex=False)
    before = set(multiprocessing.active_children())
    own = set[BaseProcess]()
    pool = ProcessPoolExecutor(count, WORKERS, _begin, (ours, begin, arguments))
    try:
        pool.submit(os.getpid)  # starts all processes
        own |= set(multiprocessing.active_children()) - before
        yield pool
    finally:
        theirs.close()
        for process in own or set(multiprocessing.active_children()) - before:
            process.kill()  # a task that keeps the interpreter's lock would keep the lifeline from ending it
        pool.shutdown(wait=True, cancel_futures=True)
        ours.close()


def _begin(lifeline: Connection, begin: Callable[..., object] | None, arguments: tuple[Any, ...]) -> None:
    end_with_parent(lifeline)
    if begin is not None:
        begin(*arguments)


@contextmanager
def _children_deaf() -> Generator[None]:
    """Block the signals of terminals in this thread: processes that it starts inherit that, other threads get them."""
    if sys.platform == "win32":
        yield
        return
    from multiprocessing import resource_tracker  # noqa: PLC0415 (not on Windows)

    resource_tracker.ensure_running()  # its start would end the blocking
    before = signal.pthread_sigmask(signal.SIG_BLOCK, FROM_TERMINALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

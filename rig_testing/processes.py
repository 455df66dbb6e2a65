"""Division of a long test over processes. Each has the driver and its recording, and answers by number."""

from __future__ import annotations

import multiprocessing
import pickle
import signal
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing.connection import Connection
from typing import TypeVar

from rig_basics.lifeline import end_with_parent
from rig_basics.log_output import show_log_as_parent
from rig_testing.subject import Subject

A = TypeVar("A")
_PER_TASK = 20  # numbers that a process takes at a time
_own: list[Subject] = []  # one, in a process that answers


def each_answer(part: Callable[[Subject, int], A], subject: Subject, numbers: Sequence[int]) -> Generator[A]:
    """Yield the answers of a part of a test in the order of the numbers, by the subject's number of processes.

    A driver that cannot be sent to another process is tested in this one.

    Args:
        part: function of a module; its answers depend on subject and number alone.
    """
    content = _sendable(subject) if subject.processes > 1 else None
    if content is None:
        yield from map(partial(part, subject), numbers)
        return
    tasks = [numbers[i : i + _PER_TASK] for i in range(0, len(numbers), _PER_TASK)]
    with _processes(subject.processes, content) as pool:
        for answers in pool.map(partial(_answers, part), tasks):
            yield from answers


def _sendable(subject: Subject) -> bytes | None:
    content = subject.driver, subject.thorough, subject.tape
    try:
        return pickle.dumps(content)
    except (pickle.PicklingError, AttributeError, TypeError):  # usual: a driver that is defined inside a function
        return None


@contextmanager
def _processes(count: int, content: bytes) -> Generator[ProcessPoolExecutor]:
    """Start processes. They end with the context, even if they hang, and with this process."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    before = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(count, context, _begin, (ours, content))
    try:
        yield pool
    finally:
        theirs.close()
        for process in set(multiprocessing.active_children()) - before:
            process.kill()  # a regular expression without end would keep its lifeline from ending it
        pool.shutdown(wait=True, cancel_futures=True)
        ours.close()


def _begin(lifeline: Connection, content: bytes) -> None:
    """Prepare a process: it ignores Ctrl-C and ends with its parent."""
    show_log_as_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent(lifeline)
    driver, thorough, tape = pickle.loads(content)
    subject = Subject(driver, thorough)
    subject.tape = tape
    _own[:] = [subject]


def _answers(part: Callable[[Subject, int], A], numbers: Iterable[int]) -> list[A]:
    (subject,) = _own
    return [part(subject, number) for number in numbers]

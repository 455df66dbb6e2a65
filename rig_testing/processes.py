"""Division of a long test over processes. Each has the driver and its recording, and answers by number."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Generator, Iterable, Sequence
from functools import partial
from typing import TypeVar

from rig_basics.worker_processes import worker_pool
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
    with worker_pool(subject.processes, _begin, content) as pool:
        for answers in pool.map(partial(_answers, part), tasks):
            yield from answers


def _sendable(subject: Subject) -> bytes | None:
    content = subject.driver, subject.thorough, subject.tape
    try:
        return pickle.dumps(content)
    except (pickle.PicklingError, AttributeError, TypeError):  # usual: a driver that is defined inside a function
        return None


def _begin(content: bytes) -> None:
    driver, thorough, tape = pickle.loads(content)
    subject = Subject(driver, thorough)
    subject.tape = tape
    _own[:] = [subject]


def _answers(part: Callable[[Subject, int], A], numbers: Iterable[int]) -> list[A]:
    (subject,) = _own
    return [part(subject, number) for number in numbers]

"""A long test of a driver over several processes: the same answers, and every end of a process is noticed."""

from __future__ import annotations

import multiprocessing
import os
import time
from concurrent.futures.process import BrokenProcessPool

import pytest

from rig_configs.drivers import load_driver
from rig_testing.mutations import damaged_excerpt
from rig_testing.processes import each_answer
from rig_testing.report import Failed
from rig_testing.subject import Subject


@pytest.fixture(scope="module")
def subject() -> Subject:
    return Subject(load_driver("vesc_can"), thorough=False, processes=2)


def whose(subject: Subject, number: int) -> tuple[int, int]:
    return os.getpid(), number


def complaint(subject: Subject, number: int) -> int:
    raise Failed(f"number {number} is wrong")


def death(subject: Subject, number: int) -> int:
    os._exit(9)


def silence(subject: Subject, number: int) -> int:
    while number >= 20:
        time.sleep(0.1)
    return number


def test_several_processes_give_the_answers_of_one(subject: Subject) -> None:
    numbers = range(41)
    pids, answers = zip(*each_answer(whose, subject, numbers), strict=True)
    assert list(answers) == list(numbers)
    assert os.getpid() not in pids
    assert list(each_answer(damaged_excerpt, subject, range(25))) == [damaged_excerpt(subject, n) for n in range(25)]
    assert multiprocessing.active_children() == []


def test_what_fails_in_a_process_fails_here(subject: Subject) -> None:
    with pytest.raises(Failed, match="number 0 is wrong"):
        list(each_answer(complaint, subject, range(3)))
    with pytest.raises(BrokenProcessPool):
        list(each_answer(death, subject, range(3)))
    assert multiprocessing.active_children() == []


def test_a_process_that_hangs_ends_with_the_test(subject: Subject) -> None:
    answers = each_answer(silence, subject, range(60))
    assert [next(answers) for _ in range(20)] == list(range(20))
    answers.close()  # type: ignore[attr-defined]
    assert multiprocessing.active_children() == []


def test_a_driver_that_cannot_be_sent_is_tested_here(subject: Subject) -> None:
    class Here(type(subject.driver)):  # type: ignore[misc]
        pass

    local = Subject(Here(), thorough=False, processes=2)
    assert list(each_answer(whose, local, range(2))) == [(os.getpid(), 0), (os.getpid(), 1)]

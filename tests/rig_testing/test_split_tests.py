"""A long test of a driver over several processes: the same answers, and every end of a process is noticed."""

from __future__ import annotations

import multiprocessing
import os
import re
import time
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from functools import partial
from pathlib import Path

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


def endless(folder: Path, subject: Subject, number: int) -> int:
    if number >= 20:
        (folder / str(number)).touch()
        re.match(r"(a+)+$", "a" * 60 + "b")  # no other thread of the process runs meanwhile
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


def test_a_process_that_hangs_ends_with_the_test(subject: Subject, tmp_path: Path) -> None:
    answers = each_answer(partial(endless, tmp_path), subject, range(60))
    assert [next(answers) for _ in range(20)] == list(range(20))
    deadline = time.monotonic() + 60
    while {path.name for path in tmp_path.iterdir()} != {"20", "40"}:
        assert time.monotonic() < deadline, "both processes reach the part that hangs"
        time.sleep(0.01)
    answers.close()
    assert multiprocessing.active_children() == []


def test_a_driver_that_cannot_be_sent_is_tested_here(subject: Subject) -> None:
    unnamed = replace(subject.driver, words=lambda event: "")  # no module has this function
    local = Subject(unnamed, thorough=False, processes=2)
    assert list(each_answer(whose, local, range(2))) == [(os.getpid(), 0), (os.getpid(), 1)]

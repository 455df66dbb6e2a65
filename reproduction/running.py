"""Reproduction of items in parallel processes, the long ones first."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from multiprocessing.queues import SimpleQueue
from pathlib import Path

from dynamics.compiled_code import keep_compiled_code
from reproduction.catalogue import ITEMS, Item
from reproduction.files import Written, read_item, write_failure, write_item
from reproduction.workspace import Workspace
from rig_basics.worker_processes import WORKERS, worker_pool

_POLL_S = 0.5  # interval at which ended items are collected
_Ended = SimpleQueue[tuple[float, str]]  # expected duration of an item, s, and its number
_own: list[_Ended] = []  # one, in a process that reproduces
Progress = Callable[[float, str], None]
"""Called with the completed share, 0 … 1, and the item completed last."""


def reproduce(items: Sequence[Item], folder: Path, jobs: int = 1, progress: Progress | None = None) -> list[Written]:
    """Reproduce items and write their files.

    Args:
        items: of ITEMS.
        folder: each item gets a folder in it, named by its number.
        jobs: processes; 1: this one.
        progress: see Progress.
    Returns:
        The written items in the order of `items`; one that could not be reproduced has `failed` set.
    """
    notify = progress or _ignore
    total = sum(item.seconds for item in items)
    if jobs == 1:
        done = 0.0
        for item in items:
            _reproduce_one(
                item, folder, lambda share, at=done, own=item: notify((at + share * own.seconds) / total, own.id)
            )
            done += item.seconds
            notify(done / total, item.id)
    else:
        _in_parallel(items, folder, jobs, notify)
    return [read_item(item, folder / item.id) for item in items]


def _in_parallel(items: Sequence[Item], folder: Path, jobs: int, notify: Progress) -> None:
    total, done = sum(item.seconds for item in items), 0.0
    ended: _Ended = WORKERS.SimpleQueue()
    with worker_pool(min(jobs, len(items)), _begin, ended) as pool:
        running: set[Future[None]] = {pool.submit(_in_sequence, part, folder) for part in _groups(items)}
        while running:
            over = wait(running, timeout=_POLL_S, return_when=FIRST_COMPLETED).done
            running -= over
            while not ended.empty():
                seconds, number = ended.get()
                done += seconds
                notify(done / total, number)
            for future in over:
                future.result()


def _begin(ended: _Ended) -> None:
    """Prepare a process before its first item."""
    keep_compiled_code()
    _own[:] = [ended]


def _groups(items: Sequence[Item]) -> list[list[str]]:
    """Return the numbers of the items of each group, the longest work first."""
    groups: dict[str, list[Item]] = {}
    for item in items:
        groups.setdefault(item.group or item.id, []).append(item)
    ordered = sorted(groups.values(), key=lambda group: -sum(item.seconds for item in group))
    return [[item.id for item in group] for group in ordered]


def _in_sequence(numbers: list[str], folder: Path) -> None:
    (ended,) = _own
    for number in numbers:
        item = next(each for each in ITEMS if each.id == number)
        _reproduce_one(item, folder, _ignore_share)
        ended.put((item.seconds, number))


def _ignore_share(share: float) -> None:
    del share


def _reproduce_one(item: Item, folder: Path, progress: Callable[[float], None]) -> None:
    started = time.perf_counter()
    own = folder / item.id
    own.mkdir(parents=True, exist_ok=True)
    try:
        found = item.make()(Workspace(own, progress))
        write_item(item, found, own, time.perf_counter() - started)
    except Exception as fault:  # the other items are still reproduced; the record and the command report the failure
        write_failure(item, own, fault)


def _ignore(share: float, what: str) -> None:
    del share, what

"""Reproduction of items in parallel processes, the long ones first."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any

from dynamics.compiled_code import keep_compiled_code
from reproduction.catalogue import ITEMS, Item
from reproduction.files import Written, read_item, write_failure, write_item
from reproduction.workspace import Workspace

_POLL_S = 0.5  # interval at which ended items are collected
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
    context = multiprocessing.get_context("spawn")
    with (
        context.Manager() as manager,
        ProcessPoolExecutor(min(jobs, len(items)), mp_context=context, initializer=keep_compiled_code) as pool,
    ):
        ended = manager.Queue()
        parts = _groups(items)
        running: set[Future[None]] = {pool.submit(_in_sequence, part, folder, ended) for part in parts}
        try:
            while running:
                over = wait(running, timeout=_POLL_S, return_when=FIRST_COMPLETED).done
                running -= over
                while not ended.empty():
                    seconds, number = ended.get()
                    done += seconds
                    notify(done / total, number)
                for future in over:
                    future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _groups(items: Sequence[Item]) -> list[list[str]]:
    """Return the numbers of the items of each group, the longest work first."""
    groups: dict[str, list[Item]] = {}
    for item in items:
        groups.setdefault(item.group or item.id, []).append(item)
    ordered = sorted(groups.values(), key=lambda group: -sum(item.seconds for item in group))
    return [[item.id for item in group] for group in ordered]


def _in_sequence(numbers: list[str], folder: Path, ended: Any) -> None:
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

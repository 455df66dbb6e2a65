# pyright: strict
"""Make items, each in a process of its own, the long ones first."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any

from dynamics.compiled_code import keep_compiled_code
from reproduction.catalogue import ITEMS, Item
from reproduction.files import Written, read_item, write_item
from reproduction.workspace import Workspace

_LOOK_S = 0.5  # how often what has ended is looked for
Progress = Callable[[float, str], None]
"""Called with the share of the work done, 0 … 1, and what was done last."""


def reproduce(items: Sequence[Item], folder: Path, jobs: int = 1, progress: Progress | None = None) -> list[Written]:
    """Make items and write their files.

    Args:
        items: of ITEMS.
        folder: each gets a folder of its own in it, by its number.
        jobs: processes; 1: this one.
        progress: see Progress.
    Returns:
        What was written, in the order of `items`.
    """
    tell = progress or _tell_nobody
    total = sum(item.seconds for item in items)
    if jobs == 1:
        done = 0.0
        for item in items:
            _made(item, folder, lambda share, at=done, own=item: tell((at + share * own.seconds) / total, own.id))
            done += item.seconds
            tell(done / total, item.id)
    else:
        _beside(items, folder, jobs, tell)
    return [read_item(item, folder / item.id) for item in items]


def _beside(items: Sequence[Item], folder: Path, jobs: int, tell: Progress) -> None:
    total, done = sum(item.seconds for item in items), 0.0
    context = multiprocessing.get_context("spawn")
    with (
        context.Manager() as manager,
        ProcessPoolExecutor(min(jobs, len(items)), mp_context=context, initializer=keep_compiled_code) as pool,
    ):
        ended = manager.Queue()
        parts = _groups(items)
        running: set[Future[None]] = {pool.submit(_one_by_one, part, folder, ended) for part in parts}
        try:
            while running:
                over = wait(running, timeout=_LOOK_S, return_when=FIRST_COMPLETED).done
                running -= over
                while not ended.empty():
                    seconds, number = ended.get()
                    done += seconds
                    tell(done / total, number)
                for future in over:
                    future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _groups(items: Sequence[Item]) -> list[list[str]]:
    """Numbers of the items that go together, the longest work first."""
    groups: dict[str, list[Item]] = {}
    for item in items:
        groups.setdefault(item.group or item.id, []).append(item)
    ordered = sorted(groups.values(), key=lambda group: -sum(item.seconds for item in group))
    return [[item.id for item in group] for group in ordered]


def _one_by_one(numbers: list[str], folder: Path, ended: Any) -> None:
    for number in numbers:
        item = next(each for each in ITEMS if each.id == number)
        _made(item, folder, _tell_no_share)
        ended.put((item.seconds, number))


def _tell_no_share(share: float) -> None:
    del share


def _made(item: Item, folder: Path, tell: Callable[[float], None]) -> None:
    started = time.perf_counter()
    own = folder / item.id
    own.mkdir(parents=True, exist_ok=True)
    found = item.make()(Workspace(own, tell))
    write_item(item, found, own, time.perf_counter() - started)


def _tell_nobody(share: float, what: str) -> None:
    del share, what

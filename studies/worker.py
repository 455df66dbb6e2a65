# pyright: strict
"""What a worker does: compile once, then work tiles out.

Compiled code is kept in one folder per host (dynamics.compiled_code). Where many workers begin at once on a host with
nothing compiled, one compiles and the others wait for it, by a lock that ends with the process that holds it.
"""

from __future__ import annotations

import contextlib
import os
import platform
import sqlite3
import tempfile
import threading
from collections.abc import Generator
from pathlib import Path

from dynamics.compiled_code import keep_compiled_code, source_digest
from studies.errors import OtherSoftware
from studies.study import kind_named, software_digest
from studies.tile_files import packed

_LONGEST_COMPILATION_S = 600.0
_warm: set[tuple[str, str]] = set()
_warming = threading.Lock()


def answer_tile(kind: str, text: str, software: str, tile: int, threads: int = 1) -> bytes:
    """Work one tile out.

    Args:
        kind, text, software: the study's.
        tile: its number.
        threads: that it may use.
    Returns:
        The content of its file.
    Raises:
        OtherSoftware: this worker's sources are not those of the one who asks.
    """
    warm_up(kind, text, software)
    return packed(kind_named(kind).answer(text, tile, threads))


def warm_up(kind: str, text: str, software: str) -> None:
    """Import and compile what the tiles of a study need, once in a process and one process of a host at a time."""
    own = software_digest()
    with _warming:
        if own != software:
            raise OtherSoftware(
                f"worker {os.getpid()} on {platform.node()}: expected the sources {software} of whoever asks, it runs "
                f"{own}; install the same version on all hosts and start the workers again"
            )
        if (kind, text) in _warm:
            return
        place = keep_compiled_code() or Path(os.environ.get("NUMBA_CACHE_DIR") or tempfile.gettempdir())
        with _alone(place):
            kind_named(kind).warm_up(text)
        _warm.add((kind, text))


@contextlib.contextmanager
def _alone(place: Path) -> Generator[None]:
    """Hold a folder against other processes of this host that want to compile into it.

    A database's lock is had on all systems and falls with its process. A folder that cannot hold one is used unheld:
    each process then compiles for itself.
    """
    try:
        lock = sqlite3.connect(
            place / f"compiling-{source_digest()}.lock", timeout=_LONGEST_COMPILATION_S, isolation_level=None
        )
    except (sqlite3.Error, OSError):
        yield
        return
    try:
        with contextlib.suppress(sqlite3.Error):
            lock.execute("BEGIN EXCLUSIVE")
        yield
    finally:
        lock.close()

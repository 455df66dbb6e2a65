"""Work of a worker: compile once, then compute tiles.

Compiled code is stored in one folder per host (dynamics.compiled_code). If many workers start at once on a host without
compiled code, one compiles and the others wait, by a lock that ends with the process that holds it.
"""

from __future__ import annotations

import contextlib
import logging
import os
import platform
import sqlite3
import tempfile
import threading
from collections.abc import Generator
from pathlib import Path

from dynamics.compiled_code import keep_compiled_code, source_digest
from rig_basics.ignoring import ignoring
from studies.errors import OtherSoftware
from studies.study import kind_named, software_digest
from studies.tile_files import packed

_COMPILATION_TIMEOUT_S = 600.0
_warm: set[tuple[str, str]] = set()
_warming = threading.Lock()
_log = logging.getLogger(__name__)


def answer_tile(kind: str, text: str, software: str, tile: int, threads: int = 1) -> bytes:
    """Compute one tile.

    Args:
        kind, text, software: fields of the study.
        tile: number of the tile.
        threads: number of threads that it may use.
    Returns:
        The content of its file.
    Raises:
        OtherSoftware: this worker has other sources than the process that started the study.
    """
    warm_up(kind, text, software)
    return packed(kind_named(kind).answer(text, tile, threads))


def warm_up(kind: str, text: str, software: str) -> None:
    """Import and compile the code of a study's tiles, once per process and by one process of a host at a time."""
    own = software_digest()
    with _warming:
        if own != software:
            raise OtherSoftware(
                f"worker {os.getpid()} on {platform.node()}: expected the sources {software} of the study, it runs "
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
    """Lock a folder against other processes of this host that compile into it.

    The lock of a database works on all systems and ends with its process. If a folder does not support it, no lock is
    used, and each process compiles for itself.
    """
    try:
        lock = sqlite3.connect(
            place / f"compiling-{source_digest()}.lock", timeout=_COMPILATION_TIMEOUT_S, isolation_level=None
        )
    except (sqlite3.Error, OSError) as error:
        _log.info("no lock in %s, this process compiles without it: %s", place, error)
        yield
        return
    try:
        with ignoring(_log, f"locking {place}", sqlite3.Error):
            lock.execute("BEGIN EXCLUSIVE")
        yield
    finally:
        lock.close()

"""Cache of the catalogue: one SQLite file in the folder of the logs.

The file is never modified. A process that has new rows writes a complete new file and renames it to the final name.
A reader therefore opens either the old or the new file and never waits, any number of processes may write, the file
may be deleted at any time, and network drives without working locks are supported. Of two concurrent writers the last
one wins. It merges the rows of the other before it writes; rows that are lost in between are computed again.

The contents are checked before use. A file of another application or version is ignored, a row with a wrong checksum
is ignored, and a row is valid only for the file state it was made from (`Stamp`).
"""

from __future__ import annotations

import contextlib
import logging
import os
import secrets
import sqlite3
import time
import zlib
from collections.abc import Collection, Mapping
from contextlib import closing
from pathlib import Path
from typing import NamedTuple, cast

from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)

NAME = ".rig-logs.sqlite"
VERSION = 3
_TABLE = (
    "CREATE TABLE logs (path TEXT PRIMARY KEY, size_bytes INTEGER, modified_ns INTEGER, changed_ns INTEGER, "
    "verdict_stamp TEXT, looked_ns INTEGER, digest TEXT, entry TEXT, checksum INTEGER)"
)
_COARSE_NS = 2 * 10**9  # FAT, the coarsest clock of a file system
_BUSY_S = 2.0
_ABANDONED_S = 3600.0
_TRIES = 5


class Stamp(NamedTuple):
    """State of a file: size, and the times of the last change of its content and of its status, ns since 1970."""

    size_bytes: int
    modified_ns: int
    changed_ns: int

    @classmethod
    def of(cls, status: os.stat_result) -> Stamp:
        """Return the stamp that belongs to a file status."""
        return cls(status.st_size, status.st_mtime_ns, status.st_ctime_ns)

    def settled_by(self, looked_ns: int) -> bool:
        """Return True if any change after `looked_ns` alters the stamp: a file may change twice within a clock tick."""
        return max(self.modified_ns, self.changed_ns) < looked_ns - _COARSE_NS

    def __str__(self) -> str:
        return f"{self.size_bytes} {self.modified_ns} {self.changed_ns}"


class CachedFacts(NamedTuple):
    """Cached facts of one file.

    Attributes:
        stamp: state of the log file.
        verdict_stamp: state of the log's verdict file, as text; empty for a log without verdict file.
        looked_ns: time at which the file was examined, ns since 1970.
        digest: digest of the log; empty if it was not computed.
        entry: catalogue entry as JSON.
    """

    stamp: Stamp
    verdict_stamp: str
    looked_ns: int
    digest: str
    entry: str


def load(folder: Path) -> dict[str, CachedFacts]:
    """Return the rows by path; empty if the cache does not exist or cannot be used."""
    file = folder / NAME
    try:
        if not file.is_file():
            return {}
        with closing(sqlite3.connect(file, timeout=_BUSY_S)) as database:
            if not _is_ours(database):
                return {}
            found = database.execute("SELECT * FROM logs").fetchall()
    except (OSError, sqlite3.Error, OverflowError) as fault:
        _log.info("%s: the cache is not used, the logs are read again: %s", file, fault)
        return {}
    return {path: row for path, row, checksum in map(_unpacked, found) if checksum == _checksum(path, row)}


def save(folder: Path, rows: Mapping[str, CachedFacts], gone: Collection[str]) -> None:
    """Write rows, merged with those that other processes have written meanwhile.

    Args:
        gone: paths of files that no longer exist.

    Raises:
        OSError: the folder cannot be written to, or the disk is full.
    """
    merged = {path: row for path, row in load(folder).items() if path not in gone}
    merged |= {path: row for path, row in rows.items() if path not in merged or _is_newer(row, merged[path])}
    _sweep(folder)
    written = folder / f"{NAME}.{secrets.token_hex(6)}.new"
    try:
        with open(written, "xb"):
            pass  # raises OSError with the system's reason; SQLite does not report one
        _write(written, merged)
        _put(written, folder / NAME)
    except sqlite3.Error as fault:
        raise OSError(f"{written}: {fault}") from fault
    finally:
        with contextlib.suppress(OSError):  # usual: the file has its final name
            written.unlink()


def _is_newer(row: CachedFacts, other: CachedFacts) -> bool:
    return row.looked_ns >= other.looked_ns


def _write(file: Path, rows: Mapping[str, CachedFacts]) -> None:
    with closing(sqlite3.connect(file, timeout=_BUSY_S, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode = OFF")
        database.execute("PRAGMA synchronous = OFF")  # a file torn by a power cut is ignored by `load`
        database.execute(f"PRAGMA user_version = {VERSION}")
        database.execute("BEGIN")
        database.execute(_TABLE)
        database.executemany(
            "INSERT INTO logs VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
            ((path, *row.stamp, *row[1:], _checksum(path, row)) for path, row in rows.items()),
        )
        database.execute("COMMIT")


def _put(written: Path, file: Path) -> None:
    """Replace the old file by the new one; on Windows retry while another process is reading the old one."""
    for attempt in range(_TRIES):
        try:
            os.replace(written, file)
            return
        except PermissionError:
            if os.name != "nt" or attempt == _TRIES - 1:
                raise
            time.sleep(0.02 * (attempt + 1))


def _is_ours(database: sqlite3.Connection) -> bool:
    """Return True if the file has this version and this table only: a view could contain a query that never ends."""
    (version,) = database.execute("PRAGMA user_version").fetchone()
    made = database.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL").fetchall()
    return version == VERSION and made == [(_TABLE,)]


def _unpacked(columns: tuple[object, ...]) -> tuple[str, CachedFacts, object]:
    # a row with values of other types fails the comparison of its checksum
    typed = cast("tuple[str, int, int, int, str, int, str, str, int]", columns)
    path, size, modified, changed, verdict_stamp, looked, digest, entry, checksum = typed
    return str(path), CachedFacts(Stamp(size, modified, changed), verdict_stamp, looked, digest, entry), checksum


def _checksum(path: str, row: CachedFacts) -> int:
    return zlib.crc32(repr((path, *row)).encode("utf-8", "backslashreplace"))


def _sweep(folder: Path) -> None:
    """Remove temporary files of processes that were killed while they wrote."""
    for left in folder.glob(f"{NAME}.*.new*"):
        with ignoring(_log, f"removing {left}", OSError):
            if time.time() - left.stat().st_mtime > _ABANDONED_S:
                left.unlink()

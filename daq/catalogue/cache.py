"""What the catalogue remembers from one look to the next, in one SQLite file in the folder of the logs.

The file is never changed: whoever has something new writes a whole new one beside it and puts it in its place. So a
reader sees the old or the new one and never waits, any number of processes may write, the file may be deleted under
them, and a folder on a network drive whose locks do not work is as good as any. Who comes second wins; what the
other had found is taken over first, and at worst found again.

Nothing in it is believed because it stands there: a file of another make or version counts as none, a row whose
checksum is wrong does not count, and a row counts for the very file it was made of (`Stamp`) and no other.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import sqlite3
import time
import zlib
from collections.abc import Collection, Mapping
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

NAME = ".rig-logs.sqlite"
VERSION = 2
_TABLE = (
    "CREATE TABLE logs (path TEXT PRIMARY KEY, size_bytes INTEGER, modified_ns INTEGER, changed_ns INTEGER, "
    "verdict_stamp TEXT, looked_ns INTEGER, digest TEXT, entry TEXT, checksum INTEGER)"
)
_COARSE_NS = 2 * 10**9  # FAT, the coarsest clock of a file system
_BUSY_S = 2.0
_ABANDONED_S = 3600.0
_TRIES = 5


class Stamp(NamedTuple):
    """What tells one state of a file from another: size, and when its content and its status changed, ns since 1970."""

    size_bytes: int
    modified_ns: int
    changed_ns: int

    @classmethod
    def of(cls, status: os.stat_result) -> Stamp:
        """Of a file's status."""
        return cls(status.st_size, status.st_mtime_ns, status.st_ctime_ns)

    def settled_by(self, looked_ns: int) -> bool:
        """Whether a change after that look would show: a file may change twice within one tick of its clock."""
        return max(self.modified_ns, self.changed_ns) < looked_ns - _COARSE_NS

    def __str__(self) -> str:
        return f"{self.size_bytes} {self.modified_ns} {self.changed_ns}"


class Row(NamedTuple):
    """One file as it was seen.

    Attributes:
        stamp: of the log.
        verdict_stamp: of the verdict beside it, as text; empty without one.
        looked_ns: when it was looked at, ns since 1970.
        digest: of the log; empty when nobody needed it.
        entry: the entry as JSON.
    """

    stamp: Stamp
    verdict_stamp: str
    looked_ns: int
    digest: str
    entry: str


def load(folder: Path) -> dict[str, Row]:
    """Rows by path; empty when there is no cache, or none that can be used."""
    file = folder / NAME
    try:
        if not file.is_file():
            return {}
        with closing(sqlite3.connect(file, timeout=_BUSY_S)) as database:
            if not _is_ours(database):
                return {}
            found = database.execute("SELECT * FROM logs").fetchall()
    except (OSError, sqlite3.Error, OverflowError):
        return {}
    return {path: row for path, row, checksum in map(_unpacked, found) if checksum == _checksum(path, row)}


def save(folder: Path, rows: Mapping[str, Row], gone: Collection[str]) -> None:
    """Keep rows, beside those that other processes have found meanwhile.

    Args:
        gone: paths of files that are no longer there.

    Raises:
        OSError: the folder cannot be written to, or the disk is full.
    """
    merged = {path: row for path, row in load(folder).items() if path not in gone}
    merged |= {path: row for path, row in rows.items() if path not in merged or _is_newer(row, merged[path])}
    _sweep(folder)
    written = folder / f"{NAME}.{secrets.token_hex(6)}.new"
    try:
        with open(written, "xb"):
            pass  # said by the system itself why it cannot be, which SQLite does not
        _write(written, merged)
        _put(written, folder / NAME)
    except sqlite3.Error as fault:
        raise OSError(f"{written}: {fault}") from fault
    finally:
        with contextlib.suppress(OSError):
            written.unlink()


def _is_newer(row: Row, other: Row) -> bool:
    return row.looked_ns >= other.looked_ns


def _write(file: Path, rows: Mapping[str, Row]) -> None:
    with closing(sqlite3.connect(file, timeout=_BUSY_S, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode = OFF")
        database.execute("PRAGMA synchronous = OFF")  # a file that a power cut has torn counts as none
        database.execute(f"PRAGMA user_version = {VERSION}")
        database.execute("BEGIN")
        database.execute(_TABLE)
        database.executemany(
            "INSERT INTO logs VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
            ((path, *row.stamp, *row[1:], _checksum(path, row)) for path, row in rows.items()),
        )
        database.execute("COMMIT")


def _put(written: Path, file: Path) -> None:
    """Put a new file in the place of the old; on Windows another process that is just reading it is in the way."""
    for attempt in range(_TRIES):
        try:
            os.replace(written, file)
            return
        except PermissionError:
            if os.name != "nt" or attempt == _TRIES - 1:
                raise
            time.sleep(0.02 * (attempt + 1))


def _is_ours(database: sqlite3.Connection) -> bool:
    """Whether the file has our version and our table and nothing else: a view could be a query without an end."""
    (version,) = database.execute("PRAGMA user_version").fetchone()
    made = database.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL").fetchall()
    return version == VERSION and made == [(_TABLE,)]


def _unpacked(columns: tuple[object, ...]) -> tuple[str, Row, object]:
    path, size, modified, changed, verdict_stamp, looked, digest, entry, checksum = columns
    row = Row(Stamp(size, modified, changed), verdict_stamp, looked, digest, entry)  # type: ignore[arg-type]
    return str(path), row, checksum


def _checksum(path: str, row: Row) -> int:
    return zlib.crc32(repr((path, *row)).encode("utf-8", "backslashreplace"))


def _sweep(folder: Path) -> None:
    """Remove what a process that was killed while writing has left behind."""
    for left in folder.glob(f"{NAME}.*.new*"):
        with contextlib.suppress(OSError):
            if time.time() - left.stat().st_mtime > _ABANDONED_S:
                left.unlink()

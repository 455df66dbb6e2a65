"""Cache of the catalogue: one JSON file in the folder of the logs.

The file is never modified. A process that has new rows writes a complete new file and renames it to the final name.
A reader therefore gets either the old or the new file and never waits, any number of processes may write, the file
may be deleted at any time, and network drives without working locks are supported. Of two concurrent writers the last
one wins. It merges the rows of the other before it writes; rows that are lost in between are computed again.

The contents are checked before use. The first line holds the version of the rows and the checksum of the rest; a file
with another version, a wrong checksum or rows of another form is ignored. A row is valid only for the file state it was
made from (`Stamp`).
"""

from __future__ import annotations

import contextlib
import logging
import os
import secrets
import time
import zlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import NamedTuple

from pydantic import BaseModel, TypeAdapter

from daq.catalogue.entry import Entry
from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)

NAME = ".rig-logs.json"
VERSION = 1
_COARSE_NS = 2 * 10**9  # FAT, the coarsest clock of a file system
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


class CachedFacts(BaseModel, extra="forbid", frozen=True):
    """Cached facts of one file.

    Attributes:
        stamp: state of the log file.
        verdict_stamp: state of the log's verdict file; None for a log without verdict file.
        looked_ns: time at which the file was examined, ns since 1970.
        digest: digest of the log; empty if it was not computed.
        entry: catalogue entry.
    """

    stamp: Stamp
    verdict_stamp: Stamp | None
    looked_ns: int
    digest: str
    entry: Entry


_ROWS: TypeAdapter[dict[str, CachedFacts]] = TypeAdapter(dict[str, CachedFacts])


def load(folder: Path) -> dict[str, CachedFacts]:
    """Return the rows by path; empty if the cache does not exist or cannot be used."""
    file = folder / NAME
    try:
        if not file.is_file():
            return {}
        head, _, text = file.read_bytes().partition(b"\n")
        if head != _head(text):
            raise ValueError(f"expected {_head(text)!r} as the first line, got {head[:80]!r}")
        return _ROWS.validate_json(text)
    except (OSError, ValueError) as fault:
        _log.info("%s: the cache is not used, the logs are read again: %s", file, fault)
        return {}


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
    text = _ROWS.dump_json(merged)
    try:
        written.write_bytes(_head(text) + b"\n" + text)
        _put(written, folder / NAME)
    finally:
        with contextlib.suppress(OSError):  # usual: the file has its final name
            written.unlink()


def _head(text: bytes) -> bytes:
    return f"{VERSION} {zlib.crc32(text):08x}".encode()


def _is_newer(row: CachedFacts, other: CachedFacts) -> bool:
    return row.looked_ns >= other.looked_ns


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


def _sweep(folder: Path) -> None:
    """Remove temporary files of processes that were killed while they wrote."""
    for left in folder.glob(f"{NAME}.*.new*"):
        with ignoring(_log, f"removing {left}", OSError):
            if time.time() - left.stat().st_mtime > _ABANDONED_S:
                left.unlink()

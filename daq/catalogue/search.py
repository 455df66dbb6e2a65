"""All logs of a folder, with their facts, and a search over them.

    for entry in Catalogue("logs").search(Query(point="B", since_ns=parse_instant("3d", datetime.now()))):
        print(entry.started, entry.path, entry.verdict)

The files are the only source of facts. The facts are cached in the folder (`daq.catalogue.cache`). If the cache is
deleted, the next search takes longer and gives the same result.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from daq.catalogue import cache
from daq.catalogue.cache import CachedFacts, Stamp
from daq.catalogue.entry import Entry
from daq.catalogue.query import Query
from daq.errors import LogError
from daq.log.verdicts import SUFFIX, digest_of, verdict_of, verdict_path

_LOG_SUFFIXES = (".mcap", ".mcap.part")
_SAVE_PERIOD_S = 5.0  # an interrupted first search of thousands of logs continues where it stopped
_MAX_LOOKS = 3  # a recording that ends while the folder is read changes its name

Progress = Callable[[float], None]


class _File(NamedTuple):
    """A log as listed in its folder; a stamp is None if the file does not exist."""

    place: Path
    stamp: Stamp | None
    verdict_stamp: Stamp | None

    def is_as_in(self, row: CachedFacts | None) -> bool:
        """Return True if the row was made from this state of the log."""
        return row is not None and row.stamp == self.stamp and row.stamp.settled_by(row.looked_ns)

    def is_all_as_in(self, row: CachedFacts | None) -> bool:
        """Return True if the row was made from this state of the log and of its verdict file."""
        if row is None or not self.is_as_in(row) or row.verdict_stamp != self.verdict_stamp:
            return False
        return self.verdict_stamp is None or self.verdict_stamp.settled_by(row.looked_ns)


class Catalogue:
    """The logs in a folder and in the folders below it.

    Args:
        folder: folder that contains the logs.
        now_ns: clock to compare file times with, ns since 1970.

    Attributes:
        cache_trouble: reason why the results of the last search could not be cached; empty if they were.
        unread_folders: subfolders that the last search could not read, each with the reason.

    Raises:
        LogError: the folder does not exist.
    """

    def __init__(self, folder: str | Path, now_ns: Callable[[], int] = time.time_ns) -> None:
        self.folder: Path = Path(folder)
        self.cache_trouble: str = ""
        self.unread_folders: list[str] = []
        self._now_ns = now_ns
        self._unsaved: dict[str, CachedFacts] = {}
        if not self.folder.is_dir():
            raise LogError(f"{folder}: expected a folder with logs, the folder does not exist. Check the path")

    def search(self, query: Query | None = None, progress: Progress | None = None) -> list[Entry]:
        """Return the entries of the logs that match a query, in the requested order.

        Args:
            query: search conditions; None for all logs.
            progress: called with the completed share of the new and changed files, 0 … 1; not called without any.

        Raises:
            LogError: the folder itself cannot be read.
        """
        query = query or Query()
        return query.sorted(entry for entry in self.entries(progress) if query.admits(entry))

    def entries(self, progress: Progress | None = None) -> list[Entry]:
        """Return the entry of every file, by path. Files that are not logs yield an entry with `why` set."""
        for _ in range(_MAX_LOOKS - 1):
            entries, vanished = self._look(progress)
            if not vanished:
                return entries
        return self._look(progress)[0]

    def _look(self, progress: Progress | None) -> tuple[list[Entry], bool]:
        """Return the entries by path, and True if a file vanished while it was read."""
        looked_ns = self._now_ns()
        files = dict(sorted(self._files()))
        rows = cache.load(self.folder) | self._unsaved
        entries = {path: rows[path].entry for path, file in files.items() if file.is_all_as_in(rows.get(path))}
        new = [path for path in files if path not in entries]
        gone = rows.keys() - files.keys()
        saved_s = time.monotonic()
        try:
            for number, path in enumerate(new):
                file, row = files[path], rows.get(path)
                entries[path], digest = _read(path, file, row, _stretch(progress, number, len(new)))
                if file.stamp is not None and not _is_gone(file.place):  # other processes may have cached a gone file
                    self._unsaved[path] = CachedFacts(
                        stamp=file.stamp,
                        verdict_stamp=file.verdict_stamp,
                        looked_ns=looked_ns,
                        digest=digest,
                        entry=entries[path],
                    )
                if time.monotonic() - saved_s > _SAVE_PERIOD_S:
                    self._save(gone)
                    saved_s = time.monotonic()
        finally:
            if self._unsaved or gone:
                self._save(gone)
        vanished = {path for path in new if _is_gone(files[path].place)}
        return [entries[path] for path in files if path not in vanished], bool(vanished)

    def _save(self, gone: set[str]) -> None:
        self._unsaved = {path: row for path, row in self._unsaved.items() if path not in gone}
        try:
            cache.save(self.folder, self._unsaved, gone)
        except OSError as fault:
            self.cache_trouble = (
                f"{self.folder}: the facts that were read cannot be cached there ({fault.strerror or fault}), so the "
                "next search reads all logs again. Make the folder writable for faster searches"
            )
        else:
            self.cache_trouble = ""
            self._unsaved = {}

    def _files(self) -> Iterator[tuple[str, _File]]:
        """Yield each log with its path in the catalogue."""
        self.unread_folders = []
        for folder, _, names in os.walk(self.folder, onerror=self._note_unread):
            present = set(names)
            for name in names:
                if name.endswith(_LOG_SUFFIXES):
                    place = Path(folder, name)
                    verdict_stamp = _stamp(verdict_path(place)) if name + SUFFIX in present else None
                    path = place.relative_to(self.folder).as_posix()
                    yield path.encode("utf-8", "backslashreplace").decode(), _File(place, _stamp(place), verdict_stamp)

    def _note_unread(self, fault: OSError) -> None:
        if fault.filename == str(self.folder):
            raise LogError(f"{self.folder}: cannot be read ({fault.strerror}). Check its permissions") from fault
        if not isinstance(fault, FileNotFoundError):  # a folder that was removed meanwhile contains no logs
            self.unread_folders.append(f"{fault.filename}: cannot be read ({fault.strerror}), its logs are not listed")


def _stamp(file: Path) -> Stamp | None:
    try:
        return Stamp.of(file.stat())
    except OSError:  # usual: the file was removed meanwhile
        return None


def _is_gone(file: Path) -> bool:
    """Return True if the file does not exist; a file without read permission exists."""
    try:
        file.lstat()
    except (FileNotFoundError, NotADirectoryError):  # usual: this is the question
        return True
    except OSError:  # usual: the file exists and must not be read
        return False
    return False


def _read(path: str, file: _File, row: CachedFacts | None, progress: Progress | None) -> tuple[Entry, str]:
    """Return a file's entry with its verdict, and the log's digest if it was needed or is cached."""
    from daq.catalogue.facts import one_line, read_entry  # noqa: PLC0415 (loads the log reader: not if all is cached)

    known_digest = row.digest if row is not None and file.is_as_in(row) else ""
    entry = read_entry(file.place, path, file.stamp.size_bytes if file.stamp else 0)
    if file.verdict_stamp is None:
        return entry, known_digest
    try:
        verdict = verdict_of(file.place)
        if verdict is None:
            return entry, known_digest
        digest = known_digest or digest_of(file.place, progress)
    except LogError as fault:
        return entry.model_copy(update={"verdict": "unreadable", "why": one_line(fault, file.place)}), known_digest
    result = verdict.verdict if verdict.is_of(digest) else "stale"
    return entry.model_copy(update={"verdict": result, "judged": verdict}), digest


def _stretch(progress: Progress | None, number: int, count: int) -> Progress | None:
    """Return the progress function of step `number` of `count`, after reporting that the step begins."""
    if progress is None:
        return None
    progress(number / count)
    return lambda share: progress((number + share) / count)

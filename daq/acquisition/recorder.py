"""Writes one run to one MCAP file: raw bytes first, then what was decoded from them.

The threads that read devices only leave their work in a bounded backlog. Every 50 ms one writer thread takes all of it,
writes it as one block per channel and hands it to the system; another thread then waits for the disk, so that a disk
that dawdles delays nobody. The backlog, the disk's pace and the room left on it are measured all the time
(`Recorder.state`), and `Recorder.trouble` says when the run has to end: before anything is lost, and while there is
still room to finish the file.
"""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from daq import channels
from daq.channels import CHANNELS, Channel
from daq.drivers.items import Batch, Event, joined
from daq.errors import LogError, RecordingError
from daq.log.file import LogFile, ReservedName
from daq.transports.host_clock import HostClock

_FLUSH_S = 0.05
BACKLOG_BYTES = 64 * 2**20
"""More waiting than this, minutes of a rig's bytes, and the disk is given up as too slow."""
_SLOW_SHARE = 0.02  # of the backlog, or …
_SLOW_SYNC_S = 1.0  # … so long behind: the disk is called slow
_ITEM_BYTES = 400  # what an item costs beside its data
_SPARE_BYTES = 2 * 2**20  # room kept on the disk to finish the file …
_SPARE_BYTES_A_FLUSH = 300  # … whose index grows with every flush


@dataclass(frozen=True)
class DiskState:
    """How the disk keeps up.

    Attributes:
        backlog_bytes: what waits to be written.
        unsynced_s: age of the oldest bytes that the disk does not surely have, wall s.
        slow_s: how long, all in all, the disk was behind, wall s.
        written_bytes: size of the file.
        free_bytes: room left on the disk.
        seconds_left: how long that lasts at this rate, wall s; infinite as long as nothing is known.
    """

    backlog_bytes: int = 0
    unsynced_s: float = 0.0
    slow_s: float = 0.0
    written_bytes: int = 0
    free_bytes: int = 0
    seconds_left: float = float("inf")

    @property
    def slow(self) -> bool:
        """Behind so far that someone should know, long before anything is lost."""
        return self.backlog_bytes > _SLOW_SHARE * BACKLOG_BYTES or self.unsynced_s > _SLOW_SYNC_S

    def facts(self) -> dict[str, Any]:
        """For a health report."""
        known = self.seconds_left != float("inf")
        return {**vars(self), "seconds_left": self.seconds_left if known else None, "slow": self.slow}


class Disk(Protocol):
    """Where logs are written to."""

    def free_bytes(self, folder: Path) -> int:
        """Room that is left.

        Raises:
            OSError: the folder is gone.
        """
        ...

    def sync(self, log: LogFile) -> None:
        """Wait until the disk has what was handed to the system.

        Raises:
            OSError: it fails.
        """
        ...


class RealDisk:
    """See Disk."""

    def free_bytes(self, folder: Path) -> int:
        """See Disk."""
        return shutil.disk_usage(folder).free

    def sync(self, log: LogFile) -> None:
        """See Disk."""
        log.sync()


class Recorder:
    """One log being written.

    Args:
        path: the finished file's name, ending in .mcap, or one that was reserved.
        clock: the host clock that stamps health reports.
        metadata: flat facts of the run (test, point, operator's note, software version …).
        attachments: files that go in whole, by name (rig snapshot, identities).
        devices: names of the devices whose raw bytes are kept.
        sample_channels: what is decoded.
        disk: where it is written to.

    Raises:
        LogError: the file or the rest of a cut one of its name exists already.
        RecordingError: it cannot be created, or the disk has no room for it.
    """

    def __init__(
        self,
        path: Path | ReservedName,
        clock: HostClock,
        metadata: Mapping[str, str],
        attachments: Mapping[str, bytes],
        devices: tuple[str, ...],
        sample_channels: Iterable[Channel] = tuple(CHANNELS.values()),
        disk: Disk | None = None,
    ) -> None:
        self._clock, self._disk = clock, disk or RealDisk()
        self.trouble: RecordingError | None = None
        self._failure: Exception | None = None  # the disk's: nothing more can be written
        self._log = LogFile(path, metadata, attachments, devices, clock.now_ns(), sample_channels)
        self.path, self.part = self._log.path, self._log.part
        self._lock = threading.RLock()
        self._backlog: list[tuple[Any, ...]] = []
        self._backlog_bytes = 0
        self._unsynced = threading.Event()
        self._flushed_at = self._synced_to = clock.wall_s()
        self._flushes = 0
        self._slow_s = 0.0
        self._started_s = clock.wall_s()
        self._written_first = self._size()
        if self.state().free_bytes < 2 * _SPARE_BYTES:
            self._log.close()
            self.part.unlink()
            raise RecordingError(
                f"{self.path.parent}: {self.state().free_bytes / 1e6:.1f} MB of room, at least "
                f"{2 * _SPARE_BYTES / 1e6:.1f} MB are needed to begin a log. Make room on the disk"
            )
        self._syncing = clock.every(_FLUSH_S, self._sync, "sync", self._fail)
        self._writing = clock.every(_FLUSH_S, self._write_all, "recorder", self._fail)

    # --- from the readers --------------------------------------------------------------------------------------

    def raw(self, device: str, direction: int, data: bytes, host_ns: int) -> bool:
        """Keep bytes as they came or went; False when the run has ended, and what they decode to is not wanted either.

        What was decoded from bytes that were taken is always taken: a log holds both or neither.
        """
        if self.trouble is not None:
            return False
        self._leave(("raw", device, direction, data, host_ns), len(data))
        return True

    def batch(self, batch: Batch, host_ns: int) -> None:
        """Keep decoded samples."""
        self._leave(("batch", batch, host_ns), len(batch.time_ns) * batch.channel.dtype.itemsize)

    def event(self, event: Event, host_ns: int) -> None:
        """Keep an event."""
        self._leave(("event", event, host_ns), 0)

    def health(self, facts: Mapping[str, Any]) -> None:
        """Keep a snapshot of rates and losses."""
        self._leave(("health", dict(facts), self._clock.now_ns()), 0)

    def _leave(self, item: tuple[Any, ...], size: int) -> None:
        with self._lock:
            self._backlog.append(item)
            self._backlog_bytes += size + _ITEM_BYTES
            too_much = self._backlog_bytes > BACKLOG_BYTES
        if too_much:
            self._end_because(
                f"the disk is too slow, {BACKLOG_BYTES / 2**20:.0f} MB wait to be written. The log ends here and is "
                "whole; use a faster disk, or find out what else is writing to this one"
            )

    def together(self) -> AbstractContextManager[Any]:
        """A context: what is left within it is written together, so a log has bytes and their samples, or neither."""
        return self._lock

    # --- how it goes -------------------------------------------------------------------------------------------

    def state(self) -> DiskState:
        """How the disk keeps up, now."""
        behind = self._flushed_at > self._synced_to
        written = self._size()
        free = self._disk.free_bytes(self.part.parent)
        rate = (written - self._written_first) / max(1e-3, self._clock.wall_s() - self._started_s)
        return DiskState(
            self._backlog_bytes,
            self._clock.wall_s() - self._synced_to if behind else 0.0,
            self._slow_s,
            written,
            free,
            max(0, free - self._spare()) / rate if rate > 0 else float("inf"),
        )

    def look(self) -> DiskState:
        """How the disk keeps up, and end the run while there is still room to finish the file."""
        try:
            state = self.state()
            if not self._log.is_there():
                raise FileNotFoundError(f"{self.part.name} was moved or deleted")
        except OSError as error:
            self._fail(error)
            return DiskState()
        if state.free_bytes < self._spare():
            self._end_because(
                f"the disk is full ({state.free_bytes / 1e6:.1f} MB left). The log ends here and is whole; make room "
                "and repeat the test"
            )
        return state

    def _spare(self) -> int:
        return _SPARE_BYTES + _SPARE_BYTES_A_FLUSH * self._flushes + self._backlog_bytes

    def _size(self) -> int:
        try:
            return self.part.stat().st_size
        except OSError:
            return 0

    def _end_because(self, why: str) -> None:
        if self.trouble is None:
            self.trouble = RecordingError(f"{self.path}: {why}")

    # --- writing -----------------------------------------------------------------------------------------------

    def _write_all(self) -> None:
        """Write what is there; a late turn is made good by the next one's being larger."""
        with self._lock:
            items, self._backlog = self._backlog, []
            size = self._backlog_bytes
        if items and self._failure is None:
            try:
                self._write(items)
                self._log.flush()
            except Exception as error:  # whatever it is: it must be seen, and the backlog go on being emptied
                self._fail(error)
            self._flushes += 1
            self._flushed_at = self._clock.wall_s()
            self._unsynced.set()
        with self._lock:
            self._backlog_bytes -= size

    def _write(self, items: list[tuple[Any, ...]]) -> None:
        """Raw bytes and events as they came; the samples of a channel together, which is quicker and packs better."""
        batches: dict[str, list[tuple[Batch, int]]] = {}
        for item in items:
            match item:
                case ("raw", device, direction, data, host_ns):
                    self._log.raw(device, direction, data, host_ns)
                case ("batch", batch, host_ns):
                    batches.setdefault(batch.channel.topic, []).append((batch, host_ns))
                case ("event", event, host_ns):
                    self._log.event(event, host_ns)
                case (_, facts, host_ns):
                    self._log.note(channels.HEALTH_TOPIC, facts, host_ns, host_ns)
        for arrived in batches.values():
            batch, host_ns = joined(arrived)
            self._log.batch(batch, host_ns)

    def _sync(self) -> None:
        """Keep the disk up to date; a slow disk delays this and nothing else."""
        if not self._unsynced.is_set() or self._failure is not None:
            return
        self._unsynced.clear()
        begun, last = self._clock.wall_s(), self._synced_to
        try:
            self._disk.sync(self._log)
        except OSError as error:
            self._fail(error)
        self._synced_to = begun
        self._slow_s += max(0.0, self._clock.wall_s() - last - _SLOW_SYNC_S)

    def _fail(self, error: Exception) -> None:
        self._failure = self._failure or error
        if isinstance(error, FileNotFoundError):
            what = "the folder or the file in it has gone, and what was recorded with it; look for it, repeat the test"
        else:
            room = "make room on the disk, or use another" if isinstance(error, OSError) else "tell the developers"
            what = f"{self.part.name} is readable up to the last flush and `rig recover` makes it whole; {room}"
        self._end_because(f"writing failed ({error}). {what}")

    def close(self, summary: Mapping[str, Any]) -> Path:
        """Finish the file; the summary (losses, verdicts) goes in as metadata.

        Raises:
            RecordingError: the disk failed; what was written until then stays readable in the .part file.
        """
        self._writing.stop(None)
        self._syncing.stop(None)
        self._write_all()
        if self._failure is None:
            try:
                self._log.finish({**summary, "disk": {"slow_s": round(self._slow_s, 3)}})
            except (OSError, LogError) as error:
                self._fail(error)
        self._log.close()
        if self._failure is not None and self.trouble is not None:
            raise self.trouble
        return self.path

"""Recording of one run in one MCAP file: raw bytes and the samples decoded from them.

The reader threads add items to a bounded backlog. Every 50 ms the writer thread takes the backlog, writes one block for
each channel and passes it to the operating system. A third thread waits for the disk, so that a slow disk delays
neither readers nor writer. Backlog, delay of the disk and free space are measured continuously (`Recorder.state`).
`Recorder.trouble` is set when the run has to end, before data is lost and while there is space to finish the file.
"""

from __future__ import annotations

import logging
import shutil
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from typing_extensions import override

from daq import channels
from daq.acquisition.effects import Keep, Note, WriteHealth
from daq.channels import CHANNELS, Channel
from daq.errors import LogError, RecordingError
from daq.items import Batch, joined
from daq.log.file import LogFile, ReservedName
from daq.transports.host_clock import HostClock
from rig_basics.texts import distinct

_log = logging.getLogger(__name__)

_FLUSH_S = 0.05  # period of writer and sync, s
BACKLOG_BYTES = 64 * 2**20
"""Largest backlog, some minutes of a rig's bytes. A larger one ends the run, since the disk is too slow."""
_SLOW_SHARE = 0.02  # of `BACKLOG_BYTES`: the disk counts as slow above this share, or …
_SLOW_SYNC_S = 1.0  # … if the oldest bytes have not been synchronised for this time, s
_ITEM_BYTES = 400  # memory of an item in addition to its data
_SPARE_BYTES = 2 * 2**20  # space reserved on the disk to finish the file …
_SPARE_BYTES_A_FLUSH = 300  # … and its increase with every flush, for the index of the file


Recorded = Keep | Note | WriteHealth
"""Effects that are written to a log."""


@dataclass(frozen=True)
class DiskState:
    """State of the disk.

    Attributes:
        backlog_bytes: size of the backlog.
        unsynced_s: age of the oldest bytes that have not been synchronised to the disk, s.
        slow_s: total time for which the disk was slow, s.
        written_bytes: size of the file.
        free_bytes: free space of the disk.
        seconds_left: time until the disk is full at the present rate, s; infinite if unknown.
    """

    backlog_bytes: int = 0
    unsynced_s: float = 0.0
    slow_s: float = 0.0
    written_bytes: int = 0
    free_bytes: int = 0
    seconds_left: float = float("inf")

    @property
    def slow(self) -> bool:
        """Whether the disk is slow enough for a report, long before data is lost."""
        return self.backlog_bytes > _SLOW_SHARE * BACKLOG_BYTES or self.unsynced_s > _SLOW_SYNC_S

    def facts(self) -> dict[str, Any]:
        """Return the state as JSON values for a health report."""
        known = self.seconds_left != float("inf")
        return {**vars(self), "seconds_left": self.seconds_left if known else None, "slow": self.slow}


class Disk(Protocol):
    """Disk to which logs are written."""

    def free_bytes(self, folder: Path) -> int:
        """Return the free space of the disk of a folder.

        Raises:
            OSError: the folder does not exist.
        """
        ...

    def sync(self, log: LogFile) -> None:
        """Wait until the disk has stored everything that was passed to the operating system.

        Raises:
            OSError: writing failed.
        """
        ...


class RealDisk(Disk):
    """The disk of this machine; implements Disk."""

    @override
    def free_bytes(self, folder: Path) -> int:
        return shutil.disk_usage(folder).free

    @override
    def sync(self, log: LogFile) -> None:
        log.sync()


class Recorder:
    """Writes one log.

    Args:
        path: path of the finished file, ending in .mcap, or a reserved name.
        clock: host clock for the time stamps of health reports.
        metadata: flat facts of the run (test, point, operator's note, software version …).
        attachments: contents of the attachments (rig snapshot, identities), by name.
        devices: names of the devices whose raw bytes are recorded.
        sample_channels: channels of the decoded samples.
        disk: disk to which the log is written; the disk of this machine if None.

    Attributes:
        trouble: error that ends the recording; None if there is none.
        path, part: path of the finished file, and of the file that is being written.

    Raises:
        LogError: the file, or an unfinished file of its name, exists already.
        RecordingError: the file cannot be created, or the disk has insufficient space.
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
        self._failure: Exception | None = None  # error of the disk, after which nothing can be written
        self._log = LogFile(path, metadata, attachments, devices, clock.now_ns(), sample_channels)
        self.path: Path = self._log.path
        self.part: Path = self._log.part
        self._lock = threading.Lock()
        self._backlog: list[Recorded] = []
        self._backlog_bytes = 0
        self._unsynced = threading.Event()
        self._flushed_at = self._synced_to = clock.now_s()
        self._flushes = 0
        self._slow_s = 0.0
        self._started_s = clock.now_s()
        self._written_first = self._size()
        if self.state().free_bytes < 2 * _SPARE_BYTES:
            self._log.close()
            self.part.unlink()
            free, needed = distinct(self.state().free_bytes / 1e6, 2 * _SPARE_BYTES / 1e6)
            raise RecordingError(
                f"{self.path.parent}: {free} MB free, at least {needed} MB are needed to begin a log. Make room on the "
                "disk"
            )
        self._syncing = clock.every(_FLUSH_S, self._sync, "sync", self._fail)
        self._writing = clock.every(_FLUSH_S, self._write_all, "recorder", self._fail)

    # --- from the readers ----------------------------------------------------------------------------------------

    def add(self, effect: Recorded) -> bool:
        """Record bytes with their items, an event or a health report.

        Returns:
            False if the recording has ended: bytes are not accepted any more, and neither are their items.
        """
        if isinstance(effect, Keep) and self.trouble is not None:
            return False
        with self._lock:
            self._backlog.append(effect)
            self._backlog_bytes += _size_of(effect)
            is_full = self._backlog_bytes > BACKLOG_BYTES
        if is_full:
            self._end_because(
                f"the disk is too slow, {BACKLOG_BYTES / 2**20:.0f} MB wait to be written. The log ends here and is "
                "complete; use a faster disk, or find out which other program is writing to this one"
            )
        return True

    # --- state ---------------------------------------------------------------------------------------------------

    def state(self) -> DiskState:
        """Return the present state of the disk."""
        behind = self._flushed_at > self._synced_to
        written = self._size()
        free = self._disk.free_bytes(self.part.parent)
        rate = (written - self._written_first) / max(1e-3, self._clock.now_s() - self._started_s)
        return DiskState(
            self._backlog_bytes,
            self._clock.now_s() - self._synced_to if behind else 0.0,
            self._slow_s,
            written,
            free,
            max(0, free - self._spare()) / rate if rate > 0 else float("inf"),
        )

    def look(self) -> DiskState:
        """Return the state of the disk. End the recording while there is still space to finish the file."""
        try:
            state = self.state()
            if not self._log.is_there():
                raise FileNotFoundError(f"{self.part.name} was moved or deleted")
        except OSError as error:
            self._fail(error)
            return DiskState()
        if state.free_bytes < self._spare():
            self._end_because(
                f"the disk is full ({state.free_bytes / 1e6:.1f} MB left). The log ends here and is complete; make "
                "room and repeat the test"
            )
        return state

    def _spare(self) -> int:
        return _SPARE_BYTES + _SPARE_BYTES_A_FLUSH * self._flushes + self._backlog_bytes

    def _size(self) -> int:
        try:
            return self.part.stat().st_size
        except OSError as error:
            _log.debug("%s: its size cannot be read: %s", self.part, error)
            return 0

    def _end_because(self, why: str) -> None:
        if self.trouble is None:
            self.trouble = RecordingError(f"{self.path}: {why}")

    # --- writing -------------------------------------------------------------------------------------------------

    def _write_all(self) -> None:
        """Write the whole backlog. After a delay the next block is larger."""
        with self._lock:
            items, self._backlog = self._backlog, []
            size = self._backlog_bytes
        if items and self._failure is None:
            try:
                self._write(items)
                self._log.flush()
            except Exception as error:  # every error must be reported, and the backlog must still be emptied
                self._fail(error)
            self._flushes += 1
            self._flushed_at = self._clock.now_s()
            self._unsynced.set()
        with self._lock:
            self._backlog_bytes -= size

    def _write(self, effects: list[Recorded]) -> None:
        """Write raw bytes and events in their order, and the samples of each channel as one block."""
        batches: dict[str, list[tuple[Batch, int]]] = {}
        for effect in effects:
            match effect:
                case Keep(device, direction, data, items, host_ns):
                    self._log.raw(device, direction, data, host_ns)
                    for item in items:
                        if isinstance(item, Batch):
                            batches.setdefault(item.channel.topic, []).append((item, host_ns))
                        else:
                            self._log.event(item, host_ns)
                case Note(event, host_ns):
                    self._log.event(event, host_ns)
                case WriteHealth(facts, host_ns):
                    self._log.note(channels.HEALTH_TOPIC, facts, host_ns, host_ns)
        for arrived in batches.values():
            batch, host_ns = joined(arrived)
            self._log.batch(batch, host_ns)

    def _sync(self) -> None:
        """Synchronise the file with the disk. A slow disk delays only this thread."""
        if not self._unsynced.is_set() or self._failure is not None:
            return
        self._unsynced.clear()
        begun, last = self._clock.now_s(), self._synced_to
        try:
            self._disk.sync(self._log)
        except OSError as error:
            self._fail(error)
        self._synced_to = begun
        self._slow_s += max(0.0, self._clock.now_s() - last - _SLOW_SYNC_S)

    def _fail(self, error: Exception) -> None:
        self._failure = self._failure or error
        if isinstance(error, FileNotFoundError):
            advice = "the folder or the file has been removed, with the recording; look for it, or repeat the test"
        else:
            remedy = "make room on the disk, or use another" if isinstance(error, OSError) else "inform the developers"
            advice = f"{self.part.name} is readable up to the last flush, and `rig recover` completes it; {remedy}"
        self._end_because(f"writing failed ({error}). {advice}")

    def close(self, summary: Mapping[str, Any]) -> Path:
        """Finish the file and return its path. The summary (losses, verdicts) is written as metadata.

        Raises:
            RecordingError: the disk failed. The content up to the last flush stays readable in the .part file.
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


def _size_of(effect: Recorded) -> int:
    """Return the memory of an effect, bytes."""
    if not isinstance(effect, Keep):
        return _ITEM_BYTES
    batches = (item for item in effect.items if isinstance(item, Batch))
    samples = sum(len(batch.time_ns) * batch.channel.dtype.itemsize for batch in batches)
    return len(effect.data) + samples + _ITEM_BYTES * (1 + len(effect.items))

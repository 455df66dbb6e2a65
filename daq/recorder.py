"""Writes one run to one MCAP file: raw bytes first, then what was decoded from them.

The threads that read devices only put work into a queue; one writer thread builds blocks, flushes and syncs every
50 ms. While recording the file is NAME.mcap.part; it gets its name when it is whole. A disk that fails is noticed by
`error`, and the run is to be stopped: nothing is thrown away silently.
"""

from __future__ import annotations

import json
import os
import queue
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from daq import channels
from daq.errors import LogError, RecordingError
from daq.mcap_writer import BlockWriter
from daq.stream_items import Batch, Event
from daq.transports.host_clock import HostClock

_FLUSH_S = 0.05
_QUEUE_ITEMS = 20_000  # about 20 s of a rig's reads; beyond it the reader waits and the wait is counted


class Recorder:
    """One log being written.

    Args:
        path: the finished file's name, ending in .mcap.
        clock: the host clock that stamps events.
        metadata: flat facts of the run (test, point, operator's note, software version …).
        attachments: files that go in whole, by name (rig snapshot, identities).
        devices: names of the devices whose raw bytes are kept.
    Raises:
        LogError: the file or the rest of a cut one of its name exists already.
        RecordingError: it cannot be created.
    """

    def __init__(
        self,
        path: Path,
        clock: HostClock,
        metadata: Mapping[str, str],
        attachments: Mapping[str, bytes],
        devices: tuple[str, ...],
    ) -> None:
        self.path = Path(path)
        self.part = self.path.with_name(self.path.name + ".part")
        self.error: Exception | None = None
        self.stalled = 0  # times a reader had to wait for the disk
        self._clock = clock
        self._queue: queue.Queue[tuple[Any, ...] | None] = queue.Queue(_QUEUE_ITEMS)
        if self.path.exists():
            raise LogError(f"{self.path}: exists already; a log is never written over. Give another name")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = open(self.part, "xb")  # noqa: SIM115 (lives as long as the recorder)
            self._writer = BlockWriter(self._file)
            self._open(metadata, attachments, devices)
        except FileExistsError as error:
            raise LogError(
                f"{self.part}: exists already, the rest of a recording that was cut. Move it away or give another name"
            ) from error
        except OSError as error:
            raise RecordingError(
                f"{self.part}: cannot be created ({error}). Is the folder there and the disk not full?"
            ) from error
        self._unsynced = threading.Event()
        self._syncing = True
        self._sync_thread = threading.Thread(target=self._sync, name="sync", daemon=True)
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._sync_thread.start()
        self._thread.start()

    def _open(self, metadata: Mapping[str, str], attachments: Mapping[str, bytes], devices: tuple[str, ...]) -> None:
        w, now = self._writer, self._clock.now_ns()
        w.start()
        raw_schema = w.register_schema(channels.RAW_SCHEMA_NAME, "protobuf", channels.raw_descriptor_set())
        note_schema = w.register_schema(channels.NOTE_SCHEMA_NAME, "jsonschema", channels.note_schema())
        self._ids = {
            channels.raw_topic(d): w.register_channel(channels.raw_topic(d), "protobuf", raw_schema) for d in devices
        }
        schemas: dict[str, int] = {}
        for topic, channel in channels.CHANNELS.items():
            if channel.schema_name not in schemas:
                schemas[channel.schema_name] = w.register_schema(
                    channel.schema_name, "protobuf", channel.file_descriptor_set()
                )
            self._ids[topic] = w.register_channel(topic, "protobuf", schemas[channel.schema_name])
        for topic in (channels.EVENTS_TOPIC, channels.HEALTH_TOPIC):
            self._ids[topic] = w.register_channel(topic, "json", note_schema)
        w.add_metadata("run", dict(metadata))
        for name, data in attachments.items():
            w.add_attachment(name, "application/json", data, now)
        w.flush()

    def raw(self, device: str, direction: int, data: bytes, host_ns: int) -> None:
        """Keep bytes as they came or went."""
        self._put(("message", channels.raw_topic(device), host_ns, host_ns, channels.pack_raw(direction, data)))

    def batch(self, batch: Batch, host_ns: int) -> None:
        """Keep decoded samples."""
        self._put(("block", batch, host_ns))

    def event(self, event: Event, host_ns: int) -> None:
        """Keep an event."""
        time_ns = int(event.facts.get("time_ns", host_ns))
        note = {"kind": event.kind, "device": event.device, "text": event.text, **event.facts}
        self._put(("message", channels.EVENTS_TOPIC, host_ns, time_ns, channels.pack_note(note)))

    def health(self, facts: Mapping[str, Any]) -> None:
        """Keep a snapshot of rates and losses."""
        now = self._clock.now_ns()
        self._put(("message", channels.HEALTH_TOPIC, now, now, channels.pack_note(facts)))

    def close(self, summary: Mapping[str, Any]) -> Path:
        """Finish the file; the summary (losses, verdicts) goes in as metadata.

        Raises:
            RecordingError: the disk failed; what was written until then stays readable in the .part file.
        """
        self._put(("metadata", "summary", {k: json.dumps(v) for k, v in summary.items()}))
        self._queue.put(None)
        self._thread.join()
        if self.error is not None:
            raise RecordingError(
                f"{self.part}: writing failed ({self.error}). The file is readable up to the last flush; "
                "make room on the disk and repeat the test"
            )
        return self.path

    def _put(self, item: tuple[Any, ...]) -> None:
        if self.error is not None:
            return
        try:
            self._queue.put_nowait(item)
        except queue.Full:
            self.stalled += 1
            self._queue.put(item)

    def _run(self) -> None:
        due = time.monotonic() + _FLUSH_S
        finished = False
        while not finished:
            try:
                item = self._queue.get(timeout=max(0.0, due - time.monotonic()))
                finished = item is None
                if item is not None and self.error is None:
                    self._write(item)
            except queue.Empty:
                pass
            except Exception as error:  # whatever it is: it must be seen, and the queue must go on being emptied
                self.error = error
            if time.monotonic() >= due:
                due = time.monotonic() + _FLUSH_S
                if not finished and self.error is None:
                    self._flush()
        self._finish()

    def _write(self, item: tuple[Any, ...]) -> None:
        if item[0] == "block":
            _, batch, host_ns = item
            messages = batch.channel.pack(batch.columns)
            self._writer.add_block(
                self._ids[batch.channel.topic], host_ns, batch.time_ns.astype(np.uint64), batch.sequence, messages
            )
        elif item[0] == "message":
            _, topic, log_ns, publish_ns, data = item
            self._writer.add_message(self._ids[topic], log_ns, publish_ns, 0, data)
        else:
            self._writer.add_metadata(item[1], item[2])

    def _flush(self) -> None:
        """Hand everything to the system, which is enough if this process dies; the other thread sees to the disk."""
        try:
            self._writer.flush()
            self._file.flush()
        except Exception as error:
            self.error = error
        self._unsynced.set()

    def _sync(self) -> None:
        """Keep the disk up to date; a slow disk delays this thread and no other."""
        sync = getattr(os, "fdatasync", os.fsync)  # only POSIX has fdatasync
        while self._syncing:
            self._unsynced.wait()
            self._unsynced.clear()
            if self._syncing and self.error is None:
                try:
                    sync(self._file.fileno())
                except OSError as error:
                    self.error = error

    def _finish(self) -> None:
        self._syncing = False
        self._unsynced.set()
        self._sync_thread.join()
        for step in (self._writer.finish, self._flush_file):
            if self.error is None:
                self._attempt(step)
        self._attempt(self._file.close)
        if self.error is None:
            self._attempt(lambda: os.replace(self.part, self.path))

    def _attempt(self, step: Callable[[], object]) -> None:
        try:
            step()
        except Exception as error:
            self.error = self.error or error

    def _flush_file(self) -> None:
        self._file.flush()
        os.fsync(self._file.fileno())

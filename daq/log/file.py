"""One log being written, by one thread: a NAME.mcap.part with the rig's channels that gets its name when it is whole.

    with LogFile(path, facts, attachments, devices, now_ns) as log:
        log.raw("probe", RX, data, host_ns)
        log.batch(batch, host_ns)
        log.finish({"losses": …})

The recorder puts a backlog and a thread before it; whoever makes a log of another (decoded anew, imported) uses it as
it is.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from daq import channels
from daq.drivers.items import Batch, Event
from daq.errors import LogError, RecordingError
from daq.mcap.writer import BlockWriter, compile_writer

FOXGLOVE = "foxglove"
"""Metadata record by which Foxglove's recorder agent knows whose log it is."""
_WAITS_S = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
_MEDIA_TYPES = {".json": "application/json", ".toml": "application/toml", ".csv": "text/csv", ".txt": "text/plain"}


class ReservedName:
    """A log's name, taken before there is anything to write: its empty NAME.mcap.part stands in the folder.

        with ReservedName(path) as name:
            …  # open devices
            log = LogFile(name, …)

    A name that was not used in the end is given back.

    Raises:
        LogError: the name does not end in .mcap, or is taken by a log, by one being written, or by a cut one.
        RecordingError: the file cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self.part = self.path.with_name(self.path.name + ".part")
        check_name(self.path)
        compile_writer()  # before there is a file: one that is killed must not be found empty
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file: BinaryIO | None = open(self.part, "xb")  # noqa: SIM115 (lives on)
        except FileExistsError as error:
            raise LogError(_taken(self.part)) from error
        except OSError as error:
            raise _cannot_create(self.part, error) from error
        try:
            check_name(self.path)  # again: another recording of this name may just have ended
        except BaseException:
            self.give_back()
            raise

    def take(self) -> BinaryIO:
        """The file to write; from now on it is its writer's."""
        assert self._file is not None, "the name has been used"
        file, self._file = self._file, None
        return file

    def give_back(self) -> None:
        """Let go of a name that was not used; nothing is in its file yet."""
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()
            with contextlib.suppress(OSError):
                self.part.unlink()
            self._file = None

    def __enter__(self) -> ReservedName:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.give_back()


class LogFile:
    """A log being written.

    Args:
        path: the finished file's name, ending in .mcap, or one that was reserved.
        metadata: flat facts of the run (test, point, operator's note, software version …).
        attachments: files that go in whole, by name (rig snapshot, identities).
        devices: names of the devices whose raw bytes are kept.
        created_ns: when, ns since 1970.
        sample_channels: what is decoded.
        compression: of the chunks.

    Raises:
        LogError: the name does not end in .mcap, or the file or the rest of a cut one of its name exists already.
        RecordingError: it cannot be created.
    """

    def __init__(
        self,
        path: Path | ReservedName,
        metadata: Mapping[str, str],
        attachments: Mapping[str, bytes],
        devices: Iterable[str],
        created_ns: int,
        sample_channels: Iterable[channels.Channel] = tuple(channels.CHANNELS.values()),
        compression: Literal["zstd", "none"] = "zstd",
    ) -> None:
        name = path if isinstance(path, ReservedName) else ReservedName(path)
        self.path, self.part, self.file = name.path, name.part, name.take()
        try:
            self._writer = BlockWriter(self.file, compression)
            self._ids = self._define(devices, sample_channels)
            self._writer.add_metadata("run", dict(metadata))
            if rig := metadata.get("rig"):  # without it Foxglove's recorder agent passes the file over
                self._writer.add_metadata(FOXGLOVE, {"deviceName": rig, "deviceId": rig})
            for name, data in attachments.items():
                self._writer.add_attachment(name, _media_type(name), data, created_ns)
            self.flush()
        except BaseException as error:
            with contextlib.suppress(OSError):
                self.file.close()
            with contextlib.suppress(OSError):
                self.part.unlink()  # nothing is in it yet
            if isinstance(error, OSError):
                raise _cannot_create(self.part, error) from error
            raise

    def _define(self, devices: Iterable[str], sample_channels: Iterable[channels.Channel]) -> dict[str, int]:
        writer = self._writer
        writer.start()
        raw_schema = writer.register_schema(channels.RAW_SCHEMA_NAME, "protobuf", channels.raw_descriptor_set())
        note_schema = writer.register_schema(channels.NOTE_SCHEMA_NAME, "jsonschema", channels.note_schema())
        topics = [channels.raw_topic(device) for device in devices]
        ids = {topic: writer.register_channel(topic, "protobuf", raw_schema) for topic in topics}
        schemas: dict[str, int] = {}
        for channel in sample_channels:
            if channel.schema_name not in schemas:
                schema = channel.file_descriptor_set()
                schemas[channel.schema_name] = writer.register_schema(channel.schema_name, "protobuf", schema)
            ids[channel.topic] = writer.register_channel(channel.topic, "protobuf", schemas[channel.schema_name])
        for topic in (channels.EVENTS_TOPIC, channels.HEALTH_TOPIC):
            ids[topic] = writer.register_channel(topic, "json", note_schema)
        return ids

    def raw(self, device: str, direction: int, data: bytes, host_ns: int) -> None:
        """Keep bytes as they came from a device or went to it."""
        message = channels.pack_raw(direction, data)
        self._writer.add_message(self._ids[channels.raw_topic(device)], host_ns, host_ns, 0, message)

    def batch(self, batch: Batch, host_ns: int | NDArray[np.int64]) -> None:
        """Keep decoded samples that arrived at one host time, or each at its own (n,)."""
        messages = batch.channel.pack(batch.columns)
        self._writer.add_block(self._ids[batch.channel.topic], host_ns, batch.time_ns, batch.sequence, messages)

    def event(self, event: Event, host_ns: int) -> None:
        """Keep an event; its own time is ``facts["time_ns"]`` where it has one."""
        note = {"kind": event.kind, "device": event.device, "text": event.text, **event.facts}
        self.note(channels.EVENTS_TOPIC, note, host_ns, int(event.facts.get("time_ns", host_ns)))

    def note(self, topic: str, facts: Mapping[str, Any], log_ns: int, publish_ns: int) -> None:
        """Keep an event or a health report as it stands."""
        self._writer.add_message(self._ids[topic], log_ns, publish_ns, 0, channels.pack_note(facts))

    def flush(self) -> None:
        """Hand everything to the system: it survives the end of this process."""
        self._writer.flush()

    def sync(self) -> None:
        """Wait until the disk has what was flushed: it survives the end of the machine. Any thread may call it."""
        getattr(os, "fdatasync", os.fsync)(self.file.fileno())  # only POSIX has fdatasync

    def is_there(self) -> bool:
        """Whether the file still has its name: one that was moved or deleted is written in vain.

        Raises:
            OSError: its folder is gone.
        """
        try:
            return os.path.samestat(os.stat(self.part), os.fstat(self.file.fileno()))
        except FileNotFoundError:
            return False

    def finish(self, summary: Mapping[str, Any]) -> Path:
        """Write the summary metadata (losses, verdicts; values as JSON) and the file's end, and give it its name.

        Raises:
            OSError: the disk failed; the .part file stays.
            LogError: another file has taken the name meanwhile; the .part file stays, whole.
        """
        self._writer.add_metadata("summary", {key: _json(value) for key, value in summary.items()})
        self._writer.finish()
        os.fsync(self.file.fileno())
        self.file.close()
        give_name(self.part, self.path)
        self._sync_folder()
        return self.path

    def close(self) -> None:
        """Let go of the file; one that was not finished stays as .part, readable up to the last flush."""
        with contextlib.suppress(OSError):  # what a full disk did not take is tried once more here
            self.file.close()

    def __enter__(self) -> LogFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _sync_folder(self) -> None:
        """The new name must survive a power cut too; Windows cannot open a folder and needs no such thing."""
        with contextlib.suppress(OSError):
            folder = os.open(self.path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)


def check_name(path: Path) -> None:
    """Whether a log of this name can be written.

    Raises:
        LogError: it does not end in .mcap, or is taken.
    """
    if path.suffix != ".mcap":
        raise LogError(f"{path}: expected a name that ends in .mcap, got {path.name!r}")
    if path.exists():
        raise LogError(f"{path}: exists already; a log is never written over. Give another name")


def give_name(part: Path, path: Path) -> None:
    """Rename a finished file, unless the name is taken; on Windows a program that is just reading it is waited for.

    Raises:
        LogError: the name is taken.
        OSError: it cannot be renamed.
    """
    try:
        os.link(part, path)  # a rename would write over a file that was made meanwhile
    except FileExistsError as fault:
        raise LogError(f"{path}: exists already; a log is never written over. Give another name") from fault
    except OSError:  # a file system without links
        check_name(path)
        _patiently(lambda: os.rename(part, path))
    else:
        _patiently(part.unlink)


def _patiently(step: Callable[[], object]) -> None:
    for wait_s in _WAITS_S:
        try:
            step()
            return
        except PermissionError:
            if os.name != "nt":
                raise
            time.sleep(wait_s)
    step()


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, default=_plain)


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"expected a JSON value in a log's summary, got {type(value).__name__}")


def _media_type(name: str) -> str:
    return _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")


def _taken(part: Path) -> str:
    size = 0
    with contextlib.suppress(OSError):
        size = part.stat().st_size
    if not size:
        return (
            f"{part}: exists already: a recording under this name is about to begin, or was ended before it began. "
            "Give another name, or remove the file if nothing is recording"
        )
    return (
        f"{part}: exists already: another recording is writing it, or it is the rest of a recording that was cut. "
        f"Give another name; `rig recover {part}` makes a cut one whole"
    )


def _cannot_create(part: Path, error: OSError) -> RecordingError:
    return RecordingError(f"{part}: cannot be created ({error}). Is the folder there and the disk not full?")

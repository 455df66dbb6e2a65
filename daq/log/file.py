"""Writer of one log, used by one thread: a NAME.mcap.part with the rig's channels, renamed to NAME.mcap when complete.

    with LogFile(path, facts, attachments, devices, now_ns) as log:
        log.raw("probe", RX, data, host_ns)
        log.batch(batch, host_ns)
        log.finish({"losses": …})

The recorder adds a backlog and a thread in front of it. Programs that make a log from another one (decoding again,
import) use it directly.
"""

from __future__ import annotations

import contextlib
import io
import json
import logging
import os
import time
from collections.abc import Callable, Generator, Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Literal, cast

import numpy as np
from numpy.typing import NDArray

from daq import channels
from daq.errors import LogError, RecordingError
from daq.items import Batch, DeviceEvent
from daq.mcap.writer import BlockWriter
from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)

FOXGLOVE = "foxglove"
"""Metadata record by which Foxglove's recorder agent identifies the device of a log."""
_RETRY_DELAYS_S = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
_MEDIA_TYPES = {".json": "application/json", ".toml": "application/toml", ".csv": "text/csv", ".txt": "text/plain"}


class ReservedName:
    """A log's name, reserved before there is data: an empty NAME.mcap.part exists in the folder.

        with ReservedName(path) as name:
            …  # open devices
            log = LogFile(name, …)

    A reserved name that was not used is released at the end of the block.

    Raises:
        LogError: the name does not end in .mcap, or is used by a log, by one being written, or by a cut one.
        RecordingError: the file cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self.path: Path = Path(path)
        self.part: Path = self.path.with_name(self.path.name + ".part")
        check_name(self.path)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file: BinaryIO | None = io.BufferedWriter(io.FileIO(self.part, "x"))
        except FileExistsError as error:
            raise LogError(_taken(self.part)) from error
        except OSError as error:
            raise _cannot_create(self.part, error) from error
        try:
            check_name(self.path)  # again: another recording of this name may have ended meanwhile
        except BaseException:
            self.give_back()
            raise

    def take(self) -> BinaryIO:
        """Return the file to write; the caller owns it from now on."""
        assert self._file is not None, "the name has been used"
        file, self._file = self._file, None
        return file

    def give_back(self) -> None:
        """Release a name that was not used and remove its empty file."""
        if self._file is not None:
            with ignoring(_log, f"closing {self.part}", OSError):
                self._file.close()
            with ignoring(_log, f"removing {self.part}", OSError):
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
        path: name of the finished file, ending in .mcap, or a reserved name.
        metadata: flat facts of the run (test, point, operator's note, software version …).
        attachments: content of attached files by name (rig snapshot, identities).
        devices: names of the devices whose raw bytes are recorded.
        created_ns: creation time, ns since 1970.
        sample_channels: channels of decoded samples.
        compression: compression of the chunks.

    Raises:
        LogError: the name does not end in .mcap, or the file or an unfinished one of its name exists already.
        RecordingError: the file cannot be created.
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
        self.path: Path = name.path
        self.part: Path = name.part
        self.file: BinaryIO = name.take()
        try:
            self._writer = BlockWriter(self.file, compression)
            self._ids = self._define(devices, sample_channels)
            self._writer.add_metadata("run", dict(metadata))
            if rig := metadata.get("rig"):  # Foxglove's recorder agent skips files without it
                self._writer.add_metadata(FOXGLOVE, {"deviceName": rig, "deviceId": rig})
            for name, data in attachments.items():
                self._writer.add_attachment(name, _media_type(name), data, created_ns)
            self.flush()
        except BaseException as error:
            with ignoring(_log, f"closing {self.part}", OSError):
                self.file.close()
            with ignoring(_log, f"removing {self.part}", OSError):
                self.part.unlink()  # it is still empty
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
        """Write bytes as they came from a device or were sent to it."""
        message = channels.pack_raw(direction, data)
        self._writer.add_message(self._ids[channels.raw_topic(device)], host_ns, host_ns, 0, message)

    def batch(self, batch: Batch, host_ns: int | NDArray[np.int64]) -> None:
        """Write decoded samples that arrived at one host time, or each at its own (n,)."""
        channel = batch.channel
        channel.check_names(batch.columns)
        heads = host_ns, batch.time_ns, batch.sequence
        self._writer.add_samples(self._ids[channel.topic], *heads, channel.item, batch.columns)

    def event(self, event: DeviceEvent, host_ns: int) -> None:
        """Write an event; its own time is ``facts["time_ns"]`` if present."""
        note = {"kind": event.kind, "device": event.device, "text": event.text, **event.facts}
        self.note(channels.EVENTS_TOPIC, note, host_ns, int(event.facts.get("time_ns", host_ns)))

    def note(self, topic: str, facts: Mapping[str, Any], log_ns: int, publish_ns: int) -> None:
        """Write the facts of an event or a health report unchanged."""
        self._writer.add_message(self._ids[topic], log_ns, publish_ns, 0, channels.pack_note(facts))

    def flush(self) -> None:
        """Pass all data to the operating system, so that it survives the end of this process."""
        self._writer.flush()

    def sync(self) -> None:
        """Wait until flushed data is on the disk, so that it survives a power cut. Any thread may call it."""
        getattr(os, "fdatasync", os.fsync)(self.file.fileno())  # only POSIX has fdatasync

    def is_there(self) -> bool:
        """Return True if the file still has its name. Data written to a moved or deleted file would be lost.

        Raises:
            OSError: its folder does not exist any more.
        """
        try:
            return os.path.samestat(os.stat(self.part), os.fstat(self.file.fileno()))
        except FileNotFoundError:  # usual: this is the question
            return False

    def finish(self, summary: Mapping[str, Any]) -> Path:
        """Write the summary metadata (losses, verdicts; values as JSON) and the file's end, and rename the file.

        Raises:
            OSError: the disk failed; the .part file remains.
            LogError: another file has taken the name meanwhile; the complete .part file remains.
        """
        self._writer.add_metadata("summary", {key: _json(value) for key, value in summary.items()})
        self._writer.finish()
        os.fsync(self.file.fileno())
        self.file.close()
        give_name(self.part, self.path)
        self._sync_folder()
        return self.path

    def close(self) -> None:
        """Close the file. An unfinished file remains as .part, readable up to the last flush."""
        with ignoring(_log, f"closing {self.part}", OSError):  # closing retries the data that a full disk did not take
            self.file.close()

    @contextlib.contextmanager
    def or_nothing(self) -> Generator[None]:
        """Return a context that closes the file, and removes it if the block raises: its origin has all the data."""
        try:
            with self:
                yield
        except BaseException:
            with ignoring(_log, f"removing {self.part}", OSError):
                self.part.unlink(missing_ok=True)
            raise

    def __enter__(self) -> LogFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _sync_folder(self) -> None:
        """Make the new name survive a power cut. Windows cannot open a folder and does not need it."""
        with ignoring(_log, f"writing the folder of {self.path} to the disk", OSError):
            folder = os.open(self.path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)


def check_name(path: Path) -> None:
    """Check that a log of this name can be written.

    Raises:
        LogError: the name does not end in .mcap, or is taken.
    """
    if path.suffix != ".mcap":
        raise LogError(f"{path}: expected a name that ends in .mcap, got {path.name!r}")
    if path.exists():
        raise LogError(f"{path}: exists already; logs are never overwritten. Give another name")


def give_name(part: Path, path: Path) -> None:
    """Rename a finished file, unless the name is taken. On Windows retry while another program is reading the file.

    Raises:
        LogError: the name is taken.
        OSError: the file cannot be renamed.
    """
    try:
        os.link(part, path)  # a rename would overwrite a file that was created meanwhile
    except FileExistsError as fault:
        raise LogError(f"{path}: exists already; logs are never overwritten. Give another name") from fault
    except OSError:  # usual: a file system without links
        check_name(path)
        _patiently(lambda: os.rename(part, path))
    else:
        _patiently(part.unlink)


def _patiently(step: Callable[[], object]) -> None:
    for wait_s in _RETRY_DELAYS_S:
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
        return cast("Any", value).tolist()
    raise TypeError(f"expected a JSON value in a log's summary, got {type(value).__name__}")


def _media_type(name: str) -> str:
    return _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")


def _taken(part: Path) -> str:
    size = 0
    with contextlib.suppress(OSError):  # usual: the other recording has ended meanwhile
        size = part.stat().st_size
    if not size:
        return (
            f"{part}: exists already: a recording under this name is about to begin, or was stopped before it began. "
            "Give another name, or remove the file if nothing is recording"
        )
    return (
        f"{part}: exists already: another recording is writing it, or it is the rest of a recording that was cut. "
        f"Give another name; `rig recover {part}` makes a complete log of a cut one"
    )


def _cannot_create(part: Path, error: OSError) -> RecordingError:
    return RecordingError(f"{part}: cannot be created ({error}). Is the folder there and the disk not full?")

"""A log as arrays: `open_log(path)` reads finished, unfinished and cut files alike.

    with open_log("run.mcap") as log:
        x = log["laser/x"]
        x.time_s, x.displacement_m          # (n,) s since 1970, m
        log.between(start_ns, end_ns)["laser/x"]   # reads only what it needs

A finished file opens at once, from its index. Damage is found when the damaged part is read, or by `verify`. Missing
and unreadable parts are listed in `log.missing`; all data that is returned was complete and had the right CRC.
Sample fields are read from the schema in the file, so logs of other versions are read in the same way.
"""

from __future__ import annotations

import json
import operator
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, cast

from mcap.records import Channel as ChannelRecord, Schema

from daq.channels import EVENTS_TOPIC, HEALTH_TOPIC, RAW_PREFIX, RAW_SCHEMA_NAME, Channel, unpack_raw
from daq.errors import ChannelMissing, LogError
from daq.log.lost_before import read_lost
from daq.log.samples import RawChunk, Samples
from daq.log.source import LogSource
from daq.log.window import LogWindow
from daq.mcap.missing import Missing
from rig_basics.texts import did_you_mean


class Log(Mapping[str, Samples]):
    """An open log: a mapping from topic to `Samples`, and the other contents of the file.

    Created by `open_log` and `between`.

    Attributes:
        path: path of the file.
        window_ns: first time and end of the samples it is limited to, ns since 1970; None if it is not limited.
    """

    def __init__(self, path: Path, source: LogSource, window_ns: tuple[int, int] | None = None) -> None:
        self.path = path
        self.window_ns = window_ns
        self._source = source
        self._window = LogWindow(source, window_ns)
        self._samples: dict[str, Samples] = {}

    @property
    def missing(self) -> list[Missing]:
        """Missing and damaged parts of the file found so far; reading may find more. What a recovered log had lost
        before its recovery is at the end of the list.
        """
        return [*self._source.missing, *self.lost_before]

    @property
    def lost_before(self) -> list[Missing]:
        """What a recovered log had lost before it was recovered; empty for any other log."""
        return list(read_lost(self._source.contents.metadata))

    @property
    def complete(self) -> bool:
        """True if nothing has been found missing; `verify` checks the whole file."""
        return not self.missing

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Tables of texts by name of the metadata record."""
        return self._source.contents.metadata

    @property
    def attachments(self) -> dict[str, bytes]:
        """Content of the attached files by name; read and checked at the first access."""
        return self._source.attachments

    @property
    def library(self) -> str:
        """Program that wrote the file, as stated in its header."""
        return self._source.contents.header.library

    @property
    def size_bytes(self) -> int:
        """Size of the file when it was opened."""
        return self._source.file.size

    @property
    def chunk_count(self) -> int:
        """Number of readable chunks."""
        return len(self._source.contents.table)

    @property
    def start_ns(self) -> int:
        """First log time, ns since 1970; 0 if there are no messages."""
        return self._span()[0]

    @property
    def end_ns(self) -> int:
        """Last log time, ns since 1970; 0 if there are no messages."""
        return self._span()[1]

    @property
    def topics(self) -> tuple[str, ...]:
        """Every topic of the file, sorted: samples, raw bytes, events, health."""
        return tuple(sorted(self._window.ids()))

    @property
    def devices(self) -> tuple[str, ...]:
        """Devices whose raw bytes are in the file, sorted."""
        return tuple(topic.removeprefix(RAW_PREFIX) for topic in self.topics if topic.startswith(RAW_PREFIX))

    def count(self, topic: str) -> int:
        """Return the number of messages of a topic; 0 if the topic does not exist."""
        ids = self._window.ids().get(topic, [])
        if self.window_ns is None:
            return sum(self._source.contents.counts.get(channel_id, 0) for channel_id in ids)
        return sum(len(part) for part in self._window.messages([topic]))

    def channel(self, topic: str) -> Channel:
        """Return the layout of a sample channel, as defined by the file's schema.

        Raises:
            ChannelMissing: the log does not have this sample channel.
            LogError: the schema is missing, has fields of variable width, or is not the same throughout the file.
        """
        if not self._is_samples(topic):
            raise self._missing_channel(topic, list(self))
        contents = self._source.contents.definitions
        ids = {contents.channels[channel_id].schema_id for channel_id in self._window.ids()[topic]}
        schemas = [contents.schemas.get(schema_id) for schema_id in sorted(ids)]
        first = schemas[0]
        if first is None:
            raise LogError(f"{self.path}: {topic}: expected schema {min(ids)} in the file, it is missing")
        if any(schema is None or _meaning(schema) != _meaning(first) for schema in schemas):
            raise LogError(f"{self.path}: {topic}: expected one schema for the whole file, got {len(schemas)}")
        try:
            return Channel.from_descriptor_set(topic, first.name, first.data)
        except ValueError as fault:
            raise LogError(f"{self.path}: {fault}") from fault

    def between(self, start_ns: int, end_ns: int) -> Log:
        """Return the same log limited to start_ns ≤ time_ns < end_ns: samples, events and health by their own times,
        raw bytes by their host time. Only the necessary chunks are read. The part is open as long as this log is.

        Raises:
            TypeError: a time is not a whole number; in seconds it would be a time in 1970.
        """
        try:
            start_ns, end_ns = operator.index(start_ns), operator.index(end_ns)
        except TypeError as fault:
            raise TypeError(
                f"expected whole numbers of ns since 1970 (int), got {start_ns!r} and {end_ns!r}: "
                "take times from time_ns, or int(seconds * 1e9)"
            ) from fault
        low, high = self.window_ns or (start_ns, end_ns)
        return Log(self.path, self._source, (max(low, start_ns), min(high, end_ns)))

    def verify(self, progress: Callable[[float], None] | None = None) -> list[Missing]:
        """Read the whole file and check everything: chunks, message indexes, attachments, metadata, CRC of the data,
        counts.

        Args:
            progress: called with the completed share, 0 … 1.

        Returns:
            Everything that is missing or damaged in this file, followed by the parts for which another writer stored
            no CRC. What a recovered log lost before its recovery is only in `lost_before`.
        """
        self._source.walk(progress)
        self._samples.clear()
        return [*self._source.missing, *self._source.contents.unchecked]

    def __iter__(self) -> Iterator[str]:
        return (topic for topic in self.topics if self._is_samples(topic))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, topic: object) -> bool:
        return isinstance(topic, str) and self._is_samples(topic)

    def __getitem__(self, topic: str) -> Samples:
        """Return the samples of a topic; decoded at the first call and kept.

        Raises:
            ChannelMissing: the log does not have this sample channel; the text lists the existing ones.
            LogError: the messages do not match their schema, or the log was closed.
        """
        if not self._is_samples(topic):
            raise self._missing_channel(topic, list(self))
        if topic not in self._samples:
            self._samples[topic] = next(self.parts(topic))
        return self._samples[topic]

    def parts(self, topic: str, rows: int = 2**62) -> Iterator[Samples]:
        """Yield the samples of a topic in file order, at least one part; nothing is kept.

        Args:
            rows: approximate number of samples in a part.

        Raises:
            ChannelMissing, LogError: as for all samples at once.
        """
        layout = self.channel(topic)
        try:
            for part in self._window.columns(topic, layout, rows):
                yield Samples(topic, part.publish_ns, part.log_ns, part.sequence, part.fields)
        except ValueError as fault:
            raise LogError(f"{self.path}: {fault}; the file was not written by this package's schema") from fault

    def raw(self, device: str) -> list[RawChunk]:
        """Return the bytes from and to one device, in file order.

        Raises:
            ChannelMissing: the log has no raw bytes of that device.
        """
        if device not in self.devices:
            raise self._missing_channel(device, list(self.devices))
        return [chunk for _, chunk in self._raw([device])]

    def raw_in_order(self) -> Iterator[tuple[str, RawChunk]]:
        """Yield the bytes from and to all devices as (device, bytes), in the order in which they were written."""
        return self._raw(list(self.devices))

    @property
    def events(self) -> list[dict[str, Any]]:
        """Events in file order, each with its ``time_ns``."""
        return self._notes(EVENTS_TOPIC)

    @property
    def health(self) -> list[dict[str, Any]]:
        """Health reports in file order, each with its ``time_ns``."""
        return self._notes(HEALTH_TOPIC)

    def close(self) -> None:
        """Close the file. Samples already read stay valid. Closing a part made by `between` does not close the file."""
        if self.window_ns is None:
            self._source.close()

    def __bool__(self) -> bool:
        """Return True, also for a log without sample channels."""
        return True

    def __eq__(self, other: object) -> bool:
        """Return True for the same object only: comparing two logs as mappings would read both."""
        return self is other

    def __hash__(self) -> int:
        return object.__hash__(self)

    def __enter__(self) -> Log:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        state = "complete" if self.complete else f"incomplete: {'; '.join(map(str, self.missing))}"
        return f"<Log {self.path}: {', '.join(self.topics)}; {state}>"

    def _is_samples(self, topic: str) -> bool:
        channels = self._source.contents.definitions.channels
        return any(
            channel.message_encoding == "protobuf" and self._schema_name(channel) != RAW_SCHEMA_NAME
            for channel in (channels[channel_id] for channel_id in self._window.ids().get(topic, ()))
        )

    def _schema_name(self, channel: ChannelRecord) -> str:
        schema = self._source.contents.definitions.schemas.get(channel.schema_id)
        return schema.name if schema else ""

    def _missing_channel(self, wanted: str, present: list[str]) -> ChannelMissing:
        lacking = f" (the file is incomplete: {'; '.join(map(str, self.missing))})" if self.missing else ""
        return ChannelMissing(
            f"{self.path}: expected one of {present}, got {wanted!r}{did_you_mean(wanted, present)}{lacking}"
        )

    def _span(self) -> tuple[int, int]:
        if self.window_ns is None:
            return self._source.contents.span_ns
        times = [part.log_ns for part in self._window.messages(list(self.topics)) if len(part.log_ns)]
        return (min(int(t.min()) for t in times), max(int(t.max()) for t in times)) if times else (0, 0)

    def _raw(self, devices: list[str]) -> Iterator[tuple[str, RawChunk]]:
        topics = [RAW_PREFIX + device for device in devices]
        for messages in self._window.messages(topics):
            channels = self._source.contents.definitions.channels
            for row, host_ns in enumerate(messages.log_ns.tolist()):
                try:
                    direction, data = unpack_raw(messages.payload(row))
                except ValueError as fault:
                    raise LogError(f"{self.path}: raw bytes: {fault}") from fault
                topic = channels[int(messages.channel_ids[row])].topic
                yield topic.removeprefix(RAW_PREFIX), RawChunk(host_ns, direction, data)

    def _notes(self, topic: str) -> list[dict[str, Any]]:
        notes: list[dict[str, Any]] = []
        for messages in self._window.messages([topic]):
            for row, time_ns in enumerate(messages.publish_ns.tolist()):
                try:
                    note: Any = json.loads(messages.payload(row))
                except (ValueError, RecursionError) as fault:
                    raise LogError(f"{self.path}: {topic}: expected JSON, got something else ({fault})") from fault
                if not isinstance(note, dict):
                    raise LogError(f"{self.path}: {topic}: expected a JSON object, got {note!r:.80}")
                notes.append(cast("dict[str, Any]", note) | {"time_ns": time_ns})
        return notes


def _meaning(schema: Schema) -> tuple[str, bytes]:
    return schema.name, schema.data


def open_log(path: str | Path) -> Log:
    """Open a log for reading.

    Args:
        path: an MCAP file, finished or an unfinished ``.part``; it may be cut or damaged.

    Returns:
        The log; `Log.complete` and `Log.missing` state what is missing.

    Raises:
        LogError: the file does not exist or is not an MCAP file.
    """
    path = Path(path)
    try:
        return Log(path, LogSource(path))
    except OSError as fault:
        raise LogError(f"{path}: expected a log, cannot read it ({fault.strerror}): check the path") from fault
    except LogError as fault:
        raise LogError(f"{path}: {fault}; logs are made by 'rig record' and end in .mcap or .mcap.part") from fault

"""A log as arrays: `open_log(path)` reads finished, unfinished and cut files alike.

    with open_log("run.mcap") as log:
        x = log["laser/x"]
        x.time_s, x.displacement_m          # (n,) s since 1970, m

What could not be read is in `log.missing`; whatever is handed out was whole and had the right CRC.
Sample fields are what the schema in the file says, so logs of other versions read alike.
"""

import difflib
import json
import mmap
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from mcap.records import Channel as ChannelRecord
from numpy.typing import NDArray

from daq.channels import EVENTS_TOPIC, HEALTH_TOPIC, RAW_PREFIX, RAW_SCHEMA_NAME, Channel, unpack_raw
from daq.errors import ChannelMissing, LogError
from daq.mcap_chunks import HEAD, Scan, gather, payload, scan_records, unpack_chunk
from daq.mcap_reader import walk
from daq.samples import RawChunk, Samples

_CACHE_BYTES = 256 * 2**20


class Log(Mapping[str, Samples]):
    """An open log: a mapping from topic to `Samples`, and what else the file holds. Made by `open_log`.

    Attributes:
        path: the file.
        missing: what the file lacks or what is damaged, in words.
        metadata: named tables of texts.
        attachments: files by name.
    """

    def __init__(self, path: Path, file: Any, size: int) -> None:
        self.path = path
        self._file: Any = file
        contents = walk(file, size)
        self.missing, self.metadata, self.attachments = contents.missing, contents.metadata, contents.attachments
        self._chunks, self._schemas, self._counts = contents.chunks, contents.schemas, contents.counts
        self._channels = contents.channels
        self._ids: dict[str, list[int]] = {}
        for channel_id, channel in sorted(contents.channels.items()):
            self._ids.setdefault(channel.topic, []).append(channel_id)
        for channel_id in sorted(set(contents.counts) - set(contents.channels)):
            self.missing.append(f"the name of channel {channel_id}, so its {contents.counts[channel_id]} messages")
        self._cache: dict[int, Scan] = {}
        self._cached_bytes = 0
        self._samples: dict[str, Samples] = {}

    @property
    def complete(self) -> bool:
        """Nothing is missing: the file was finished and every CRC is right."""
        return not self.missing

    @property
    def topics(self) -> tuple[str, ...]:
        """Every topic of the file, sorted: samples, raw bytes, events, health."""
        return tuple(sorted(self._ids))

    @property
    def devices(self) -> tuple[str, ...]:
        """Devices whose raw bytes are in the file, sorted."""
        return tuple(topic.removeprefix(RAW_PREFIX) for topic in self.topics if topic.startswith(RAW_PREFIX))

    def count(self, topic: str) -> int:
        """Messages of a topic, 0 when there is no such topic."""
        return sum(self._counts.get(channel_id, 0) for channel_id in self._ids.get(topic, ()))

    def __iter__(self) -> Iterator[str]:
        return (topic for topic in self.topics if self._is_samples(topic))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, topic: object) -> bool:
        return isinstance(topic, str) and self._is_samples(topic)

    def __getitem__(self, topic: str) -> Samples:
        """Samples of a topic; decoded at the first call, kept for the next.

        Raises:
            ChannelMissing: no such sample channel; lists those there are and the nearest name.
            LogError: its messages are not what its schema says.
        """
        if not self._is_samples(topic):
            raise self._missing_channel(topic, list(self))
        if topic not in self._samples:
            self._samples[topic] = self._decode(topic)
        return self._samples[topic]

    def raw(self, device: str) -> list[RawChunk]:
        """Bytes from and to one device, in file order.

        Raises:
            ChannelMissing: no raw bytes of that device.
        """
        if device not in self.devices:
            raise self._missing_channel(device, list(self.devices))
        return [chunk for _, chunk in self._raw([device])]

    def raw_in_order(self) -> Iterator[tuple[str, RawChunk]]:
        """Bytes from and to all devices as (device, bytes), in the order they were written."""
        return self._raw(list(self.devices))

    @property
    def events(self) -> list[dict[str, Any]]:
        """Events in file order, each with its ``time_ns``; empty when there are none."""
        return self._notes(EVENTS_TOPIC)

    @property
    def health(self) -> list[dict[str, Any]]:
        """Health reports in file order, each with its ``time_ns``; empty when there are none."""
        return self._notes(HEALTH_TOPIC)

    def close(self) -> None:
        """Let go of the file; samples already read stay valid."""
        self._cache.clear()
        if isinstance(self._file, mmap.mmap):
            self._file.close()
        self._file = None

    def __enter__(self) -> "Log":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        state = "complete" if self.complete else f"incomplete: {'; '.join(self.missing)}"
        return f"<Log {self.path}: {', '.join(self.topics)}; {state}>"

    def _is_samples(self, topic: str) -> bool:
        return any(
            channel.message_encoding == "protobuf" and self._schema_name(channel) != RAW_SCHEMA_NAME
            for channel in (self._channels[channel_id] for channel_id in self._ids.get(topic, ()))
        )

    def _schema_name(self, channel: ChannelRecord) -> str:
        schema = self._schemas.get(channel.schema_id)
        return schema.name if schema else ""

    def _missing_channel(self, wanted: str, present: list[str]) -> ChannelMissing:
        near = difflib.get_close_matches(wanted, present, 1, 0.4)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        lacking = f" (the file is incomplete: {'; '.join(self.missing)})" if self.missing else ""
        return ChannelMissing(f"{self.path}: expected one of {present}, got {wanted!r}{hint}{lacking}")

    def _scan(self, number: int) -> Scan:
        """Records of a chunk; kept while there is room."""
        if number in self._cache:
            return self._cache[number]
        if self._file is None:
            raise LogError(f"{self.path}: expected an open log, it was closed: read what you need before close()")
        scan = scan_records(unpack_chunk(self._file, self._chunks[number]))
        if self._cached_bytes + len(scan.data) <= _CACHE_BYTES:
            self._cache[number] = scan
            self._cached_bytes += len(scan.data)
        return scan

    def _messages(self, topics: list[str]) -> Iterator[tuple[Scan, NDArray[np.intp], NDArray[np.int64]]]:
        """Per chunk: its records, the rows that are messages of the topics, and the channel id of every row."""
        wanted = np.array([channel_id for topic in topics for channel_id in self._ids.get(topic, ())])
        for number in range(len(self._chunks)):
            scan = self._scan(number)
            ids = scan.channel_ids()
            rows = np.flatnonzero(np.isin(ids, wanted))
            if len(rows):
                yield scan, rows, ids

    def _decode(self, topic: str) -> Samples:
        layout = self._layout(topic)
        heads: list[NDArray[Any]] = [np.empty(0, HEAD)]
        columns = [layout.unpack(np.empty(0, layout.dtype))]
        whole = np.dtype([("head", HEAD), ("message", layout.dtype)])
        try:
            for scan, rows, _ in self._messages([topic]):
                if (scan.lengths[rows] == whole.itemsize).all():
                    table = gather(scan, rows, whole.itemsize).view(whole)[:, 0]
                    heads.append(table["head"].copy())
                    columns.append(self._unpack(layout, table["message"]))
                else:
                    heads.append(scan.heads(rows))
                    columns.append(layout.unpack_any(payload(scan, row) for row in rows))
        except ValueError as fault:
            raise LogError(f"{self.path}: {fault}; the file was not written by this package's schema") from fault
        joined = {name: np.concatenate([part[name] for part in columns]) for name in layout.names}
        return Samples(topic, np.concatenate(heads), joined)

    def _unpack(self, layout: Channel, messages: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Columns of equally long messages: in our own layout, or else in whatever order their writer chose."""
        try:
            return layout.unpack(messages)
        except ValueError:
            return layout.unpack_any(message.tobytes() for message in messages)

    def _layout(self, topic: str) -> Channel:
        channel = self._channels[self._ids[topic][0]]
        schema = self._schemas.get(channel.schema_id)
        if schema is None:
            raise LogError(f"{self.path}: {topic}: expected schema {channel.schema_id} in the file, it is missing")
        try:
            return Channel.from_descriptor_set(topic, schema.name, schema.data)
        except ValueError as fault:
            raise LogError(f"{self.path}: {fault}") from fault

    def _raw(self, devices: list[str]) -> Iterator[tuple[str, RawChunk]]:
        device_of = {id_: device for device in devices for id_ in self._ids.get(RAW_PREFIX + device, ())}
        for scan, rows, ids in self._messages([RAW_PREFIX + device for device in devices]):
            heads = scan.heads(rows)
            for row, host_ns in zip(rows, heads["log_time"].tolist(), strict=True):
                try:
                    direction, data = unpack_raw(payload(scan, row))
                except ValueError as fault:
                    raise LogError(f"{self.path}: raw bytes: {fault}") from fault
                yield device_of[int(ids[row])], RawChunk(host_ns, direction, data)

    def _notes(self, topic: str) -> list[dict[str, Any]]:
        notes: list[dict[str, Any]] = []
        for scan, rows, _ in self._messages([topic]):
            heads = scan.heads(rows)
            for row, time_ns in zip(rows, heads["publish_time"].tolist(), strict=True):
                try:
                    note = json.loads(payload(scan, row))
                except ValueError as fault:
                    raise LogError(f"{self.path}: {topic}: expected JSON, got something else ({fault})") from fault
                if not isinstance(note, dict):
                    raise LogError(f"{self.path}: {topic}: expected a JSON object, got {note!r}")
                notes.append(note | {"time_ns": time_ns})
        return notes


def open_log(path: str | Path) -> Log:
    """Open a log for reading.

    Args:
        path: an MCAP file, finished or a ``.part`` that was never finished; it may be cut or damaged.

    Returns:
        The log; `Log.complete` and `Log.missing` say what is not there.

    Raises:
        LogError: no such file, or it is no MCAP file.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream:
            size = stream.seek(0, 2)
            file = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) if size else b""
    except OSError as fault:
        raise LogError(f"{path}: expected a log, cannot read it ({fault.strerror}): check the path") from fault
    try:
        return Log(path, file, size)
    except LogError as fault:
        if isinstance(file, mmap.mmap):
            file.close()
        raise LogError(f"{path}: {fault}; logs are made by 'rig record' and end in .mcap or .mcap.part") from fault

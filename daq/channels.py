"""The log's channels: protobuf messages of only fixed-width fields, so that numpy can write and read them.

A protobuf field is a tag byte and its value. When every field has a fixed width and all are written in field order,
each message of a channel has the same layout, which is a packed numpy dtype; a block of samples then becomes messages
by assigning columns, and any protobuf reader still reads them. Fields carry their unit in their name.

Raw bytes of devices (`raw/<device>`) are protobuf too, with a variable length; events and health are JSON.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2
from google.protobuf.message import DecodeError
from numpy.typing import ArrayLike, NDArray

RX, TX = 0, 1
"""Direction of raw bytes: from the device, to the device."""

_FieldProto = descriptor_pb2.FieldDescriptorProto
_KINDS: dict[str, tuple[str, int, Any]] = {  # numpy type, wire type, descriptor type
    "double": ("<f8", 1, _FieldProto.TYPE_DOUBLE),
    "fixed32": ("<u4", 5, _FieldProto.TYPE_FIXED32),
    "fixed64": ("<u8", 1, _FieldProto.TYPE_FIXED64),
    "sfixed32": ("<i4", 5, _FieldProto.TYPE_SFIXED32),
    "sfixed64": ("<i8", 1, _FieldProto.TYPE_SFIXED64),
}
_KIND_OF_TYPE = {descriptor_type: kind for kind, (_, _, descriptor_type) in _KINDS.items()}
_TAG = "tag_"


@dataclass(frozen=True)
class Channel:
    """One sample channel.

    Attributes:
        topic: name in the log.
        schema_name: protobuf message, like ``rig.LaserSample``.
        fields: (name with unit, kind) in field order; numbers count from 1, at most 15 so that a tag is one byte.
        later: names of those fields that logs of earlier versions do not have; 0 where nobody gives them.
    """

    topic: str
    schema_name: str
    fields: tuple[tuple[str, str], ...]
    later: tuple[str, ...] = field(default=(), compare=False)

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """Layout of one whole message: per field ``tag_<name>`` u1 and ``<name>``."""
        parts: list[tuple[str, str]] = []
        for name, kind in self.fields:
            parts += [(_TAG + name, "u1"), (name, _KINDS[kind][0])]
        return np.dtype(parts)

    @property
    def names(self) -> tuple[str, ...]:
        """Field names in field order."""
        return tuple(name for name, _ in self.fields)

    @cached_property
    def _tags(self) -> dict[str, int]:
        return {name: number << 3 | _KINDS[kind][1] for number, (name, kind) in enumerate(self.fields, 1)}

    @cached_property
    def _only_tags(self) -> NDArray[Any]:
        """One message of zeros as opaque bytes: repeating it fills the tags of a block in one pass."""
        row = np.zeros(1, self.dtype)
        for name, tag in self._tags.items():
            row[_TAG + name] = tag
        return row.view(f"V{self.dtype.itemsize}")

    def pack(self, columns: Mapping[str, ArrayLike]) -> NDArray[Any]:
        """Messages of a block of samples.

        Args:
            columns: every field by name (those of `later` may be left out); arrays of shape (n,), or scalars that
                stand for n equal values.

        Returns:
            Structured array (n,) of `dtype`, tags filled.

        Raises:
            ValueError: a field is missing or unknown, or lengths differ.
        """
        if columns.keys() != self._tags.keys():
            columns = dict.fromkeys(self.later, 0) | dict(columns)
        if columns.keys() != self._tags.keys():
            raise ValueError(f"{self.topic}: expected the fields {self.names}, got {tuple(columns)}")
        arrays = [np.asarray(columns[name]) for name in self.names]
        if arrays[0].ndim != 1 or any(array.shape != arrays[0].shape for array in arrays):
            arrays = [array.reshape(-1) for array in np.broadcast_arrays(*arrays)]
        out = self._only_tags.repeat(len(arrays[0])).view(self.dtype)
        for name, array in zip(self.names, arrays, strict=True):
            out[name] = array
        return out

    def unpack(self, messages: bytes | NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Columns of messages in the constant layout.

        Args:
            messages: whole messages back to back as bytes, or a structured array of `dtype`.

        Returns:
            Field name to contiguous array (n,).

        Raises:
            ValueError: the length is no multiple of the message's, or a tag is not where it must be.
        """
        data = np.frombuffer(messages, self.dtype) if isinstance(messages, bytes) else messages
        for name, tag in self._tags.items():
            if (data[_TAG + name] != tag).any():
                raise ValueError(f"{self.topic}: expected tag {tag:#04x} before {name} in every message")
        return {name: np.ascontiguousarray(data[name]) for name in self.names}

    def unpack_any(self, messages: Iterable[bytes]) -> dict[str, NDArray[Any]]:
        """Columns of messages any protobuf writer may have made: fields omitted when 0, in any order, unknown ones.

        Raises:
            ValueError: a message is no protobuf of this schema.
        """
        by_tag = {
            tag: (name, np.dtype(_KINDS[kind][0]))
            for (name, kind), tag in zip(self.fields, self._tags.values(), strict=True)
        }
        rows: dict[str, list[Any]] = {name: [] for name in self.names}
        for message in messages:
            found = {
                by_tag[tag][0]: np.frombuffer(value, by_tag[tag][1])[0]
                for tag, value in _fields(message)
                if tag in by_tag
            }
            for name, column in rows.items():
                column.append(found.get(name, 0))
        return {name: np.array(rows[name], _KINDS[kind][0]) for name, kind in self.fields}

    def file_descriptor_set(self) -> bytes:
        """The schema as MCAP wants it: a serialized FileDescriptorSet."""
        return _descriptor_set(self.schema_name, [(name, _KINDS[kind][2]) for name, kind in self.fields])

    @classmethod
    def from_descriptor_set(cls, topic: str, schema_name: str, data: bytes) -> "Channel":
        """The channel a schema in a log describes.

        Raises:
            ValueError: not a FileDescriptorSet, without that message, or with fields that are not fixed-width.
        """
        files = descriptor_pb2.FileDescriptorSet()
        try:
            files.ParseFromString(data)
        except DecodeError as fault:
            raise ValueError(f"{topic}: expected a FileDescriptorSet as schema, got {len(data)} other bytes") from fault
        for file in files.file:
            for message in file.message_type:
                if f"{file.package}.{message.name}".lstrip(".") == schema_name:
                    return cls(topic, schema_name, _fixed_width_fields(schema_name, message))
        raise ValueError(f"{topic}: expected a message {schema_name!r} in the schema, found none")


def _fixed_width_fields(schema_name: str, message: Any) -> tuple[tuple[str, str], ...]:
    fields = sorted(message.field, key=lambda field: field.number)
    numbers = [field.number for field in fields]
    plain = all(field.type in _KIND_OF_TYPE and field.label != _FieldProto.LABEL_REPEATED for field in fields)
    # names that are no UTF-8 come as bytes; two equal ones are no columns
    plain &= len({field.name for field in fields if isinstance(field.name, str) and field.name}) == len(fields)
    if not plain or not fields or numbers != list(range(1, len(fields) + 1)) or len(fields) > 15:
        came = [(field.name, field.number) for field in fields]
        raise ValueError(f"{schema_name}: expected 1 … 15 fixed-width fields numbered from 1, got {came}")
    return tuple((field.name, _KIND_OF_TYPE[field.type]) for field in fields)


def _descriptor_set(schema_name: str, fields: Sequence[tuple[str, Any]]) -> bytes:
    package, _, message_name = schema_name.rpartition(".")
    message = descriptor_pb2.DescriptorProto(name=message_name)
    for number, (name, descriptor_type) in enumerate(fields, 1):
        message.field.add(name=name, number=number, type=descriptor_type, label=_FieldProto.LABEL_OPTIONAL)
    file = descriptor_pb2.FileDescriptorProto(
        name=f"{package}/{message_name}.proto", package=package, syntax="proto3", message_type=[message]
    )
    return descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString(deterministic=True)


def _varint(message: bytes, position: int) -> tuple[int, int]:
    value = shift = 0
    while position < len(message) and shift < 64:
        byte = message[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
        shift += 7
    raise ValueError(f"expected a protobuf number at byte {position} of {len(message)}")


def _fields(message: bytes) -> Iterable[tuple[int, bytes]]:
    """Tag and value bytes of each field of a protobuf message; of a varint, the tag only."""
    position = 0
    while position < len(message):
        tag, position = _varint(message, position)
        wire_type = tag & 7
        if wire_type == 0:
            _, position = _varint(message, position)
            size = 0
        elif wire_type == 2:
            size, position = _varint(message, position)
        elif wire_type in (1, 5):
            size = 8 if wire_type == 1 else 4
        else:
            raise ValueError(f"expected a protobuf field, got wire type {wire_type}")
        if position + size > len(message):
            raise ValueError(
                f"expected {size} more bytes in a protobuf field, the message has {len(message) - position}"
            )
        yield tag, message[position : position + size]
        position += size


DEVICE_TICK_S = 1e-5
"""Unit of `device_ticks` of displacement samples: their device's own clock."""
SUSPECT_BEFORE, SUSPECT_PLACES = 0x1, 10
"""Bit of a displacement sample's flags: the sample so many places before it in the channel is suspect."""
ENCODER_FAULT_A, ENCODER_FAULT_B, BATTERY_LOW, LOCK_A_CLOSED, LOCK_B_CLOSED = 0x1, 0x2, 0x8, 0x20, 0x40
"""Bits of a pendulum sample's flags."""
LOCKS_CLOSED = LOCK_A_CLOSED | LOCK_B_CLOSED


def suspects(flags: NDArray[Any]) -> NDArray[np.bool_]:
    """Which displacement samples are suspect, from their channel's flags; both of shape (n,)."""
    found = np.zeros(len(flags), bool)
    found[:-SUSPECT_PLACES] = (flags[SUSPECT_PLACES:] & SUSPECT_BEFORE) != 0
    return found


_LASER = (
    ("displacement_m", "double"),
    ("code", "fixed32"),
    ("counter", "fixed32"),
    ("device_ticks", "fixed64"),
    ("flags", "fixed32"),
)


def displacement_channel(topic: str) -> Channel:
    """The channel of a displacement sensor: "laser/x", "laser/y", or that of a witness."""
    return Channel(topic, "rig.LaserSample", _LASER, ("flags",))


LASER_X = displacement_channel("laser/x")
LASER_Y = displacement_channel("laser/y")
PENDULUMS = Channel(
    "pendulums",
    "rig.PendulumSample",
    (
        ("theta3_rad", "double"),
        ("theta4_rad", "double"),
        ("count_a", "sfixed32"),
        ("count_b", "sfixed32"),
        ("index", "fixed32"),
        ("node_time_us", "fixed64"),
        ("flags", "fixed32"),
    ),
)
TACHO = Channel("tacho", "rig.IndexMark", (("revolutions", "fixed32"), ("node_time_us", "fixed64")))
MOTOR = Channel(
    "motor", "rig.MotorSample", (("speed_rpm", "double"), ("target_rpm", "double"), ("statusword", "fixed32"))
)

CHANNELS = {channel.topic: channel for channel in (LASER_X, LASER_Y, PENDULUMS, TACHO, MOTOR)}
"""Every sample channel by topic."""

RAW_PREFIX = "raw/"
RAW_SCHEMA_NAME = "rig.RawBytes"
EVENTS_TOPIC, HEALTH_TOPIC = "events", "health"
NOTE_SCHEMA_NAME = "rig.Note"


def raw_topic(device: str) -> str:
    """Topic of a device's raw bytes."""
    return RAW_PREFIX + device


def raw_descriptor_set() -> bytes:
    """Schema of raw bytes: ``fixed32 direction = 1; bytes data = 2``."""
    return _descriptor_set(RAW_SCHEMA_NAME, [("direction", _FieldProto.TYPE_FIXED32), ("data", _FieldProto.TYPE_BYTES)])


def pack_raw(direction: int, data: bytes) -> bytes:
    """One stretch of raw bytes as a message; direction `RX` or `TX`."""
    size, length = bytearray(), len(data)
    while length >= 0x80:
        size.append(length & 0x7F | 0x80)
        length >>= 7
    size.append(length)
    return b"\x0d" + direction.to_bytes(4, "little") + b"\x12" + size + data


def unpack_raw(message: bytes) -> tuple[int, bytes]:
    """Direction and bytes of a raw message.

    Raises:
        ValueError: not a protobuf message.
    """
    direction, data = RX, b""
    for tag, value in _fields(message):
        if tag == 0x0D:
            direction = int.from_bytes(value, "little")
        elif tag == 0x12:
            data = value
    return direction, data


def note_schema() -> bytes:
    """JSON schema of events and health: kind, device and text, beside them any numbers; the time is the message's."""
    words = {name: {"type": "string"} for name in ("kind", "device", "text")}
    return json.dumps({"title": NOTE_SCHEMA_NAME, "type": "object", "properties": words, "required": ["kind"]}).encode()


def pack_note(note: Mapping[str, Any]) -> bytes:
    """An event or a health report as JSON; numbers that are no JSON (NaN, infinite) become null.

    Raises:
        ValueError: it has no kind.
    """
    if not isinstance(note.get("kind"), str):
        raise ValueError(f"expected a text under 'kind', got {note!r}")
    plain = {key: None if isinstance(value, float) and not np.isfinite(value) else value for key, value in note.items()}
    return json.dumps(plain, ensure_ascii=False, allow_nan=False, default=_plain_number).encode()


def _plain_number(value: Any) -> Any:
    """Numpy numbers and arrays as JSON's own."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"expected a JSON value, got {type(value).__name__}")

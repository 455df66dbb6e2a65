"""Channels of a log: protobuf messages with fixed-width fields only, written and read with numpy.

A protobuf field is a tag byte and its value. If every field has a fixed width and all fields are written in field
order, every message of a channel has the same layout, which is a packed numpy dtype. A block of samples is converted to
messages by assigning columns. Every protobuf reader can read them. Field names contain the unit.

Raw bytes of devices (`raw/<device>`) are protobuf messages of variable length. Events and health reports are JSON.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np
from google.protobuf import descriptor_pb2
from google.protobuf.message import DecodeError
from numpy.typing import ArrayLike, NDArray

from rig_basics.texts import number_of, storable

RX, TX = 0, 1
"""Direction of raw bytes: received from the device, transmitted to the device."""

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
        topic: name of the channel in the log.
        schema_name: name of the protobuf message, for example ``rig.LaserSample``.
        fields: (name with unit, kind) in field order. Field numbers are 1 … 15, so that a tag is one byte.
    """

    topic: str
    schema_name: str
    fields: tuple[tuple[str, str], ...]

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """Layout of one message: for each field ``tag_<name>`` (u1) and ``<name>``."""
        parts: list[tuple[str, str]] = []
        for name, kind in self.fields:
            parts += [(_TAG + name, "u1"), (name, _KINDS[kind][0])]
        return np.dtype(parts)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Field names in field order."""
        return tuple(name for name, _ in self.fields)

    @cached_property
    def _tags(self) -> dict[str, int]:
        return {name: number << 3 | _KINDS[kind][1] for number, (name, kind) in enumerate(self.fields, 1)}

    @cached_property
    def item(self) -> NDArray[Any]:
        """One message of zeros: structured array (1,) of `dtype` with all tags set."""
        row = np.zeros(1, self.dtype)
        for name, tag in self._tags.items():
            row[_TAG + name] = tag
        row.flags.writeable = False
        return row

    def check_names(self, columns: Mapping[str, ArrayLike]) -> None:
        """Check that there are values for all fields and no others.

        Raises:
            ValueError: a field is missing or unknown.
        """
        if columns.keys() != self._tags.keys():
            raise ValueError(f"{self.topic}: expected the fields {self.names}, got {tuple(columns)}")

    def pack(self, columns: Mapping[str, ArrayLike]) -> NDArray[Any]:
        """Convert a block of samples to messages.

        Args:
            columns: values by field name: arrays of shape (n,), or scalars that are repeated n times.

        Returns:
            Structured array (n,) of `dtype` with all tags set.

        Raises:
            ValueError: a field is missing or unknown, or the lengths differ.
        """
        self.check_names(columns)
        arrays = [np.asarray(columns[name]) for name in self.names]
        if arrays[0].ndim != 1 or len({array.shape for array in arrays}) > 1:
            arrays = [array.reshape(-1) for array in np.broadcast_arrays(*arrays)]
        out = np.frombuffer(bytearray(self.item.tobytes() * len(arrays[0])), self.dtype)
        for name, array in zip(self.names, arrays, strict=True):
            out[name] = array
        return out

    def unpack(self, messages: bytes | NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Convert messages of the constant layout to columns.

        Args:
            messages: complete, consecutive messages as bytes, or a structured array of `dtype`.

        Returns:
            Contiguous array (n,) of each field, by field name.

        Raises:
            ValueError: the length is not a multiple of the message size, or a tag is wrong.
        """
        data = np.frombuffer(messages, self.dtype) if isinstance(messages, bytes) else messages
        self.check(data)
        return {name: np.ascontiguousarray(data[name]) for name in self.names}

    def check(self, messages: NDArray[Any]) -> None:
        """Check that messages, (n,) of `dtype`, have the constant layout.

        Raises:
            ValueError: a tag is wrong.
        """
        for name, tag in self._tags.items():
            if (messages[_TAG + name] != tag).any():
                raise ValueError(f"{self.topic}: expected tag {tag:#04x} before {name} in every message")

    def unpack_any(self, messages: Iterable[bytes]) -> dict[str, NDArray[Any]]:
        """Convert messages of any protobuf writer to columns.

        Such messages may omit fields that are 0, order fields differently and contain unknown fields.

        Raises:
            ValueError: a message is not a protobuf message of this schema.
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
        """Return the schema as MCAP requires it: a serialized FileDescriptorSet."""
        return _descriptor_set(self.schema_name, [(name, _KINDS[kind][2]) for name, kind in self.fields])

    @classmethod
    def from_descriptor_set(cls, topic: str, schema_name: str, data: bytes) -> "Channel":
        """Return the channel that a schema of a log describes.

        Raises:
            ValueError: `data` is not a FileDescriptorSet, lacks the message, or has fields of variable width.
        """
        files = descriptor_pb2.FileDescriptorSet()
        try:
            files.ParseFromString(data)
        except DecodeError as fault:
            raise ValueError(
                f"{topic}: expected a FileDescriptorSet as schema, got {number_of(len(data), 'other byte')}"
            ) from fault
        for file in files.file:
            for message in file.message_type:
                if f"{file.package}.{message.name}".lstrip(".") == schema_name:
                    return cls(topic, schema_name, _fixed_width_fields(schema_name, message))
        raise ValueError(f"{topic}: expected a message {schema_name!r} in the schema, found none")


def _fixed_width_fields(schema_name: str, message: Any) -> tuple[tuple[str, str], ...]:
    fields = sorted(message.field, key=lambda field: field.number)
    numbers = [field.number for field in fields]
    plain = all(field.type in _KIND_OF_TYPE and field.label != _FieldProto.LABEL_REPEATED for field in fields)
    # protobuf returns names that are not valid UTF-8 as bytes; duplicate names cannot be columns
    plain &= len({field.name for field in fields if isinstance(field.name, str) and field.name}) == len(fields)
    if not plain or not fields or numbers != list(range(1, len(fields) + 1)) or len(fields) > 15:
        found = [(field.name, field.number) for field in fields]
        raise ValueError(f"{schema_name}: expected 1 … 15 fixed-width fields numbered from 1, got {found}")
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
    """Yield tag and value bytes of each field of a protobuf message. The value of a varint is empty."""
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
                f"expected {number_of(size, 'more byte')} in a protobuf field, the message has "
                f"{len(message) - position}"
            )
        yield tag, message[position : position + size]
        position += size


DEVICE_TICK_S = 1e-5
"""Period of the device clock that `device_ticks` of displacement samples counts, s."""
SUSPECT_BEFORE, SUSPECT_PLACES = 0x1, 10
"""Bit of a displacement sample's flags, and the number of samples between the flag and the suspect sample before it."""
ENCODER_FAULT_A, ENCODER_FAULT_B, BATTERY_LOW, LOCK_A_CLOSED, LOCK_B_CLOSED = 0x1, 0x2, 0x8, 0x20, 0x40
"""Bits of a pendulum sample's flags."""
LOCKS_CLOSED = LOCK_A_CLOSED | LOCK_B_CLOSED


def suspects(flags: NDArray[Any]) -> NDArray[np.bool_]:
    """Return a mask (n,) of the suspect displacement samples, from the channel's flags (n,)."""
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
    """Return the channel of a displacement sensor: "laser/x", "laser/y", or the channel of a witness."""
    return Channel(topic, "rig.LaserSample", _LASER)


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
    """Return the topic of a device's raw bytes."""
    return RAW_PREFIX + device


def raw_descriptor_set() -> bytes:
    """Return the schema of raw bytes: ``fixed32 direction = 1; bytes data = 2``."""
    return _descriptor_set(RAW_SCHEMA_NAME, [("direction", _FieldProto.TYPE_FIXED32), ("data", _FieldProto.TYPE_BYTES)])


def pack_raw(direction: int, data: bytes) -> bytes:
    """Convert one block of raw bytes to a message; `direction` is `RX` or `TX`."""
    size, length = bytearray(), len(data)
    while length >= 0x80:
        size.append(length & 0x7F | 0x80)
        length >>= 7
    size.append(length)
    return b"\x0d" + direction.to_bytes(4, "little") + b"\x12" + size + data


def unpack_raw(message: bytes) -> tuple[int, bytes]:
    """Return direction and bytes of a raw message.

    Raises:
        ValueError: the message is not a protobuf message.
    """
    direction, data = RX, b""
    for tag, value in _fields(message):
        if tag == 0x0D:
            direction = int.from_bytes(value, "little")
        elif tag == 0x12:
            data = value
    return direction, data


def note_schema() -> bytes:
    """Return the JSON schema of events and health reports.

    The properties are kind, device and text, and any further numbers. The time is the time of the message.
    """
    texts = {name: {"type": "string"} for name in ("kind", "device", "text")}
    return json.dumps({"title": NOTE_SCHEMA_NAME, "type": "object", "properties": texts, "required": ["kind"]}).encode()


def pack_note(note: Mapping[str, Any]) -> bytes:
    """Convert an event or a health report to JSON. NaN and infinite numbers become null.

    Raises:
        ValueError: the note has no text under "kind".
    """
    if not isinstance(note.get("kind"), str):
        raise ValueError(f"expected a text under 'kind', got {note!r}")
    plain = {key: None if isinstance(value, float) and not np.isfinite(value) else value for key, value in note.items()}
    return storable(json.dumps(plain, ensure_ascii=False, allow_nan=False, default=_plain_number)).encode()


def _plain_number(value: Any) -> Any:
    """Convert numpy numbers and arrays to the types that JSON supports."""
    if isinstance(value, np.generic | np.ndarray):
        return cast("NDArray[Any] | np.generic", value).tolist()
    raise TypeError(f"expected a JSON value, got {type(value).__name__}")

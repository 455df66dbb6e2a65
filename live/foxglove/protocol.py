# pyright: strict
"""The Foxglove WebSocket protocol, version 1: what a server that only gives says, and what it understands.

Text is JSON with a field `op`, bytes begin with an opcode; numbers are little-endian. No I/O here.
Source: https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md.
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from daq import channels

SUBPROTOCOLS = ("foxglove.websocket.v1", "foxglove.sdk.v1")
"""Names of the protocol, the preferred first: programs that offer both may accept the first only. What is said here is
the same under both."""
INFO, WARNING, ERROR = 0, 1, 2
"""Levels of a status."""
_MESSAGE, _TIME = struct.Struct("<BIQ"), struct.Struct("<BQ")
_MESSAGE_OPCODE, _TIME_OPCODE = 1, 2
_LARGEST_ID = 2**32 - 1
_QUOTED = 60  # characters of what a client sent, in an answer
_READ_ONLY = {
    "advertise": "publishing",
    "unadvertise": "publishing",
    "getParameters": "parameters",
    "setParameters": "parameters",
    "subscribeParameterUpdates": "parameters",
    "unsubscribeParameterUpdates": "parameters",
    "fetchAsset": "assets",
    "subscribeConnectionGraph": "the connection graph",
    "unsubscribeConnectionGraph": "the connection graph",
}
_READ_ONLY_BYTES = {1: "publishing", 2: "services"}


class NotUnderstood(Exception):
    """A client's message is none of the protocol, or asks for more than reading; the text says what was expected."""


@dataclass(frozen=True)
class Offered:
    """One channel as it is advertised.

    Attributes:
        number: its id in the protocol.
        topic: as in a log.
        encoding: of messages: "protobuf" or "json".
        schema_name: as in a log.
        schema: as in a log: a FileDescriptorSet, or a JSON schema.
    """

    number: int
    topic: str
    encoding: str
    schema_name: str
    schema: bytes

    def facts(self) -> dict[str, Any]:
        """For an advertisement."""
        binary = self.encoding == "protobuf"
        return {
            "id": self.number,
            "topic": self.topic,
            "encoding": self.encoding,
            "schemaName": self.schema_name,
            "schema": base64.b64encode(self.schema).decode() if binary else self.schema.decode(),
            "schemaEncoding": "protobuf" if binary else "jsonschema",
        }


@dataclass(frozen=True)
class Block:
    """Messages of one channel, equally long.

    Attributes:
        number: the channel's.
        time_ns: of each, ns since 1970, ascending, shape (n,).
        data: all of them, back to back.
    """

    number: int
    time_ns: NDArray[np.int64]
    data: bytes

    @property
    def size(self) -> int:
        """Bytes of one message."""
        return len(self.data) // len(self.time_ns) if len(self.time_ns) else 0


@dataclass(frozen=True)
class Subscribe:
    """A client wants channels: (its own id, the channel's number) of each."""

    wanted: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Unsubscribe:
    """A client wants no more of these; its own ids."""

    ids: tuple[int, ...]


def offered(sample_channels: Iterable[channels.Channel]) -> list[Offered]:
    """What a log with these sample channels has, as a log has it: samples, events, health."""
    given = [(c.topic, "protobuf", c.schema_name, c.file_descriptor_set()) for c in sample_channels]
    notes = [
        (topic, "json", channels.NOTE_SCHEMA_NAME, channels.note_schema())
        for topic in (channels.EVENTS_TOPIC, channels.HEALTH_TOPIC)
    ]
    return [Offered(number, *each) for number, each in enumerate([*given, *notes], 1)]


def server_info(name: str, session: str, metadata: Mapping[str, str]) -> str:
    """The first message. Of the protocol's capabilities `time` alone: whoever plots by time of arrival gets the time of
    the samples, and everything else would let clients act.
    """
    told = {"op": "serverInfo", "name": name, "capabilities": ["time"], "metadata": dict(metadata)}
    return json.dumps(told | {"sessionId": session}, ensure_ascii=False)


def advertise(given: Sequence[Offered]) -> str:
    """The second message: all channels."""
    return json.dumps({"op": "advertise", "channels": [each.facts() for each in given]}, ensure_ascii=False)


def status(level: int, text: str, about: str = "") -> str:
    """A sentence for the person at the client.

    Args:
        about: a later status about the same takes its place.
    """
    return json.dumps({"op": "status", "level": level, "message": text} | ({"id": about} if about else {}))


def message_data(subscription: int, time_ns: int, payload: bytes) -> bytes:
    """One message of a channel."""
    return _MESSAGE.pack(_MESSAGE_OPCODE, subscription, time_ns) + payload


def time_data(time_ns: int) -> bytes:
    """The clock of what is shown."""
    return _TIME.pack(_TIME_OPCODE, time_ns)


def in_order(blocks: Sequence[Block], wanted: Mapping[int, int]) -> Iterator[tuple[int, int, int, bytes]]:
    """Messages of several channels by their times; equal times in the order of the blocks.

    Args:
        wanted: a client's id by channel number; other channels are passed over.

    Yields:
        Channel number, the client's id, time (ns), message.
    """
    taken = [block for block in blocks if block.number in wanted and len(block.time_ns)]
    if not taken:
        return
    times = np.concatenate([block.time_ns for block in taken])
    which = np.repeat(np.arange(len(taken)), [len(block.time_ns) for block in taken])
    row = np.concatenate([np.arange(len(block.time_ns)) for block in taken])
    order = np.argsort(times, kind="stable")
    sorted_ns, sources, places = (cast("list[int]", each[order].tolist()) for each in (times, which, row))
    for time_ns, index, place in zip(sorted_ns, sources, places, strict=True):
        block = taken[index]
        at = place * block.size
        yield block.number, wanted[block.number], time_ns, block.data[at : at + block.size]


def understood(said: str | bytes) -> Subscribe | Unsubscribe:
    """What a client's message asks for.

    Raises:
        NotUnderstood: nothing that is done here.
    """
    if isinstance(said, bytes):
        what = _READ_ONLY_BYTES.get(said[0]) if said else None
        raise NotUnderstood(_refusal(what) if what else f"expected text, got {len(said)} bytes of no known opcode")
    try:
        parsed: Any = json.loads(said)
    except (ValueError, RecursionError) as fault:
        raise NotUnderstood(f"expected JSON, got {_quoted(said)}") from fault
    asked = cast("dict[str, Any]", parsed) if isinstance(parsed, dict) else {}
    match asked.get("op"):
        case "subscribe":
            return Subscribe(tuple(_pair(each) for each in _items(asked, "subscriptions")))
        case "unsubscribe":
            return Unsubscribe(tuple(_number(each, "subscriptionIds") for each in _items(asked, "subscriptionIds")))
        case str(op) if op in _READ_ONLY:
            raise NotUnderstood(_refusal(_READ_ONLY[op]))
        case _:
            raise NotUnderstood(f'expected {{"op": "subscribe" or "unsubscribe", …}}, got {_quoted(said)}')


def _refusal(what: str) -> str:
    return f"{what}: refused, this connection is read-only"


def _quoted(said: str) -> str:
    return ascii(said[:_QUOTED]) + ("…" if len(said) > _QUOTED else "")


def _items(asked: Mapping[str, Any], name: str) -> list[Any]:
    found = asked.get(name)
    if not isinstance(found, list):
        raise NotUnderstood(f"expected a list under {name}, got {_quoted(str(found))}")
    return cast("list[Any]", found)


def _pair(each: Any) -> tuple[int, int]:
    if not isinstance(each, dict):
        raise NotUnderstood(f'expected {{"id", "channelId"}} in subscriptions, got {_quoted(str(each))}')
    found = cast("dict[str, Any]", each)
    return _number(found.get("id"), "id"), _number(found.get("channelId"), "channelId")


def _number(value: Any, name: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= _LARGEST_ID:
        raise NotUnderstood(f"expected a whole number of 0 … {_LARGEST_ID} as {name}, got {_quoted(str(value))}")
    return value

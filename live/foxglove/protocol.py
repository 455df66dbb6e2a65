"""The Foxglove WebSocket protocol, version 1: messages of a read-only server, and parsing of its clients' requests.

Text messages are JSON with a field `op`. Binary messages begin with an opcode; numbers are little-endian. No I/O here.
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
from live.errors import InvalidRequest
from rig_basics.texts import number_of, storable

SUBPROTOCOLS = ("foxglove.websocket.v1", "foxglove.sdk.v1")
"""Names of the protocol, the preferred one first; programs that offer both may accept the first only. The messages are
the same under both."""
INFO, WARNING, ERROR = 0, 1, 2
"""Levels of a status message."""
_MESSAGE, _TIME = struct.Struct("<BIQ"), struct.Struct("<BQ")
_MESSAGE_OPCODE, _TIME_OPCODE = 1, 2
_MAX_ID = 2**32 - 1
_MAX_QUOTED = 60  # letters of a client's message in an answer
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


@dataclass(frozen=True)
class Offered:
    """One advertised channel.

    Attributes:
        number: id of the channel in the protocol.
        topic: topic, as in a log.
        encoding: encoding of its messages: "protobuf" or "json".
        schema_name: name of the schema, as in a log.
        schema: schema, as in a log: a FileDescriptorSet, or a JSON schema.
    """

    number: int
    topic: str
    encoding: str
    schema_name: str
    schema: bytes

    def facts(self) -> dict[str, Any]:
        """Return the fields of an advertisement."""
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
class ChannelMessages:
    """Messages of one channel, of equal size.

    Attributes:
        number: number of the channel.
        time_ns: time of each message, ns since 1970, ascending, shape (n,).
        data: all messages, concatenated.
    """

    number: int
    time_ns: NDArray[np.int64]
    data: bytes

    @property
    def size(self) -> int:
        """Size of one message in bytes."""
        return len(self.data) // len(self.time_ns) if len(self.time_ns) else 0


@dataclass(frozen=True)
class Subscribe:
    """Request for channels: (subscription id of the client, channel number) of each."""

    wanted: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Unsubscribe:
    """Request to end subscriptions, by their ids."""

    ids: tuple[int, ...]


def offered(sample_channels: Iterable[channels.Channel]) -> list[Offered]:
    """Return the channels of a log with these sample channels: samples, events, health."""
    given = [(c.topic, "protobuf", c.schema_name, c.file_descriptor_set()) for c in sample_channels]
    notes = [
        (topic, "json", channels.NOTE_SCHEMA_NAME, channels.note_schema())
        for topic in (channels.EVENTS_TOPIC, channels.HEALTH_TOPIC)
    ]
    return [Offered(number, *each) for number, each in enumerate([*given, *notes], 1)]


def server_info(name: str, session: str, metadata: Mapping[str, str]) -> str:
    """Return the first message.

    Its only capability is `time`, so that programs that plot by time of arrival receive the time of the samples. All
    other capabilities would allow clients to write.
    """
    info = {"op": "serverInfo", "name": name, "capabilities": ["time"], "metadata": dict(metadata)}
    return storable(json.dumps(info | {"sessionId": session}, ensure_ascii=False))


def advertise(given: Sequence[Offered]) -> str:
    """Return the second message: all channels."""
    return storable(json.dumps({"op": "advertise", "channels": [each.facts() for each in given]}, ensure_ascii=False))


def status(level: int, text: str, about: str = "") -> str:
    """Return a status message for the user of the client.

    Args:
        level: INFO, WARNING or ERROR.
        text: text of the message.
        about: id; a later status with the same id replaces this one.
    """
    return json.dumps({"op": "status", "level": level, "message": text} | ({"id": about} if about else {}))


def message_data(subscription: int, time_ns: int, payload: bytes) -> bytes:
    """Return one message of a channel."""
    return _MESSAGE.pack(_MESSAGE_OPCODE, subscription, time_ns) + payload


def time_data(time_ns: int) -> bytes:
    """Return the clock of the display."""
    return _TIME.pack(_TIME_OPCODE, time_ns)


def in_order(blocks: Sequence[ChannelMessages], wanted: Mapping[int, int]) -> Iterator[tuple[int, int, int, bytes]]:
    """Merge the messages of several channels by time; equal times keep the order of the blocks.

    Args:
        blocks: messages by channel.
        wanted: subscription id by channel number; other channels are left out.

    Yields:
        Channel number, subscription id, time (ns), message.
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


def parsed_request(message: str | bytes) -> Subscribe | Unsubscribe:
    """Parse a client's message.

    Raises:
        InvalidRequest: it is not a request that this server supports.
    """
    if isinstance(message, bytes):
        what = _READ_ONLY_BYTES.get(message[0]) if message else None
        text = f"expected text, got {number_of(len(message), 'byte')} with an unknown opcode"
        raise InvalidRequest(_refusal(what) if what else text)
    try:
        parsed: Any = json.loads(message)
    except (ValueError, RecursionError) as fault:
        raise InvalidRequest(f"expected JSON, got {_quoted(message)}") from fault
    request = cast("dict[str, Any]", parsed) if isinstance(parsed, dict) else {}
    match request.get("op"):
        case "subscribe":
            return Subscribe(tuple(_pair(each) for each in _items(request, "subscriptions")))
        case "unsubscribe":
            return Unsubscribe(tuple(_number(each, "subscriptionIds") for each in _items(request, "subscriptionIds")))
        case str(op) if op in _READ_ONLY:
            raise InvalidRequest(_refusal(_READ_ONLY[op]))
        case _:
            raise InvalidRequest(f'expected {{"op": "subscribe" or "unsubscribe", …}}, got {_quoted(message)}')


def _refusal(what: str) -> str:
    return f"{what}: refused, this connection is read-only"


def _quoted(message: str) -> str:
    return ascii(message[:_MAX_QUOTED]) + ("…" if len(message) > _MAX_QUOTED else "")


def _items(request: Mapping[str, Any], name: str) -> list[Any]:
    found = request.get(name)
    if not isinstance(found, list):
        raise InvalidRequest(f"expected a list under {name}, got {_quoted(str(found))}")
    return cast("list[Any]", found)


def _pair(each: Any) -> tuple[int, int]:
    if not isinstance(each, dict):
        raise InvalidRequest(f'expected {{"id", "channelId"}} in subscriptions, got {_quoted(str(each))}')
    found = cast("dict[str, Any]", each)
    return _number(found.get("id"), "id"), _number(found.get("channelId"), "channelId")


def _number(value: Any, name: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= _MAX_ID:
        raise InvalidRequest(f"expected a whole number of 0 … {_MAX_ID} as {name}, got {_quoted(str(value))}")
    return value

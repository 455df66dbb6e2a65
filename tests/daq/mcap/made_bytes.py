"""Records of MCAP files made by hand, right or wrong."""

from __future__ import annotations

import struct

from daq.mcap.checksum import crc32
from daq.mcap.writer import MAGIC, METADATA_CRC, metadata_crc


def record(kind: int, body: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(body)) + body


def text(data: str) -> bytes:
    return struct.pack("<I", len(data)) + data.encode()


def table(texts: dict[str, str]) -> bytes:
    pairs = b"".join(text(key) + text(value) for key, value in texts.items())
    return struct.pack("<I", len(pairs)) + pairs


def header(library: str = "another program") -> bytes:
    return record(1, text("") + text(library))


def channel(number: int, topic: str) -> bytes:
    return record(4, struct.pack("<HH", number, 0) + text(topic) + text("") + struct.pack("<I", 0))


def message(
    channel: int, log_ns: int, data: bytes = b"1234", publish_ns: int | None = None, sequence: int = 0
) -> bytes:
    published_ns = log_ns if publish_ns is None else publish_ns
    return record(5, struct.pack("<HIQQ", channel, sequence, log_ns, published_ns) + data)


def chunk(records: bytes, first: int, last: int, crc: int | None = None) -> bytes:
    body = struct.pack("<QQQI", first, last, len(records), crc32(records) if crc is None else crc)
    return record(6, body + text("") + struct.pack("<Q", len(records)) + records)


def indexes(**listed: list[tuple[int, int]]) -> bytes:
    out = b""
    for name, entries in listed.items():
        pairs = b"".join(struct.pack("<QQ", *entry) for entry in entries)
        out += record(7, struct.pack("<HI", int(name[1:]), len(pairs)) + pairs)
    return out


def metadata(name: str, texts: dict[str, str], ours: bool = False) -> bytes:
    return record(12, text(name) + table(texts | ({METADATA_CRC: metadata_crc(name, texts)} if ours else {})))


def data_end(crc: int = 0) -> bytes:
    return record(15, struct.pack("<I", crc))


def statistics(messages: int, channels: dict[int, int], chunks: int = 0, facts: int = 0, attachments: int = 0) -> bytes:
    counts = b"".join(struct.pack("<HQ", *pair) for pair in channels.items())
    numbers = struct.pack("<QHIIIIQQ", messages, 0, len(channels), attachments, facts, chunks, 0, 0)
    return record(11, numbers + struct.pack("<I", len(counts)) + counts)


def ending(before: bytes, summary: bytes, crc: int | None = 0) -> bytes:
    """Footer and end of a file; `crc` None for the right one."""
    start = len(before) if summary else 0
    head = struct.pack("<BQQQ", 2, 20, start, 0)
    return summary + head + struct.pack("<I", crc32(summary + head) if crc is None else crc) + MAGIC


def attachment(data: bytes = b"12345", crc: int | None = None, name: bytes = b"a.json", **wrong: int) -> bytes:
    body = struct.pack("<QQ", 3, 4)
    for key, value in (("label", name), ("media", b"text/x")):
        body += struct.pack("<I", len(value) + wrong.get(key, 0)) + value
    body += struct.pack("<Q", len(data) + wrong.get("content", 0)) + data
    return record(9, body + struct.pack("<I", crc32(body) if crc is None else crc))


FRONT = MAGIC + header() + channel(1, "a") + channel(2, "b")
LOOSE = message(1, 10) + message(2, 20) + message(1, 30)
"""Messages outside of chunks."""
INNER = LOOSE
"""Content of a chunk."""


def finished(*parts: bytes, end: bytes = data_end(), summary: bytes = b"", crc: int | None = 0) -> bytes:
    """A whole file with these records, its channels before them; see `ending`."""
    before = FRONT + b"".join(parts) + end
    return before + ending(before, summary, crc)

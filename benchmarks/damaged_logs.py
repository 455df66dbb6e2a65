"""Thousands of damaged logs: nothing wrong is handed out, nothing is lost in silence, nothing hangs or eats memory.

    python -m benchmarks.damaged_logs --files 10000 --seed 1

Small logs whose samples name themselves are damaged in every way a disk, a cut, a careless copy or a hostile hand
can; each is opened, read, verified, recovered and read again. Data that are read must equal those written.
"""

from __future__ import annotations

import argparse
import faulthandler
import io
import struct
import sys
import tempfile
import time
import zlib
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from numpy.random import Generator

from daq import channels as ch
from daq.errors import ChannelMissing, LogError
from daq.log import Log, open_log
from daq.log.recover import recover
from daq.mcap.writer import MAGIC, BlockWriter

T0 = 1_700_000_000_000_000_000
MOST_SECONDS = 20.0
MOST_MEMORY_MiB = 700
METADATA = {"run": {"test": "ring-down-x", "note": "spring 2"}, "summary": {"losses": "{}"}}
ATTACHMENTS = {"rig.json": b'{"rig": "bench"}' * 40, "identities.json": b"{}"}


Damager = Callable[[bytearray, Generator], None]


@dataclass(frozen=True)
class Shape:
    """An undamaged log and how much is in it."""

    name: str
    data: bytes
    finished: bool
    laser: int
    marks: int
    raw: int
    events: int


def laser(k: np.ndarray) -> dict[str, np.ndarray]:
    ticks = 25 * k.astype(np.uint64)
    return {"displacement_m": k * 1e-6, "code": k, "counter": k % 2**18, "device_ticks": ticks, "flags": 0 * k}


def make_shape(compression: Any, finished: bool, blocks: int, per_block: int, flush_every: int, chunk: int) -> Shape:
    """A log of `blocks` blocks, flushed every `flush_every` of them."""
    stream = io.BytesIO()
    writer = BlockWriter(stream, compression, chunk)
    writer.start("rig")
    ids: dict[str, int] = {}
    for channel in (ch.LASER_X, ch.TACHO):
        schema = writer.register_schema(channel.schema_name, "protobuf", channel.file_descriptor_set())
        ids[channel.topic] = writer.register_channel(channel.topic, "protobuf", schema)
    raw = writer.register_channel(
        "raw/laser_x", "protobuf", writer.register_schema(ch.RAW_SCHEMA_NAME, "protobuf", ch.raw_descriptor_set())
    )
    note = writer.register_schema(ch.NOTE_SCHEMA_NAME, "jsonschema", ch.note_schema())
    events = writer.register_channel("events", "json", note)
    writer.add_metadata("run", METADATA["run"])
    for name, data in ATTACHMENTS.items():
        writer.add_attachment(name, "application/json", data, T0)
    for block in range(blocks):
        now, k = T0 + (block + 1) * 10**7, np.arange(block * per_block, (block + 1) * per_block)
        writer.add_message(raw, now, now, block, ch.pack_raw(block % 2, block.to_bytes(2, "big") * 20))
        writer.add_block(ids["laser/x"], now, T0 + k * 250_000, k, ch.LASER_X.pack(laser(k)))
        mark = ch.TACHO.pack({"revolutions": [block], "node_time_us": [10_000 * block]})
        writer.add_block(ids["tacho"], now, now - 5, block, mark)
        if block % 4 == 0:
            writer.add_message(events, now, now, block, ch.pack_note({"kind": "beat", "number": block}))
        if (block + 1) % flush_every == 0:
            writer.flush()
    if finished:
        writer.add_metadata("summary", METADATA["summary"])
        writer.finish()
    name = f"{'finished' if finished else 'unfinished'} {compression}, {per_block * flush_every} samples a chunk"
    return Shape(name, stream.getvalue(), finished, blocks * per_block, blocks, blocks, (blocks + 3) // 4)


def shapes() -> list[Shape]:
    sizes = ((12, 25, 1, 2**18), (70, 10, 1, 2**18), (30, 100, 10, 2**18), (8, 200, 1, 3000))
    return [make_shape(kind, end, *size) for kind in ("zstd", "none") for end in (True, False) for size in sizes]


# ---------------------------------------------------------------------------------------------------------- damage


def chunk_spans(data: bytes) -> list[tuple[int, int]]:
    return [(start, end) for opcode, start, end in record_spans(data) if opcode == 6]


def record_spans(data: bytes) -> list[tuple[int, int, int]]:
    spans, at = [], len(MAGIC)
    while at + 9 <= len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, at)
        if at + 9 + length > len(data):
            break
        spans.append((opcode, at, at + 9 + length))
        at += 9 + length
    return spans


def flip_one(data: bytearray, rng: Generator) -> None:
    flip(data, rng, 1)


def flip_many(data: bytearray, rng: Generator) -> None:
    flip(data, rng, int(rng.integers(2, 101)))


def flip(data: bytearray, rng: Generator, count: int) -> None:
    for bit in rng.integers(8 * len(MAGIC), 8 * len(data), count):
        data[bit // 8] ^= 1 << bit % 8


def flip_heads(data: bytearray, rng: Generator) -> None:
    """Bits in the first bytes of records, where lengths stand."""
    spans = record_spans(data)
    for _ in range(int(rng.integers(1, 6))):
        _, start, end = spans[rng.integers(len(spans))]
        at = start + int(rng.integers(0, min(60, end - start)))
        data[at] ^= 1 << int(rng.integers(8))


def cut(data: bytearray, rng: Generator) -> None:
    del data[int(rng.integers(len(MAGIC), len(data))) :]


def cut_and_flip(data: bytearray, rng: Generator) -> None:
    cut(data, rng)
    if len(data) > len(MAGIC):
        flip(data, rng, 3)


def remove(data: bytearray, rng: Generator) -> None:
    start = int(rng.integers(len(MAGIC), len(data)))
    del data[start : start + int(rng.choice([1, 7, 512, 4096]))]


def insert(data: bytearray, rng: Generator) -> None:
    start = int(rng.integers(len(MAGIC), len(data)))
    data[start:start] = rng.integers(0, 256, int(rng.choice([1, 8, 512, 4096])), np.uint8).tobytes()


def block_pair(data: bytearray, rng: Generator) -> tuple[int, int, int]:
    """Two places and a size: sectors, pages, or whole chunks."""
    spans = chunk_spans(data)
    if rng.integers(2) and len(spans) > 1:
        a, b = (spans[k] for k in rng.choice(len(spans), 2, replace=False))
        return a[0], b[0], a[1] - a[0]
    size = int(rng.choice([512, 4096]))
    a, b = (max(len(MAGIC), int(rng.integers(0, len(data))) // 512 * 512) for _ in range(2))
    return a, b, size


def swap(data: bytearray, rng: Generator) -> None:
    a, b, size = block_pair(data, rng)
    a, b = min(a, b), max(a, b)
    size = min(size, b - a, len(data) - b)
    data[a : a + size], data[b : b + size] = data[b : b + size], data[a : a + size]


def copy(data: bytearray, rng: Generator) -> None:
    a, b, size = block_pair(data, rng)
    size = min(size, len(data) - max(a, b))
    data[b : b + size] = data[a : a + size]


def zero(data: bytearray, rng: Generator) -> None:
    a, _, size = block_pair(data, rng)
    size = min(size, len(data) - a)
    data[a : a + size] = bytes(size)


def double_chunk(data: bytearray, rng: Generator) -> None:
    """A chunk with its message indexes stands in the file twice."""
    spans = chunk_spans(data)
    if len(spans) > 1:
        k = int(rng.integers(len(spans) - 1))
        part = data[spans[k][0] : spans[k + 1][0]]
        at = spans[int(rng.integers(len(spans)))][0]
        data[at:at] = part


def hostile_length(data: bytearray, rng: Generator) -> None:
    """A length or a count in some record becomes a huge number."""
    spans = record_spans(data)
    _, start, end = spans[rng.integers(len(spans))]
    size = int(rng.choice([4, 8]))
    at = start + 1 if rng.integers(2) else int(rng.integers(start + 9, max(start + 10, end)))
    value = int(rng.choice([0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**62, 2**63 - 1]))
    data[at : at + size] = (value % 2 ** (8 * size)).to_bytes(size, "little")


def hostile_summary(data: bytearray, rng: Generator) -> None:
    """A number in the summary or footer is another one, and the CRC is that of the changed bytes."""
    footer = bytes(data).rfind(b"\x02" + struct.pack("<Q", 20))
    if not data.endswith(MAGIC) or footer < 0:
        hostile_length(data, rng)
        return
    start = struct.unpack_from("<Q", data, footer + 9)[0]
    spans = [span for span in record_spans(data) if span[1] >= start]
    for _ in range(int(rng.integers(1, 4))):
        _, begin, end = spans[rng.integers(len(spans))]
        at = int(rng.integers(begin + 9, max(begin + 10, end)))
        value = int(rng.choice([0, 1, int(rng.integers(2**16)), 2**31, 2**32 - 1, 2**63 - 1]))
        size = int(rng.choice([1, 2, 4, 8]))
        data[at : at + size] = (value % 2 ** (8 * size)).to_bytes(size, "little")
    data[footer + 25 : footer + 29] = zlib.crc32(data[start : footer + 25]).to_bytes(4, "little")


def bomb(data: bytearray, rng: Generator) -> None:
    """A chunk becomes one that unpacks to very much."""
    size = int(rng.choice([10**7, 6 * 10**7, 10**9]))
    packed = zstandard.ZstdCompressor(level=1).compress(bytes(min(size, 6 * 10**7)))
    body = struct.pack("<QQQII", T0, T0, size, int(rng.integers(2**32)), 4) + b"zstd" + struct.pack("<Q", len(packed))
    record = struct.pack("<BQ", 6, len(body) + len(packed)) + body + packed
    spans = chunk_spans(data)
    start, end = spans[rng.integers(len(spans))]
    data[start : end if rng.integers(2) else start] = record


DAMAGES: tuple[Damager, ...] = (
    flip_one,
    flip_many,
    flip_heads,
    cut,
    cut_and_flip,
    remove,
    insert,
    swap,
    copy,
    zero,
    double_chunk,
    hostile_length,
    hostile_summary,
    bomb,
)


# ---------------------------------------------------------------------------------------------------------- checks


def check_laser(log: Log) -> set[int]:
    """Check that laser samples equal those written under their numbers; return the numbers."""
    if "laser/x" not in log:
        return set()
    x = log["laser/x"]
    k = x.code.astype(np.int64)
    for name, column in laser(k).items():
        assert np.array_equal(x[name], column), f"wrong {name}"
    assert np.array_equal(x.time_ns, T0 + k * 250_000), "wrong sample times"
    assert np.array_equal(x.sequence, k), "wrong sequence numbers"
    assert len(np.unique(k)) == len(k), "samples twice"
    return set(k.tolist())


def check_others(log: Log) -> tuple[int, int, int]:
    """Marks, raw bytes, events, metadata, attachments are what was written; returns how many of the first three."""
    marks = raw = 0
    if "tacho" in log:
        n = log["tacho"].revolutions.astype(np.int64)
        assert np.array_equal(log["tacho"].log_time_ns, T0 + (n + 1) * 10**7), "wrong marks"
        assert np.array_equal(log["tacho"].node_time_us, 10_000 * n), "wrong marks"
        assert len(np.unique(n)) == len(n), "marks twice"
        marks = len(n)
    if "laser_x" in log.devices:
        chunks = log.raw("laser_x")
        numbers = [int.from_bytes(chunk.data[:2], "big") for chunk in chunks]
        for number, chunk in zip(numbers, chunks, strict=True):
            wanted = (T0 + (number + 1) * 10**7, number % 2, number.to_bytes(2, "big") * 20)
            assert tuple(chunk) == wanted, "wrong raw bytes"
        assert len(set(numbers)) == len(numbers), "raw bytes twice"
        raw = len(numbers)
    events = log.events
    for event in events:
        number = event["number"]
        assert event == {"kind": "beat", "number": number, "time_ns": T0 + (number + 1) * 10**7}, "wrong event"
    assert len({event["number"] for event in events}) == len(events), "events twice"
    for name, texts in log.metadata.items():
        # no CRC covers a metadata record's name: where the index is gone as well, it may come out wrong
        if name in METADATA or set(texts) != {"most_late_ns", "most_early_ns"}:
            wanted = [METADATA[name]] if name in METADATA else list(METADATA.values())
            assert texts in wanted, f"wrong metadata {name!r}"
    for name, data in log.attachments.items():
        assert data == ATTACHMENTS[name], f"wrong attachment {name!r}"
    return marks, raw, len(events)


def check_window(log: Log, laser_samples: set[int], rng: Generator) -> None:
    """A part of the log holds exactly what the whole log holds of that time."""
    if not laser_samples:
        return
    low, high = sorted(int(k) for k in rng.integers(0, max(laser_samples) + 2, 2))
    part = log.between(T0 + low * 250_000, T0 + high * 250_000)
    found = set(part["laser/x"].code.tolist()) if "laser/x" in part else set()
    assert found == {k for k in laser_samples if low <= k < high}, "a window with other samples"


def check_file(path: Path, shape: Shape, kind: Damager | None, rng: Generator) -> str:
    """Everything about one file, damaged in a way or not at all; returns what became of it."""
    # a change with a corrected CRC is in bytes that are not read, or the values that are read show it
    changed = kind not in (None, hostile_summary) and path.read_bytes() != shape.data
    try:
        log = open_log(path)
    except LogError:
        return "refused"
    with log:
        try:
            read = check_laser(log), check_others(log)
            check_window(log, read[0], rng)
        except (LogError, ChannelMissing):  # a hostile schema with the right CRC
            read = set(), (0, 0, 0)
        reported = log.verify()
        verified = check_laser(log), check_others(log)
        whole = (len(verified[0]), *verified[1]) == (shape.laser, shape.marks, shape.raw, shape.events)
        facts = (log.metadata, log.attachments) == (
            METADATA if shape.finished else {"run": METADATA["run"]},
            ATTACHMENTS,
        )
        assert read[0] <= verified[0], "samples handed out that are not there"
        if not (whole and facts):
            assert reported, "data are missing, and no damage was reported"
        if not whole:
            assert any(place.messages != 0 for place in reported), (
                "samples are missing, no message was reported as lost"
            )
        if changed:
            assert reported, "bytes were changed, and no damage was reported"
        # one damaged place is reported exactly; of several, indexes that do not fit may claim more than was lost
        if whole and kind in (flip_one, double_chunk):
            assert all(place.messages in (0, None) for place in reported), f"missed, though there: {reported}"
        assert all(str(place) for place in reported)
        assert log.complete is (not reported), "complete, and yet something is missing"
        assert log.complete is False or set(log.metadata) <= set(METADATA), "metadata under a wrong name"
    return check_recovered(path, verified[0], verified[1]) + (", all samples" if whole else "")


def check_recovered(path: Path, laser_samples: set[int], others: tuple[int, int, int]) -> str:
    out = path.with_name("out.mcap")
    out.unlink(missing_ok=True)
    try:
        found = recover(path, out)
    except LogError:
        assert sum(others, len(laser_samples)) == 0, "samples were there, and were not recovered"
        return "nothing in it"
    with open_log(out) as log:
        for name in ("recovered", "recovered earlier"):
            log.metadata.pop(name, None)
        ended = log.metadata.get("summary", {}).pop("ended", None)
        if ended is not None:
            del log.metadata["summary"]
        assert check_laser(log) == laser_samples, "other samples in the recovered log"
        assert check_others(log) == others, "other messages in the recovered log"
        assert sum(log.count(topic) for topic in log.topics) == found.messages, "another count of messages"
        assert log.verify() == [], "the recovered log is not whole"
    return "recovered"


# ---------------------------------------------------------------------------------------------------------- campaign


def damaged(shape: Shape, kind: Damager, rng: Generator) -> bytes:
    data = bytearray(shape.data)
    kind(data, rng)
    return bytes(data)


def limit_memory() -> None:
    """No more address space than a few GiB, where the system can: eating memory becomes an error."""
    if sys.platform == "linux":
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (6 * 2**30, 6 * 2**30))


def peak_MiB() -> float:
    if sys.platform != "linux":
        return float("nan")
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, help="number of one file, to repeat it")
    arguments = parser.parse_args()
    limit_memory()
    originals = shapes()
    results: dict[str, Counter[str]] = defaultdict(Counter)
    slowest: dict[str, float] = defaultdict(float)
    faults = 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        for shape in originals:
            path.write_bytes(shape.data)
            check_file(path, shape, None, np.random.default_rng(0))
        base = peak_MiB()
        for number in range(arguments.files) if arguments.only is None else [arguments.only]:
            rng = np.random.default_rng([arguments.seed, number])
            shape, kind = originals[rng.integers(len(originals))], DAMAGES[number % len(DAMAGES)]
            path.write_bytes(damaged(shape, kind, rng))
            faulthandler.dump_traceback_later(MOST_SECONDS, exit=True)
            started = time.perf_counter()
            try:
                outcome = check_file(path, shape, kind, rng)
            except (Exception, MemoryError) as error:
                faults += 1
                outcome = "FAULT"
                print(f"file {number} ({kind.__name__}, {shape.name}): {type(error).__name__}: {error}")
                if arguments.only is not None:
                    raise
            results[kind.__name__][outcome] += 1
            slowest[kind.__name__] = max(slowest[kind.__name__], time.perf_counter() - started)
            faulthandler.cancel_dump_traceback_later()
    outcomes = sorted({outcome for counts in results.values() for outcome in counts})
    print(f"{'damage':16}" + "".join(f"{outcome:>26}" for outcome in outcomes) + "   slowest s")
    for name, counts in results.items():
        print(f"{name:16}" + "".join(f"{counts[o]:26d}" for o in outcomes) + f"{slowest[name]:12.2f}")
    print(f"{faults} faults; peak memory {peak_MiB():.0f} MiB, {peak_MiB() - base:.0f} MiB above undamaged files")
    return 1 if faults or peak_MiB() - base > MOST_MEMORY_MiB else 0


if __name__ == "__main__":
    sys.exit(main())

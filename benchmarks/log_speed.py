"""Logs: samples and CAN frames written and read per second, ours against the peers in the same run.

    python -m benchmarks.log_speed [--quick] [--json] [--repeats N] [--folder DIR]

Every figure is the median of interleaved repeats and includes making the file whole and one fdatasync. Samples are a
laser's, one message each with CRC and index (`benchmarks.laser_samples`); ours are columns, the peers
get ready-made messages. Frames are those of a drive (`benchmarks.can_frames`).
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Literal

import foxglove
import numpy as np
from foxglove.mcap import MCAPCompression, MCAPWriteOptions
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from benchmarks import can_frames
from benchmarks.laser_samples import LaserSamples, laser_samples
from daq import channels
from daq.log import open_log
from daq.mcap.writer import BlockWriter

LASER = channels.LASER_X
_sync = getattr(os, "fdatasync", os.fsync)  # macOS and Windows have only fsync


@dataclass(frozen=True)
class Case:
    """One line of a table: `run(path)` handles `count` items, writing them to `path` or reading files made before."""

    table: str
    name: str
    count: int
    run: Callable[[Path], None]


@dataclass(frozen=True)
class Result:
    """Items per second at the median, their spread, and the file's bytes per item (None when it was only read)."""

    table: str
    name: str
    count: int
    per_second: float
    slowest: float
    fastest: float
    bytes_each: float | None


@contextmanager
def synced(path: Path) -> Iterator[BinaryIO]:
    """A file that is on the disk at the end."""
    with path.open("wb") as stream:
        yield stream
        stream.flush()
        _sync(stream.fileno())


def sync(path: Path) -> None:
    """Bring a file that something else has written onto the disk."""
    with path.open("r+b") as stream:
        _sync(stream.fileno())


def write_ours(path: Path, blocks: list[LaserSamples], compression: Literal["zstd", "none"]) -> None:
    """Write the columns of each block."""
    with synced(path) as stream:
        writer = BlockWriter(stream, compression)
        writer.start()
        schema = writer.register_schema(LASER.schema_name, "protobuf", LASER.file_descriptor_set())
        channel = writer.register_channel(LASER.topic, "protobuf", schema)
        for block in blocks:
            heads = block.log_time_ns, block.time_ns, block.sequence
            writer.add_samples(channel, *heads, LASER.item, block.columns)
        writer.finish()


def write_library(path: Path, rows: list[tuple[int, bytes, int, int]], compression: CompressionType) -> None:
    """Write ready-made messages with the mcap library."""
    with synced(path) as stream:
        writer = Writer(stream, compression=compression, enable_data_crcs=True)
        writer.start()
        schema = writer.register_schema(LASER.schema_name, "protobuf", LASER.file_descriptor_set())
        channel = writer.register_channel(LASER.topic, "protobuf", schema)
        for log_time, data, publish_time, sequence in rows:
            writer.add_message(channel, log_time, data, publish_time, sequence)
        writer.finish()


def write_foxglove(path: Path, rows: list[tuple[int, bytes, int, int]], compression: Any, direct: bool) -> None:
    """Write ready-made messages with foxglove-sdk, which keeps neither publish time nor sequence.

    Args:
        direct: by the Rust channel's own method, past the Python class around it.
    """
    context = foxglove.Context()
    options = MCAPWriteOptions(compression=compression, calculate_data_section_crc=True)
    with foxglove.open_mcap(path, context=context, writer_options=options, allow_overwrite=True):
        schema = foxglove.Schema(name=LASER.schema_name, encoding="protobuf", data=LASER.file_descriptor_set())
        channel = foxglove.Channel(LASER.topic, schema=schema, message_encoding="protobuf", context=context)
        if direct:
            log = channel.base.log
            for log_time, data, _, _ in rows:
                log(data, log_time)
        else:
            for log_time, data, _, _ in rows:
                channel.log(data, log_time=log_time)
    sync(path)


def read_ours(path: Path, count: int) -> None:
    """Samples as arrays."""
    with open_log(path) as log:
        samples = log[LASER.topic]
        assert len(samples) == count
        assert samples.displacement_m[-1] != 0


def read_library(path: Path, count: int) -> None:
    """The same arrays through the mcap library, in file order (its default order is slower still)."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = [
            (m.log_time, m.publish_time, m.sequence, m.data) for _, _, m in reader.iter_messages(log_time_order=False)
        ]
    times = np.array([row[:3] for row in found], np.int64)
    columns = LASER.unpack(b"".join(row[3] for row in found))
    assert len(times) == len(columns["displacement_m"]) == count


def sample_cases(folder: Path, quick: bool) -> list[Case]:
    """Writing and reading laser samples."""
    samples = laser_samples(100_000 if quick else 400_000)
    few = samples[: 20_000 if quick else 40_000]
    rows = list(
        zip(
            few.log_time_ns.tolist(),
            [m.tobytes() for m in few.messages()],
            few.time_ns.tolist(),
            few.sequence.tolist(),
            strict=True,
        )
    )
    several = rows * 5
    cases: list[Case] = []
    for compression in ("zstd", "none"):
        for size in (40, 400, 4000):
            blocks = list(samples.blocks(size))
            cases.append(
                Case(
                    "write samples",
                    f"ours, {compression}, blocks of {size}",
                    len(samples),
                    lambda path, b=blocks, c=compression: write_ours(path, b, c),
                )
            )
    for theirs in (CompressionType.ZSTD, CompressionType.NONE):
        cases.append(
            Case(
                "write samples",
                f"mcap library, {theirs.name.lower()}",
                len(rows),
                lambda path, c=theirs: write_library(path, rows, c),
            )
        )
    for name, kind in (("zstd", MCAPCompression.Zstd), ("none", None)):
        for direct in (False, True):
            cases.append(
                Case(
                    "write samples",
                    f"foxglove-sdk, {name}, {'BaseChannel.log' if direct else 'Channel.log'}",
                    len(several),
                    lambda path, k=kind, d=direct: write_foxglove(path, several, k, d),
                )
            )
    return cases + reading_cases(folder, samples, 5, len(few))


def reading_cases(folder: Path, samples: LaserSamples, times: int, few: int) -> list[Case]:
    """Files to read: the samples `times` over, and the first `few` of them for the library."""
    cases: list[Case] = []
    for compression in ("zstd", "none"):
        long, short = folder / f"long-{compression}.mcap", folder / f"short-{compression}.mcap"
        write_ours(long, list(samples.blocks(4000)) * times, compression)
        write_ours(short, list(samples[:few].blocks(4000)), compression)
        count = times * len(samples)
        cases += [
            Case("read samples", f"ours, {compression}", count, lambda _, p=long, n=count: read_ours(p, n)),
            Case("read samples", f"mcap library, {compression}", few, lambda _, p=short: read_library(p, few)),
        ]
    return cases


def frame_cases(quick: bool) -> list[Case]:
    """Writing CAN frames."""
    count = 10_000 if quick else 50_000
    frames = can_frames.drive_frames(count)
    reads, messages = can_frames.raw_reads(frames), can_frames.python_can_messages(frames)
    cases = [
        Case("write frames", f"ours, {name}", count, lambda path, f=function: f(path, reads))
        for name, function in can_frames.OURS.items()
    ]
    cases += [
        Case(
            "write frames",
            f"python-can {name}",
            count,
            lambda path, m=make: can_frames.write_python_can(path, m, messages),
        )
        for name, make in can_frames.PYTHON_CAN.items()
    ]
    return cases


def measure(cases: list[Case], folder: Path, repeats: int) -> list[Result]:
    """Run all cases once to warm up, then `repeats` times, one after the other in every round."""
    seconds: dict[str, list[float]] = {f"{case.table}/{case.name}": [] for case in cases}
    sizes: dict[str, int] = {}
    for number in range(repeats + 1):
        for case in cases:
            path, key = folder / "one.mcap", f"{case.table}/{case.name}"
            path.unlink(missing_ok=True)
            start = time.perf_counter()
            case.run(path)
            if number:
                seconds[key].append(time.perf_counter() - start)
            sizes[key] = path.stat().st_size if path.exists() else 0
    results: list[Result] = []
    for case in cases:
        key = f"{case.table}/{case.name}"
        slow, middle, fast = (pick(seconds[key]) for pick in (max, statistics.median, min))
        rates = (case.count / taken for taken in (middle, slow, fast))
        size = sizes[key] / case.count if sizes[key] else None
        results.append(Result(case.table, case.name, case.count, *rates, size))
    return results


def show(results: list[Result]) -> None:
    """The tables; ratios are to the last line of ours, of the same compression where there are several."""
    for table in dict.fromkeys(result.table for result in results):
        lines = [result for result in results if result.table == table]
        print(f"\n{table:34} {'items':>9} {'k/s':>9} {'slowest':>9} {'fastest':>9} {'bytes':>7} {'ours/it':>8}")
        for line in lines:
            peers = [r for r in lines if r.name.startswith("ours")]
            same = [r for r in peers if ("none" in r.name) == ("none" in line.name)] or peers
            size = "" if line.bytes_each is None else f"{line.bytes_each:.1f}"
            print(
                f"{line.name:34} {line.count:9d} {line.per_second / 1e3:9.0f} {line.slowest / 1e3:9.0f} "
                f"{line.fastest / 1e3:9.0f} {size:>7} {same[-1].per_second / line.per_second:8.2f}"
            )


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer items, three repeats")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--repeats", type=int, default=0, help="default 7, quick 3")
    parser.add_argument("--folder", type=Path, help="where the files go, default the system's temporary folder")
    options = parser.parse_args()
    machine = f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"
    repeats = options.repeats or (3 if options.quick else 7)
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        folder = Path(name)
        results = measure(sample_cases(folder, options.quick) + frame_cases(options.quick), folder, repeats)
    if options.json:
        json.dump({"machine": machine, "repeats": repeats, "results": [vars(r) for r in results]}, sys.stdout, indent=1)
        return 0
    print(f"{machine}; medians of {repeats} interleaved repeats, one fdatasync each")
    show(results)
    return 0


if __name__ == "__main__":
    sys.exit(main())

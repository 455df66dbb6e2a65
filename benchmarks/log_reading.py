"""Reading logs: ours against the mcap library's reader, in one run.

    python -m benchmarks.log_reading [--fresh]

Two files are made once in the system's temporary folder: 2 million laser samples, one message each; and one hour of a
whole rig (two lasers at 4 kHz, encoders at 1 kHz, marks, drive, raw bytes, events), flushed every 50 ms. Figures are
medians; "cold" is with an empty page cache, where the system lets us empty it. Each measurement of memory is a process
of its own.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from daq import channels as ch
from daq.log import open_log
from daq.mcap.writer import BlockWriter

T0 = 1_700_000_000_000_000_000
FLUSH_NS = 50_000_000
SAMPLES = 2_000_000
CHUNKS = 72_000
PEER_SAMPLES = 200_000
TOPICS = ("laser/x", "laser/y", "pendulums")
rng = np.random.default_rng(4)


def laser(k: np.ndarray) -> dict[str, np.ndarray]:
    """A laser at rest with 4 µm of noise, on its 16 bit code."""
    code = np.round(32768 + rng.normal(0, 4e-6, len(k)) / 25e-3 * 65520 + 500 * np.sin(0.003 * k)).astype(np.uint32)
    return {
        "displacement_m": code * (25e-3 / 65520),
        "code": code,
        "counter": k % 2**18,
        "device_ticks": 25 * k.astype(np.uint64),
        "flags": 0,
    }


def laser_times(k: np.ndarray) -> np.ndarray:
    return T0 + np.round(k * 250_003.1).astype(np.int64)


def writer_with(stream, wanted: list[ch.Channel]) -> tuple[BlockWriter, dict[str, int]]:
    writer = BlockWriter(stream)
    writer.start()
    ids = {}
    for channel in wanted:
        schema = writer.register_schema(channel.schema_name, "protobuf", channel.file_descriptor_set())
        ids[channel.topic] = writer.register_channel(channel.topic, "protobuf", schema)
    return writer, ids


def make_samples(path: Path, samples: int = SAMPLES) -> None:
    with path.open("wb") as stream:
        writer, ids = writer_with(stream, [ch.LASER_X])
        for first in range(0, samples, 4000):
            k = np.arange(first, first + 4000)
            times = laser_times(k)
            writer.add_block(ids["laser/x"], times + 2_000_000, times, k, ch.LASER_X.pack(laser(k)))
        writer.finish()


def make_few(path: Path) -> None:
    make_samples(path, PEER_SAMPLES)


def make_hour(path: Path) -> None:
    with path.open("wb") as stream:
        writer, ids = writer_with(stream, list(ch.CHANNELS.values()))
        schema = writer.register_schema(ch.RAW_SCHEMA_NAME, "protobuf", ch.raw_descriptor_set())
        for device in ("laser_x", "laser_y", "encoder", "drive"):
            ids[device] = writer.register_channel(ch.raw_topic(device), "protobuf", schema)
        note = writer.register_schema(ch.NOTE_SCHEMA_NAME, "jsonschema", ch.note_schema())
        ids |= {topic: writer.register_channel(topic, "json", note) for topic in (ch.EVENTS_TOPIC, ch.HEALTH_TOPIC)}
        writer.add_metadata("run", {"test": "ring-down-x"})
        writer.add_attachment("rig.json", "application/json", b"{}" * 2000, T0)
        for number in range(CHUNKS):
            add_flush(writer, ids, number)
        writer.finish()


def add_flush(writer: BlockWriter, ids: dict[str, int], number: int) -> None:
    """50 ms of the whole rig."""
    now = T0 + (number + 1) * FLUSH_NS
    k, j = np.arange(200 * number, 200 * number + 200), np.arange(50 * number, 50 * number + 50)
    for channel in (ch.LASER_X, ch.LASER_Y):
        writer.add_samples(ids[channel.topic], now, laser_times(k), k, channel.item, laser(k))
    counts = np.round(2048 + 900 * np.sin(0.004 * j)).astype(np.int32)
    angles = {
        "theta3_rad": counts * (2 * np.pi / 4096),
        "theta4_rad": -counts * (2 * np.pi / 4096),
        "count_a": counts,
        "count_b": -counts,
        "index": j,
        "node_time_us": 1000 * j.astype(np.uint64),
        "flags": 96,
    }
    times = T0 + j * 1_000_000
    writer.add_samples(ids["pendulums"], now, times, j, ch.PENDULUMS.item, angles)
    motor = {"speed_rpm": 600 + rng.normal(0, 0.1, 50), "target_rpm": 600.0, "statusword": 0x237}
    writer.add_samples(ids["motor"], now, times, j, ch.MOTOR.item, motor)
    if number % 2:
        mark = ch.TACHO.pack({"revolutions": [number // 2], "node_time_us": [50_000 * number]})
        writer.add_block(ids["tacho"], now, now, number, mark)
    raw = rng.integers(0, 256, 1600, np.uint8).tobytes()
    for device, size in (("laser_x", 1600), ("laser_y", 1600), ("encoder", 400), ("drive", 1300)):
        writer.add_message(ids[device], now, now, number, ch.pack_raw(ch.RX, raw[:size]))
    if number % 20 == 0:
        report = ch.pack_note({"kind": "health", "device": "", "text": "", "losses": {"laser_x": {"samples": 0}}})
        writer.add_message(ids["health"], now, now, 0, report)
    if number % 400 == 0:
        writer.add_message(ids["events"], now, now, 0, ch.pack_note({"kind": "gap", "device": "encoder", "text": "1"}))
    writer.flush()


def drop_page_cache() -> bool:
    """Empty the page cache; only a system that lets us has one that can be emptied."""
    try:
        os.sync()
        Path("/proc/sys/vm/drop_caches").write_text("3")
    except OSError:
        return False
    return True


def median_s(run: Callable[[], object], repeats: int, cold: bool = False) -> float:
    times = []
    for _ in range(repeats):
        if cold and not drop_page_cache():
            return float("nan")
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def each(starts: list[int], read: Callable[[Path, int], int]) -> Callable[[], int]:
    """Reads the next window each time it is called."""
    places = iter(starts)
    return lambda: read(HOUR, next(places))


def read_samples(path: Path) -> None:
    with open_log(path) as log:
        assert len(log["laser/x"].displacement_m) == SAMPLES


def read_window(path: Path, start_ns: int) -> int:
    with open_log(path) as log:
        part = log.between(start_ns, start_ns + 10**9)
        sizes = [len(part[topic]) for topic in TOPICS]
    assert sizes[2] == 1000
    return sum(sizes)


def peer_window(path: Path, start_ns: int) -> int:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        window = reader.iter_messages(TOPICS, starting_at=start_ns, ending_before=start_ns + 10**9 + FLUSH_NS)
        return sum(start_ns <= message.publish_time < start_ns + 10**9 for _, _, message in window)


def peer_samples(path: Path) -> None:
    with path.open("rb") as stream:
        messages = make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False)
        assert len(ch.LASER_X.unpack(b"".join(message.data for _, _, message in messages))["code"]) == PEER_SAMPLES


def peak_MiB(task: str) -> float:
    """Peak memory of a fresh process that does `task`, above that of one that reads a tiny log; Linux only."""
    code = (
        "import benchmarks.log_reading as b\nfrom pathlib import Path\n{}\n"
        "print(Path('/proc/self/status').read_text().split('VmHWM:')[1].split()[0])"
    )
    peaks = [
        int(subprocess.run([sys.executable, "-c", code.format(do)], capture_output=True, text=True, check=True).stdout)
        for do in (task, "b.open_log(b.FEW)['laser/x']")
    ]
    return (peaks[0] - peaks[1]) / 1024


FOLDER = Path(tempfile.gettempdir()) / "rig-log-reading"
LASERS, FEW, HOUR = FOLDER / "samples.mcap", FOLDER / "few.mcap", FOLDER / "hour.mcap"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fresh", action="store_true", help="make the files again")
    arguments = parser.parse_args()
    FOLDER.mkdir(exist_ok=True)
    for path, make in ((LASERS, make_samples), (FEW, make_few), (HOUR, make_hour)):
        if arguments.fresh or not path.exists():
            part = path.with_suffix(".part")
            make(part)
            part.replace(path)
    print(
        f"files: {LASERS.stat().st_size / 1e6:.0f} MB of {SAMPLES / 1e6:.0f} M samples, "
        f"{HOUR.stat().st_size / 1e6:.0f} MB of one hour"
    )
    read_samples(LASERS)
    ours, cold = median_s(lambda: read_samples(LASERS), 7), median_s(lambda: read_samples(LASERS), 3, cold=True)
    peer = median_s(lambda: peer_samples(FEW), 3) * SAMPLES / PEER_SAMPLES
    print(
        f"2 M samples into arrays: {ours:.3f} s warm, {cold:.3f} s cold; mcap library {peer:.1f} s (scaled from "
        f"a file of {PEER_SAMPLES}), {peer / ours:.0f} ×"
    )
    opening = median_s(lambda: open_log(HOUR).close(), 21), median_s(lambda: open_log(HOUR).close(), 5, cold=True)
    print(f"1 h log opened: {opening[0] * 1e3:.1f} ms warm, {opening[1] * 1e3:.1f} ms cold")
    starts = (T0 + rng.integers(1, 3598, 40) * 10**9).tolist()
    warm = median_s(each(starts, read_window), 31)
    cold = median_s(each(starts, read_window), 9, cold=True)
    assert peer_window(HOUR, starts[0]) == read_window(HOUR, starts[0])
    peer = median_s(each(starts, peer_window), 3)
    print(
        f"1 s window, opened again: {warm * 1e3:.1f} ms warm, {cold * 1e3:.1f} ms cold; mcap library "
        f"{peer * 1e3:.0f} ms, {peer / warm:.0f} ×"
    )
    if sys.platform == "linux":
        for what, task in (
            ("a 1 s window", "b.read_window(b.HOUR, b.T0 + 10**12)"),
            ("the events of the hour", "b.open_log(b.HOUR).events"),
            ("one channel of the hour", "b.open_log(b.HOUR)['laser/x']"),
        ):
            print(f"peak memory for {what}: {peak_MiB(task):.0f} MiB above that for {PEER_SAMPLES} samples")


if __name__ == "__main__":
    main()

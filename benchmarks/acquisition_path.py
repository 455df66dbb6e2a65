"""The complete acquisition path, from a device's bytes to the log, against the same job done with public libraries.

    python -m benchmarks.acquisition_path [--seconds 20] [--repeats 7]

Two lasers at 4 kHz and a drive at 1 kHz, their real bytes, read by read. Ours decodes, maps clocks, marks spikes,
watches rates, silences, amplitude and speed, keeps the last seconds at hand, and writes raw bytes and samples with
CRC and index every 50 ms. The peer decodes the same bytes with numpy and python-can, as a script would, and writes raw
bytes and samples with the mcap library: no clock map, no checks, no interlocks. Printed is processor time for each
second of the rig, medians of interleaved repeats, and their ratio.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import can
import numpy as np
from mcap.writer import Writer

from benchmarks.can_frames import drive_frames, raw_reads
from benchmarks.laser_samples import RATE_HZ, START_NS, laser_reads
from daq import channels
from daq.acquisition.interlocks import Interlocks
from daq.acquisition.least_motion import LeastMotion
from daq.acquisition.rate_watch import RateWatches
from daq.acquisition.recent import Recent
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.stream import DrivePipeline
from daq.drivers.optoncdt import distance_words
from daq.drivers.optoncdt.stream import LaserPipeline
from daq.items import RX, Batch, joined
from daq.log.file import LogFile
from rig_configs import load_rig

_FLUSH_NS, _TICK_NS = 50_000_000, 100_000_000
_SAMPLE_CHANNELS = {"laser_x": channels.LASER_X, "laser_y": channels.LASER_Y, "drive": channels.MOTOR}

Reads = list[tuple[int, str, bytes]]


def reads_of(seconds: float) -> Reads:
    """Host time, device and bytes of every read, in order."""
    found: Reads = []
    for seed, name in enumerate(("laser_x", "laser_y"), 1):
        found += [(host_ns, name, data) for data, host_ns in laser_reads(round(seconds * RATE_HZ), seed)]
    found += [(host_ns, "drive", text) for host_ns, _, text in raw_reads(drive_frames(round(1000 * seconds)))]
    return sorted(found, key=lambda read: read[0])


def ours(path: Path, reads: Reads) -> int:
    """Everything that a recording does with bytes; returns samples written."""
    rig = load_rig("virtual")
    d = rig.devices
    pipelines = {
        "laser_x": LaserPipeline("laser_x", d["laser_x"], {}),
        "laser_y": LaserPipeline("laser_y", d["laser_y"], {}),
        "drive": DrivePipeline("drive", d["drive"], {}),
    }
    rates, recent = RateWatches(d), Recent(90.0)
    interlocks = Interlocks(rig.limits, rig.roles, LeastMotion.of(rig), driving=True)
    interlocks.begin(START_NS)
    interlocks.commanded(600.0)
    flush = tick = START_NS
    samples, arrived = 0, {}
    with LogFile(path, {}, {}, tuple(pipelines), START_NS) as log:
        for host_ns, name, data in reads:
            found = pipelines[name].feed(RX, data, host_ns)
            found += rates.feed(found, host_ns)
            log.raw(name, RX, data, host_ns)
            for item in found:
                if isinstance(item, Batch):
                    recent.add(item)
                    interlocks.feed(item, host_ns)
                    arrived.setdefault(name, []).append((item, host_ns))
                    samples += len(item.time_ns)
                else:
                    log.event(item, host_ns)
            if host_ns >= tick:
                tick += _TICK_NS
                interlocks.tick(host_ns)
            if host_ns >= flush:
                flush += _FLUSH_NS
                _write(log, arrived)
        _write(log, arrived)
        log.finish({})
    return samples


def _write(log: LogFile, arrived: dict[str, list[tuple[Batch, int]]]) -> None:
    for batches in arrived.values():
        log.batch(*joined(batches))
    arrived.clear()
    log.flush()


def peer(path: Path, reads: Reads) -> int:
    """numpy, python-can and the mcap library; returns samples written."""
    samples, tails = 0, dict.fromkeys(_SAMPLE_CHANNELS, b"")
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        raw_schema = writer.register_schema(channels.RAW_SCHEMA_NAME, "protobuf", channels.raw_descriptor_set())
        raws, ids = {}, {}
        for name, channel in _SAMPLE_CHANNELS.items():
            raws[name] = writer.register_channel(channels.raw_topic(name), "protobuf", raw_schema)
            schema = writer.register_schema(channel.schema_name, "protobuf", channel.file_descriptor_set())
            ids[name] = writer.register_channel(channel.topic, "protobuf", schema)
        for host_ns, name, data in reads:
            writer.add_message(raws[name], host_ns, channels.pack_raw(RX, data), host_ns)
            columns, tails[name] = (_motor if name == "drive" else _laser)(tails[name] + data)
            packed = _SAMPLE_CHANNELS[name].pack(columns)
            for message in packed:
                writer.add_message(ids[name], host_ns, message.tobytes(), host_ns)
            samples += len(packed)
        writer.finish()
    return samples


def _laser(data: bytes) -> tuple[dict[str, np.ndarray], bytes]:
    """Whole blocks of four words of 18 bits, and the bytes behind them."""
    whole = len(data) // 12 * 12
    words = np.frombuffer(data[:whole], np.uint8).reshape(-1, 4, 3).astype(np.uint32) & 0x3F
    value = words[..., 0] | words[..., 1] << 6 | words[..., 2] << 12
    ticks = (value[:, 2] & 0xFFFF | (value[:, 3] & 0xFFFF) << 16).astype(np.uint64)
    metres = distance_words.metres(value[:, 0], 0.025) - 0.0125
    own = {"displacement_m": metres, "code": value[:, 0], "counter": value[:, 1], "device_ticks": ticks}
    return {**own, "flags": np.zeros(len(value), np.uint32)}, data[whole:]


def _motor(data: bytes) -> tuple[dict[str, np.ndarray], bytes]:
    """Status reports, as python-can messages."""
    *lines, rest = data.split(b"\r")
    messages = [
        can.Message(arbitration_id=int(line[1:4], 16), data=bytes.fromhex(line[5:].decode()), is_extended_id=False)
        for line in lines
        if line[:1] == b"t"
    ]
    rows = [cia402.VELOCITY.unpack(bytes(message.data)) for message in messages]
    columns = {
        "speed_rpm": np.array([rpm for _, rpm in rows], float),
        "target_rpm": np.zeros(len(rows)),
        "statusword": np.array([word for word, _ in rows], np.uint32),
    }
    return columns, rest


def processor_s(run: Callable[[Path, Reads], int], path: Path, reads: Reads) -> tuple[float, int]:
    """Processor time of one recording, and its samples."""
    path.unlink(missing_ok=True)
    began = time.process_time()
    samples = run(path, reads)
    return time.process_time() - began, samples


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--repeats", type=int, default=7)
    arguments = parser.parse_args()
    reads = reads_of(arguments.seconds)
    spent: dict[str, list[float]] = {"ours": [], "peer": []}
    counts: dict[str, int] = {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        processor_s(ours, path, reads[:200])  # compilation
        for _ in range(arguments.repeats):
            for name, run in (("ours", ours), ("peer", peer)):
                seconds, counts[name] = processor_s(run, path, reads)
                spent[name].append(seconds)
    own, other = (1e3 * statistics.median(spent[name]) / arguments.seconds for name in ("ours", "peer"))
    ratio = statistics.median(a / b for a, b in zip(spent["ours"], spent["peer"], strict=True))
    print(f"ours: {own:.1f} ms of processor time a second of the rig ({counts['ours']} samples)")
    print(f"peer (numpy, python-can, mcap library; unchecked): {other:.1f} ms ({counts['peer']} samples)")
    print(f"ours / peer: {ratio:.3f}, median of {arguments.repeats} pairs")


if __name__ == "__main__":
    main()

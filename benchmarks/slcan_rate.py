"""The rate of CAN frames in slcan text that the recording path carries, next to python-can's own slcan reader.

    python -m benchmarks.slcan_rate [--frames 400000] [--repeats 5]

A process of its own writes the text of two messages to a pty, as fast as it is read, with bad lines in between. Ours is
the path of a recording: the link reads the pty in the thread of a DeviceReader, raw bytes and decoded samples go to a
log with CRC and index, flushed every 50 ms. It decodes displacements of a DBC file, or the status and the speed of a
drive whose state changes every thousand reports. The peer receives frame objects from `can.Bus(interface="slcan")`,
with neither values nor a log. All frames must arrive, and each bad line must be counted. Printed are frames for each
second of wall time and of the process's own processor time, medians of interleaved repeats, and the ratio of the pairs.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import statistics
import tempfile
import threading
import time
import tty
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import can
import numpy as np

from daq.acquisition.reader import DeviceReader
from daq.drivers.cia402.settings import MotorDrive
from daq.drivers.cia402.stream import DrivePipeline
from daq.drivers.contract import Pipeline
from daq.items import RX, Batch, joined
from daq.log.file import LogFile
from daq.transports.can_frames import decode as decode_records
from daq.transports.host_clock import HostClock
from daq.transports.link import open_link
from daq.transports.slcan import HostText
from rig_drivers.dbc.settings import CanSensors
from rig_drivers.dbc.stream import CanPipeline

_FLUSH_NS = 50_000_000
_WRITE_BYTES = 4096
_BAD = (
    b"t1",
    b"t1009",
    b"q",
    b"t10080102",
    b"T00000",
    b"tZZZ0",
    b"\x80\xff\x00",
    b"t1002\xb2AB",
    b"x" * 100,
    b"t100101Z1",
)
_DBC = """VERSION ""
BU_: N
BO_ 389 X: 4 N
 SG_ Distance : 0|16@1- (0.5,0) [0|0] "um" N
 SG_ Count : 16|16@1+ (1,0) [0|65535] "" N
BO_ 390 Y: 4 N
 SG_ Distance : 0|16@1- (0.5,0) [0|0] "um" N
 SG_ Count : 16|16@1+ (1,0) [0|65535] "" N
"""


@dataclass(frozen=True)
class Result:
    """Frames and bad lines that arrived, and the time from the first to the last byte, s."""

    frames: int
    bad: int
    wall_s: float
    processor_s: float


def displaced(frames: int) -> list[int]:
    """First word of each frame of a sensor: displacements."""
    return np.random.default_rng(1).integers(0, 2**16, frames).tolist()


def driven(frames: int) -> list[int]:
    """First word of each frame of a drive: it is enabled and switched off in turn."""
    return np.where(np.arange(frames) // 2000 % 2, 0x0237, 0x0233).tolist()


def text_of(values: list[int], bad_every: int) -> tuple[bytes, int]:
    """Text of frames of two messages with a value and a number in each, and the number of bad lines in it."""
    lines: list[bytes] = []
    bad = 0
    for i, value in enumerate(values):
        number = i // 2 % 2**16
        lines.append(b"t%03X4%02X%02X%02X%02X" % (389 + i % 2, value & 255, value >> 8, number & 255, number >> 8))
        if i % bad_every == bad_every - 1:
            lines.append(_BAD[bad % len(_BAD)])
            bad += 1
    return b"\r" + b"\r".join(lines) + b"\r", bad  # the first line of a log may be cut and is not decoded


def _write(master: int, text: bytes, start: threading.Event) -> None:
    start.wait()
    at = 0
    while at < len(text):
        at += os.write(master, text[at : at + _WRITE_BYTES])


def _on_pty(text: bytes, receive: Callable[[str, Callable[[], None]], Result]) -> Result:
    """Write the text to a pty while `receive` reads the port; it calls its second argument when it is ready."""
    context = multiprocessing.get_context("fork")
    master, slave = os.openpty()
    tty.setraw(slave)
    start = context.Event()
    writer = context.Process(target=_write, args=(master, text, start))
    writer.start()
    try:
        return receive(os.ttyname(slave), start.set)
    finally:
        writer.kill()
        writer.join()
        os.close(master)
        os.close(slave)


def displacements() -> Pipeline:
    """Two displacements described by a DBC file."""
    table = {"signal": "Distance", "counter": "Count", "rate_Hz": 2000.0, "range_m": 0.1}
    settings = CanSensors.model_validate(
        {"driver": "dbc", "port": "p", "dbc_text": _DBC, "x": {"message": "X", **table}, "y": {"message": "Y", **table}}
    )
    return CanPipeline("bus", settings, {})


def drive() -> Pipeline:
    """Status and speed of a drive; node 5 sends the first message."""
    return DrivePipeline("bus", MotorDrive.model_validate({"driver": "cia402", "port": "p", "node_id": 5}), {})


def ours(path: Path, size: int, make: Callable[[], Pipeline]) -> Callable[[str, Callable[[], None]], Result]:
    """Return the recording of a port, which ends after `size` frames."""

    def receive(port: str, ready: Callable[[], None]) -> Result:
        clock, pipeline = HostClock(), make()
        done, arrived = threading.Event(), list[tuple[Batch, int]]()
        state = {"frames": 0, "received": 0, "flush": 0, "began": 0.0, "cpu": 0.0, "ended": 0.0, "errors": 0}

        def write_out() -> None:
            by_topic: dict[str, list[tuple[Batch, int]]] = {}
            for batch, ns in arrived:
                by_topic.setdefault(batch.channel.topic, []).append((batch, ns))
            for batches in by_topic.values():
                log.batch(*joined(batches))
            arrived.clear()
            log.flush()

        def take(_: object, data: bytes, host_ns: int) -> None:
            if not data:
                return
            if not state["began"]:
                state["began"], state["cpu"], state["flush"] = time.perf_counter(), time.process_time(), host_ns
            log.raw("bus", RX, data, host_ns)
            decode(data, host_ns)
            if host_ns - state["flush"] > _FLUSH_NS:
                state["flush"] = host_ns
                write_out()
            state["received"] += int(decode_records(data).is_of_bus.sum())
            if state["received"] >= size:
                decode(b"", host_ns)  # the end of the log
                done.set()

        def decode(data: bytes, host_ns: int) -> None:
            for item in pipeline.feed(RX, data, host_ns):
                if isinstance(item, Batch):
                    arrived.append((item, host_ns))
                    state["frames"] += len(item.time_ns)
                else:
                    log.event(item, host_ns)

        def failed(error: Exception) -> None:
            print(f"failed: {error}")
            done.set()

        link = open_link(port, 115_200, 1_000_000)
        with LogFile(path, {}, {}, ("bus",), clock.now_ns()) as log:
            reader = DeviceReader("bus", link, clock)
            reader.start(take, failed)
            ready()
            done.wait(120.0)
            wall_s, cpu_s = time.perf_counter() - state["began"], time.process_time() - state["cpu"]
            reader.stop()
            write_out()
            log.finish({})
        return Result(int(state["frames"]), pipeline.losses["damaged_lines"], wall_s, cpu_s)

    return receive


def peer(port: str, ready: Callable[[], None], frames: int) -> Result:
    """Receive frames by python-can; bad lines are those that raise an error."""
    count = bad = 0
    with can.Bus(interface="slcan", channel=port, bitrate=1_000_000, sleep_after_open=0.0) as bus:
        ready()
        began = cpu = 0.0
        while count < frames:
            try:
                message = bus.recv(5.0)
            except Exception:
                bad += 1
                continue
            if message is None:
                break
            if not count:
                began, cpu = time.perf_counter(), time.process_time()
            count += 1
        return Result(count, bad, time.perf_counter() - began, time.process_time() - cpu)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=400_000)
    parser.add_argument("--peer-frames", type=int, default=20_000)
    parser.add_argument("--bad-every", type=int, default=500, help="frames between two bad lines")
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    text, bad = text_of(displaced(arguments.frames), arguments.bad_every)
    drive_text, _ = text_of(driven(arguments.frames), arguments.bad_every)
    short, short_bad = text_of(displaced(arguments.peer_frames), arguments.bad_every)
    found: dict[str, list[Result]] = {"displacements": [], "drive": [], "python-can": []}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        warm, _ = text_of(displaced(2000), 100)
        for make in (displacements, drive):
            make().feed(RX, HostText().received(warm), 0)
        for _ in range(arguments.repeats):
            found["displacements"].append(_on_pty(text, ours(path, arguments.frames, displacements)))
            path.unlink()
            found["drive"].append(_on_pty(drive_text, ours(path, arguments.frames, drive)))
            path.unlink()
            found["python-can"].append(_on_pty(short, lambda port, ready: peer(port, ready, arguments.peer_frames)))
    whole = {"displacements": (arguments.frames, bad), "drive": (arguments.frames // 2, bad)}
    sent = {**whole, "python-can": (arguments.peer_frames, short_bad)}
    all_frames = {"displacements": arguments.frames, "drive": arguments.frames, "python-can": arguments.peer_frames}
    rates = {name: [all_frames[name] / r.wall_s for r in results] for name, results in found.items()}
    cpu = {name: [all_frames[name] / r.processor_s for r in results] for name, results in found.items()}
    for name, results in found.items():
        arrived = ", ".join(sorted({f"{r.frames} samples and {r.bad} bad lines" for r in results}))
        wall, own = statistics.median(rates[name]), statistics.median(cpu[name])
        print(f"{name}: {wall:.0f} frames/s ({min(rates[name]):.0f} to {max(rates[name]):.0f}), {own:.0f} a second of")
        print(f"    processor time; {arrived}, of {sent[name][0]} and {sent[name][1]}")
    for name in ("displacements", "drive"):
        ratio = statistics.median(a / b for a, b in zip(rates[name], rates["python-can"], strict=True))
        print(f"{name} / python-can: {ratio:.1f}, median of {arguments.repeats} pairs")


if __name__ == "__main__":
    main()

"""A small log with every channel, made through the real recorder and pipelines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from daq.acquisition.effects import Keep
from daq.acquisition.recorder import Recorder
from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia402
from daq.drivers.devices import make_pipelines
from daq.drivers.optoncdt import distance_words, wire as optoncdt
from daq.drivers.rotorlink import wire as rotorlink
from daq.items import RX, Batch
from daq.transports import HostClock
from daq.transports.can_frames import CanFrame, encode
from rig_configs import load_rig


def device_bytes(
    steps: int = 10, opened_at: int | None = None, reported: tuple[int, ...] = ()
) -> list[tuple[str, bytes]]:
    """One read per device per step of 10 ms; locks open at a step, the node reports the pendulums in `reported`."""
    reads: list[tuple[str, bytes]] = []
    seq = 0
    for step in range(steps):
        number = 40 * step + np.arange(40)
        ticks = 25 * number + 1000
        codes = distance_words.code(0.0125 + 1e-3 * np.sin(0.05 * number), 0.025)
        words = np.column_stack([codes, number, ticks & 0xFFFF, ticks >> 16]).astype(np.uint32)
        counts = np.column_stack([10 * step + np.arange(10), np.full(10, 2048)]).astype(np.int32)
        is_open = opened_at is not None and step >= opened_at
        block = rotorlink.EncoderBlock(1, seq, 10 * step, 10_000 * step, 1000, 0 if is_open else 96, counts)
        mark = rotorlink.IndexMark(1, seq + 1, 10_000 * step + 9_500, step)
        seq += 2
        events = b""
        for pendulum in reported if step == opened_at else ():
            event = rotorlink.LockEvent(1, seq, 10_000 * step + 3_000, pendulum, 1, 7)
            events, seq = events + rotorlink.wire(event.pack()), seq + 1
        frame = CanFrame(cia301.cob_tpdo(1, 5), cia402.VELOCITY.pack(0x0237, 60 + step))
        reads += [
            ("laser_x", optoncdt.encode_block(words)),
            ("laser_y", optoncdt.encode_block(words)),
            ("encoder", rotorlink.wire(block.pack()) + rotorlink.wire(mark.pack()) + events),
            ("drive", encode(frame)),
        ]
    return reads


def write_small_log(path: Path, falsify: bool = False, **what: Any) -> Path:
    """Write it; with `falsify` one decoded sample differs from the raw bytes; `what` goes to device_bytes."""
    rig = load_rig("virtual")
    pipelines = make_pipelines(rig.devices, {})
    attachments: dict[str, bytes] = {
        "rig.json": rig.snapshot_json(),
        "roles.json": rig.roles_json(),
        "identities.json": b"{}",
    }
    recorder = Recorder(path, HostClock(), {"test": "small"}, attachments, tuple(pipelines))
    start = 1_700_000_000_000_000_000
    for i, (device, data) in enumerate(device_bytes(**what)):
        host_ns = start + 10_000_000 * (i // 4 + 1)
        items = pipelines[device].feed(RX, data, host_ns)
        if falsify and i == 4:
            items = [_falsified(item) if isinstance(item, Batch) else item for item in items]
        recorder.add(Keep(device, RX, data, tuple(items), host_ns))
    return recorder.close({"losses": {n: p.losses for n, p in pipelines.items()}})


def _falsified(batch: Batch) -> Batch:
    columns: dict[str, Any] = {k: np.array(v) for k, v in batch.columns.items()}
    columns["displacement_m"][3] += 1e-9
    return Batch(batch.channel, batch.time_ns, batch.sequence, columns)

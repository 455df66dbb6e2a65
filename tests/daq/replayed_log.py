"""A log as written by a rig: reads cut anywhere, both directions, health, the host's events; deterministic."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.channels import HEALTH_TOPIC
from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia402
from daq.drivers.devices import make_pipelines
from daq.drivers.optoncdt import distance_words, wire as optoncdt
from daq.drivers.rotorlink import wire as rotorlink
from daq.items import RX, TX, Batch, DeviceEvent
from daq.log import Log
from daq.log.file import LogFile
from daq.transports.can_frames import CanFrame, encode
from daq.version import DECODER
from rig_configs import load_rig
from tests.daq.can_text import tx

START_NS = 1_700_000_000_000_000_000
STEP_NS = 10_000_000
WORDS = ["DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI"]
IDENTITIES = {
    "laser_x": {"name": "ILD1420", "serial": "1", "range_m": 0.025, "version": "001.019", "words": WORDS},
    "laser_y": {"name": "ILD1420", "serial": "2", "range_m": 0.025, "version": "001.020", "words": WORDS},
    "encoder": {"driver": "rotorlink"},
    "drive": {"driver": "cia402", "node_id": 5},
}

Read = tuple[str, int, bytes, int]  # device, direction, bytes, host time in ns


def _laser(rng: np.random.Generator, step: int, lost: set[int], restarts_at: int | None) -> bytes:
    number = 40 * step + np.arange(40)
    codes = distance_words.code(0.0125 + 1e-3 * np.sin(0.05 * number) + 4e-6 * rng.standard_normal(40), 0.025)
    if restarts_at is not None and step >= restarts_at:
        number = number - 40 * restarts_at
    ticks = 25 * number + 1000
    words = np.column_stack([codes, number % 2**18, ticks & 0xFFFF, ticks >> 16]).astype(np.uint32)
    return b"" if step in lost else optoncdt.encode_block(words)


class _Node:
    """Encoder blocks, and index marks: one per step with closed locks, or one per turn of a rotor with open locks."""

    def __init__(self, marks_turn: bool) -> None:
        self._marks_turn, self._seq, self._turns = marks_turn, 0, 0.0
        self._flags = 0 if marks_turn else 96  # both locks closed, although A's counts go on

    def bytes_of(self, step: int, rpm: float) -> bytes:
        counts = np.column_stack([10 * step + np.arange(10), np.full(10, 2048)]).astype(np.int32)
        data = self._wire(rotorlink.EncoderBlock(1, self._seq, 10 * step, 10_000 * step, 1000, self._flags, counts))
        if not self._marks_turn:
            return data + self._wire(rotorlink.IndexMark(1, self._seq, 10_000 * step + 9_500, step))
        before, self._turns = self._turns, self._turns + rpm / 60 * 0.01
        if int(self._turns) == int(before):
            return data
        at_us = 10_000 * step + int(10_000 * (int(self._turns) - before) / (self._turns - before))
        return data + self._wire(rotorlink.IndexMark(1, self._seq, at_us, int(self._turns)))

    def _wire(self, frame: rotorlink.EncoderBlock | rotorlink.IndexMark) -> bytes:
        self._seq = (self._seq + 1) & 0xFFFF
        return rotorlink.wire(frame.pack())


def _frame(identifier: int, data: bytes) -> bytes:
    return encode(CanFrame(identifier, data))


def reads(
    steps: int,
    seed: int = 1,
    lost: frozenset[int] = frozenset(),
    restarts_at: int | None = None,
    rests_from: int | None = None,
) -> Iterator[Read]:
    """Reads and writes of a host in steps of 10 ms.

    Args:
        lost: steps whose samples of laser y are missing.
        restarts_at: step at which laser x starts its counters again.
        rests_from: step at which a rotor that slows down evenly, with one index mark per turn, stops; None: a wrong
                speed, with a mark in every step.
    """
    rng = np.random.default_rng(seed)
    kept: dict[str, bytes] = {}
    node = _Node(marks_turn=rests_from is not None)
    yield "drive", TX, tx(b"\rC\rS6\rO\r"), START_NS
    for step in range(steps):
        host_ns = START_NS + (step + 1) * STEP_NS
        if step % 7 == 3:
            command = cia402.VELOCITY.pack(15, 10 * step % 1000)
            yield "drive", TX, _frame(cia301.cob_rpdo(1, 5), command), host_ns - 200_000
            yield "drive", TX, _frame(cia301.cob_heartbeat(1), b"\x05"), host_ns - 150_000
            yield (
                "encoder",
                TX,
                rotorlink.wire(rotorlink.NodeCommand(1, step, rotorlink.ACTIONS["lock both"]).pack()),
                host_ns,
            )
        rpm = 60 + step % 1000 if rests_from is None else max(0, 1059 * (rests_from - step) // rests_from)
        status = _frame(cia301.cob_tpdo(1, 5), cia402.VELOCITY.pack(0x0237 if step < steps // 2 else 0x0240, rpm))
        came = {
            "laser_x": _laser(rng, step, set(), restarts_at),
            "laser_y": _laser(rng, step, set(lost), None),
            "encoder": node.bytes_of(step, rpm),
            "drive": status,
        }
        for i, (device, new) in enumerate(came.items()):
            data = kept.get(device, b"") + new
            cut = len(data) if step == steps - 1 else len(data) - int(rng.integers(0, 12))
            kept[device] = data[cut:]
            if data[:cut]:
                yield device, RX, data[:cut], host_ns + 1000 * i + int(rng.integers(0, 500_000))


Falsify = Callable[[int, Batch | DeviceEvent, int], tuple[Batch | DeviceEvent, "int | NDArray[np.int64]"] | None]


def as_it_is(number: int, item: Batch | DeviceEvent, host_ns: int) -> tuple[Batch | DeviceEvent, int]:
    """Return the item unchanged."""
    return item, host_ns


def write_log(
    path: Path,
    steps: int = 60,
    *,
    falsify: Falsify = as_it_is,
    finish: bool = True,
    unwritten_from: int | None = None,
    flush_steps: int = 5,
    decoder: str | None = str(DECODER),
    **what: Any,
) -> Path:
    """Write the log with the real pipelines; return the resulting file.

    Args:
        falsify: called with each item's number, the item and its host time; None omits the item.
        finish: False leaves a .part.
        unwritten_from: number of the read from which on raw bytes are written without their samples.
        decoder: fact of the log; None: it has no such fact.
        what: arguments of `reads`.
    """
    rig = load_rig("virtual")
    attachments = {"rig.json": rig.snapshot_json(), "identities.json": json.dumps(IDENTITIES).encode()}
    pipelines = make_pipelines(rig.devices, IDENTITIES)
    facts = {"test": "point-A", "rig": "virtual", "software": "0.0.1", "note": "springs changed"}
    facts |= {} if decoder is None else {"decoder": decoder}
    count = 0
    with LogFile(path, facts, attachments, tuple(pipelines), START_NS) as log:
        for number, (device, direction, data, host_ns) in enumerate(reads(steps, **what)):
            log.raw(device, direction, data, host_ns)
            for item in pipelines[device].feed(direction, data, host_ns):
                kept = falsify(count, item, host_ns)
                count += 1
                if kept is None or (unwritten_from is not None and number >= unwritten_from):
                    continue
                if isinstance(kept[0], Batch):
                    log.batch(kept[0], kept[1])
                else:
                    log.event(kept[0], host_ns)
            if number % (4 * flush_steps) == 0:
                losses = {name: pipeline.losses for name, pipeline in pipelines.items()}
                log.note(
                    HEALTH_TOPIC, {"kind": "health", "device": "host", "text": "", "losses": losses}, host_ns, host_ns
                )
                log.flush()
            if number == 50:
                log.event(DeviceEvent("disk", "host", "the disk is slow", {"backlog_bytes": 7}), host_ns)
        log.flush()
        if finish:
            losses = {name: pipeline.losses for name, pipeline in pipelines.items()}
            return log.finish({"losses": losses, "ended": "duration", "verdict": {"settled": True}})
    return log.part


def from_device(log: Log, device: str) -> bytes:
    """What a device of the log sent."""
    return b"".join(chunk.data for chunk in log.raw(device) if chunk.direction == RX)

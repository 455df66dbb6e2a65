"""CAN frames of a drive, and writing them: as our log keeps them, and by python-can's own loggers."""

from __future__ import annotations

import os
import sqlite3
import warnings
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import can
import numpy as np
from can.io.generic import MessageWriter

from benchmarks.laser_samples import START_NS
from daq import channels
from daq.drivers.canopen import cia301
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.stream import DrivePipeline
from daq.items import RX, Batch
from daq.mcap.writer import BlockWriter
from daq.transports.can_frames import CanFrame, encode
from rig_configs import load_rig

PERIOD_NS = 1_000_000  # 1 kHz
PER_READ = 10
FRAME = channels.Channel(
    "can/drive", "rig.CanFrame", (("arbitration_id", "fixed32"), ("length", "fixed32"), ("data", "fixed64"))
)
_sync = getattr(os, "fdatasync", os.fsync)

Reads = list[tuple[int, list[CanFrame], bytes]]


def drive_frames(count: int) -> list[CanFrame]:
    """Status and speed of a drive that holds its speed but for noise."""
    node = load_rig("virtual").devices["drive"].node_id
    speeds = np.rint(600 + 2 * np.random.default_rng(1).standard_normal(count)).astype(int)
    return [CanFrame(cia301.cob_tpdo(1, node), cia402.VELOCITY.pack(0x0237, int(rpm))) for rpm in speeds]


def raw_reads(frames: list[CanFrame]) -> Reads:
    """Host time, frames and records of reads of `PER_READ` frames."""
    groups = [frames[first : first + PER_READ] for first in range(0, len(frames), PER_READ)]
    return [(START_NS + PERIOD_NS * PER_READ * number, group, encode(*group)) for number, group in enumerate(groups)]


def python_can_messages(frames: list[CanFrame]) -> list[can.Message]:
    """The same as python-can has them."""
    return [
        can.Message((START_NS + PERIOD_NS * number) / 1e9, frame.arbitration_id, is_extended_id=False, data=frame.data)
        for number, frame in enumerate(frames)
    ]


def _write(path: Path, fill: Callable[[BlockWriter], None]) -> None:
    with path.open("wb") as stream:
        writer = BlockWriter(stream)
        writer.start()
        fill(writer)
        writer.finish()
        _sync(stream.fileno())


def _raw_channel(writer: BlockWriter) -> int:
    schema = writer.register_schema(channels.RAW_SCHEMA_NAME, "protobuf", channels.raw_descriptor_set())
    return writer.register_channel(channels.raw_topic("drive"), "protobuf", schema)


def _sample_channel(writer: BlockWriter, channel: channels.Channel) -> int:
    schema = writer.register_schema(channel.schema_name, "protobuf", channel.file_descriptor_set())
    return writer.register_channel(channel.topic, "protobuf", schema)


def write_raw(path: Path, reads: Reads) -> None:
    """The records of each read."""

    def fill(writer: BlockWriter) -> None:
        raw = _raw_channel(writer)
        for host_ns, _, text in reads:
            writer.add_message(raw, host_ns, host_ns, 0, channels.pack_raw(channels.RX, text))

    _write(path, fill)


def write_raw_and_decoded(path: Path, reads: Reads) -> None:
    """The text of each read and the motor samples decoded from it, as a recording does."""

    def fill(writer: BlockWriter) -> None:
        raw, motor = _raw_channel(writer), _sample_channel(writer, channels.MOTOR)
        pipeline = DrivePipeline("drive", load_rig("virtual").devices["drive"], {})
        for host_ns, _, text in reads:
            writer.add_message(raw, host_ns, host_ns, 0, channels.pack_raw(channels.RX, text))
            for item in pipeline.feed(RX, text, host_ns):
                if isinstance(item, Batch):
                    packed = channels.MOTOR.pack(item.columns)
                    writer.add_block(motor, host_ns, item.time_ns, item.sequence, packed)

    _write(path, fill)


def write_messages(path: Path, reads: Reads) -> None:
    """One message per frame, from the frames as objects."""

    def fill(writer: BlockWriter) -> None:
        channel, number = _sample_channel(writer, FRAME), 0
        for host_ns, frames, _ in reads:
            data = np.frombuffer(b"".join(frame.data.ljust(8, b"\0") for frame in frames), "<u8")
            columns: dict[str, Any] = {
                "arbitration_id": [frame.arbitration_id for frame in frames],
                "length": [len(frame.data) for frame in frames],
                "data": data,
            }
            numbers = number + np.arange(len(frames))
            writer.add_block(channel, host_ns, START_NS + PERIOD_NS * numbers, numbers, FRAME.pack(columns))
            number += len(frames)

    _write(path, fill)


OURS: dict[str, Callable[[Path, Reads], None]] = {
    "raw records + decoded": write_raw_and_decoded,
    "raw records": write_raw,
    "one message per frame": write_messages,
}

PYTHON_CAN: dict[str, Callable[[Path], MessageWriter]] = {
    "BLF": can.BLFWriter,
    "ASC": can.ASCWriter,
    "candump .log": can.CanutilsLogWriter,
    "CSV": can.CSVWriter,
    "sqlite .db": can.SqliteWriter,
}


def write_python_can(path: Path, make: Callable[[Path], MessageWriter], messages: list[can.Message]) -> None:
    """Every frame through one of python-can's loggers."""
    logger = make(path)
    for message in messages:
        logger.on_message_received(message)
    logger.stop()
    if isinstance(logger, can.SqliteWriter):
        with closing(sqlite3.connect(path)) as database:
            (kept,) = database.execute("SELECT count(*) FROM messages").fetchone()
        if kept != len(messages):
            warnings.warn(f"python-can's sqlite log holds {kept} of {len(messages)} frames", stacklevel=2)
    with path.open("r+b") as stream:
        _sync(stream.fileno())

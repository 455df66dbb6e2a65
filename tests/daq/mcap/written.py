"""MCAP files made in memory: by the project's writer, and by the library's as another program would."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import mcap.writer
import numpy as np
from numpy.typing import ArrayLike, NDArray

from daq.channels import TACHO, Channel
from daq.mcap.writer import BlockWriter

T0 = 1_700_000_000_000_000_000


def written(fill: Callable[[BlockWriter], object], *, finish: bool = True, **options: Any) -> bytes:
    """Bytes of a file whose contents `fill` adds; without `finish` those of a recording that was cut."""
    stream = io.BytesIO()
    writer = BlockWriter(stream, **options)
    writer.start("rig")
    fill(writer)
    (writer.finish if finish else writer.flush)()
    return stream.getvalue()


def foreign(fill: Callable[[mcap.writer.Writer], object], library: str = "another program", **options: Any) -> bytes:
    """Bytes of a file of another program, whose contents `fill` adds."""
    stream = io.BytesIO()
    writer = mcap.writer.Writer(stream, **options)
    writer.start(library=library)
    fill(writer)
    writer.finish()
    return stream.getvalue()


def fresh() -> BlockWriter:
    """A writer whose file is of no interest."""
    writer = BlockWriter(io.BytesIO())
    writer.start()
    return writer


def add_channel(writer: BlockWriter | mcap.writer.Writer, channel: Channel = TACHO, topic: str = "") -> int:
    """Register a channel with its schema; return its number."""
    schema = writer.register_schema(channel.schema_name, "protobuf", channel.file_descriptor_set())
    return writer.register_channel(topic or channel.topic, "protobuf", schema)


def marks(numbers: int | ArrayLike) -> NDArray[Any]:
    """Messages of index marks with these numbers, or with those below a number."""
    turns = np.arange(numbers) if isinstance(numbers, int) else np.asarray(numbers)
    return TACHO.pack({"revolutions": turns, "node_time_us": 1000 * turns})

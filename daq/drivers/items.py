"""What pipelines give: samples in batches, and events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq import channels

RX, TX = 0, 1


@dataclass(frozen=True)
class Batch:
    """Samples of one channel from one read.

    Attributes:
        channel: the log channel.
        time_ns: sample times on the common clock, int64, shape (n,).
        sequence: device counters, uint32, shape (n,).
        columns: the channel's fields, each of shape (n,).
    """

    channel: channels.Channel
    time_ns: NDArray[np.int64]
    sequence: NDArray[np.uint32]
    columns: Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Event:
    """Something that happened on a device: a gap, a released lock, an answer, damage.

    Attributes:
        kind: "gap", "damage", "restart", "lock", "acknowledge", "reply", "status", "emergency", "drive", "fault".
        facts: numbers and words that go into the log with it.
    """

    kind: str
    device: str
    text: str
    facts: Mapping[str, Any] = field(default_factory=dict)


def joined(arrived: Sequence[tuple[Batch, int]]) -> tuple[Batch, NDArray[np.int64]]:
    """Batches of one channel as one, and the host time of each sample.

    Args:
        arrived: at least one batch, each with its host time, ns.
    """
    batches = [batch for batch, _ in arrived]
    columns = {name: np.concatenate([b.columns[name] for b in batches]) for name in batches[0].columns}
    together = Batch(
        batches[0].channel,
        np.concatenate([b.time_ns for b in batches]),
        np.concatenate([b.sequence for b in batches]),
        columns,
    )
    return together, np.repeat(np.array([ns for _, ns in arrived], np.int64), [len(b.time_ns) for b in batches])

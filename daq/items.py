"""Output of pipelines: batches of samples, and events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq import channels
from rig_basics.texts import number_of

RX, TX = 0, 1


@dataclass(frozen=True)
class Batch:
    """Samples of one channel from one read.

    Attributes:
        channel: the log channel.
        time_ns: sample times on the common clock, int64, shape (n,).
        sequence: device counters, uint32, shape (n,).
        columns: values of the channel's fields, by name, each of shape (n,).
    """

    channel: channels.Channel
    time_ns: NDArray[np.int64]
    sequence: NDArray[np.uint32]
    columns: Mapping[str, NDArray[Any]]


LOSS_KINDS = ("gap", "damage", "marks", "clock")
"""Kinds of events about what is missing or contradicts itself: samples; bytes and frames; index marks; a clock."""


SILENT_MS = "_silent_ms"
"""Ending of the kind of loss that is the duration of a channel's silence."""


def loss_words(number: int, kind: str) -> str:
    """Return a loss with its number, for example "1 radio frame", "2 radio frames", "3 damaged".

    Args:
        number: how many.
        kind: key of the count, for example "radio_frames" or "laser_x.samples".
    """
    words = kind.replace("_", " ").replace(".", " ")
    plural = words.endswith("s") and not kind.endswith(SILENT_MS)
    return number_of(number, words.removesuffix("s") if plural else words, words)


@dataclass(frozen=True)
class DeviceEvent:
    """An event of a device: a gap, a released lock, an answer, damage.

    Attributes:
        kind: one of LOSS_KINDS, "restart", "lock", "acknowledge", "reply", "status", "emergency", "drive", "fault".
        device: name of the device in the rig file.
        text: description for the log and the operator; of a reply the answer itself.
        facts: numbers and strings that are written to the log with the event.
    """

    kind: str
    device: str
    text: str
    facts: Mapping[str, Any] = field(default_factory=dict[str, Any])


def joined(arrived: Sequence[tuple[Batch, int]]) -> tuple[Batch, NDArray[np.int64]]:
    """Join batches of one channel.

    Args:
        arrived: at least one batch, each with its host time, ns since 1970.

    Returns:
        The joined batch, and the host time of each of its samples, ns since 1970, shape (n,).
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

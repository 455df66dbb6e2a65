"""Messages with a number: what numbers them, and what is handed on when they have a place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray


class Rows(Protocol):
    """Contents of consecutive messages, for example a list or an array."""

    def __getitem__(self, part: slice, /) -> Self: ...


R = TypeVar("R", bound=Rows)
T = TypeVar("T")


@dataclass(frozen=True)
class Count:
    """Numbers of a sender's messages.

    Attributes:
        size: number of different numbers; 1 if messages have none.
        period_ns: time between two messages by the rig file, ns.
        step: numbers from one message to the next.
        clock_size: number of different times of the sender's clock; 0 without one.
        clock_step: its step from one message to the next.
        late_messages: number of messages by which one may come late, or once more; 0 of a line that keeps their order.
        is_checked: whether a message with a damaged number is impossible.
        look_ahead_ns: longest time for which messages after a gap wait for those that fill it, ns; 0 of a line that
            keeps their order. Their step is 1.
    """

    size: int
    period_ns: float
    step: float = 1.0
    clock_size: int = 0
    clock_step: float = 1.0
    late_messages: int = 0
    is_checked: bool = True
    look_ahead_ns: float = 0.0


@dataclass(frozen=True)
class Stretch(Generic[R]):
    """Consecutive messages of one read.

    Attributes:
        numbers: continuous numbers, int64, shape (n,); those after a new start begin with the sender's own.
        rows: their contents.
        host_ns: host time of the read, ns.
        lost: number of messages missing before them.
        is_about: whether `lost` is an estimate from the host's time.
        is_restart: whether the sender started again before them.
    """

    numbers: NDArray[np.int64]
    rows: R
    host_ns: int
    lost: int = 0
    is_about: bool = False
    is_restart: bool = False


@dataclass(frozen=True)
class Message(Generic[R]):
    """A message with the place that it has if no whole cycle is missing before it.

    Attributes:
        number, time: as received; `time` of its sender's clock.
        place: continuous number.
        missing: number of messages missing before it, after the one before it.
        cycle_ns: time after which number and clock are the same again, ns.
        late_ns: lateness at this place, ns.
        at_ns, host_ns: time of its arrival, estimated from those after it in its read, and of the read, ns.
        row: its content.
    """

    number: int
    time: int
    place: int
    missing: int
    cycle_ns: float
    late_ns: float
    at_ns: int
    host_ns: int
    row: R


def chained(parts: Sequence[list[T]]) -> list[T]:
    """Join the contents of messages that are lists."""
    return [each for part in parts for each in part]

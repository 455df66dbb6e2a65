# pyright: strict
"""What a driver brings, and all that anything above it may ask.

A driver is one object, found by its name in the entry-point group `rig.drivers` (`daq.drivers.registry`). It holds no
state of a device: what belongs to an open device is in its pipeline. Settings are the device's own table of the rig
file.
"""

from __future__ import annotations

import queue
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from daq.channels import Channel
from daq.drivers.items import Batch, Event


@dataclass(frozen=True)
class Line:
    """What carries a device's bytes.

    Attributes:
        port: serial port, `tcp://host:port`, or a CAN adapter's.
        baud: of a serial port.
        bitrate: of the CAN bus behind an adapter, bit/s; None where there is none.
    """

    port: str
    baud: int
    bitrate: int | None = None


@dataclass(frozen=True)
class SampleClock:
    """A channel whose samples bear the time of a clock in the device.

    Attributes:
        topic: of the channel.
        rate_Hz: how many samples a second the device is set to.
        tolerance_ppm: standard uncertainty of the clock's rate.
        field, tick_ns: the channel's field that holds its time, and that field's unit.
        count_wrap: where the sequence number of the samples wraps.
    """

    topic: str
    rate_Hz: float
    tolerance_ppm: float
    field: str
    tick_ns: int
    count_wrap: int


class Pipeline(Protocol):
    """What turns one device's bytes into samples. It does no I/O and reads no clock.

    Live recording and replay run the same object on the same bytes with the same host times, so that a log's raw
    bytes decoded again give its decoded channels bit for bit.

    Attributes:
        losses: counted so far, by kind.
    """

    losses: dict[str, int]

    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | Event]:
        """Take one read (RX) or one write (TX) with the host time it happened."""
        ...


class Talk(Protocol):
    """An open device while a driver talks to it."""

    @property
    def replies(self) -> queue.Queue[str]:
        """Its answers, lines as the pipeline finds them."""
        ...

    @property
    def bytes_in(self) -> int:
        """How many bytes have come so far."""
        ...

    def send(self, data: bytes) -> None:
        """Write to it.

        Raises:
            LinkLost: it is gone.
        """
        ...

    def begin_anew(self) -> None:
        """Forget what was decoded so far: a fresh pipeline takes what comes from here on."""
        ...


class Driver(Protocol):
    """One kind of device."""

    @property
    def name(self) -> str:
        """As in a rig file's `driver = "…"`."""
        ...

    @property
    def rest_s(self) -> float:
        """How long its reader may rest between two looks at the line, rig s: short where the host's time counts."""
        ...

    def line(self, settings: Any) -> Line:
        """What carries the bytes of a device with these settings."""
        ...

    def channels(self, settings: Any) -> tuple[Channel, ...]:
        """Those that a healthy device fills all the time."""
        ...

    def clocks(self, settings: Any) -> tuple[SampleClock, ...]:
        """Of its channels, those on a clock of its own."""
        ...

    def pipeline(self, device: str, settings: Any, identity: Mapping[str, Any]) -> Pipeline:
        """A fresh one.

        Args:
            device: the device's name in the rig file.
            identity: what the device said of itself when it was opened; empty where nobody asked.

        Raises:
            DeviceError: an identity that no such device can have.
        """
        ...

    def prepare(self) -> None:
        """Load what takes long to load, before any byte waits for it."""
        ...

    def open(self, device: str, settings: Any, talk: Talk) -> dict[str, Any]:
        """Ask who it is, set it up, start its stream.

        Returns:
            Its identity, plain words and numbers: all that its pipeline has to know beside the settings.

        Raises:
            DeviceError: no answer, a refusal, or a device that is not what the rig file says.
        """
        ...

    def stop(self, talk: Talk) -> None:
        """End its stream; it may be gone.

        Raises:
            LinkLost, DeviceError: it is.
        """
        ...

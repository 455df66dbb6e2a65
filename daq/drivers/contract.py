"""Objects of an open device: what the layers above use of it, and what its driver may use."""

from __future__ import annotations

import math
import queue
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Literal, Protocol

from daq.clock import ClockSeed
from daq.items import Batch, DeviceEvent
from rig_basics.texts import number_of

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


ADAPTER_BAUD = 115_200
"""Line rate of the serial port of an adapter to a bus, baud; an adapter with USB ignores it."""


@dataclass(frozen=True)
class DeviceLine:
    """The line that carries a device's bytes.

    Attributes:
        port: port in the notation of `daq.transports.open_link`.
        baud: line rate of a serial port, baud; 0 of a port on the network.
        bitrate: bit rate of the CAN bus behind an adapter, bit/s; None without a bus.
        parity: parity of a serial port: none, even or odd.
        stop_bits: stop bits of a serial port.
    """

    port: str
    baud: int = 0
    bitrate: int | None = None
    parity: Literal["N", "E", "O"] = "N"
    stop_bits: Literal[1, 2] = 1

    @classmethod
    def of(cls, settings: Any) -> DeviceLine:
        """Return the line with the port, rates, parity and stop bits that a device's settings have."""
        names = [each.name for each in fields(cls) if hasattr(settings, each.name)]
        given: dict[str, Any] = {"baud": ADAPTER_BAUD} if "bitrate" in names else {}
        return cls(**given | {name: getattr(settings, name) for name in names})


@dataclass(frozen=True)
class SampleClock:
    """A channel whose samples contain the time of a clock in the device.

    Attributes:
        topic: topic of the channel.
        rate_Hz: sample rate to which the device is set, Hz.
        tolerance_ppm: standard uncertainty of the clock's rate, ppm.
        field: the channel's field that contains the clock's time.
        tick_ns: unit of that field, ns.
        count_wrap: modulus of the samples' sequence number.
    """

    topic: str
    rate_Hz: float
    tolerance_ppm: float
    field: str
    tick_ns: int
    count_wrap: int


FOREIGN = "foreign_"
"""Prefix of the kinds of `Pipeline.losses` that count messages of other devices."""


@dataclass(frozen=True)
class PipelineStatus:
    """What a pipeline has found about its device so far, in addition to samples and events.

    The defaults are those of a device that reports nothing of itself and has no clock.

    Attributes:
        has_reported: whether the device has reported its own configuration; True if such a device does not report it.
        complaint: the contradiction between this report and the rig file that makes the samples invalid; empty
            without a contradiction.
        set_up_lost: what shows that the device sends, but no longer as it was set up, for example after a power cut: a
            clause for the operator, empty without such a sign. The session opens such a device again, as it does with
            a silent one. The bytes sent by `Driver.open` reset it.
        clock_seed: state of the map of the device's clock, with which the next log starts; None if the next log cannot
            use it.
        clock_std_ns: standard uncertainty of the newest sample's time, ns (`ClockMap.std_ns`); NaN if it is unknown.
        learned: identity derived from the received bytes, part of the device's identity from the next log on; None if
            the bytes of such a device do not identify it.
        heard_frames: numbers, modulo 65536, of the first and of the newest frame received by radio; None before the
            first.
    """

    has_reported: bool = True
    complaint: str = ""
    set_up_lost: str = ""
    clock_seed: ClockSeed | None = None
    clock_std_ns: float = math.nan
    learned: Mapping[str, str | int] | None = None
    heard_frames: tuple[int, int] | None = None


class Pipeline(ABC):
    """Decoder of one device's bytes to samples and events. It does no I/O and reads no clock.

    Live recording and replay run the same object on the same bytes with the same host times. Decoding the raw bytes of
    a log again therefore reproduces its decoded channels bit for bit.

    Args:
        device: name of the device in the rig file.
        kinds: kinds of losses that are counted.

    Attributes:
        losses: number of losses so far, by kind. A kind that begins with `FOREIGN` counts messages of other devices,
            which are not losses.
    """

    def __init__(self, device: str, *kinds: str) -> None:
        self.losses: dict[str, int] = dict.fromkeys(kinds, 0)
        self._device = device

    @abstractmethod
    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | DeviceEvent]:
        """Decode the bytes of one read (RX) or one write (TX).

        A read without bytes marks the end of the log: samples that were held back are returned.

        Args:
            direction: RX or TX.
            data: the bytes.
            host_ns: host time of the read or write, ns since 1970.
        """

    @property
    def status(self) -> PipelineStatus:
        """What has been found about the device. Another thread may call `feed` meanwhile."""
        return PipelineStatus()

    def damage(self, loss: str, text: str, count: int = 1, **facts: Any) -> DeviceEvent:
        """Count what is dropped as damaged, a kind of `losses`, and return its event with the facts."""
        self.losses[loss] += count
        return DeviceEvent("damage", self._device, text, facts)

    def skipped_bytes(self, count: int, unit: str) -> DeviceEvent:
        """Count skipped bytes and return their event. `unit` is what they should be part of, for example "packet"."""
        belong = number_of(count, "byte skipped that belongs", "bytes skipped that belong")
        return self.damage("bytes", f"{belong} to no {unit}", count, bytes=count)

    def lost_samples(self, lost: int, span_s: float, **facts: Any) -> DeviceEvent:
        """Count missing samples; return their event.

        Args:
            lost: their number.
            span_s: their duration, s.
            facts: further facts, such as `time_ns`, the time of the sample after them.
        """
        self.losses["samples"] += lost
        text = f"{number_of(lost, 'sample')} lost ({span_s * 1e3:.2f} ms)"
        return DeviceEvent("gap", self._device, text, {"samples": lost, "span_s": span_s, **facts})


class Talk(Protocol):
    """An open device during a dialogue of its driver: set-up, identification or stop."""

    @property
    def clock(self) -> HostClock:
        """Clock for every wait of the dialogue."""
        ...

    @property
    def replies(self) -> queue.Queue[str]:
        """Answers of the device: the texts of the pipeline's `reply` events."""
        ...

    @property
    def bytes_in(self) -> int:
        """Number of bytes received so far."""
        ...

    def send(self, data: bytes) -> None:
        """Write bytes to the device.

        Raises:
            LinkLost: the connection to the device is lost.
        """

    def restart_decoding(self) -> None:
        """Discard the state of decoding: a new pipeline decodes the bytes from here on."""


# --- commands of a device --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RotorGuard:
    """Conditions that a speed source queries before it turns the rotor and while it stops the rotor.

    Attributes:
        permit: called with each speed, rpm, before it is sent, and with None before the device is enabled. It raises
            if the rotor must not turn at that speed.
        at_rest: returns whether the rotor stands, from all devices; None if unknown.
        speed_rpm: returns the speed of the rotor, rpm, from all devices; NaN if unknown.
    """

    permit: Callable[[float | None], None]
    at_rest: Callable[[], bool | None]
    speed_rpm: Callable[[], float]


@dataclass(frozen=True)
class TimeOut:
    """Time-out of a speed source: the silence of the host after which it stops the rotor by itself.

    Attributes:
        measured_s: time from the last sign of life to the report that it is missing, s; None without such a report.
        stated_s: time-out that the device states, or that it must have by the rig file, s; None without either.
        resolution_s: uncertainty of `measured_s` from the periods of messages and reports, s.
    """

    measured_s: float | None
    stated_s: float | None
    resolution_s: float


class SpeedControl(Protocol):
    """An open device that turns the rotor; `daq.drivers.host_command.HostCommand` has what such devices share."""

    was_reset: str
    """Text for the operator about a fault that `enable` found and reset; empty without such a fault."""
    dropped_out: str | None
    """State that the device entered by itself while it should have been running; None if it did not."""

    @property
    def actual_rpm(self) -> float:
        """Speed as the device reports it, rpm; NaN if the newest report is too old."""
        ...

    @property
    def enabled(self) -> bool:
        """Whether the device holds the rotor's speed, from its newest report."""
        ...

    def notice(self, pipeline: Pipeline) -> None:
        """Read the new reports from the pipeline. The device's reader calls this after each `feed`."""

    @property
    def state(self) -> str:
        """State in the device's newest report."""
        ...

    def fault_code(self) -> int | None:
        """Query the code of the present fault; None if the device does not report it."""
        ...

    def why(self) -> str:
        """Return the reported cause of a stop, to be appended to a message; empty if none was reported."""
        ...

    def start(self) -> None:
        """Set up the device while the rotor stands."""

    def enable(self) -> None:
        """Hold speed 0."""

    def set_ramp(self, rpm_per_s: float) -> None:
        """Set the rate of speeding up and slowing down, rpm/s."""

    def set_speed(self, rpm: float) -> None:
        """Ramp to a speed, rpm."""

    def disable(self) -> None:
        """Release the rotor, which stands.

        Raises:
            DeviceError: the device does not release it, or does not confirm the release.
            LinkLost: the connection to the device is lost.
        """

    def quick_stop(self) -> None:
        """Stop the rotor as fast as the device can."""

    def stop(self, notify: Callable[[str], None] = ...) -> bool:
        """Stop the rotor, then release it. The commands are also sent to a device that does not answer.

        Args:
            notify: called with a text about each step that is waited for or could not be confirmed.

        Returns:
            Whether it is confirmed that the rotor stands and that the device has released it.

        Raises:
            LinkLost, DeviceError: the connection to the device is lost.
        """
        ...

    def pause(self) -> None:
        """Send no requests between the commands until `start`: the driver's dialogue opens the device again."""
        return

    def measure_time_out(self) -> TimeOut | None:
        """Withhold the signs of life until the device reports that they are missing, then send them again.

        Returns:
            The time-out; None if the device does not report a missing host while the rotor stands without torque.

        Raises:
            DeviceError: the rotor turns or is held, or the device does not answer.
            LinkLost: the connection to the device is lost.
        """
        return None


class LockControl(Protocol):
    """An open device that locks and releases the pendulums."""

    def command(self, action: str, check: Callable[[], None]) -> None:
        """Send a command until the device acknowledges it.

        Args:
            action: "lock both", "release both", "lock A", …, or "zero": define the present angles as those of closed
                locks.
            check: called during the wait; it raises to end the wait.

        Raises:
            DeviceError: the device refuses or does not answer.
        """

    def heard(self, event: DeviceEvent) -> None:
        """Take an acknowledgement of the device."""

    def measure_round_trip(self) -> float | None:
        """Send requests, and compare the times of their arrival on the common clock with those of sending.

        The map of the device's clock lacks the least delay of the way to the host, beyond the stated one. The least
        difference is therefore the least delay of the whole way, there and back, less the stated one.

        Returns:
            The least difference, s; None without an answer, or if the device does not answer with the time, on its
            clock, at which a request arrived.

        Raises:
            LinkLost: the connection to the device is lost.
        """
        return None


class Poller(Protocol):
    """Sends the requests of an open device that answers only on request."""

    def start(self) -> None:
        """Begin to send requests, after the device was opened, and again after it was opened again."""

    def heard(self, data: bytes) -> None:
        """Take bytes of the device. The device's reader calls this after the bytes were logged; it must not wait."""

    def stop(self) -> None:
        """End the requests, before the device is stopped or opened again."""

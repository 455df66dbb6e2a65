# pyright: strict
"""What a driver brings, and all that anything above it may ask.

A driver is one object, found by its name in the entry-point group `rig.drivers` (`daq.drivers.registry`). It holds no
state of a device: what belongs to an open device is in its pipeline. Settings are the device's own table of the rig
file.
"""

from __future__ import annotations

import queue
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol, runtime_checkable

from daq.channels import Channel
from daq.clock import ClockSeed
from daq.drivers.checks import Checks
from daq.drivers.items import Batch, Event
from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd
from rig_configs.device import DeviceSettings

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock


@dataclass(frozen=True)
class Line:
    """What carries a device's bytes.

    Attributes:
        port: as `daq.transports.open_link` takes it.
        baud: of a serial port.
        bitrate: of the CAN bus behind an adapter, bit/s; None where there is none.
        parity: of a serial port: none, even or odd.
    """

    port: str
    baud: int
    bitrate: int | None = None
    parity: Literal["N", "E", "O"] = "N"


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


FOREIGN = "foreign_"


class Pipeline(Protocol):
    """What turns one device's bytes into samples. It does no I/O and reads no clock.

    Live recording and replay run the same object on the same bytes with the same host times, so that a log's raw
    bytes decoded again give its decoded channels bit for bit.

    Attributes:
        losses: counted so far, by kind. A kind that begins with `FOREIGN` counts messages of other devices, which are
            no loss.
    """

    losses: dict[str, int]

    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | Event]:
        """Take one read (RX) or one write (TX) with the host time it happened.

        A read without bytes tells that the log ends: what still waits for bytes to come is handed out.
        """
        ...


@runtime_checkable
class TellsItself(Protocol):
    """A pipeline of a device that says now and then what it is, unasked.

    Attributes:
        told: whether it has.
        complaint: what of it the rig file says otherwise, so that its samples cannot be believed; empty when nothing.
    """

    told: bool
    complaint: str


@runtime_checkable
class KeepsTime(Protocol):
    """A pipeline that knows how its device's clock stands: the next log's begins with it, in its identity."""

    @property
    def clock_seed(self) -> ClockSeed | None:
        """See ClockMap.seed."""
        ...


@runtime_checkable
class LearnsIdentity(Protocol):
    """A pipeline of a device that is known by what it sends, where nobody can ask it."""

    @property
    def learned(self) -> Mapping[str, str | int]:
        """What it is by its own bytes: part of its identity from the next log on."""
        ...


@runtime_checkable
class CountsFrames(Protocol):
    """A pipeline of frames that came by radio.

    Attributes:
        heard_frames: numbers, modulo 65536, of the first and of the newest frame; None before the first.
    """

    heard_frames: tuple[int, int] | None


class Talk(Protocol):
    """An open device while a driver talks to it."""

    @property
    def clock(self) -> HostClock:
        """What a dialogue waits by."""
        ...

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
    def settings(self) -> type[DeviceSettings]:
        """Of a device's table in the rig file; they say which roles the device plays."""
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

    def occasional(self, settings: Any) -> tuple[Channel, ...]:
        """Those that it fills now and then: index marks come only from a rotor that turns."""
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

    def words(self, event: Event) -> str:
        """An emergency of a device, for its operator; empty when it is one that has passed."""
        ...

    def checks(self, settings: Any, pipeline: Pipeline, control: SpeedSource | None, events: Sequence[Event]) -> Checks:
        """What only it can look at in an open device, beside what every device of its roles is looked at for.

        Args:
            pipeline: of the device, after some seconds of stream.
            control: who holds the device, where it turns the rotor.
            events: of the device in those seconds.
        """
        ...

    def far_end(self, device: str, settings: Any, world: Any) -> FarEnd:
        """A simulated device.

        Args:
            world: a `daq.virtual_rig.world.World`.
        """
        ...

    def played(self, settings: Any, identity: Mapping[str, Any]) -> PlayedDevice:
        """What stands in for a device of a log while it is played.

        Raises:
            LogError: an identity no such device has.
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


# --- what a driver may state of itself -------------------------------------------------------------------------
#
# A driver may have three attributes more. A test kit and a list of drivers read them; nothing else does.


def example_of(driver: Driver) -> dict[str, Any]:
    """The optional attribute `example`: settings of a device, by name, beside `driver` and `port`.

    It is needed where the settings class has fields without a default; without it those fields are all there are.
    """
    return dict(getattr(driver, "example", {}))


CLAIMS = {
    "checksum": "every message bears a check of 16 bits or more: a damaged one gives no sample",
    "counts exactly": 'losses["samples"] is the number of samples that are missing between two that came',
    "falls silent": "after its stop the device sends nothing until it is opened again",
}
"""What a driver may claim of its device's wire, and what each claim means. A claim makes tests stricter."""


def claims_of(driver: Driver) -> frozenset[str]:
    """The optional attribute `claims`: words of CLAIMS; none by default."""
    return frozenset(getattr(driver, "claims", ()))


def is_verified(driver: Driver) -> bool:
    """The optional attribute `verified`: whether the driver has been tried on the hardware itself; False by default."""
    return bool(getattr(driver, "verified", False))


# --- what a device can be asked to do --------------------------------------------------------------------------


@dataclass(frozen=True)
class RotorGuard:
    """What a speed source asks before it turns the rotor, and while it stops it.

    Attributes:
        permit: called with each speed, rpm, before the device is told, with None before it is enabled; raises where the
            rotor must not turn so.
        at_rest: whether the rotor stands, by all that is known; None when nobody can tell.
        speed_rpm: how fast it turns, by all that is known; NaN when nobody can tell.
    """

    permit: Callable[[float | None], None]
    at_rest: Callable[[], bool | None]
    speed_rpm: Callable[[], float]


class SpeedSource(Protocol):
    """An open device that turns the rotor."""

    was_reset: str
    """What `enable` found and reset, for whoever runs the rig; empty when nothing."""

    @property
    def actual_rpm(self) -> float:
        """Its own word on its speed; NaN where that is too old to be one."""
        ...

    @property
    def enabled(self) -> bool:
        """Whether it holds the rotor's speed, by its own newest word."""
        ...

    @property
    def dropped_out(self) -> str | None:
        """The state it fell into by itself while it should have been running."""
        ...

    def notice(self, pipeline: Pipeline) -> None:
        """Its reader has just fed its pipeline."""
        ...

    @property
    def state(self) -> str:
        """Its state as it last told, in its own words."""
        ...

    def fault_code(self) -> int | None:
        """Why it stands in a fault, asked anew; None when it does not tell."""
        ...

    def why(self) -> str:
        """What it says of why it stopped, to stand behind a message; empty when nothing."""
        ...

    def start(self) -> None:
        """Set it up, rotor at rest."""
        ...

    def enable(self) -> None:
        """Hold speed 0."""
        ...

    def set_ramp(self, rpm_per_s: float) -> None:
        """How fast it speeds up and slows down."""
        ...

    def set_speed(self, rpm: float) -> None:
        """Ramp to a speed."""
        ...

    def disable(self) -> None:
        """Let go of the rotor, which stands.

        Raises:
            DeviceError: it keeps hold of it, or does not answer whether it does.
            LinkLost: it is gone.
        """
        ...

    def quick_stop(self) -> None:
        """Stop as fast as it can."""
        ...

    def stop(self, told: Callable[[str], None] = ...) -> bool:
        """Stop the rotor, then let go of it; whether it is known to stand, and the device to have let go of it.

        A device that does not answer is told all the same; `told` learns in words what could not be confirmed.

        Raises:
            LinkLost, DeviceError: it is gone.
        """
        ...


class PendulumLocks(Protocol):
    """An open device that locks and releases the pendulums."""

    def command(self, action: str, check: Callable[[], None]) -> None:
        """Have it do something, until it says that it does.

        Args:
            action: "lock both", "release both", "lock A", …, or "zero": take the angles now for those of closed locks.
            check: called while it waits; raises to give up.

        Raises:
            DeviceError: refused, or no answer.
        """
        ...

    def heard(self, event: Event) -> None:
        """An acknowledgement came."""
        ...


@runtime_checkable
class TurnsRotor(Protocol):
    """A driver of devices that turn the rotor."""

    def speed_source(
        self, settings: Any, send: Callable[[bytes], None], clock: HostClock, guard: RotorGuard
    ) -> SpeedSource:
        """The command of an open device."""
        ...


@runtime_checkable
class MovesLocks(Protocol):
    """A driver of devices that lock and release the pendulums."""

    def locks(self, settings: Any, send: Callable[[bytes], None], clock: HostClock) -> PendulumLocks:
        """The command of an open device."""
        ...

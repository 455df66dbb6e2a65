"""A driver: everything that the layers above may use of one kind of device.

A driver is one object, found by its name in the entry-point group `rig.drivers` (`daq.drivers.registry`). It holds no
state of a device: the state of an open device is in its pipeline. Settings are the device's table of the rig file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from daq.channels import Channel
from daq.drivers.checks import Checks
from daq.drivers.contract import (
    DeviceLine,
    LockControl,
    Pipeline,
    Poller,
    RotorGuard,
    SampleClock,
    SpeedControl,
    Talk,
)
from daq.drivers.identification import Announcement, FoundDevice, IdentityTurns
from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FarEnd
from daq.items import DeviceEvent
from rig_configs.device import DeviceSettings

if TYPE_CHECKING:
    from daq.transports.host_clock import HostClock

Send = Callable[[bytes], None]

CLAIMS = {
    "checksum": "every message contains a check of 16 bits or more: a damaged message gives no sample",
    "counts exactly": 'losses["samples"] is the number of missing samples of all channels between two received samples',
    "falls silent": "after its stop the device sends nothing until it is opened again",
}
"""Claims of a driver about its device's wire, with their meaning. A claim makes tests stricter."""


class Part:
    """A function of a driver that is imported when it is first called, so that a driver is fast to find.

    Args:
        package: package of the driver.
        path: its place in the package, "module:name".
    """

    def __init__(self, package: str, path: str) -> None:
        module, _, name = f"{package}.{path}".partition(":")
        self.module: str = module
        self.name: str = name

    def load(self) -> Callable[..., Any]:
        """Import the function.

        Raises:
            ImportError, AttributeError: the path is wrong.
        """
        return attrgetter(self.name)(import_module(self.module))

    def __call__(self, *arguments: Any) -> Any:
        """Call the function."""
        return self.load()(*arguments)


def parts_of(package: str) -> Callable[[str], Part]:
    """Return what makes the parts of a driver from "module:name" in its package."""
    return partial(Part, package)


# --- what most drivers have in common ---------------------------------------------------------------------------


def _no_channels(settings: Any) -> tuple[Channel, ...]:
    return ()


def _host_time(settings: Any) -> tuple[SampleClock, ...]:
    """Return no clock: samples get the host's time."""
    return ()


def _not_queried(device: str, settings: Any, talk: Talk) -> dict[str, Any]:
    return {}


def _never_stops(settings: Any, talk: Talk) -> None:
    """Do nothing: the device sends as long as it has power, or its command has stopped it."""


def _text(event: DeviceEvent) -> str:
    return event.text


def _no_checks(settings: Any, pipeline: Any, control: SpeedControl | None, events: Sequence[DeviceEvent]) -> Checks:
    return {}


def _bytes_of_log(settings: Any, identity: Mapping[str, Any]) -> PlayedDevice:
    """Return a stand-in that plays the bytes of the log and ignores all commands."""
    return PlayedDevice()


def _unknown_code(code: int) -> str:
    return ""


@dataclass(frozen=True, kw_only=True)
class Driver:
    """One kind of device. Functions take the settings of a device, its table in the rig file, as their first argument.

    A driver that only sends needs `name`, `settings`, `channels`, `pipeline` and `far_end`.

    Attributes:
        name: name of the driver in a rig file's `driver = "…"`.
        settings: class of a device's table in the rig file. The settings define the roles of the device.
        channels: returns the channels that a healthy device fills continuously.
        pipeline: makes a new pipeline from the device's name, its settings, and its identity from `open`, empty if the
            device was not queried. It raises DeviceError if the identity is impossible for such a device.
        far_end: makes a simulated device from its name, its settings and a `daq.virtual_rig.world.World`.
        line: returns the line of a device; see DeviceLine.of.
        occasional: returns the channels that the device fills occasionally, such as index marks, which need a turning
            rotor.
        clocks: returns the clocks of those channels whose samples contain the time of a clock in the device.
        open: queries the identity of a device, given by its name, sets it up and starts its stream. The identity
            consists of strings and numbers: everything that the pipeline needs in addition to the settings. Its entry
            `warning`, if present, is shown to the operator. It raises DeviceError if the device does not answer,
            refuses a command, or differs from the rig file.
        stop: ends the stream of a device, which may be disconnected. It raises LinkLost or DeviceError then.
        words: returns the text of an emergency event for the operator; empty if the emergency has ended.
        checks: returns the checks of an open device that are specific to this driver, in addition to those of every
            device of the same roles: from its settings, its pipeline after some seconds of stream, its SpeedControl if
            it turns the rotor, and its events in those seconds.
        played: makes the stand-in for a device of a log while the log is played, from its settings and identity. It
            raises LogError if the identity is impossible for such a device.
        code_meaning: returns the meaning of a code in the channel's field `code`, which some sensors send in place of
            a value, for example without a target: a short clause; empty if it is unknown.
        pause_s: longest pause of the reader between two reads, s; short if samples get the host's time.
        by_radio: whether the samples come by radio, where a small share of them is lost on a healthy rig.
        claims: keys of CLAIMS.
        measured: keys of the identity whose values are measured: they differ each time the same device is opened.
        verified: whether the driver was tested on the hardware.
        example: settings of a device by name, in addition to `driver` and `port`, if there are settings without a
            default.
        usual: settings with which such devices are usual, the most frequent first, in addition to `example`.
        speed_source: makes the SpeedControl of an open device that turns the rotor, from its settings, a function that
            sends bytes to it, the clock, and a RotorGuard; None for other devices.
        locks: makes the LockControl of an open device that locks and releases the pendulums, from its settings, a
            function that sends bytes to it, and the clock; None for other devices.
        poller: makes the Poller of an open device that answers only on request, from the same; None for other devices.
        identity_request: returns the dialogue that identifies a device with these settings (IdentityTurns). It only
            reads: it does not configure or enable the device, and does not start or stop its stream. The port may
            belong to any other device, and the device may be streaming. None if devices answer no request.
        recognise: returns the FoundDevice whose settings the bytes that arrived on a port contain; None if the bytes
            are not of such a device. They may begin and end anywhere, or be of any other device. The pipeline is then
            tried with the settings. None if the bytes contain no settings.
        announcement: returns the Announcement of devices that announce themselves on the network.
    """

    name: str
    settings: type[DeviceSettings]
    channels: Callable[[Any], tuple[Channel, ...]]
    pipeline: Callable[[str, Any, Mapping[str, Any]], Pipeline]
    far_end: Callable[[str, Any, Any], FarEnd]
    line: Callable[[Any], DeviceLine] = DeviceLine.of
    occasional: Callable[[Any], tuple[Channel, ...]] = _no_channels
    clocks: Callable[[Any], tuple[SampleClock, ...]] = _host_time
    open: Callable[[str, Any, Talk], dict[str, Any]] = _not_queried
    stop: Callable[[Any, Talk], None] = _never_stops
    words: Callable[[DeviceEvent], str] = _text
    checks: Callable[[Any, Any, SpeedControl | None, Sequence[DeviceEvent]], Checks] = _no_checks
    played: Callable[[Any, Mapping[str, Any]], PlayedDevice] = _bytes_of_log
    code_meaning: Callable[[int], str] = _unknown_code
    pause_s: float = 0.01
    by_radio: bool = False
    claims: frozenset[str] = frozenset()
    measured: frozenset[str] = frozenset()
    verified: bool = False
    example: Mapping[str, Any] = field(default_factory=dict[str, Any])
    usual: tuple[Mapping[str, Any], ...] = ({},)
    speed_source: Callable[[Any, Send, HostClock, RotorGuard], SpeedControl] | None = None
    locks: Callable[[Any, Send, HostClock], LockControl] | None = None
    poller: Callable[[Any, Send, HostClock], Poller] | None = None
    identity_request: Callable[[Any], IdentityTurns] | None = None
    recognise: Callable[[Any, bytes], FoundDevice | None] | None = None
    announcement: Callable[[], Announcement] | None = None

    def example_at(self, port: str, **others: Any) -> DeviceSettings:
        """Return the settings of a usual device at a port.

        Args:
            port: its port.
            others: settings that differ from the example's.

        Raises:
            ValueError: they are not valid.
        """
        return self.settings.model_validate({"driver": self.name, "port": port, **self.example, **others})

    def load(self) -> None:
        """Import the parts of a real device, so that none is imported after its first byte has arrived."""
        simulated = (self.far_end, self.played)
        for part in vars(self).values():
            if isinstance(part, Part) and part not in simulated:
                part.load()

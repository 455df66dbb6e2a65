"""Devices of an open session: which are open, what they have sent, and what they report of themselves."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from daq.acquisition.core import Core
from daq.acquisition.links import Links
from daq.acquisition.rotor_command import RotorCommand
from daq.drivers.checks import Checks
from daq.drivers.contract import PipelineStatus
from daq.drivers.devices import Device
from daq.items import DeviceEvent, loss_words
from daq.transports import HostClock
from rig_basics.texts import number_of


class OpenDevices:
    """Devices of one session.

    Args:
        devices: devices of the rig with their drivers.
        core: core of the acquisition.
        links: links of the devices.
        clock: the host clock.
    """

    def __init__(self, devices: Mapping[str, Device], core: Core, links: Links, clock: HostClock) -> None:
        self._devices, self._core, self._links, self._clock = devices, core, links, clock

    def send(self, name: str, data: bytes) -> None:
        """Write to a device immediately, without waiting for log and decoders. The bytes are logged afterwards.

        Raises:
            LinkLost: the link of the device is lost.
        """
        self._links.send(name, data)

    # --- links and bytes -----------------------------------------------------------------------------------------

    @property
    def unopened(self) -> Mapping[str, str]:
        """Reasons why devices are not open, by device; only a `lenient` policy permits such devices."""
        return {**self._core.gone, **self._links.refused}

    @property
    def bytes_in(self) -> int:
        """Number of bytes received from all devices."""
        return sum(self._core.bytes_in.values())

    @property
    def unheard(self) -> list[str]:
        """Devices from which no byte was received."""
        return [name for name, count in self._core.bytes_in.items() if not count]

    @property
    def silent_s(self) -> float:
        """Time since any device sent bytes, s."""
        return self._clock.now_s() - self._links.heard_s()

    def without_samples(self) -> list[str]:
        """Return the devices that have not sent a sample of each channel."""
        return [
            name
            for name, device in self._devices.items()
            if name not in self._links.refused
            and not all(len(self._core.recent.last(channel.topic, ())[0]) for channel in device.channels)
        ]

    def received_words(self, name: str) -> str:
        """Describe what a device without samples has sent."""
        bytes_in, losses = self._core.bytes_in[name], self._core.pipelines[name].losses
        lost = ", ".join(loss_words(n, kind) for kind, n in losses.items() if n)
        received = f"{number_of(bytes_in, 'byte')} received, none of them a sample" if bytes_in else "silent"
        why = self.identification_of(name)[1] or "Look at its power, its settings and the rig file"
        return f"{name}: {received}{f' ({lost})' if lost else ''}. {why[:1].upper()}{why[1:]}"

    # --- reports of the devices ----------------------------------------------------------------------------------

    def identification_of(self, name: str) -> tuple[bool, str]:
        """Return whether a device has described itself, and its deviation from the rig file (empty if there is none).

        Devices that never describe themselves return (True, "").
        """
        status = self._status(name)
        return status.has_reported, status.complaint

    def all_identified(self) -> bool:
        """Return whether every open device has described itself."""
        gone = self.unopened
        return all(self.identification_of(name)[0] for name in self._devices if name not in gone)

    def clock_stds_ns(self) -> dict[str, float]:
        """Return the stated standard uncertainty of the newest times, ns, by device with a clock."""
        found = {name: self._status(name).clock_std_ns for name in self._core.pipelines}
        return {name: std_ns for name, std_ns in found.items() if not math.isnan(std_ns)}

    def _status(self, name: str) -> PipelineStatus:
        with self._links.unread(name):
            return self._core.pipelines[name].status

    def own_checks(self, events: Iterable[DeviceEvent], rotor: RotorCommand) -> dict[str, Checks]:
        """Return the checks that the drivers make on their open devices, by device.

        Args:
            events: of the checked time span.
            rotor: holds the speed source.
        """
        happened = list(events)
        return {
            name: device.driver.checks(
                device.settings,
                self._core.pipelines[name],
                rotor.drive if name == rotor.drive_name else None,
                [event for event in happened if event.device == name],
            )
            for name, device in self._devices.items()
        }

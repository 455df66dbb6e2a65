"""The devices of a rig file, each with its driver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from daq.channels import CHANNELS, Channel
from daq.clock import CLOCK_SEED
from daq.drivers.contract import DeviceLine, Pipeline, SampleClock
from daq.drivers.driver import Driver
from daq.drivers.played import PlayedDevice
from daq.drivers.registry import driver
from daq.drivers.simulated import FarEnd
from rig_configs.device import DeviceSettings, StoredDevice


@dataclass(frozen=True)
class Device:
    """One device of a rig: its name and settings in the rig file, and the driver that the settings name."""

    name: str
    settings: DeviceSettings
    driver: Driver

    @property
    def line(self) -> DeviceLine:
        """See Driver."""
        return self.driver.line(self.settings)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """See Driver."""
        return self.driver.channels(self.settings)

    @property
    def occasional(self) -> tuple[Channel, ...]:
        """See Driver."""
        return self.driver.occasional(self.settings)

    @property
    def clocks(self) -> tuple[SampleClock, ...]:
        """See Driver."""
        return self.driver.clocks(self.settings)

    def far_end(self, world: Any) -> FarEnd:
        """See Driver."""
        return self.driver.far_end(self.name, self.settings, world)

    def played(self, identity: Mapping[str, Any]) -> PlayedDevice:
        """See Driver."""
        return self.driver.played(self.settings, identity)

    def pipeline(self, identity: Mapping[str, Any]) -> Pipeline:
        """See Driver. The samples of a displacement sensor are not yet corrected by its calibration."""
        return self.driver.pipeline(self.name, self.settings, identity)


def devices_of(devices: Mapping[str, DeviceSettings]) -> dict[str, Device]:
    """Return all devices of a rig file by name, in the file's order.

    Raises:
        DeviceError: a driver is not installed.
    """
    return {name: Device(name, settings, driver(settings.driver)) for name, settings in devices.items()}


def installed_of(devices: Mapping[str, DeviceSettings]) -> dict[str, DeviceSettings]:
    """Return the devices whose driver is installed. A log may contain devices of drivers that are not."""
    return {name: device for name, device in devices.items() if not isinstance(device, StoredDevice)}


def channels_of(devices: Mapping[str, DeviceSettings]) -> dict[str, Channel]:
    """Return every channel that a log of these devices may contain, by topic: the standard ones, then the drivers'."""
    found = dict(CHANNELS)
    for device in devices_of(installed_of(devices)).values():
        found |= {channel.topic: channel for channel in (*device.channels, *device.occasional)}
    return found


def make_pipelines(
    devices: Mapping[str, DeviceSettings],
    identities: Mapping[str, Mapping[str, Any]],
    seeds: Mapping[str, Mapping[str, Any]] | None = None,
) -> dict[str, Pipeline]:
    """Make new pipelines for all devices of a rig.

    Args:
        identities: identity of each device from its opening, by device ("words" of a laser, for instance).
        seeds: known state of each device's clock, by device: tables of `ClockSeed`.

    Raises:
        DeviceError: an identity is impossible for its device.
    """
    known = seeds or {}
    return {
        name: device.pipeline({**identities.get(name, {}), CLOCK_SEED: known.get(name)})
        for name, device in devices_of(devices).items()
    }

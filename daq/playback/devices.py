"""Simulated devices at the far ends of the ports while a log is played."""

from __future__ import annotations

from daq.drivers.devices import devices_of, installed_of
from daq.drivers.played import PlayedDevice
from daq.errors import DeviceError, LogError
from daq.log import Log
from daq.log.snapshot import identities_of, rig_of


def played_devices(log: Log) -> dict[str, PlayedDevice]:
    """Return the simulated device for each device of a log.

    Raises:
        LogError: the log does not contain the settings of its devices.
    """
    devices, identities = devices_of(installed_of(rig_of(log).devices)), identities_of(log)

    def played(name: str) -> PlayedDevice:
        if name not in devices:
            return PlayedDevice()
        try:
            return devices[name].played(identities.get(name, {}))
        except (LogError, DeviceError) as fault:
            raise LogError(f"{log.path}: {name}: {fault}") from fault

    return {device: played(device) for device in log.devices}

# pyright: strict
"""What stands at the far end of each port while a log is played."""

from __future__ import annotations

from daq.drivers.devices import devices_of, installed_of
from daq.drivers.played import PlayedDevice
from daq.errors import DeviceError, LogError
from daq.log import Log
from daq.log.snapshot import identities_of, rig_of


def played_devices(log: Log) -> dict[str, PlayedDevice]:
    """What stands in for each device of a log.

    Raises:
        LogError: the log does not say what its devices were.
    """
    known, identities = devices_of(installed_of(rig_of(log).devices)), identities_of(log)

    def played(name: str) -> PlayedDevice:
        if name not in known:
            return PlayedDevice()
        try:
            return known[name].played(identities.get(name, {}))
        except (LogError, DeviceError) as fault:
            raise LogError(f"{log.path}: {name}: {fault}") from fault

    return {device: played(device) for device in log.devices}

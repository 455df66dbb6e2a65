"""Drivers by name, found among the entry points of the installed packages."""

from __future__ import annotations

from daq.drivers.driver import Driver
from daq.errors import DeviceError
from rig_configs.drivers import load_driver


def driver(name: str) -> Driver:
    """Return the driver of a name.

    Raises:
        DeviceError: no driver of that name is installed, or it cannot be loaded.
    """
    try:
        found = load_driver(name)
    except ValueError as error:
        raise DeviceError(str(error)) from error
    if not isinstance(found, Driver):
        raise DeviceError(f"driver {name}: expected a daq.drivers.driver.Driver, got {found!r:.80}")
    return found

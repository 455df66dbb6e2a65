# pyright: strict
"""Drivers by name, found among the entry points of what is installed."""

from __future__ import annotations

import difflib
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from daq.drivers.contract import Driver
from daq.errors import DeviceError

GROUP = "rig.drivers"


def installed() -> dict[str, EntryPoint]:
    """Entry points of all drivers that are installed, by name."""
    return {point.name: point for point in sorted(entry_points(group=GROUP), key=lambda point: point.name)}


@cache
def driver(name: str) -> Driver:
    """The driver of a name.

    Raises:
        DeviceError: none of that name is installed, or it cannot be loaded.
    """
    known = installed()
    if name not in known:
        near = difflib.get_close_matches(name, known, 1)
        meant = f" Did you mean {near[0]!r}?" if near else ""
        raise DeviceError(f"no driver {name!r} is installed, only {', '.join(known)}.{meant}")
    try:
        found: Driver = known[name].load()
    except Exception as error:
        source = known[name].value
        raise DeviceError(f"driver {name!r} ({source}) cannot be loaded: {type(error).__name__}: {error}") from error
    return found

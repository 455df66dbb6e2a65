"""Drivers by name from the entry points of installed packages; used here for their settings only."""

from __future__ import annotations

import difflib
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from rig_configs.device import DeviceSettings

GROUP = "rig.drivers"


@cache
def installed() -> dict[str, EntryPoint]:
    """Return the entry points of all installed drivers by name."""
    return {point.name: point for point in sorted(entry_points(group=GROUP), key=lambda point: point.name)}


@cache
def load_driver(name: str) -> Any:
    """Load a driver by name.

    Raises:
        ValueError: no driver of that name is installed, or it cannot be loaded.
    """
    known = installed()
    if name not in known:
        near = difflib.get_close_matches(name, known, 1)
        meant = f" Did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"no driver {name!r} is installed, only {', '.join(known)}.{meant}")
    try:
        return known[name].load()
    except Exception as error:
        source = known[name].value
        raise ValueError(f"driver {name!r} ({source}) cannot be loaded: {type(error).__name__}: {error}") from error


def settings_of(name: str) -> type[DeviceSettings]:
    """Return the settings class of a driver.

    Raises:
        ValueError: the driver does not exist, or has no settings.
    """
    found = getattr(load_driver(name), "settings", None)
    if not (isinstance(found, type) and issubclass(found, DeviceSettings)):
        raise ValueError(f"driver {name!r} brings no settings class: expected an attribute `settings`, got {found!r}")
    return found

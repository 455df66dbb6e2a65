"""Parts of all displacement sensors: their range by identity and rig file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from daq.errors import DeviceError
from rig_configs.device import DisplacementSettings

_SAME_M = 1e-6


def range_of(device: str, settings: DisplacementSettings, identity: Mapping[str, Any]) -> float:
    """Return the measuring range of a sensor's identity, or of the rig file if it has none, m.

    Raises:
        DeviceError: it is no positive number.
    """
    found = identity.get("range_m", settings.range_m)
    if isinstance(found, int | float) and not isinstance(found, bool) and math.isfinite(found) and found > 0:
        return float(found)
    raise DeviceError(f"{device}: expected a measuring range in m above 0 in its identity, got range_m {found!r:.80}")


def compare_range(device: str, settings: DisplacementSettings, range_m: float, serial: object) -> None:
    """Compare the range that a sensor reports with that of the rig file.

    Raises:
        DeviceError: they differ.
    """
    if abs(range_m - settings.range_m) > _SAME_M:
        raise DeviceError(
            f"{device}: the range is {settings.range_m * 1e3:g} mm in the rig file and {range_m * 1e3:g} mm in "
            f"the sensor (serial {serial}). Correct devices.{device}.range_m or plug in the right sensor"
        )

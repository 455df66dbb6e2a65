"""Parts of all displacement sensors: their range by identity and rig file, and their samples."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.channels import Channel
from daq.drivers.plain import TICK_NS
from daq.errors import DeviceError
from daq.items import Batch
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


def displacement_batch(
    channel: Channel,
    time_ns: NDArray[np.int64],
    number: NDArray[np.integer],
    device_ns: NDArray[np.int64],
    displacement_m: NDArray[np.float64],
    code: NDArray[np.integer],
    flags: NDArray[np.uint32] | None = None,
) -> Batch:
    """Return the samples of a sensor, all of shape (n,).

    Args:
        channel: the sensor's channel.
        time_ns: times on the common clock, ns since 1970.
        number: numbers, which the log stores modulo 2³².
        device_ns: times on the sensor's clock, ns.
        displacement_m: displacements of the disk centre, m; NaN without a reading.
        code: words of the sensor, as received.
        flags: flags of the samples; None: 0.
    """
    counter = number.astype(np.uint32)
    columns: dict[str, NDArray[Any]] = {
        "displacement_m": displacement_m,
        "code": code.astype(np.uint32),
        "counter": counter,
        "device_ticks": (device_ns // TICK_NS).astype(np.uint64),
        "flags": np.zeros(len(counter), np.uint32) if flags is None else flags,
    }
    return Batch(channel, time_ns, counter, columns)

"""Refusal of displacements that the rig's sensors cannot give: they are in another unit than the log states."""

from __future__ import annotations

import numpy as np

from daq.errors import LogError
from rig_basics.arrays import Array
from rig_configs.roles import DisplacementSensor
from rig_configs.schema import Rig

_LARGEST_GAIN = 2.0  # largest `gain_factor` of a rig file, by which readings may exceed the range
_UNSEEN_SHARE = 10.0  # a unit that is mistaken, the inch or smaller, makes displacements 39 times as large or more
_UNITS = (("mm", 1e-3), ("µm", 1e-6), ("nm", 1e-9))


def refuse_impossible(source: str, axis: str, values_m: Array, sensor: DisplacementSensor | None, rig: Rig) -> None:
    """Check that displacements along an axis span no more than their sensor's range.

    The span does not depend on the sensor's zero. Without a sensor in the rig file it may be at most ten times as large
    as the amplitude at which the rotor is stopped, to both sides.

    Args:
        source: the log, for messages.
        axis: "x" or "y".
        values_m: displacements as the log has them, shape (n,), m; NaN for invalid ones.
        sensor: sensor along the axis, if the rig has one.
        rig: rig of the log.
    Raises:
        LogError: the span is larger; the message contains the likely unit.
    """
    finite = values_m[np.isfinite(values_m)]
    if not len(finite):
        return
    span_m = float(finite.max() - finite.min())
    if sensor is None:
        limit_m, bound = 2 * _UNSEEN_SHARE * rig.limits.amplitude_m, "ten times the limit of the amplitude"
    else:
        limit_m, bound = 2 * _LARGEST_GAIN * sensor.reach_m, f"the range of {sensor.device}"
    if span_m <= limit_m:
        return
    likely = next((unit for unit, metres in _UNITS if span_m * metres <= limit_m), None)
    hint = f"the values look like {likely}" if likely else "no usual unit of length makes them possible"
    raise LogError(
        f"{source}: displacement along {axis}: expected m within a span of {limit_m:.3g} m ({bound}), got a span of "
        f"{span_m:.6g} m; {hint}. Make the log again with the right unit (`rig import` takes the unit of each column)"
    )

"""Assignment of a fit's directions to the stiffness axes for a pair of sensors that is turned against the axes.

A fit of both sensors finds the angle β from stiffness x to sensor x up to whole quarter turns. A further quarter turn
exchanges the two directions and describes the same motion. The fit names the direction closer to sensor x direction 1.
The mounting angle in the rig file determines the number of quarter turns; for sensors along the axes it is zero. An
angle that contradicts the rig file, given both standard uncertainties, yields a warning.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import TypeVar

import numpy as np

from identification.errors import NotIdentifiable
from identification.ring_down.result import RingDownFit
from identification.run_up.result import RunUpFit
from rig_configs.roles import AXIS_TOLERANCE_DEG

Fit = TypeVar("Fit", RingDownFit, RunUpFit)

_ANGLE = "axis_angle_deg"
_MAX_DEVIATION_STD = 2.968  # 99.7 % of normal errors are within so many standard deviations
_MAX_DEVIATION_DEG = 15.0  # beyond it, k1 and k2 may be exchanged
_OTHER_NAME = {name.format(i): name.format(3 - i) for name in ("f{}_Hz", "zeta{}", "k{}_N_per_m") for i in (1, 2)}
_IN_TEXT = re.compile(r"\b(f|k|zeta|direction )([12])(?=\b|_)")


def as_mounted(fit: Fit, turn_deg: float) -> Fit:
    """Return the fit of two sensors with its directions named according to the mounting of the sensors.

    Args:
        fit: fit of both sensors.
        turn_deg: angle from the x axis to sensor x by the rig file, deg. The fit is unchanged for 0.
    Raises:
        NotIdentifiable: the sensors are turned and the record does not determine both directions.
    """
    if abs(turn_deg) <= AXIS_TOLERANCE_DEG:
        return fit
    if _ANGLE not in fit.values:
        raise NotIdentifiable(
            f"the sensors stand turned by {turn_deg:g}°, and the record shows one direction alone: two turned "
            "sensors do not show which. Pull farther along the other axis too"
        )
    found = fit.values[_ANGLE]
    quarters = round((turn_deg - found) / 90.0)
    named = _exchanged(fit) if quarters % 2 else fit
    values = dict(named.values)
    values[_ANGLE] = found + 90.0 * quarters
    for name in ("phase_x_deg", "phase_y_deg", "bow_x_deg", "bow_y_deg"):
        if name in values:
            values[name] = math.remainder(values[name] + 90.0 * quarters, 360.0)
    shift = {name: values[name] - named.values[name] for name in values}
    intervals = {n: (low + shift.get(n, 0.0), high + shift.get(n, 0.0)) for n, (low, high) in named.intervals.items()}
    return replace(named, values=values, intervals=intervals)


def mounting_remarks(found_deg: tuple[float, float], mounted_deg: tuple[float, float]) -> list[str]:
    """Return a message if the identified angle contradicts the rig file. A NaN angle yields no message.

    Args:
        found_deg: angle from the stiffness x axis to sensor x by the record and its standard uncertainty, deg.
        mounted_deg: angle and standard uncertainty by the rig file, deg.
    """
    (angle, std), (mounted, mounted_std) = found_deg, mounted_deg
    if not abs(angle - mounted) > _MAX_DEVIATION_STD * math.hypot(mounted_std, std):
        return []
    then = (
        "k1 and k2 are exchanged where they are more than 45° apart"
        if abs(angle - mounted) > _MAX_DEVIATION_DEG
        else "all figures use the identified angle; turn the sensors, or enter the angle in the rig file"
    )
    return [
        f"the sensors stand turned: at {angle:.2f} ± {std:.1g}° to the stiffness axes by the record, at "
        f"{mounted:g} ± {mounted_std:g}° by the rig file (direction_deg, direction_std_deg); {then}"
    ]


def _other(text: str) -> str:
    """Return a sentence with both directions exchanged."""
    return _IN_TEXT.sub(lambda found: found[1] + ("2" if found[2] == "1" else "1"), text)


def _exchanged(fit: Fit) -> Fit:
    """Return the fit with directions 1 and 2 exchanged. The order of the names is kept."""
    names = [_OTHER_NAME.get(name, name) for name in fit.values]
    order = [names.index(name) for name in fit.values] if set(names) == set(fit.values) else list(range(len(names)))
    numbers = list(fit.values.values())
    values = {names[i]: numbers[i] for i in order}
    intervals = {_OTHER_NAME.get(name, name): interval for name, interval in fit.intervals.items()}
    warnings = [_other(warning) for warning in fit.warnings]
    covariance = fit.covariance[np.ix_(order, order)]
    named = replace(fit, values=values, intervals=intervals, covariance=covariance, warnings=warnings)
    if isinstance(named, RingDownFit):
        return replace(
            named,
            model=_other(named.model),
            model_table=[replace(row, name=_other(row.name), why=_other(row.why)) for row in named.model_table],
            amplitude=[replace(one, mode=3 - one.mode) for one in named.amplitude],
            nonlinear=[replace(one, direction=3 - one.direction) for one in named.nonlinear],
            terms=[replace(one, direction=3 - one.direction) for one in named.terms],
        )
    return named

# pyright: strict
"""Two sensors at right angles that stand turned against the axes: which direction of a fit is which.

A fit of both sensors finds the angle β from stiffness x to sensor x up to whole quarter turns: with a quarter turn more
the two directions are exchanged, and the motion is the same. The fit names as direction 1 what is nearer to sensor x.
How the sensors stand, by the rig file, decides which quarter turn it is; for sensors along the axes it is none. An
angle that its standard uncertainty does not allow is told.
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
_DOUBTED = 2.968  # of a normal error, 99.7 % are within so many standard deviations
_DOUBTFUL_DEG = 15.0
_DIRECTION = re.compile(r"\b(f|k|zeta|direction )([12])(?=\b|_)")


def as_mounted(fit: Fit, turn_deg: float) -> Fit:
    """A fit of two sensors with its directions named by how the sensors stand.

    Args:
        turn_deg: from the x axis to sensor x by the rig file; 0 leaves the fit as it is.
    Raises:
        NotIdentifiable: turned sensors, and the record does not show both directions.
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
    """A sentence where the sensors stand otherwise than the rig file can mean; none for an angle that is not known.

    Args:
        found_deg: from the stiffness x axis to sensor x by the record, and its standard uncertainty; nan: not known.
        mounted_deg: the same by the rig file.
    """
    (angle, std), (mounted, mounted_std) = found_deg, mounted_deg
    if not abs(angle - mounted) > _DOUBTED * math.hypot(mounted_std, std):
        return []
    then = (
        "k1 and k2 are exchanged where they are more than 45° apart"
        if abs(angle - mounted) > _DOUBTFUL_DEG
        else "all figures take what was found; turn the sensors, or say in the rig file how they stand"
    )
    return [
        f"the sensors stand turned: at {angle:.2f} ± {std:.1g}° to the stiffness axes by the record, at "
        f"{mounted:g} ± {mounted_std:g}° by the rig file (direction_deg, direction_std_deg); {then}"
    ]


def _other(text: str) -> str:
    """A name or a sentence with both directions exchanged."""
    return _DIRECTION.sub(lambda found: found[1] + ("2" if found[2] == "1" else "1"), text)


def _exchanged(fit: Fit) -> Fit:
    """Direction 1 named 2, and 2 named 1; in the order of names that the fit has."""
    names = [_other(name) for name in fit.values]
    order = [names.index(name) for name in fit.values] if set(names) == set(fit.values) else list(range(len(names)))
    numbers = list(fit.values.values())
    values = {names[i]: numbers[i] for i in order}
    intervals = {_other(name): interval for name, interval in fit.intervals.items()}
    told = [_other(warning) for warning in fit.warnings]
    covariance = fit.covariance[np.ix_(order, order)]
    named = replace(fit, values=values, intervals=intervals, covariance=covariance, warnings=told)
    if isinstance(named, RingDownFit):
        return replace(
            named,
            model=_other(named.model),
            model_table=[replace(row, name=_other(row.name), why=_other(row.why)) for row in named.model_table],
            amplitude=[replace(one, mode=3 - one.mode) for one in named.amplitude],
            nonlinear=[replace(one, direction=3 - one.direction) for one in named.nonlinear],
        )
    return named

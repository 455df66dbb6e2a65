"""Single causes of a deviation, and the change of the differences at the points with each of them.

A cause is one of: a parameter that differs from its identified value (changed since, or wrongly identified), a number
of the rig file that differs from its true value (values identified with it are then wrong too), an encoder's zero, the
index angle, a laser's gain or the axis angle.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from analysis.differences import Differences
from analysis.prediction import AXIS_ANGLE
from analysis.run_out import SLOW_ROLL
from rig_basics.arrays import Array
from rig_configs import PARAMETER_SYMBOLS, IdentifiedParameters, Rig
from rig_configs.error_label import ErrorLabel
from rig_configs.known import CONTACT_FRICTION, DRAG, FRICTION, INDEX, PHYSICAL, USUAL_SHARE, ZERO_A, ZERO_B

_NUMBER_WORDS = {
    "rotor.mass_kg": "the rotor's mass",
    "imbalance.mass_kg": "the imbalance's mass",
    "pendulums.a.mass_kg": "the mass of pendulum A",
    "pendulums.b.mass_kg": "the mass of pendulum B",
    "pendulums.a.length_m": "the length of pendulum A",
    "pendulums.b.length_m": "the length of pendulum B",
    "pendulums.pivot_shift_m": "the pivot shift",
    ZERO_A: "the zero of encoder A",
    ZERO_B: "the zero of encoder B",
    INDEX: "the index angle",
}
SLOW_ROLL_STD_M = 2e-5
"""Standard uncertainty of run-out and bow that no test has measured: usual size for targets and shafts."""
_SLOW_ROLL_WORDS = {
    "run-out along": "run-out along the imbalance",
    "run-out across": "run-out across the imbalance",
    "bow along": "a bow along the imbalance",
    "bow across": "a bow across the imbalance",
}
_SETTLES = {
    "run-out": "a slow roll, or another run-up",
    "bow": "another run-up",
    "k": "another ring-down along this direction",
    "zeta": "another ring-down along this direction",
    "c": "another spin-down",
    "SP": "another run-up",
    "rotor": "weigh the rotor",
    "imbalance": "weigh the imbalance",
    "pendulums": "weigh and measure the pendulum",
    "encoders": "set the zero again at the lock",
    "phase": "set the index angle again by a slow roll",
    "gain": "calibrate the laser and its lever",
    AXIS_ANGLE.text: "another ring-down in both directions",
    "friction": "another spin-down, and clean bearings",
    "drag": "another spin-down from a faster flick",
}


BOTH: Mapping[tuple[str, str], str] = {
    FRICTION: "friction.both_Nm",
    CONTACT_FRICTION: "friction.both_kg_m2",
    DRAG: "drag.both_Nms2_per_rad2",
}
_USUAL_SPEED2 = 1e4  # (rad/s)²
_FLICK_RAD_S, _USUAL_SHARE = 12.0, 1e-2
"""Speed of a flicked pendulum, rad/s, and usual share of friction in the largest viscous torque at it."""


@dataclass(frozen=True)
class Cause:
    """One possible cause.

    Attributes:
        name: a parameter, a number of the rig file, "gain x", "gain y", "axis angle" or one of SLOW_ROLL.
        words: description for a reader.
        value: value used for the comparison; NaN if the relative size is undefined.
        std: standard uncertainty of that value, in the cause's unit.
        direction: change of the differences when the true value is one unit above the value used, shape (m,).
        unit, factor: display unit ("%", "°" or another unit) and the factor to it.
        settles: test or measurement that would confirm the cause.
        one_sided: whether its size cannot be below 0.
    """

    name: str
    words: str
    value: float
    std: float
    direction: Array
    unit: str
    factor: float
    settles: str
    one_sided: bool = False

    def sized(self, size: float, std: float) -> str:
        """Describe a size and its standard uncertainty, both in the cause's unit."""
        shown, spread = abs(size) * self.factor, std * self.factor
        digits = max(0, min(6, 1 - math.floor(math.log10(spread)))) if spread > 0 else 3
        if self.one_sided:
            return f"{self.words} of {shown:.{digits}f} ± {spread:.{digits}f} {self.unit}"
        side = "above" if size > 0 else "below"
        against = "the value of the rig file" if self.name in _NUMBER_WORDS else "the value used"
        return f"{self.words} {shown:.{digits}f} ± {spread:.{digits}f} {self.unit} {side} {against}"


def causes(differences: Differences, rig: Rig, identified: IdentifiedParameters) -> tuple[Cause, ...]:
    """Return all causes that the points could show.

    Args:
        differences: differences of all points.
        rig, identified: rig file and parameters behind the predictions.
    """
    std, found = identified.std, list[Cause]()
    for k, name in enumerate(identified.values):
        value = identified.values[name]
        deviation = std[name] or USUAL_SHARE * abs(value)
        if deviation > 0:
            found.append(_share(name, PARAMETER_SYMBOLS[name], value, deviation, -differences.by_parameter[:, k]))
    known, own = rig.known, differences.by_parameter
    for name in PHYSICAL:
        value = known.values[name]
        if value and name in differences.by_number and name != "imbalance.mass_kg":  # acts as the rotor's mass does
            moved = differences.by_number[name] + own @ identified.by_number.get(name, np.zeros(len(identified.values)))
            deviation = known.std(name) or USUAL_SHARE * value
            found.append(_share(name, _NUMBER_WORDS[name], value, deviation, -moved))
    found += _torques(differences, identified)
    for name in (ZERO_A, ZERO_B, INDEX):
        shift, deviation = differences.shared.get(ErrorLabel("known", name)), known.std(name)
        if shift is not None and deviation > 0:
            found.append(_angle(name, _NUMBER_WORDS[name], deviation, -shift / deviation))
    for axis, deviation in zip("xy", rig.roles.gain_stds, strict=True):
        gain = ErrorLabel("gain", axis)
        shift = differences.shared.get(gain)
        if shift is not None and deviation > 0:
            words = f"the gain of laser {axis}"
            found.append(_share(gain.text, words, 1.0, deviation, shift / deviation))
    for name in SLOW_ROLL:
        if np.any(differences.by_slow_roll.get(name, 0.0)):
            words, direction = _SLOW_ROLL_WORDS[name], differences.by_slow_roll[name]
            found.append(Cause(name, words, math.nan, SLOW_ROLL_STD_M, direction, "µm", 1e6, _settles(name)))
    angle = identified.axis_angle_deg
    if angle is not None and angle[1] > 0 and AXIS_ANGLE in differences.shared:
        deviation = math.radians(angle[1])
        found.append(_angle(AXIS_ANGLE.text, "the axis angle", deviation, -differences.shared[AXIS_ANGLE] / deviation))
    return tuple(found)


def _torques(differences: Differences, identified: IdentifiedParameters) -> list[Cause]:
    """Return torques that were taken as 0, on A, on B and on both alike: both kinds of friction and air drag."""
    viscous = [_FLICK_RAD_S * identified.values.get(name, 0.0) for name in ("c3_Nms_per_rad", "c4_Nms_per_rad")]
    found, by = list[Cause](), differences.by_number
    if min(viscous) <= 0:
        return found
    usual = _USUAL_SHARE * 0.5 * sum(viscous)
    for names, unit, factor, words, std in (
        (FRICTION, f"% of c3 · {_FLICK_RAD_S:g} rad/s", 100 / viscous[0], "dry friction of", usual),
        (CONTACT_FRICTION, "g mm²", 1e9, "dry friction with the contact force of", usual / _USUAL_SPEED2),
        (
            DRAG,
            f"% of the viscous torque at {_FLICK_RAD_S:g} rad/s",
            100 * _FLICK_RAD_S**2 / viscous[0],
            "the air's drag on",
            usual / _FLICK_RAD_S**2,
        ),
    ):
        if not all(name in by for name in names):
            continue
        whose = {names[0]: "pendulum A", names[1]: "pendulum B", BOTH[names]: "both pendulums alike"}
        for name, of in whose.items():
            direction = -(by[name] if name in by else by[names[0]] + by[names[1]])
            found.append(
                Cause(name, f"{words} {of}", 0.0, std, direction, unit, factor, _settles(name), one_sided=True)
            )
    return found


def torques_of(name: str, size: float) -> dict[str, float]:
    """Return the torques of a cause by their names in FRICTION, CONTACT_FRICTION and DRAG; empty for other causes."""
    for names, both in BOTH.items():
        if name == both:
            return dict.fromkeys(names, size)
        if name in names:
            return {name: size}
    return {}


def _share(name: str, words: str, value: float, std: float, direction: Array) -> Cause:
    """Return a cause whose size is displayed as a share of its value."""
    unit, factor = ("%", 100 / abs(value)) if value else ("", 1.0)
    return Cause(name, words, value, std, direction, unit, factor, _settles(name))


def _angle(name: str, words: str, std: float, direction: Array) -> Cause:
    return Cause(name, words, math.nan, std, direction, "°", 180 / math.pi, _settles(name))


def _settles(name: str) -> str:
    return next((text for stem, text in _SETTLES.items() if name.startswith(stem)), "")

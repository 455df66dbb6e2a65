"""Rejection of physically impossible values, with a warning that names the likely cause; the other values are kept.

The criterion is the schema of the rig file: a value that its loader rejects is never written to a parameters.toml.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from daq.signals.run import Run
from identification.estimate import Estimate
from identification.joint.combine import reduced
from identification.run_up.fit import RunUpFit, run_up_estimate
from identification.run_up.result import sensors_apart_m
from identification.sources import log_names
from rig_configs.load import refusal
from rig_configs.parameters_file import IdentifiedParameters
from rig_configs.schema import Rig

_LOCKED_AT = (0.0, math.pi)  # angles of A and B in their locks, rad
_MIN_HALF_TURN_RAD = math.radians(150)  # a larger deviation is taken for half a turn
_STIFFNESSES = ("k1_N_per_m", "k2_N_per_m")
_DIRECTED = (*_STIFFNESSES, "zeta1", "zeta2")
_MAX_OFF_FILE = 3 * 0.2
"""Largest |ln| of a stiffness over the rig file's, which states start values.

Three standard uncertainties of a stiffness from a spring's dimensions: 5 % of a wire's diameter change it by 20 %.
"""
_CAUSES = {
    "k": "a spring of the other sign; are time and displacement in the units that were given?",
    "zeta": "energy fed in: did something drive the column, and is the record a decay from its beginning?",
    "c": "energy fed in: was the rotor driven or tilted, and is the record a decay from its beginning?",
    "SP": "angles of the locked pendulums, masses or lengths that are not the rig's",
}


def keep_physical(estimate: Estimate, rig: Rig) -> tuple[Estimate | None, list[str]]:
    """Remove impossible values from an estimate.

    Returns:
        The estimate, or None if no value is left; a message for each removed value.
    """
    refused = {n: why for n in estimate.names if (why := refusal(rig, n, estimate.value(n))) is not None}
    if not refused:
        return estimate, []
    messages = [
        f"{log_names(estimate.sources)}: {name} comes out as {estimate.value(name):.4g} ± {estimate.std[name]:.1g}, "
        f"which no rig has ({why}); it is left out, the rest of the test is kept. {_cause(name, estimate)}"
        for name, why in refused.items()
    ]
    kept = [n for n in estimate.names if n not in refused]
    return (reduced(estimate, kept) if kept else None), messages


def keep_directed(estimate: Estimate, rig: Rig) -> tuple[Estimate | None, list[str]]:
    """Remove k and ζ of a test whose stiffnesses show that the lasers are exchanged; name stiffnesses far off the file.

    Exchanged lasers are the likely cause if k1 and k2 contradict the rig file as they are, and agree with it exchanged.

    Returns:
        The estimate without k and ζ, or None if no value is left; messages.
    """
    own, other = (_off_file(estimate, rig, exchanged) for exchanged in (False, True))
    far = {name: off for name, off in own.items() if abs(off) > _MAX_OFF_FILE}
    if not far:
        return estimate, []
    found = ", ".join(
        f"{n} = {estimate.value(n):.4g} N/m is {math.exp(off):.3g} times the rig file's" for n, off in far.items()
    )
    logs = log_names(estimate.sources)
    if max(abs(off) for off in other.values()) > _MAX_OFF_FILE:
        return estimate, [
            f"{logs}: {found}. Is the rig file this rig's, are its masses right, and are time and displacement in the "
            "units that were given?"
        ]
    kept = [n for n in estimate.names if n not in _DIRECTED]
    return (reduced(estimate, kept) if kept else None), [
        f"{logs}: {found}; exchanged, the stiffnesses agree with the file. Likely: lasers x and y are exchanged. k and "
        "ζ of this test are left out. Exchange the lasers' cables or their names in the rig file, or k1 and k2 in it"
    ]


def _off_file(estimate: Estimate, rig: Rig, exchanged: bool) -> dict[str, float]:
    """Logarithm of each stiffness over that of the rig file, or over that of the other direction if exchanged."""
    stated = rig.physics.identified()
    names: list[str] = [n for n in _STIFFNESSES if n in estimate.names]
    of = reversed(_STIFFNESSES) if exchanged else _STIFFNESSES
    beside = {name: stated[other] for name, other in zip(_STIFFNESSES, of, strict=True)}
    return {name: math.log(estimate.value(name) / beside[name]) for name in names}


def physical_parameters(parameters: IdentifiedParameters, rig: Rig) -> tuple[IdentifiedParameters, list[str]]:
    """Remove impossible values from the joint estimate. Possible values of single tests may combine to such values."""
    bad = {n: v for n, v in parameters.values.items() if refusal(rig, n, v) is not None}
    if not bad:
        return parameters, []
    messages = [f"{n}: all tests together give {v:.4g}, which no rig has; it is left out" for n, v in bad.items()]
    return parameters.without(bad), messages


def _cause(name: str, estimate: Estimate) -> str:
    value, std = estimate.value(name), estimate.std[name]
    if abs(value) < 3 * std:
        return "It is zero within its uncertainty: a longer or stronger record would show it"
    return f"Likely: {next(why for stem, why in _CAUSES.items() if name.startswith(stem))}"


def run_up_sides(
    run: Run, fit: RunUpFit, estimate: Estimate, rig: Rig, gains: tuple[float, float]
) -> tuple[Estimate, list[str]]:
    """Detect contradictions in a run-up: a pendulum half a turn off its lock, the index mark, a sensor's sign or size.

    S_P follows from the angles of the locked pendulums. If an angle deviates by half a turn from its lock (A at 0°, B
    at 180°), S_P is left out, and the message contains its value for the corrected angle. k and ζ do not depend on it.

    Returns:
        The estimate, without S_P if it is affected; messages.
    """
    messages = _opposite(run, fit) + _sensors_apart(run, fit, gains)
    if "SP_kg_m" not in estimate.names or not len(run.angle_rad):
        return estimate, messages
    locked = np.mean(run.angle_rad, axis=0)
    turned = [k for k in (0, 1) if _apart(float(locked[k]), _LOCKED_AT[k]) > _MIN_HALF_TURN_RAD]
    if not turned:
        return estimate, messages
    shift = np.array([math.pi if k in turned else 0.0 for k in (0, 1)])
    other = run_up_estimate(replace(run, angle_rad=run.angle_rad + shift), fit, rig.physics, gains)
    read = " and ".join(f"{'AB'[k]} reads {_degrees(float(locked[k])):.0f}°" for k in turned)
    expected = " and ".join(f"{_degrees(_LOCKED_AT[k]):.0f}°" for k in turned)
    messages.append(
        f"{Path(run.source).name}: {read} in its lock, expected {expected}: an encoder's zero half a turn off, or its "
        f"sense. S_P would be {estimate.value('SP_kg_m'):.4g} kg m by that reading, {other.value('SP_kg_m'):.4g} kg m "
        "with half a turn more; it is left out, k and ζ do not depend on it. Set the encoder's zero (at its lock) and "
        "repeat the run-up; releases need it too"
    )
    kept = [n for n in estimate.names if n != "SP_kg_m"]
    return reduced(estimate, kept), messages


def _opposite(run: Run, fit: RunUpFit) -> list[str]:
    """Messages if the imbalance appears opposite to its angle, in both sensors or in one of them."""
    sides = {
        axis: _apart(math.radians(fit.values[name]), 0.0) > _MIN_HALF_TURN_RAD
        for axis in "xy"
        if (name := f"phase_{axis}_deg") in fit.values
    }
    name = Path(run.source).name
    if len(sides) == 2 and sides["x"] != sides["y"]:
        axis = "x" if sides["x"] else "y"
        return [
            f"{name}: laser {axis} shows the imbalance opposite to the other laser: its axis points in the opposite "
            f"direction. k, ζ and S_P do not depend on it, the orbits' sense does; change the sign of its channel"
        ]
    if sides and all(sides.values()) and run.phase_absolute:
        return [
            f"{name}: the imbalance appears half a turn from its angle by ψ: the index mark is half a turn off "
            "(index_angle_deg of the device that marks the rotor's phase), or both lasers point in the opposite "
            "direction. k, ζ and S_P do not depend on it, releases and points do; correct it before them"
        ]
    return []


def _sensors_apart(run: Run, fit: RunUpFit, gains: tuple[float, float]) -> list[str]:
    """Message if the sensors contradict each other in the size of the imbalance."""
    apart = sensors_apart_m(fit, gains)
    if apart == 0.0:
        return []
    x, y = (1e6 * fit.values[f"amplitude_{axis}_m"] for axis in "xy")
    return [
        f"{Path(run.source).name}: laser x shows an eccentricity of {x:.5g} µm, laser y {y:.5g} µm, more apart than "
        "their gains permit: did the imbalance change between the resonances, does a laser's stand move, or is a gain "
        "wrong? S_P is their mean, and its uncertainty contains half of the difference"
    ]


def _apart(angle: float, other: float) -> float:
    """Distance between two angles on the circle, rad."""
    return abs(math.remainder(angle - other, 2 * math.pi))


def _degrees(angle: float) -> float:
    return math.degrees(angle) % 360.0

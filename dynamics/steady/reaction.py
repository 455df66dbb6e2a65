"""Reaction of the pendulums to a sudden change of the rig at speed, for example of the imbalance or of a spring.

The rotor keeps its speed. The motion starts in the stable state of the original rig and is simulated with the equations
of the changed rig. Source: docs/theory/steady_states.md, "Reaction to a sudden change".
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dynamics.arguments import check_number
from dynamics.arrays import Array
from dynamics.equations.parameters import RigOrParameters, physics_of
from dynamics.equations.scene import Scene
from dynamics.equations.speed_history import SpeedHistory
from dynamics.errors import OutsideDomain
from dynamics.motions.integrate import simulate
from dynamics.steady.steady_motions import steady_states
from dynamics.steady.steady_state import SteadyState
from rig_basics.tabular import Column, Tabular

_SAMPLES_PER_REVOLUTION = 32
_CONSTANTS = 14.0  # simulated time in time constants of the slowest motion
_MIN_REVOLUTIONS, _MAX_S = 60, 600.0
_NEAR_RAD = 1e-2


@dataclass(frozen=True)
class Reaction(Tabular):
    """A motion after a sudden change.

    Attributes:
        before: stable state of the original rig, in which the motion starts.
        after: stable state of the changed rig reached by the motion, or None.
        time_s: time after the change at the middle of each revolution, s, shape (n,).
        amplitude_m: rms distance of the disk's centre from its mean over each revolution, shape (n,).
        theta_rad: means of θ3, θ4 over each revolution, not reduced, shape (n, 2).
        peak_m: largest amplitude after the change.
        reaction_s: time from which the amplitude stays within the given share of its largest deviation from the end, s;
            NaN if no state was reached.
        time_constant_s: time constant of the slowest deviation from the state reached, from its largest multiplier, s;
            NaN if no state was reached.
    """

    before: SteadyState
    after: SteadyState | None
    time_s: Array
    amplitude_m: Array
    theta_rad: Array
    peak_m: float
    reaction_s: float
    time_constant_s: float

    @property
    def heading(self) -> str:
        """States before and after, and what happened between them."""
        after = f"{self.after.type}, reached in {self.reaction_s:.4g} s" if self.after else "no stable state"
        return f"Reaction: {self.before.type} → {after}; amplitude at most {self.peak_m:.4g} m"

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each revolution."""
        angles = dict(zip(("theta3_rad", "theta4_rad"), self.theta_rad.T, strict=True))
        return {"time_s": self.time_s, "amplitude_m": self.amplitude_m, **angles}


def reaction(
    rig: RigOrParameters,
    changed: RigOrParameters,
    speed_rad_s: float,
    share: float = 0.05,
    seconds: float | None = None,
) -> Reaction:
    """Simulate the motion from the stable state of one rig with the equations of another.

    Args:
        rig, changed: original and changed rig: RotorParameters, or an object whose `.physics` is one.
        speed_rad_s: speed of the rotor, rad/s, constant.
        share: fraction of the largest deviation of the amplitude at which the reaction counts as finished; 0 … 1.
        seconds: simulated time, s. None: fourteen time constants of the slowest stable state of the changed rig.
    Raises:
        OutsideDomain: the rig has no stable state, or an argument is outside its range.
    """
    check_number(speed_rad_s=speed_rad_s, share=share)
    if not 0 < share < 1:
        raise OutsideDomain(f"share must lie between 0 and 1, got {share!r}")
    old, new = physics_of(rig), physics_of(changed)
    stable = [state for state in steady_states(old, speed_rad_s, 1e-8) if state.stable]
    if not stable:
        raise OutsideDomain(f"at {speed_rad_s:.6g} rad/s the rig has no stable state from which a change could start")
    ends = [state for state in steady_states(new, speed_rad_s, 1e-8) if state.stable]
    constants = [_time_constant(state, speed_rad_s) for state in ends]
    if seconds is None:
        seconds = min(_MAX_S, _CONSTANTS * max(constants, default=5.0))
    turn = 2 * math.pi / speed_rad_s
    if not (math.isfinite(seconds) and seconds > 0):
        raise OutsideDomain(f"seconds must be finite and above 0, got {seconds!r}")
    turns = max(_MIN_REVOLUTIONS, math.ceil(seconds / turn))
    time = np.arange(turns * _SAMPLES_PER_REVOLUTION) * (turn / _SAMPLES_PER_REVOLUTION)
    scene = Scene(SpeedHistory.constant(speed_rad_s), (old.a.present, old.b.present), stable[0].start)
    motion = simulate(new, scene, time, 1e-6)
    centre = np.asarray(motion.displacement_m, np.float64).reshape(turns, _SAMPLES_PER_REVOLUTION, 2)
    amplitude = np.sqrt(np.mean(np.sum((centre - centre.mean(axis=1, keepdims=True)) ** 2, axis=2), axis=1))
    theta = np.asarray(motion.angles_rad, np.float64).reshape(turns, _SAMPLES_PER_REVOLUTION, 2).mean(axis=1)
    reached = [i for i, end in enumerate(ends) if _apart(theta[-1], end.theta_rad) < _NEAR_RAD]
    after = ends[reached[0]] if reached else None
    took = math.nan
    if after is not None:
        off = np.abs(amplitude - after.amplitude_m)
        outside = np.flatnonzero(off > share * np.max(off))
        took = float((outside[-1] + 1) * turn) if len(outside) else 0.0
    middles: Array = (np.arange(turns, dtype=np.float64) + 0.5) * turn
    return Reaction(
        stable[0],
        after,
        middles,
        amplitude,
        theta,
        float(np.max(amplitude)),
        took,
        constants[reached[0]] if reached else math.nan,
    )


def _time_constant(state: SteadyState, speed_rad_s: float) -> float:
    """Time constant of the slowest deviation, s."""
    return -2 * math.pi / speed_rad_s / math.log(state.multiplier_max)


def _apart(theta: Array, other: tuple[float, float]) -> float:
    gap = np.angle(np.exp(1j * (theta - np.array(other))))
    return float(np.max(np.abs(gap)))

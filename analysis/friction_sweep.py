"""Scatter of start-ups over the assumed dry friction: the friction that is consistent with a measured scatter.

Source: docs/theory/start_ups.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from analysis.settled_scatter import SettledScatter, settled_scatter
from dynamics import RotorParameters, balanced_angles
from dynamics.motions.start_ups import start_ups_from_rest
from dynamics.steady.stick_band import held_share, stick_half_width
from rig_basics.arrays import Array


@dataclass(frozen=True)
class FrictionSweep:
    """Start-ups from the same initial angles at several friction arms.

    Attributes:
        arm_m: friction arm of both pendulums, ascending, shape (k,).
        scatter: scatter at each arm.
        half_width_rad: distance from balance at which friction holds a pendulum, to first order, shape (k,).
        held: largest share of the friction that a final state needs, shape (k,); at most 1 if all have come to rest.
        still: share of the start-ups that have come to rest, shape (k,).
        followed: share of the start-ups with a reliable path, shape (k,); see StartUpEnds.
    """

    arm_m: Array
    scatter: tuple[SettledScatter, ...]
    half_width_rad: Array
    held: Array
    still: Array
    followed: Array

    @property
    def scatter_rad(self) -> Array:
        """Standard deviation of the final angles between start-ups, shape (k,)."""
        return np.array([each.scatter_rad for each in self.scatter])

    @property
    def amplitude_m(self) -> Array:
        """Mean remaining amplitude, shape (k,)."""
        return np.array([float(np.mean(each.amplitude_m)) for each in self.scatter])

    def arm_at(self, scatter_rad: float) -> float:
        """Return the least arm above which every scatter is at least `scatter_rad`, m; NaN if it does not exist.

        Arm and scatter are interpolated on logarithmic scales.
        """
        over = self.scatter_rad >= scatter_rad
        if not over[-1]:
            return math.nan
        last_below = np.flatnonzero(~over)
        if not len(last_below):
            return float(self.arm_m[0])
        i = int(last_below[-1])
        low, high = (math.log(max(value, 1e-12)) for value in self.scatter_rad[i : i + 2].tolist())
        share = (math.log(scatter_rad) - low) / (high - low)
        return float(self.arm_m[i] * (self.arm_m[i + 1] / self.arm_m[i]) ** share)


def balance_of(p: RotorParameters) -> float | None:
    """Return the angle of two equal pendulums from the side opposite the imbalance at balance, rad; None if none."""
    angles = balanced_angles(p)
    return abs(math.remainder(angles[0][0] - math.pi, 2 * math.pi)) if angles else None


def with_arm(p: RotorParameters, arm_m: float) -> RotorParameters:
    """Return the rig with another friction arm of both pendulums."""
    return replace(p, a=replace(p.a, friction_arm_m=arm_m), b=replace(p.b, friction_arm_m=arm_m))


def scatter_over_friction(
    p: RotorParameters,
    arm_m: Sequence[float],
    speed: float,
    ramp_s: float,
    start_rad: Array,
    settle_s: float = 30.0,
    progress: Callable[[int, int], None] | None = None,
) -> FrictionSweep:
    """Simulate start-ups from rest at each of several friction arms.

    Args:
        p: parameters of the rig; its friction arms are replaced.
        arm_m: friction arms, ascending, m.
        speed, ramp_s, settle_s: as in `start_ups_from_rest`.
        start_rad: initial angles at rest, the same at each arm, shape (n, 2).
        progress: called with (completed start-ups, all start-ups).
    Raises:
        OutsideDomain: see start_ups_from_rest.
        NotEnoughData: fewer than two start-ups.
    """
    count, balance = len(start_rad), balance_of(p)
    rigs = [with_arm(p, arm) for arm in arm_m for _ in range(count)]
    ends = start_ups_from_rest(rigs, speed, ramp_s, np.tile(start_rad, (len(arm_m), 1)), settle_s, progress)
    parts = [slice(i * count, (i + 1) * count) for i in range(len(arm_m))]
    at = (math.pi, math.pi) if balance is None else (math.pi - balance, math.pi + balance)
    held = [max(held_share(rigs[i], speed, (float(a), float(b)))) for i, (a, b) in enumerate(ends.theta_rad)]
    still = ends.drift_rad < math.radians(0.01)
    return FrictionSweep(
        np.asarray(arm_m, np.float64),
        tuple(settled_scatter(ends.theta_rad[part], ends.amplitude_m[part, 0], balance) for part in parts),
        np.array([stick_half_width(with_arm(p, arm), speed, at)[0] for arm in arm_m]),
        np.array([max(held[part]) for part in parts]),
        np.array([float(np.mean(still[part])) for part in parts]),
        np.array([float(np.mean(ends.followed[part])) for part in parts]),
    )

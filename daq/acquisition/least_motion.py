"""Least once-per-turn motion of each displacement sensor that the rig file's numbers imply while the rotor turns.

With pendulums at known angles the rotor has the first moment S = |S_P + Σ m l e^{iθ}|. Along a stiffness axis, far from
both resonances, the disk centre moves at the frequency of rotation with the amplitude

    |X| = |S ω² + k b| / sqrt((k − M ω²)² + (c ω)²) + r,

where b is an unknown bow and r the run-out, each in an unknown direction. The bound takes half of S, |b| + |r| =
`RUN_OUT_M` against it, and stiffness and damping in the ranges below, whichever gives the smallest amplitude. It is 0
where the file permits that nothing is seen. A sensor at an angle to the axes measures x and y in quadrature, so the
squares of its shares add. Near a resonance the phases turn, and a ramp has not built up the motion: nothing is implied
there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from rig_configs.schema import Rig

MOMENT_SHARE = 0.5
"""Least true first moment over the rig file's: between two identifications the weight is changed, rarely to less."""
RUN_OUT_M = 50e-6
"""Largest sum of bow and run-out against the unbalance, m; of a turned disk on a straight column. With the whole S_P it
is twice that."""
_STIFFNESS_SHARE = 0.2  # of springs in the rig file before they are identified
_DAMPING_FACTOR = 2.0
_NEAR = (0.75, 1.5)  # band of speeds over a resonance in which nothing is implied; 20 % of stiffness are 10 % of it
_LOCKED_RAD = math.radians(5.0)  # deviation from 0° and 180° of pendulums that stand at their locks


@dataclass(frozen=True)
class LeastMotion:
    """Numbers of a rig file for the bound.

    Attributes:
        moment_kg_m: S with the pendulums at 0° and 180°; 0 if their angles are not measured and they could balance.
        mass_kg: vibrating mass.
        stiffness_N_per_m, damping_Ns_per_m: along x and y.
        turn_rad: angle from the stiffness axes to the sensors'.
        has_angles: whether the pendulums' angles must show that they stand at their locks.
    """

    moment_kg_m: float
    mass_kg: float
    stiffness_N_per_m: tuple[float, float]
    damping_Ns_per_m: tuple[float, float]
    turn_rad: float = 0.0
    has_angles: bool = True

    @classmethod
    def of(cls, rig: Rig) -> LeastMotion:
        """Return the numbers of a rig file."""
        physics, measured = rig.physics, rig.roles.angles is not None
        a, b = (pendulum.mass_kg * pendulum.length_m for pendulum in (physics.a, physics.b))
        moment = physics.imbalance_moment_kg_m
        return cls(
            abs(moment + a - b) if measured else max(0.0, moment - a - b),
            physics.total_mass_kg,
            (physics.k1_N_per_m, physics.k2_N_per_m),
            physics.damping_Ns_per_m,
            math.radians(rig.roles.turn_deg),
            measured and a + b > 0,
        )

    def stand_at_locks(self, theta_rad: tuple[float, float]) -> bool:
        """Return whether both pendulums are at their locks, at 0° and 180°."""
        at = (theta_rad[0], theta_rad[1] - math.pi)
        return all(abs(math.remainder(angle, 2 * math.pi)) <= _LOCKED_RAD for angle in at)

    def unbalance_m(self, axis: str, slowest_rad_s: float, fastest_rad_s: float) -> float:
        """Return the bound without bow and run-out, m, which cannot hide a motion to the last bit of a reading."""
        return min(self._amplitude_m(axis, speed, 0.0) for speed in (slowest_rad_s, fastest_rad_s))

    def amplitude_m(self, axis: str, slowest_rad_s: float, fastest_rad_s: float) -> float:
        """Return the bound of a sensor's once-per-turn amplitude over a range of speeds, m; 0 if none is implied."""
        for stiffness in self.stiffness_N_per_m:
            natural = math.sqrt(stiffness / self.mass_kg)
            if slowest_rad_s < _NEAR[1] * natural and fastest_rad_s > _NEAR[0] * natural:
                return 0.0
        return min(self._amplitude_m(axis, speed, RUN_OUT_M) for speed in (slowest_rad_s, fastest_rad_s))

    def _amplitude_m(self, axis: str, speed_rad_s: float, run_out_m: float) -> float:
        x, y = (
            self._along(k, c, speed_rad_s, run_out_m)
            for k, c in zip(self.stiffness_N_per_m, self.damping_Ns_per_m, strict=True)
        )
        own, across = (x, y) if axis == "x" else (y, x)
        return math.hypot(own * math.cos(self.turn_rad), across * math.sin(self.turn_rad))

    def _along(self, stiffness: float, damping: float, speed: float, run_out_m: float) -> float:
        inertia = self.mass_kg * speed**2
        off = max(abs((1 + sign * _STIFFNESS_SHARE) * stiffness - inertia) for sign in (-1, 1))
        dynamic = math.hypot(off, _DAMPING_FACTOR * damping * speed)
        by_unbalance = MOMENT_SHARE * self.moment_kg_m * speed**2 / dynamic
        against = run_out_m * max(1.0, (1 + _STIFFNESS_SHARE) * stiffness / dynamic)  # a run-out, or a bow
        return max(0.0, by_unbalance - against)

"""Eigenvalues of singular points over speed and both dampings, the data of Tables 3.1 to 3.4."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynamics.equations.balancing import IMPROPERLY_OVERSIZED, PROPERLY_OVERSIZED, UNDERSIZED
from dynamics.equations.parameters import RotorParameters
from dynamics.steady.point_eigenvalues import point_eigenvalues, stability_of
from dynamics.steady.singular_points import SingularPoint, singular_points
from reproduction.items.pendulum_sets import isotropic_rig, with_moments
from reproduction.workspace import Workspace

SUB, SUPER = "subcritical", "supercritical"
SPEEDS: Mapping[str, tuple[float, ...]] = {SUB: (0.3, 0.5, 0.8, 0.95), SUPER: (1.02, 1.1, 1.5, 2.5, 5.0)}
ZETAS = (0.005, 0.02, 0.05, 0.1, 0.3)
C34 = tuple(float(c) for c in np.logspace(-5, 0, 21))
SHOWN_SPEED = {SUB: 0.8, SUPER: 2.5}
SHOWN_ZETA, SHOWN_C34 = 0.05, 1e-3
ABSENT = 2
"""Stability of a point that does not exist."""


@dataclass(frozen=True)
class PendulumSet:
    """A pendulum set in a region: S_A and S_B over S_P, A the heavier."""

    region: str
    a: float
    b: float


CASES = (
    PendulumSet(PROPERLY_OVERSIZED, 1.1, 0.7),
    PendulumSet(UNDERSIZED, 0.5, 0.3),
    PendulumSet(IMPROPERLY_OVERSIZED, 1.7, 0.5),
)


@dataclass(frozen=True)
class SweepRig:
    """The rig of a region, with adjustable dampings."""

    case: PendulumSet
    rig: RotorParameters

    @classmethod
    def of(cls, work: Workspace, case: PendulumSet) -> SweepRig:
        """Return the isotropic rig with a case's pendulums."""
        p = isotropic_rig(work)
        s = p.imbalance_moment_kg_m
        return cls(case, with_moments(p, case.a * s, case.b * s))

    def damped(self, zeta: float, c34: float) -> RotorParameters:
        """Return the rig with these damping ratios and pendulum dampings, N m s/rad."""
        a, b = (replace(q, damping_Nms_per_rad=c34) for q in (self.rig.a, self.rig.b))
        return replace(self.rig, zeta1=zeta, zeta2=zeta, a=a, b=b)


@dataclass(frozen=True)
class Swept:
    """Both points of a type over a sweep.

    Attributes:
        stable: as from stability_of, or ABSENT; shape (sets, speeds, ZETAS, C34): sets I and II of the type, set II
            the point whose whirl is further along the pendulums' moment; for Type I two mirror images.
        speeds: speed ratios.
    """

    stable: NDArray[np.int64]
    speeds: tuple[float, ...]

    def at(self, ratio: float, zeta: float, c34: float) -> NDArray[np.int64]:
        """Return the stability of both sets at one place of the sweep, shape (2,)."""
        nearest = int(np.argmin(np.abs(np.log(np.array(C34) / c34))))
        return self.stable[:, self.speeds.index(ratio), ZETAS.index(zeta), nearest]


def points_of(p: RotorParameters, ratio: float, kind: str) -> list[SingularPoint]:
    """Return the singular points of a type at a speed ratio: set I, then set II."""
    return [point for point in singular_points(p, p.speed_rad_s(ratio)) if point.type == kind][::-1]


def swept(bench: SweepRig, operation: str, kind: str) -> Swept:
    """Compute the stability of a type's points over SPEEDS, ZETAS and C34."""
    speeds = SPEEDS[operation]
    stable = np.full((2, len(speeds), len(ZETAS), len(C34)), ABSENT, np.int64)
    for i, ratio in enumerate(speeds):
        for j, zeta in enumerate(ZETAS):
            points = points_of(bench.damped(zeta, C34[0]), ratio, kind)
            if points:
                for k, c34 in enumerate(C34):
                    p = bench.damped(zeta, c34)
                    stable[: len(points), i, j, k] = stability_of(point_eigenvalues(p, p.speed_rad_s(ratio), points))
    return Swept(stable, speeds)


def real_parts(bench: SweepRig, operation: str, kind: str, c34: Sequence[float]) -> list[NDArray[np.float64]]:
    """Return real parts of both sets' eigenvalues over c34 at SHOWN_SPEED and SHOWN_ZETA, shape (c34, 8) each, 1/s."""
    ratio = SHOWN_SPEED[operation]
    points = points_of(bench.damped(SHOWN_ZETA, c34[0]), ratio, kind)
    speed = bench.rig.speed_rad_s(ratio)
    found = np.array([point_eigenvalues(bench.damped(SHOWN_ZETA, c), speed, points).real for c in c34])
    return [found[:, i] for i in range(len(points))]


def stable_types(p: RotorParameters, ratio: float) -> list[str]:
    """Return the types with a stable singular point at a speed ratio, each once."""
    points = singular_points(p, p.speed_rad_s(ratio))
    stable = stability_of(point_eigenvalues(p, p.speed_rad_s(ratio), points)) if points else np.zeros(0, np.int64)
    return sorted({point.type for point, own in zip(points, stable.tolist(), strict=True) if own == 1})

"""Loss of singular points of Types II and III: speeds and damping ratios at which such a point does not exist.

Pendulums in line have the moment S_T e^{iθ}: S_T = |S_A − S_B| opposed (Type II), S_A + S_B together (Type III). Their
torque vanishes at sin(θ + φ_H) = −(S_T/S_P) sin φ_H, φ_H the lag of the whirl behind its exciting force. There is no
solution if S_T sin φ_H > S_P. On an isotropic suspension tan φ_H = 2ζΩ/(1 − Ω²), so with tan β and sin β = S_P/S_T the
pair is lost if
    2ζΩ > |1 − Ω²| tan β:    ζ(Ω) = |1 − Ω²| tan β / (2Ω),    Ω∓(ζ) = sqrt(1 + t²) ∓ t,  t = ζ / tan β,

and Ω₊ = 1/Ω₋. For S_T ≤ S_P the pair is not lost at any damping.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dynamics.arguments import real_array
from dynamics.arrays import Array
from dynamics.equations.parameters import RigOrParameters, RotorParameters, physics_of
from dynamics.errors import OutsideDomain
from dynamics.steady.singular_points import dynamic_stiffness


@dataclass(frozen=True)
class PointLoss:
    """Speeds at which a rig has no singular point of a type.

    Attributes:
        type: "II" (opposed) or "III" (together).
        moment_kg_m: S_T, kg m.
        speed_ratios: intervals (from, to) of Ω = ω/ω_n1 without such a point; empty if it is never lost.
    """

    type: str
    moment_kg_m: float
    speed_ratios: tuple[tuple[float, float], ...]

    def holds(self, speed_ratio: float) -> bool:
        """Whether the pair of points is lost at a speed ratio."""
        return any(low < speed_ratio < high for low, high in self.speed_ratios)


def damping_at_loss(share: float, speed_ratio: Array) -> Array:
    """Damping ratio of an isotropic suspension above which a pair of singular points is lost.

    Args:
        share: S_P/S_T, not negative.
        speed_ratio: Ω, above 0, any shape.
    Returns:
        ζ(Ω); inf if the pair is never lost (share at least 1).
    Raises:
        OutsideDomain: a share or a speed ratio outside these ranges.
    """
    ratio, tangent = real_array("speed_ratio", speed_ratio), _tangent(share)
    if not np.all((ratio > 0) & np.isfinite(ratio)):
        raise OutsideDomain(f"speed ratios: expected finite values above 0, got {speed_ratio!r}")
    if tangent == math.inf:
        return np.full(ratio.shape, math.inf)
    return np.abs(1 / ratio - ratio) * tangent / 2


def speeds_at_loss(share: float, zeta: Array) -> tuple[Array, Array]:
    """Speed ratios between which a pair of singular points on an isotropic suspension is lost.

    Args:
        share: S_P/S_T, not negative.
        zeta: damping ratios, not negative, any shape.
    Returns:
        Ω₋ and Ω₊ = 1/Ω₋; both 1 if nothing is lost.
    Raises:
        OutsideDomain: a share or a damping ratio outside these ranges.
    """
    damping, tangent = real_array("zeta", zeta), _tangent(share)
    if not np.all((damping >= 0) & np.isfinite(damping)):
        raise OutsideDomain(f"damping ratios: expected finite values not below 0, got {zeta!r}")
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(damping > 0, damping / tangent, 0.0)
    upper = np.hypot(1.0, t) + t
    return 1 / upper, upper


def point_losses(rig: RigOrParameters) -> tuple[PointLoss, PointLoss]:
    """Speeds at which a rig has no singular points of Type II, and of Type III.

    The result is exact on an isotropic suspension without gravity. Otherwise it is the condition of the mean torque for
    pendulums at rest on the rotor: in a lost interval an orbit with oscillating heavy pendulums may still exist.

    Args:
        rig: RotorParameters, or an object whose `.physics` is one; linear suspension, no pivot shift, no bow.
    Raises:
        OutsideDomain: the suspension is not linear, or there is a pivot shift or a bow.
    Source: docs/theory/steady_states.md; verified against singular_points on both sides of each border.
    """
    p = physics_of(rig)
    if not p.suspension_is_linear or p.pivot_shift_m != 0 or p.bow_m != 0:
        raise OutsideDomain(
            "the loss of singular points is known for a linear suspension without pivot shift and bow; use "
            "steady_states at single speeds for this rig"
        )
    a, b = p.a.first_moment_kg_m, p.b.first_moment_kg_m
    return (
        PointLoss("II", abs(a - b), _lost(p, abs(a - b))),
        PointLoss("III", a + b, _lost(p, a + b)),
    )


def _tangent(share: float) -> float:
    """tan β for sin β = share; inf for a share of at least 1."""
    (value,) = real_array("share", [share])
    if not value >= 0:
        raise OutsideDomain(f"share S_P/S_T: expected a value not below 0, got {share!r}")
    return math.inf if value >= 1 else float(value / math.sqrt((1 - value) * (1 + value)))


def _lost(p: RotorParameters, moment: float) -> tuple[tuple[float, float], ...]:
    forcing = p.imbalance_moment_kg_m
    if moment <= forcing:
        return ()
    if forcing == 0:
        return ((0.0, math.inf),) if p.zeta1 > 0 or p.zeta2 > 0 else ()
    if p.is_isotropic:
        low, high = speeds_at_loss(forcing / moment, np.array(p.zeta1))
        return ((float(low), float(high)),) if high > low else ()
    return _between(_candidates(p, forcing / moment), lambda ratio: _excess(p, moment, ratio))


def _excess(p: RotorParameters, moment: float, ratio: float) -> float:
    """sin φ_H − S_P/S_T, positive if the pair is lost."""
    stiffness = dynamic_stiffness(p, p.speed_rad_s(ratio))
    if not math.isfinite(abs(stiffness)):
        return -1.0
    lag = stiffness.imag / abs(stiffness) if stiffness != 0 else 1.0
    return lag - p.imbalance_moment_kg_m / moment


def _candidates(p: RotorParameters, share: float) -> list[float]:
    """Speed ratios near which sin² φ_H may equal share², from a polynomial of degree 6 in W = Ω².

    1/D ∝ N/P with N = D1 + D2 = a + iΩb and P = D1 D2 = c + iΩd; sin² φ_H = W(bc − ad)²/((ac + Wbd)² + W(bc − ad)²).
    """
    wide = p.k2_N_per_m / p.k1_N_per_m
    root = math.sqrt(wide)
    w = np.polynomial.Polynomial([0.0, 1.0])
    a, b = 1 + wide - 2 * w, 2 * (p.zeta1 + p.zeta2 * root)
    c = (1 - w) * (wide - w) - 4 * p.zeta1 * p.zeta2 * root * w
    d = 2 * (p.zeta1 * (wide - w) + p.zeta2 * root * (1 - w))
    imaginary, real = w * (b * c - a * d) ** 2, (a * c + w * b * d) ** 2
    roots = ((1 - share) * (1 + share) * imaginary - share**2 * real).roots()
    near = roots.real[(roots.real > 0) & (np.abs(roots.imag) < 0.05 * np.abs(roots))]
    return sorted(math.sqrt(value) for value in [*near.tolist(), 1.0, wide])


def _between(places: list[float], excess: Callable[[float], float]) -> tuple[tuple[float, float], ...]:
    """Intervals of speed ratios with excess > 0. Each sign change must be close to one of the places."""
    edges = [0.0, *places, 2 * places[-1] + 1.0]
    probes = [0.5 * (low + high) for low, high in pairwise(edges) if high > low]
    at = [excess(ratio) for ratio in probes]
    borders = [
        _sign_change(excess, low, high)
        for (low, first), (high, second) in pairwise(zip(probes, at, strict=True))
        if (first > 0) != (second > 0)
    ]
    return tuple((low, high) for low, high in zip(borders[0::2], borders[1::2], strict=True))


def _sign_change(excess: Callable[[float], float], low: float, high: float) -> float:
    """Position of the only sign change of excess between two speed ratios, bisected to the last digit."""
    rises = excess(high) > 0
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (low, middle) if (excess(middle) > 0) == rises else (middle, high)
    return low

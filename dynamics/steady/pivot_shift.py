"""Residual vibration of a balancer with a pivot shifted from the rotor's axis, over the shift.

With a compensated shift R_C the pendulums bring their pivot to rest if they can: z = −R_C, so that the residual radius
is the shift itself. This requires S_A e^{iθ3} + S_B e^{iθ4} = M_S R_C − S_P − (k + iωc) R_C/ω². The modulus of the
right side is smallest near R_C = e = S_P/M_S, where equal pendulums are opposed. It reaches S_A + S_B near
R_C = (S_P + S_A + S_B)/M_S, where they come together and balancing ends. The locked amplitude of equal pendulums is
N e, N = Ω²/√((1 − Ω²)² + (2ζΩ)²), so that the released amplitude over the locked one is ρ_C/N with ρ_C = R_C/e.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import ArrayLike

from dynamics.arrays import Array
from dynamics.equations.parameters import RigOrParameters, RotorParameters, physics_of
from dynamics.errors import OutsideDomain
from dynamics.steady.branches import SteadyBranches, steady_branches
from dynamics.steady.singular_points import singular_points


@dataclass(frozen=True)
class ShiftedPivot:
    """Steady states over the relative shift ρ_C = R_C/e.

    Attributes:
        eccentricity_m: e, m.
        found: branches over ρ_C with break points and locked amplitudes.
        ratio: shift and α = released over locked amplitude of the stable state, (n,) each, for one of two mirror
            images.
        theta_rad: θ3, θ4 of that state, (n, 2).
        apart_rad: the smaller angle between the pendulums, 0 … π, (n,).
        most_apart: ρ_C at which this angle is largest.
        together: ρ_C from which the stable state is Type III; NaN if the range contains no such ρ_C.
    """

    eccentricity_m: float
    found: SteadyBranches
    ratio: tuple[Array, Array]
    theta_rad: Array
    apart_rad: Array
    most_apart: float
    together: float


def shifted_pivot(
    rig: RigOrParameters,
    speed_rad_s: float,
    relative_shift: ArrayLike,
    eccentricity_m: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> ShiftedPivot:
    """Compute the ratio of released to locked amplitude and the pendulum angles over the pivot's shift.

    Args:
        rig: RotorParameters, or an object whose `.physics` is one; its own shift is replaced.
        speed_rad_s: speed of the rotor, rad/s.
        relative_shift: ρ_C = R_C/e, ascending, not negative, shape (n,), n ≥ 2.
        eccentricity_m: e, m. None: S_P/M_S.
        progress: called with the completed share, 0 … 1.
    Raises:
        OutsideDomain: no imbalance, or shifts that are negative or not ascending.
        NotConverged: as steady_states.
    Source: docs/theory/steady_states.md.
    """
    p = physics_of(rig)
    e = p.imbalance_moment_kg_m / p.total_mass_kg if eccentricity_m is None else eccentricity_m
    shifts = np.asarray(relative_shift, np.float64)
    if not 0 < e < math.inf:
        raise OutsideDomain(f"shifted pivot: expected an eccentricity above 0 m, got {e!r}")
    if shifts.ndim != 1 or np.any(shifts < 0):
        raise OutsideDomain(f"shifted pivot: expected relative shifts of 0 or more, got {relative_shift!r:.80}")
    found = steady_branches(lambda rho: (replace(p, pivot_shift_m=rho * e), speed_rad_s), shifts, progress=progress)
    values, amplitude, theta = _stable(found)
    locked = np.interp(values, found.values, found.locked_amplitude_m)
    apart = np.abs(np.angle(np.exp(1j * (theta[:, 0] - theta[:, 1]))))
    ends = [one.value for one in found.break_points if "III" in one.after]
    return ShiftedPivot(
        e,
        found,
        (values, amplitude / locked),
        theta,
        apart,
        _most_apart(p, speed_rad_s, e, values, apart),
        ends[-1] if ends else math.nan,
    )


def _stable(found: SteadyBranches) -> tuple[Array, Array, Array]:
    """Values, amplitudes and angles of the stable states; the first one of mirror images."""
    taken: dict[float, tuple[float, Array]] = {}
    for b in found.stable_branches():
        for i, value in enumerate(b.values.tolist()):
            taken.setdefault(value, (float(b.amplitude_m[i]), b.theta_rad[i]))
    values = sorted(taken)
    amplitude = np.array([taken[value][0] for value in values])
    return np.array(values), amplitude, np.array([taken[value][1] for value in values]).reshape(-1, 2)


def _most_apart(p: RotorParameters, speed: float, e: float, values: Array, apart: Array) -> float:
    """The shift at which the pendulums of the balancing state are farthest apart, between neighbouring values."""
    if len(values) < 3:
        return math.nan
    at = int(np.argmax(apart))
    low, high = float(values[max(at - 1, 0)]), float(values[min(at + 1, len(values) - 1)])

    def together(rho: float) -> float:
        points = singular_points(replace(p, pivot_shift_m=float(rho) * e), speed)
        gaps = [abs(math.remainder(q.theta_rad[0] - q.theta_rad[1], 2 * math.pi)) for q in points if q.type == "I"]
        return -max(gaps, default=0.0)

    best = scipy.optimize.minimize_scalar(together, bounds=(low, high), method="bounded", options={"xatol": 1e-7})
    return float(best.x)

"""Angles at which pendulums with dry friction rest permanently, and the corresponding orbit of the disk.

A pendulum at rest on the rotor needs the torque T = S Im(conj(p̈) e^{iφ}). With the disk's orbit
q = F e^{iψ} + B e^{−iψ} this torque has the mean −ω² S Im(conj(F + R_C) e^{iθ}) and a pulsation of ω² S |B| twice a
revolution. Friction holds permanently if the sum of mean and pulsation is below it for both pendulums. Otherwise the
pulsation releases a pendulum periodically and it creeps. Near frictionless angles both are linear in the angles. The
held region lies inside the outer band of dynamics.steady.stick_band. It vanishes if the pulsation alone exceeds the
friction. Source: docs/theory/validation.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.equations.parameters import RotorParameters
from dynamics.motions.locked_motion import locked_orbit

_STEP_RAD = 1e-6
_TURN = np.linspace(0, 2 * math.pi, 1440, endpoint=False)
_DIRECTIONS: Array = np.stack([np.cos(_TURN), np.sin(_TURN)], axis=1)


@dataclass(frozen=True)
class HeldBand:
    """Angles at which friction can hold both pendulums, relative to frictionless ones.

    Attributes:
        half_width_rad: largest deviation of A and B, shape (2,); π without a restoring torque.
        covariance: covariance of both angles, rad², shape (2, 2): uniform over the region's edge, where a creep ends,
            and extended to that edge along the slowest direction, along which a creep approaches.
        outer_rad: largest deviation of A and B permitted by the mean torque alone, shape (2,) (stick_band). Between it
            and the region a pendulum creeps, because the pulsation releases it twice a revolution.
        orbit_slopes: ∂(X, Y)/∂(θ3, θ4) of the held orbit x = Re(X e^{iψ}), y = Re(Y e^{iψ}), m/rad, shape (2, 2).
    """

    half_width_rad: Array
    covariance: Array
    outer_rad: Array
    orbit_slopes: Complex

    @property
    def whirl_variance_m2(self) -> Array:
        """Variance of the real or the imaginary part of X and Y, m², shape (2,), for uniformly distributed phases."""
        spread = self.orbit_slopes @ self.covariance @ np.conj(self.orbit_slopes).T
        return 0.5 * np.real(np.diag(spread))


def held_band(p: RotorParameters, speed: float, theta: tuple[float, float], torque_Nm: Array) -> HeldBand:
    """Angles at which pendulums can rest, relative to frictionless angles.

    Args:
        speed: speed of the rotor, rad/s.
        theta: θ3, θ4 of a frictionless steady state, rad; means over a revolution if they oscillate.
        torque_Nm: dry friction of A and B at this speed, shape (2,), not negative.
    Raises:
        OutsideDomain: the speed coincides with an undamped resonance.
    """
    moments = np.array([p.a.first_moment_kg_m, p.b.first_moment_kg_m]) * speed**2
    here = np.array(theta)
    ends = [[_orbit(p, speed, here + sign * step) for sign in (1, -1)] for step in _STEP_RAD * np.eye(2)]
    slopes = np.stack([(up - down) / (2 * _STEP_RAD) for up, down in ends], axis=1)
    orbit = _orbit(p, speed, here)
    # derivative of conj(F) e^{iθ} by the angles: through F, and through a pendulum's own angle
    forward, forward_by = orbit[0] + 1j * orbit[1], slopes[0] + 1j * slopes[1]  # twice F
    shift = 2 * p.pivot_shift_m
    turn = np.exp(1j * here)
    stiffness = (
        -0.5
        * moments[:, None]
        * np.imag(np.conj(forward_by)[None, :] * turn[:, None] + np.diag(1j * np.conj(forward + shift) * turn))
    )
    backward, backward_by = np.conj(orbit[0] - 1j * orbit[1]) / 2, np.conj(slopes[0] - 1j * slopes[1]) / 2
    outer = _outer(stiffness, torque_Nm)
    reach = _reach(stiffness, np.concatenate([[backward], backward_by]), moments, torque_Nm)
    ends_rad = _DIRECTIONS * reach[:, None]
    area = float(np.sum(reach**2))
    if not area > 0:
        return HeldBand(np.zeros(2), np.zeros((2, 2)), outer, slopes)
    # the edge of an ellipse has twice the variance of its area: ∫ u uᵀ r³ dr dφ over ∫ r dr dφ
    covariance = np.asarray((ends_rad * reach[:, None]).T @ (ends_rad * reach[:, None]) / area, np.float64)
    viscous = np.array([p.a.damping_Nms_per_rad, p.b.damping_Nms_per_rad])
    slowest = _slowest(stiffness / (viscous if np.all(viscous > 0) else np.ones(2))[:, None])
    along = slowest * np.interp(math.atan2(slowest[1], slowest[0]) % (2 * math.pi), _TURN, reach, period=2 * math.pi)
    lacking = np.outer(along, along) * (1 - _along(covariance, along))
    return HeldBand(np.max(np.abs(ends_rad), axis=0), covariance + lacking, outer, slopes)


def _slowest(rates: Array) -> Array:
    """Unit vector along which both angles come to rest last; 0 if they spiral, which has no such direction."""
    values, vectors = np.linalg.eig(rates)
    if np.iscomplexobj(values) or not np.all(np.isfinite(values)):
        return np.zeros(2)
    return np.asarray(vectors[:, int(np.argmin(np.abs(values)))], np.float64)


def _along(covariance: Array, end: Array) -> float:
    """Variance along a vector divided by the square of its length, at most 1."""
    square = float(end @ end)
    return min(1.0, float(end @ covariance @ end) / square**2) if square > 0 else 1.0


def _outer(stiffness: Array, torque_Nm: Array) -> Array:
    """|K⁻¹| M, at most π; π without a restoring torque."""
    try:
        compliance = np.abs(np.asarray(np.linalg.inv(stiffness), np.float64))
    except np.linalg.LinAlgError:  # usual: no restoring torque
        return np.full(2, math.pi)
    return np.minimum(compliance @ torque_Nm, math.pi)


def _reach(stiffness: Array, backward: Complex, moments: Array, torque_Nm: Array) -> Array:
    """Largest held deviation of both pendulums along each direction of the angles, rad, shape (n,), at most π.

    Along r u friction holds while |K u| r + m |B0 + (B1·u) r| ≤ M: a quadratic in r for each pendulum.

    Args:
        backward: B0 and its derivatives by θ3, θ4, shape (3,).
        moments: ω² S of A and B, shape (2,).
    """
    along, pull = _DIRECTIONS @ backward[1:], np.abs(_DIRECTIONS @ stiffness.T)
    reach = np.full(len(_DIRECTIONS), math.pi)
    for k, m, torque in zip(pull.T, moments.tolist(), torque_Nm.tolist(), strict=True):
        least = abs(backward[0]) ** 2 - (torque / m) ** 2
        if least >= 0:
            return np.zeros(len(_DIRECTIONS))
        square = np.abs(along) ** 2 - (k / m) ** 2
        half = np.real(np.conj(backward[0]) * along) + k * torque / m**2
        root = half + np.sqrt(np.maximum(half**2 - square * least, 0.0))
        reach = np.minimum(reach, np.where(root > 0, -least / np.maximum(root, 1e-300), math.pi))
    return reach


def _orbit(p: RotorParameters, speed: float, theta: Array) -> Complex:
    """X and Y of the orbit with both pendulums at rest on the rotor, x = Re(X e^{iψ}), y = Re(Y e^{iψ}), m, (2,)."""
    x, y = locked_orbit(p, speed, float(theta[0]), float(theta[1]))
    return np.array([x, -1j * y])

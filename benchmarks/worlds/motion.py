"""The rig written down once more, from its Lagrangian, with further effects of a real rig; Runge's method, fixed steps.

With φ_i = ψ + θ_i, S_i = m_i R_i and the rotor's phase ψ(t) given, the kinetic energy

    T = ½ M (ẋ² + ẏ²) + Σ_i [S_i φ̇_i (ẏ cos φ_i − ẋ sin φ_i) + ½ m_i R_i² φ̇_i²] + S_P ω (ẏ cos ψ − ẋ sin ψ)

gives, for the disk and for each pendulum that moves relative to the rotor,

    M ẍ = X + Σ_i S_i (φ̇_i² cos φ_i + φ̈_i sin φ_i) + S_P (ω² cos ψ + ω̇ sin ψ)
    M ÿ = Y + Σ_i S_i (φ̇_i² sin φ_i − φ̈_i cos φ_i) + S_P (ω² sin ψ − ω̇ cos ψ)
    m_i R_i² φ̈_i = S_i (ẍ sin φ_i − ÿ cos φ_i) + τ_i

The φ̈_i are eliminated, which leaves two equations for ẍ and ÿ. X = −k1 u (1 + κ1 u²) − c1 ẋ (1 + q1 |ẋ|) with
u = x − bow cos(ψ + bow angle) is a spring that hardens, a damper with a quadratic part and a bent shaft; Y likewise.
τ = −c θ̇ − d |θ̇| θ̇ − (T + F φ̇²) sign θ̇ holds the magnets, the air (which turns with the disk) and dry friction,
set-valued at θ̇ = 0: a pendulum sticks until the torque that holds it is above T + F φ̇².

Shares no line with the packages under test.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.worlds.kernels import integrated

Array = NDArray[np.float64]
STEP_S = 250e-6
"""Longest step: the fourth-order error of a frequency is (ω h)⁴/120 of it, 1e-9 at 73 rad/s, 5e-9 at 110 rad/s."""


@dataclass(frozen=True)
class SwingingMass:
    """One pendulum.

    Attributes:
        mass_kg, length_m: point mass and arm.
        damping_Nms_per_rad: of the magnets.
        drag_Nms2_per_rad2: torque of the air over the square of the speed relative to the rotor.
        dry_Nm: friction at any speed.
        contact_kg_m2: friction over the square of the absolute speed.
    """

    mass_kg: float
    length_m: float
    damping_Nms_per_rad: float
    drag_Nms2_per_rad2: float = 0.0
    dry_Nm: float = 0.0
    contact_kg_m2: float = 0.0

    def packed(self) -> list[float]:
        """As the kernels take them."""
        return [
            self.mass_kg,
            self.length_m,
            self.damping_Nms_per_rad,
            self.drag_Nms2_per_rad2,
            self.dry_Nm,
            self.contact_kg_m2,
        ]


@dataclass(frozen=True)
class Mechanics:
    """All that moves.

    Attributes:
        mass_kg: of everything together, the pendulums included.
        stiffness_N_per_m, damping_Ns_per_m: along x and y.
        moment_kg_m: of the imbalance.
        a, b: the pendulums.
        hardening_per_m2: relative gain of stiffness over the square of the displacement, x and y.
        quadratic_s_per_m: relative gain of damping over the speed, x and y.
        bow_m, bow_rad: how far the springs' rest lies off the rotor's axis, and where, from the imbalance.
    """

    mass_kg: float
    stiffness_N_per_m: tuple[float, float]
    damping_Ns_per_m: tuple[float, float]
    moment_kg_m: float
    a: SwingingMass
    b: SwingingMass
    hardening_per_m2: tuple[float, float] = (0.0, 0.0)
    quadratic_s_per_m: tuple[float, float] = (0.0, 0.0)
    bow_m: float = 0.0
    bow_rad: float = 0.0

    def packed(self) -> Array:
        """As the kernels take them."""
        return np.array(
            [
                self.mass_kg,
                *self.stiffness_N_per_m,
                *self.damping_Ns_per_m,
                self.moment_kg_m,
                *self.hardening_per_m2,
                *self.quadratic_s_per_m,
                self.bow_m,
                self.bow_rad,
                *self.a.packed(),
                *self.b.packed(),
            ]
        )

    def locked_orbit(self, speed_rad_s: float, locked_rad: Array) -> tuple[complex, complex]:
        """Complex amplitudes X, Y of the linear locked rig: x = Re(X e^{iψ}), y = Re(Y e^{iψ}); the bow included."""
        arms = (self.a.mass_kg * self.a.length_m, self.b.mass_kg * self.b.length_m)
        moment = self.moment_kg_m + sum(s * np.exp(1j * angle) for s, angle in zip(arms, locked_rad, strict=True))
        bow = self.bow_m * np.exp(1j * self.bow_rad)
        x, y = (
            (moment * speed_rad_s**2 + k * bow) / (k - self.mass_kg * speed_rad_s**2 + 1j * c * speed_rad_s)
            for k, c in zip(self.stiffness_N_per_m, self.damping_Ns_per_m, strict=True)
        )
        return complex(x), complex(-1j * y)


@dataclass(frozen=True)
class Turning:
    """The rotor's phase: stretches of constant acceleration.

    Attributes:
        rows: shape (n, 4): from when on (s), ψ (rad), ω (rad/s) and ω̇ (rad/s²) there.
    """

    rows: Array

    @classmethod
    def steady(cls, phase_rad: float, speed_rad_s: float) -> Turning:
        """One speed for ever; phase_rad at t = 0."""
        return cls(np.array([[0.0, phase_rad, speed_rad_s, 0.0]]))

    @classmethod
    def ramp(cls, phase_rad: float, rest_s: float, top_rad_s: float, ramp_s: float) -> Turning:
        """At rest, from `rest_s` on evenly to the top within `ramp_s`, and on at it."""
        alpha = top_rad_s / ramp_s
        there = phase_rad + 0.5 * top_rad_s * ramp_s
        return cls(
            np.array(
                [
                    [0.0, phase_rad, 0.0, 0.0],
                    [rest_s, phase_rad, 0.0, alpha],
                    [rest_s + ramp_s, there, top_rad_s, 0.0],
                ]
            )
        )

    def phase(self, time_s: Array) -> tuple[Array, Array]:
        """ψ and ω, the shape of time_s."""
        own = self.rows[np.clip(np.searchsorted(self.rows[:, 0], time_s, side="right") - 1, 0, None)]
        since = time_s - own[..., 0]
        speed = own[..., 2] + own[..., 3] * since
        return own[..., 1] + since * (own[..., 2] + 0.5 * own[..., 3] * since), speed

    def crossings(self, phases_rad: Array, time_s: Array) -> Array:
        """When the phase passes each of ascending values, s; time_s: any grid that covers them."""
        found = np.interp(phases_rad, self.phase(time_s)[0], time_s)
        for _ in range(3):
            phase, speed = self.phase(found)
            found = found - np.where(speed > 0, (phase - phases_rad) / np.where(speed > 0, speed, 1.0), 0.0)
        return found


def moved(
    mechanics: Mechanics, turning: Turning, time_s: Array, start: Array, free: bool, step_s: float = STEP_S
) -> Array:
    """States at the instants.

    Args:
        time_s: shape (n,), ascending; the start belongs to the first. A change of the rotor's acceleration should be
            one of them.
        start: x, y (m), θ3, θ4 (rad, relative to the rotor) and their rates, shape (8,).
        free: whether the pendulums swing; locked they keep their angles.
        step_s: longest step.
    Returns:
        shape (n, 8), as the start.
    """
    return integrated(
        np.ascontiguousarray(time_s, np.float64),
        np.asarray(start, np.float64),
        turning.rows,
        mechanics.packed(),
        free,
        step_s,
    )

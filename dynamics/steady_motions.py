"""Steady motions at constant speed and their stability.

In the rotating frame q = z e^{iψ} the equations have period half a revolution. Over that time e^{iψ} changes sign,
so a steady motion is a fixed point of the map
    H: state at ψ = 0  →  state at ψ = π with the signs of x, y, ẋ, ẏ turned.
The multipliers over one revolution are the squares of the eigenvalues of H's derivative. Type I is a fixed point
known in closed form, whatever the suspension; Types II and III are found by Newton's method on H, starting from the
isotropic closed form. The derivative of H is exact: a complex step of 1e-30 through the integrator.
"""

# pyright: reportMissingParameterType=false
# Compiled functions: numba takes their types from the arguments, and their docstrings tell them.

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from dynamics.errors import NotConverged
from dynamics.integrate import fastest_rate, integrate, locked_state
from dynamics.kernels import rk4_step
from dynamics.parameters import RotorParameters

_TURN = np.array([-1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True)
class SteadyState:
    """One steady motion.

    Attributes:
        type: "I" balanced, "II" pendulums opposed, "III" pendulums together.
        theta_rad: mean θ3, θ4 over a revolution, in [0, 2π).
        start: state at ψ = 0, shape (8,).
        amplitude_m: rms radius of the disk centre's orbit; for a circle its radius.
        x_m, y_m: complex order-1 amplitudes, x = Re(x_m e^{iψ}), y = Im(y_m e^{iψ}).
        multipliers: complex multipliers over one revolution, shape (8,), largest first.
        error_estimate: change of the largest multiplier when the step is halved.
    """

    type: str
    theta_rad: tuple[float, float]
    start: np.ndarray
    amplitude_m: float
    x_m: complex
    y_m: complex
    multipliers: np.ndarray
    error_estimate: float

    @property
    def multiplier_max(self) -> float:
        """Largest modulus of the multipliers over one revolution."""
        return float(np.abs(self.multipliers[0]))

    @property
    def stable(self) -> bool:
        """Whether every multiplier lies inside the unit circle by more than the error estimate."""
        return self.multiplier_max + self.error_estimate < 1.0


@njit(cache=True, error_model="numpy")
def _half_turn(y0, omega, steps, p, tangent):
    """H and, if asked for, its derivative by complex steps."""
    h = math.pi / omega / steps
    scratch = np.empty((5, 8))
    ph = np.zeros((3, 3))
    ph[:, 1] = omega
    y = y0.copy()
    for i in range(steps):
        ph[0, 0], ph[1, 0], ph[2, 0] = omega * h * i, omega * h * (i + 0.5), omega * h * (i + 1)
        rk4_step(y, h, ph[0], ph[1], ph[2], p, 1.0, 1.0, scratch[0], scratch[1], scratch[2], scratch[3], scratch[4])
    jacobian = np.zeros((8, 8))
    if tangent:
        complex_scratch = np.empty((5, 8), dtype=np.complex128)
        z = np.empty(8, dtype=np.complex128)
        for j in range(8):
            for i in range(8):
                z[i] = y0[i]
            z[j] += 1e-30j
            for i in range(steps):
                ph[0, 0], ph[1, 0], ph[2, 0] = omega * h * i, omega * h * (i + 0.5), omega * h * (i + 1)
                rk4_step(
                    z,
                    h,
                    ph[0],
                    ph[1],
                    ph[2],
                    p,
                    1.0,
                    1.0,
                    complex_scratch[0],
                    complex_scratch[1],
                    complex_scratch[2],
                    complex_scratch[3],
                    complex_scratch[4],
                )
            jacobian[:, j] = z.imag / 1e-30
    return y, jacobian


def _steps(parameters: RotorParameters, speed: float, accuracy: float) -> int:
    """Runge–Kutta steps in half a revolution for a wanted error of the multipliers."""
    turn = math.pi / speed * fastest_rate(parameters, speed)
    return max(16, math.ceil(turn * (turn / 120 / accuracy) ** 0.25))


def _multipliers(parameters: RotorParameters, speed: float, start: np.ndarray, steps: int) -> np.ndarray:
    _, jacobian = _half_turn(start, speed, steps, parameters.packed(), True)
    values = np.linalg.eigvals(_TURN[:, None] * jacobian) ** 2
    return values[np.argsort(-np.abs(values))]


def balanced_angles(parameters: RotorParameters) -> list[tuple[float, float]]:
    """Type I: the angles (θ3, θ4) with S_A e^{iθ3} + S_B e^{iθ4} = −S_P; two mirror images or none."""
    a, b, s = (
        parameters.a.first_moment_kg_m,
        parameters.b.first_moment_kg_m,
        parameters.imbalance_moment_kg_m,
    )
    if s <= 0 or not abs(a - b) <= s <= a + b:
        return []
    theta3 = math.acos(max(-1.0, min(1.0, (b * b - a * a - s * s) / (2 * a * s))))
    theta4 = math.atan2(-a * math.sin(theta3), -s - a * math.cos(theta3))
    return [
        (theta3 % (2 * math.pi), theta4 % (2 * math.pi)),
        (-theta3 % (2 * math.pi), -theta4 % (2 * math.pi)),
    ]


def singular_points(parameters: RotorParameters, speed: float, total_moment: float) -> list[tuple[float, complex]]:
    """Types II and III on an isotropic suspension in closed form.

    Args:
        total_moment: S_T = S_A − S_B (opposed) or S_A + S_B (together), kg m.
    Returns:
        Pairs of the angle θ of pendulum A (rad) and z (m); empty where the singular points are lost.
    """
    p = parameters
    k = 0.5 * (p.k1_N_per_m + p.k2_N_per_m)
    c = 0.5 * sum(p.damping_Ns_per_m)
    response = 1.0 / (k - p.total_mass_kg * speed**2 + 1j * speed * c)
    lag = -np.angle(response)
    sine = -total_moment / p.imbalance_moment_kg_m * math.sin(lag) if p.imbalance_moment_kg_m else math.inf
    if abs(sine) > 1:
        return []
    angles = (math.asin(sine) - lag, math.pi - math.asin(sine) - lag)
    return [
        (a % (2 * math.pi), speed**2 * response * (p.imbalance_moment_kg_m + total_moment * np.exp(1j * a)))
        for a in angles
    ]


def _orbit(parameters: RotorParameters, speed: float, guess: np.ndarray, accuracy: float) -> np.ndarray | None:
    """Newton's method on H; None when it does not converge."""
    packed = parameters.packed()
    steps = _steps(parameters, speed, accuracy)
    y = guess.copy()
    for _ in range(30):
        end, jacobian = _half_turn(y, speed, steps, packed, True)
        residual = _TURN * end - y
        try:
            move = np.linalg.solve(_TURN[:, None] * jacobian - np.eye(8), -residual)
        except np.linalg.LinAlgError:
            return None
        largest = np.max(np.abs(move[2:4]))
        if not np.isfinite(largest):
            return None
        y += move * min(1.0, 0.3 / largest)
        if largest < 1e-11:
            return y
    return None


def _describe(parameters: RotorParameters, speed: float, kind: str, start: np.ndarray, accuracy: float) -> SteadyState:
    steps = _steps(parameters, speed, accuracy)
    coarse = _multipliers(parameters, speed, start, steps)
    fine = _multipliers(parameters, speed, start, 2 * steps)
    per_turn = 64
    times = np.linspace(0, 2 * np.pi / speed, per_turn + 1)
    states = integrate(
        start, times, np.pi / speed / steps, np.array([0.0, 1.0]), np.array([[0.0, speed, 0.0, 0.0]]),
        parameters.packed(), 1.0, 1.0,
    )[:-1]  # fmt: skip
    turn = np.exp(-1j * speed * times[:-1])
    theta = states[:, 2:4].mean(axis=0) % (2 * np.pi)
    return SteadyState(
        type=kind,
        theta_rad=(float(theta[0]), float(theta[1])),
        start=start,
        amplitude_m=float(np.sqrt(np.mean(states[:, 0] ** 2 + states[:, 1] ** 2))),
        x_m=complex(2 * np.mean(states[:, 0] * turn)),
        y_m=complex(2j * np.mean(states[:, 1] * turn)),
        multipliers=fine,
        error_estimate=float(abs(abs(fine[0]) - abs(coarse[0]))) + 1e-12,
    )


def multipliers(parameters: RotorParameters, speed_rad_s: float, accuracy: float = 1e-8) -> SteadyState:
    """The balanced state (Type I) at a speed with its multipliers over one revolution.

    Raises:
        NotConverged: no balanced state exists for these first mass moments.
    """
    angles = balanced_angles(parameters)
    if not angles:
        raise NotConverged("no balanced state: it needs |S_A − S_B| ≤ S_P ≤ S_A + S_B")
    start = np.zeros(8)
    start[2:4] = angles[0]
    return _describe(parameters, speed_rad_s, "I", start, accuracy)


def steady_states(parameters: RotorParameters, speed_rad_s: float, accuracy: float = 1e-8) -> list[SteadyState]:
    """Every steady motion of Types I, II, III found at a constant speed, stable ones first.

    Args:
        parameters: the rig (pivot shift zero).
        speed_rad_s: running speed, rad/s, above 0.
        accuracy: wanted absolute error of the multipliers and of the angles (rad).
    Source: docs/theory/steady_states.md.
    """
    found: list[SteadyState] = []
    for theta3, theta4 in balanced_angles(parameters):
        start = np.zeros(8)
        start[2:4] = theta3, theta4
        found.append(_describe(parameters, speed_rad_s, "I", start, accuracy))
    for kind, gap in (("II", math.pi), ("III", 0.0)):
        for angle in np.arange(8) * math.pi / 4:
            guess = _guess(parameters, speed_rad_s, angle, gap)
            start = _orbit(parameters, speed_rad_s, guess, accuracy)
            if start is None or _known(found, start) or _kind(start) != kind:
                continue
            found.append(_describe(parameters, speed_rad_s, kind, start, accuracy))
    return sorted(found, key=lambda s: (not s.stable, s.type))


def _guess(parameters: RotorParameters, speed: float, angle: float, gap: float) -> np.ndarray:
    return locked_state(parameters, speed, 0.0, angle, angle + gap)


def _kind(start: np.ndarray) -> str:
    """Type by the angle between the pendulums."""
    apart = abs((start[2] - start[3] + math.pi) % (2 * math.pi) - math.pi)
    return "III" if apart < math.radians(30) else "II" if apart > math.radians(165) else "I"


def _known(found: list[SteadyState], start: np.ndarray) -> bool:
    return any(np.max(np.abs(np.exp(1j * s.start[2:4]) - np.exp(1j * start[2:4]))) < 1e-6 for s in found)

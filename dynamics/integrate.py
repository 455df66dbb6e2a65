"""The motion over time: prescribed rotor phase, state integrated inside compiled code."""

# pyright: reportMissingParameterType=false
# Compiled functions: numba takes their types from the arguments, and their docstrings tell them.

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from dynamics.errors import NotConverged
from dynamics.kernels import rk4_step
from dynamics.parameters import RotorParameters
from dynamics.scene import Scene
from dynamics.speed_history import phase_at


@dataclass(frozen=True)
class Motion:
    """A computed motion.

    Attributes:
        time_s: shape (n,).
        state: shape (n, 8): x, y, θ3, θ4, ẋ, ẏ, θ̇3, θ̇4 (SI).
        error_estimate: largest difference at the last instant between the last two step sizes (scaled to the
            finer one by the method's order), in the units of the state (m, rad).
        step_s: the largest step used.
    """

    time_s: np.ndarray
    state: np.ndarray
    error_estimate: float
    step_s: float

    @property
    def displacement_m(self) -> np.ndarray:
        """Disk centre x, y; shape (n, 2)."""
        return self.state[:, :2]

    @property
    def angles_rad(self) -> np.ndarray:
        """θ3, θ4; shape (n, 2)."""
        return self.state[:, 2:4]


@njit(cache=True, error_model="numpy")
def integrate(y0, times, step, knots, coefficients, p, free_a, free_b):
    """States at the given times by classical Runge–Kutta steps no longer than `step`.

    Args:
        y0: shape (8,), state at times[0].
        times: shape (n,), ascending.
    Returns:
        shape (n, 8).
    """
    out = np.empty((len(times), 8))
    y = y0.copy()
    out[0] = y
    scratch = np.empty((5, 8))
    ph = np.empty((3, 3))
    segment = phase_at(times[0], 0, knots, coefficients, ph[0])
    for i in range(1, len(times)):
        t = times[i - 1]
        n = max(1, int(np.ceil((times[i] - t) / step - 1e-9)))
        h = (times[i] - t) / n
        for j in range(n):
            segment = phase_at(t + (j + 0.5) * h, segment, knots, coefficients, ph[1])
            segment = phase_at(t + (j + 1) * h, segment, knots, coefficients, ph[2])
            rk4_step(
                y,
                h,
                ph[0],
                ph[1],
                ph[2],
                p,
                free_a,
                free_b,
                scratch[0],
                scratch[1],
                scratch[2],
                scratch[3],
                scratch[4],
            )
            ph[0] = ph[2]
        out[i] = y
    return out


def locked_orbit(
    parameters: RotorParameters, speed_rad_s: float, theta3_rad: float = 0.0, theta4_rad: float = np.pi
) -> tuple[complex, complex]:
    """Steady motion at constant speed with both pendulums locked.

    Returns:
        X, Y in m: x = Re(X e^{iψ}), y = Im(Y e^{iψ}).
    Source: linear oscillators under F e^{iψ}, F = ω² (S_P + S_A e^{iθ3} + S_B e^{iθ4}).
    """
    p = parameters
    moment = (
        p.imbalance_moment_kg_m
        + p.a.first_moment_kg_m * np.exp(1j * theta3_rad)
        + p.b.first_moment_kg_m * np.exp(1j * theta4_rad)
    )
    w, mass = speed_rad_s, p.total_mass_kg
    c1, c2 = p.damping_Ns_per_m
    force = moment * w * w
    return force / (p.k1_N_per_m - mass * w * w + 1j * w * c1), force / (p.k2_N_per_m - mass * w * w + 1j * w * c2)


def locked_state(
    parameters: RotorParameters, speed_rad_s: float, phase_rad: float, theta3_rad: float, theta4_rad: float
) -> np.ndarray:
    """State (8,) on the locked orbit at one phase; the start of a release."""
    x, y = locked_orbit(parameters, speed_rad_s, theta3_rad, theta4_rad)
    turn = np.exp(1j * phase_rad)
    rate = 1j * speed_rad_s
    return np.array(
        [
            (x * turn).real, (y * turn).imag, theta3_rad, theta4_rad,
            (rate * x * turn).real, (rate * y * turn).imag, 0.0, 0.0,
        ]
    )  # fmt: skip


def fastest_rate(parameters: RotorParameters, speed_rad_s: float) -> float:
    """A bound on how fast the state changes, 1/s: sets the first step of an explicit method."""
    p = parameters
    return max(
        *p.natural_frequencies_rad_s,
        2 * max(p.zeta1, p.zeta2) * max(p.natural_frequencies_rad_s),
        abs(speed_rad_s),
        p.a.damping_Nms_per_rad / p.a.inertia_kg_m2,
        p.b.damping_Nms_per_rad / p.b.inertia_kg_m2,
    )


def simulate(parameters: RotorParameters, scene: Scene, time_s: np.ndarray, accuracy: float = 1e-6) -> Motion:
    """The nonlinear motion of one run.

    Args:
        parameters: the rig.
        scene: speed history, what is released, start state.
        time_s: instants wanted, shape (n,), ascending; the start state belongs to the first.
        accuracy: wanted absolute error of the state's positions at the last instant (m and rad).
    Raises:
        NotConverged: the target is not reached (chaotic or too stiff a motion for the explicit method).
    """
    times = np.ascontiguousarray(time_s, float)
    history = scene.history
    psi, speed, _ = history.phase(times[0])[0]
    peak_speed = np.max(np.abs(history.phase(times)[:, 1]))
    start = locked_state(parameters, speed, psi, 0.0, np.pi) if scene.start is None else scene.start
    y0 = np.ascontiguousarray(start, float)
    packed = parameters.packed()
    free_a, free_b = (float(f) for f in scene.released)
    step = 0.15 / fastest_rate(parameters, peak_speed)

    def run(h: float) -> np.ndarray:
        return integrate(y0, times, h, history.knots_s, history.coefficients, packed, free_a, free_b)

    coarse, error = run(step), np.inf
    for _ in range(8):
        step /= 2
        fine = run(step)
        error = float(np.max(np.abs(fine[-1, :4] - coarse[-1, :4]))) / 15
        if error <= accuracy:
            return Motion(times, fine, error, step)
        coarse = fine
    raise NotConverged(
        f"motion over {times[-1] - times[0]:.3g} s: error estimate {error:.2g} at step {step:.2g} s, "
        f"wanted {accuracy:.2g}; ask for less or shorten the run"
    )

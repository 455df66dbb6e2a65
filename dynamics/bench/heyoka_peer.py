"""The equations of motion in heyoka, a Taylor integrator: reference and peer of the benchmarks and tests.

heyoka has wheels for Linux only and is not a dependency of the project. It is imported at the first use.
"""

from __future__ import annotations

import importlib
import math
from typing import Any

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.equations.parameters import RotorParameters

_TURN = np.array([-1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0])
DOUBLE_TOLERANCE = 2.2e-16


def heyoka() -> Any | None:
    """The heyoka module, or None if it is not installed."""
    try:
        return importlib.import_module("heyoka")
    except ImportError:  # usual: heyoka is optional
        return None


def equations(parameters: RotorParameters, speed_rad_s: float, acceleration_rad_s2: float = 0.0) -> list[Any]:
    """Pairs (variable, rate) for two free pendulums and ψ = ω t + α t²/2.

    The equations come from the second-order form by elimination of the 4 × 4 mass matrix, independent of
    dynamics.equations.kernels.
    """
    hy = heyoka()
    if hy is None:
        raise ImportError("heyoka is not installed; it has wheels for Linux: pip install heyoka")
    p = parameters
    x, y, a, b, vx, vy, va, vb = hy.make_vars("x", "y", "a", "b", "vx", "vy", "va", "vb")
    t, w, al = hy.time, speed_rad_s, acceleration_rad_s2
    psi, omega = w * t + 0.5 * al * t * t, w + al * t
    c1, c2 = p.damping_Ns_per_m
    mass, shift, g = p.total_mass_kg, p.pivot_shift_m, p.gravity_m_per_s2
    cp, sp = hy.cos(psi), hy.sin(psi)
    fx = -c1 * vx - p.k1_N_per_m * x + p.forcing_moment_kg_m * (omega * omega * cp + al * sp)
    fy = -c2 * vy - p.k2_N_per_m * y + p.forcing_moment_kg_m * (omega * omega * sp - al * cp) - mass * g
    mxx, mxy, myy = mass, 0.0, mass
    torques: list[tuple[Any, Any, Any, Any]] = []
    for angle, rate, pendulum in ((a, va, p.a), (b, vb, p.b)):
        s, j, d = pendulum.first_moment_kg_m, pendulum.inertia_kg_m2, pendulum.drive_inertia_kg_m2
        cos, sin = hy.cos(psi + angle), hy.sin(psi + angle)
        around = omega + rate
        pivot = s * (
            sin * (-shift * (al * sp + omega * omega * cp)) - cos * (shift * (al * cp - omega * omega * sp) + g)
        )
        own = (pivot - pendulum.damping_Nms_per_rad * rate - d * al) / j  # θ̈ without the disk's acceleration
        fx += s * (around * around * cos + (own + al) * sin)
        fy += s * (around * around * sin - (own + al) * cos)
        mxx, myy, mxy = mxx - s * s / j * sin * sin, myy - s * s / j * cos * cos, mxy + s * s / j * sin * cos
        torques.append((own, s / j, sin, cos))
    det = mxx * myy - mxy * mxy
    ax, ay = (myy * fx - mxy * fy) / det, (mxx * fy - mxy * fx) / det
    aa, ab = (own + ratio * (ax * sin - ay * cos) for own, ratio, sin, cos in torques)
    return [(x, vx), (y, vy), (a, va), (b, vb), (vx, ax), (vy, ay), (va, aa), (vb, ab)]


def integrator(
    parameters: RotorParameters, speed_rad_s: float, start: Array, tolerance: float = DOUBLE_TOLERANCE
) -> Any:
    """Compiled heyoka integrator of the motion."""
    hy = heyoka()
    assert hy is not None
    return hy.taylor_adaptive(equations(parameters, speed_rad_s), start, tol=tolerance, compact_mode=True)


def half_turn_integrator(parameters: RotorParameters, speed_rad_s: float) -> Any:
    """Compiled heyoka integrator of the motion and all 64 variational states."""
    hy = heyoka()
    assert hy is not None
    system = hy.var_ode_sys(equations(parameters, speed_rad_s), hy.var_args.vars, order=1)
    return hy.taylor_adaptive(system, np.zeros(8), tol=DOUBLE_TOLERANCE, compact_mode=True)


def multipliers(parameters: RotorParameters, speed_rad_s: float, start: Array, compiled: Any | None = None) -> Complex:
    """Multipliers over one revolution of the motion from a state at ψ = 0; no gravity. Shape (8,), largest first."""
    ta = half_turn_integrator(parameters, speed_rad_s) if compiled is None else compiled
    ta.time = 0.0
    ta.state[:8] = start
    ta.state[8:] = np.eye(8).ravel()
    ta.propagate_until(math.pi / speed_rad_s)
    half: Array = ta.state[8:].reshape(8, 8)
    values = np.asarray(np.linalg.eigvals(_TURN[:, None] * half) ** 2, np.complex128)
    return values[np.argsort(-np.abs(values))]

"""heyoka compiled once for all parameters: the reference in 80 bits and the peer in double precision.

The reference solves the equations to 1e-19 per step in extended precision. Its error is therefore far below the error
of every method compared with it, including heyoka in double precision. Extended precision is that of x86.
"""

from __future__ import annotations

import copy
import functools
import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any, TypeAlias, cast

import numpy as np

from dynamics.arrays import Array
from dynamics.bench.heyoka_peer import equations, heyoka
from dynamics.equations.balancing import balanced_angles
from dynamics.equations.parameters import RotorParameters

EXTENDED_TOLERANCE = 1e-19
_TURN = np.array([-1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0])
_PI = np.longdouble("3.14159265358979323846264338327950288")
_SPEED = 12  # index of ω, after the packed parameters used without shift, gravity and friction

Rig: TypeAlias = tuple[RotorParameters, float]
"""Parameters and a running speed in rad/s."""


def available() -> bool:
    """Whether heyoka is installed."""
    return heyoka() is not None


@functools.cache
def compiled(variational: bool, tolerance: float) -> Any:
    """Integrator of the motion, or of motion and variational states; tolerances below 1e-16 use extended precision."""
    hy: Any = heyoka()
    par = hy.par

    def pendulum(s: int, j: int, c: int) -> Any:
        return SimpleNamespace(
            first_moment_kg_m=par[s], inertia_kg_m2=par[j], drive_inertia_kg_m2=0.0, damping_Nms_per_rad=par[c]
        )

    symbols = SimpleNamespace(
        total_mass_kg=par[0],
        k1_N_per_m=par[1],
        k2_N_per_m=par[2],
        damping_Ns_per_m=(par[3], par[4]),
        a=pendulum(5, 8, 10),
        b=pendulum(6, 9, 11),
        forcing_moment_kg_m=par[7],
        pivot_shift_m=0.0,
        gravity_m_per_s2=0.0,
    )
    system = equations(cast(RotorParameters, symbols), par[_SPEED])
    if variational:
        system = hy.var_ode_sys(system, hy.var_args.vars, order=1)
    number = np.longdouble if tolerance < 1e-16 else float
    return hy.taylor_adaptive(system, np.zeros(8, number), tol=number(tolerance), compact_mode=True, fp_type=number)


def _number(integrator: Any) -> type:
    return np.longdouble if integrator.state.dtype == np.longdouble else float


def _set(integrator: Any, rig: Rig) -> type:
    number = _number(integrator)
    parameters, speed = rig
    integrator.pars[:] = np.array([*parameters.packed()[:_SPEED], speed], number)
    integrator.time = number(0)
    return number


def largest_multiplier(rig: Rig, tolerance: float, integrator: Any | None = None) -> float:
    """Largest modulus of the balanced state's multipliers over one revolution."""
    ta = compiled(True, tolerance) if integrator is None else integrator
    number = _set(ta, rig)
    ta.state[:] = 0
    ta.state[2:4] = balanced_angles(rig[0])[0]
    ta.state[8:] = np.eye(8, dtype=number).ravel()
    ta.propagate_until(number(_PI / np.longdouble(rig[1])))
    half = np.asarray(_TURN[:, None] * ta.state[8:].reshape(8, 8), float)
    return float(np.max(np.abs(np.linalg.eigvals(half)))) ** 2


def end_state(rig: Rig, start: Array, duration_s: float, tolerance: float, integrator: Any | None = None) -> Array:
    """State after a time at constant speed, ψ = 0 at the start; shape (8,)."""
    ta = compiled(False, tolerance) if integrator is None else integrator
    number = _set(ta, rig)
    ta.state[:] = start
    ta.propagate_until(number(duration_s))
    return np.array(ta.state, float)


def on_all_cores(one: Callable[[Any, int], Any], integrator: Any, count: int) -> list[Any]:
    """Results of one(integrator, i) for i < count. Each thread has its own integrator; heyoka releases the GIL."""
    cores = os.cpu_count() or 1

    def share(core: int) -> list[Any]:
        own = copy.deepcopy(integrator)
        return [one(own, i) for i in range(core, count, cores)]

    with ThreadPoolExecutor(cores) as pool:
        shares: Sequence[list[Any]] = list(pool.map(share, range(cores)))
    return [shares[i % cores][i // cores] for i in range(count)]


def angle_error(found: Array, true: Array) -> float:
    """Larger of the errors of θ3 and θ4, rad; both states have shape (8,)."""
    return float(np.max(np.abs(found[2:4] - true[2:4])))


def relative(found: float, true: float) -> float:
    """Error of a largest modulus relative to max(1, modulus)."""
    return abs(found - true) / max(1.0, abs(true)) if math.isfinite(found) else math.inf

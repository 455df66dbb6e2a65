"""Motion with both pendulums locked, and the rates that determine the step of any motion.

The motion has a closed form if the suspension is linear. Otherwise it is computed by harmonic balance
(dynamics.motions.nonlinear_whirl).
"""

from __future__ import annotations

from functools import partial
from typing import overload

import numpy as np
from numpy.typing import ArrayLike

from dynamics.arguments import real_array
from dynamics.arrays import Array, Complex
from dynamics.equations.parameters import RigOrParameters, RotorParameters, physics_of
from dynamics.errors import OutsideDomain
from dynamics.motions.nonlinear_whirl import Direction, whirl_orders

_SHARE = 1e-4  # relative step of a parameter for differences


@overload
def locked_orbit(  # pyright: ignore[reportOverlappingOverload] (a number is ArrayLike too)
    parameters: RigOrParameters, speed_rad_s: float, theta3_rad: float = 0.0, theta4_rad: float = np.pi
) -> tuple[complex, complex]: ...
@overload
def locked_orbit(
    parameters: RigOrParameters, speed_rad_s: ArrayLike, theta3_rad: ArrayLike = 0.0, theta4_rad: ArrayLike = np.pi
) -> tuple[Complex, Complex]: ...
def locked_orbit(
    parameters: RigOrParameters, speed_rad_s: ArrayLike, theta3_rad: ArrayLike = 0.0, theta4_rad: ArrayLike = np.pi
) -> tuple[complex, complex] | tuple[Complex, Complex]:
    """Steady motion at constant speed with both pendulums locked, without the static deflection under gravity.

    Args:
        parameters: RotorParameters, or an object whose `.physics` is one.
        speed_rad_s, theta3_rad, theta4_rad: numbers, or arrays that broadcast to one shape.
    Returns:
        X, Y in m: x = Re(X e^{iψ}), y = Im(Y e^{iψ}), of that shape. For a suspension that is not linear, the first
        order.
    Raises:
        OutsideDomain: a speed coincides with an undamped resonance, or is near a resonance bent over by the springs.
    Source: linear oscillators under F e^{iψ}, F = ω² (S_P + S_A e^{iθ3} + S_B e^{iθ4}). S_P includes the moment of an
        uncompensated pivot shift. A bow b adds k b.

    Example:
        >>> import numpy as np
        >>> from dynamics import locked_orbit
        >>> from rig_configs import load_rig
        >>> x, y = locked_orbit(load_rig("virtual"), np.array([10.0, 20.0, 40.0]))  # a steady Bode plot
        >>> (1e3 * np.abs(x)).round(3)
        array([0.137, 2.963, 0.449])
        >>> np.degrees(np.angle(x)).round(1)
        array([  -1.7, -161.4, -178.6])
    """
    p = physics_of(parameters)
    w, theta3, theta4 = _numbers(speed_rad_s=speed_rad_s, theta3_rad=theta3_rad, theta4_rad=theta4_rad)
    if not p.suspension_is_linear:
        x, y = np.vectorize(partial(_first_orders, p), otypes=[complex, complex])(w, theta3, theta4)
        return x[()], y[()]
    moment, mass = _moment(p, theta3, theta4), p.total_mass_kg
    c1, c2 = p.damping_Ns_per_m
    force = moment * w * w
    stiff1, stiff2 = p.k1_N_per_m - mass * w * w + 1j * w * c1, p.k2_N_per_m - mass * w * w + 1j * w * c2
    if np.any((stiff1 == 0) | (stiff2 == 0)):
        resonant = float(np.extract((stiff1 == 0) | (stiff2 == 0), w)[0])
        raise OutsideDomain(
            f"at {resonant:.6g} rad/s the rotor runs in an undamped resonance, where its whirl is unbounded: "
            "expected damping above 0 or another speed"
        )
    return (force + p.k1_N_per_m * p.bow_m) / stiff1, (force + p.k2_N_per_m * p.bow_m) / stiff2


def _moment(p: RotorParameters, theta3_rad: Array | float, theta4_rad: Array | float) -> Complex:
    """First mass moment of imbalance and pendulums, kg m."""
    a, b = p.a.first_moment_kg_m, p.b.first_moment_kg_m
    moment = p.forcing_moment_kg_m + a * np.exp(1j * theta3_rad) + b * np.exp(1j * theta4_rad)
    return np.asarray(moment, np.complex128)


def _first_orders(p: RotorParameters, speed: float, theta3: float, theta4: float) -> tuple[complex, complex]:
    """The result of locked_orbit for a suspension that is not linear."""
    x, y = locked_orders(p, speed, theta3, theta4)
    return complex(x[1]), complex(1j * y[1])


def locked_orders(
    p: RotorParameters, speed_rad_s: float, theta3_rad: float, theta4_rad: float
) -> tuple[Complex, Complex]:
    """All orders of x and y with the pendulums locked, x = Re Σ x_k e^{ikψ} and y alike, static deflection included.

    Raises:
        OutsideDomain: the speed is near a resonance bent over by the springs.
    """
    moment = _moment(p, theta3_rad, theta4_rad)
    force, mass, sag = complex(moment * speed_rad_s**2), p.total_mass_kg, -p.total_mass_kg * p.gravity_m_per_s2
    first, second = (
        Direction(mass, c, k, h, q)
        for c, k, h, q in zip(
            p.damping_Ns_per_m, (p.k1_N_per_m, p.k2_N_per_m), p.hardening_per_m2, p.damping_growth_s_per_m, strict=True
        )
    )
    return (
        whirl_orders(first, speed_rad_s, force, p.bow_m, 0.0),
        whirl_orders(second, speed_rad_s, -1j * force, -1j * p.bow_m, sag),
    )


def locked_state(
    parameters: RigOrParameters,
    speed_rad_s: ArrayLike,
    phase_rad: ArrayLike,
    theta3_rad: ArrayLike,
    theta4_rad: ArrayLike,
) -> Array:
    """State on the locked orbit at one phase, with the deflection −M_S g/k2 under gravity; start of a release.

    Args:
        parameters: RotorParameters, or an object whose `.physics` is one.
        speed_rad_s, phase_rad, theta3_rad, theta4_rad: numbers, or arrays that broadcast to one shape.
    Returns:
        States as in Scene.start, shape (…, 8).
    Raises:
        OutsideDomain: as locked_orbit.
    """
    p = physics_of(parameters)
    w, phase = _numbers(speed_rad_s=speed_rad_s, phase_rad=phase_rad)
    theta3, theta4 = _numbers(theta3_rad=theta3_rad, theta4_rad=theta4_rad)
    if not p.suspension_is_linear:
        return np.vectorize(partial(_nonlinear_state, p), signature="(),(),(),()->(n)")(w, phase, theta3, theta4)
    state = _on_orbit(*locked_orbit(p, w, theta3, theta4), w, phase, theta3, theta4)
    state[..., 1] -= p.total_mass_kg * p.gravity_m_per_s2 / p.k2_N_per_m
    return state


def _nonlinear_state(p: RotorParameters, speed: float, phase: float, theta3: float, theta4: float) -> Array:
    """The result of locked_state for a suspension that is not linear, shape (8,)."""
    rows = list[tuple[float, float]]()
    for orders in locked_orders(p, speed, theta3, theta4):
        k = np.arange(len(orders))
        turned = orders * np.exp(1j * k * phase)
        rows.append((float(turned.real.sum()), float((1j * speed * k * turned).real.sum())))
    (x_m, x_rate), (y_m, y_rate) = rows
    return np.array([x_m, y_m, theta3, theta4, x_rate, y_rate, 0.0, 0.0])


def _numbers(**values: ArrayLike) -> list[Array]:
    return [real_array(name, value) for name, value in values.items()]


def locked_state_derivatives(
    parameters: RotorParameters, speed_rad_s: float, phase_rad: float, theta3_rad: float, theta4_rad: float
) -> dict[str, Array]:
    """∂(locked_state)/∂(identified parameter), each of shape (8,): derivative of the quotient F/(k − M ω² + iωc)."""
    p, w = parameters, speed_rad_s
    if not p.suspension_is_linear:
        return _differences(p, w, phase_rad, theta3_rad, theta4_rad)
    x, y = locked_orbit(p, w, theta3_rad, theta4_rad)
    c1, c2 = p.damping_Ns_per_m
    mass, (k1, k2) = p.total_mass_kg, (p.k1_N_per_m, p.k2_N_per_m)
    stiff1, stiff2 = k1 - mass * w * w + 1j * w * c1, k2 - mass * w * w + 1j * w * c2
    changes = {
        "k1_N_per_m": ((p.bow_m - x * (1 + 1j * w * c1 / (2 * k1))) / stiff1, 0j),
        "k2_N_per_m": (0j, (p.bow_m - y * (1 + 1j * w * c2 / (2 * k2))) / stiff2),
        "zeta1": (-x / stiff1 * 2j * w * np.sqrt(k1 * mass), 0j),
        "zeta2": (0j, -y / stiff2 * 2j * w * np.sqrt(k2 * mass)),
        "SP_kg_m": (w * w / stiff1, w * w / stiff2),
        "c3_Nms_per_rad": (0j, 0j),
        "c4_Nms_per_rad": (0j, 0j),
    }
    out = {name: _on_orbit(dx, dy, w, phase_rad, 0.0, 0.0) for name, (dx, dy) in changes.items()}
    out["k2_N_per_m"][1] += mass * p.gravity_m_per_s2 / k2**2
    return out


def _differences(p: RotorParameters, speed: float, phase: float, theta3: float, theta4: float) -> dict[str, Array]:
    """The derivatives for a suspension that is not linear, by central differences."""
    out = dict[str, Array]()
    for name, value in p.identified().items():
        h = _SHARE * value or _SHARE
        ends = [
            locked_state(p.with_values(**{name: value + sign * h}), speed, phase, theta3, theta4) for sign in (1, -1)
        ]
        out[name] = (ends[0] - ends[1]) / (2 * h)
    return out


def _on_orbit(
    x: Complex | complex,
    y: Complex | complex,
    speed: Array | float,
    phase: Array | float,
    theta3: Array | float,
    theta4: Array | float,
) -> Array:
    """States, shape (…, 8)."""
    turn = np.exp(1j * phase)
    rate = 1j * speed * turn
    disk, going = ((x * turn).real, (y * turn).imag), ((rate * x).real, (rate * y).imag)
    return np.stack(np.broadcast_arrays(*disk, theta3, theta4, *going, 0.0, 0.0), axis=-1)


def damping_rates(parameters: RotorParameters, released: tuple[bool, bool] = (True, True)) -> tuple[float, ...]:
    """Decay rates of the free speed of each direction and each released pendulum, 1/s."""
    p = parameters
    w1, w2 = p.natural_frequencies_rad_s
    swinging = [m for m, free in zip((p.a, p.b), released, strict=True) if free and m.present]
    return (
        2 * p.zeta1 * w1,
        2 * p.zeta2 * w2,
        *(m.damping_Nms_per_rad / m.inertia_kg_m2 for m in swinging),
    )


def fastest_rate(parameters: RotorParameters, speed_rad_s: float, released: tuple[bool, bool] = (True, True)) -> float:
    """Bound on the rate of change of the state, 1/s. It determines the step of an explicit method.

    Absent and locked pendulums have no own rate.
    """
    return max(*parameters.natural_frequencies_rad_s, abs(speed_rad_s), *damping_rates(parameters, released))

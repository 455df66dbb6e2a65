"""Numerical Fisher information of a small model: the smallest covariance of an unbiased estimator.

With white noise of σ per sample the information about θ is JᵀJ/σ², where J contains the derivatives of the signal.
Independent Gaussian prior information on a nuisance parameter adds 1/s². Signals are evaluated at fewer instants than
the sensor samples, but densely enough to resolve them. An instant then represents several samples, and its noise is
smaller by the square root of their number.
Source: docs/theory/planning.md.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rig_basics.arrays import Array

Signal = Callable[[Array], Array]


def derivatives(signal: Signal, theta: Array, step: Array) -> Array:
    """Return central differences of a signal, shape (n, p).

    Args:
        signal: maps θ to samples, shape (n,).
        theta: parameters, shape (p,).
        step: half-widths of the differences, shape (p,).
    """
    columns: list[Array] = []
    for j, h in enumerate(step):
        ahead, behind = theta.copy(), theta.copy()
        ahead[j] += h
        behind[j] -= h
        columns.append((signal(ahead) - signal(behind)) / (2 * h))
    return np.column_stack(columns)


def covariance(jacobian: Array, prior_std: Array, wanted: int) -> Array:
    """Return the Cramér–Rao bound of the first `wanted` parameters with all others unknown, shape (wanted, wanted).

    Args:
        jacobian: derivatives of the samples over their standard deviation, shape (n, p).
        prior_std: standard deviation of independent prior information, shape (p,); inf for no information.
        wanted: number of parameters in the result.
    """
    rows = np.diag(np.where(np.isfinite(prior_std), 1 / np.maximum(prior_std, 1e-300), 0.0))
    whole = np.concatenate([jacobian, rows])
    scale = np.linalg.norm(whole, axis=0)
    scale = np.where(scale > 0, scale, 1.0)  # a parameter without information does not affect the others
    # the triangular factor keeps the digits that the normal matrix would lose: its condition number is squared
    triangle = np.linalg.qr(whole / scale, mode="r")
    size, vectors = np.linalg.svd(triangle)[1:]
    inverse = (vectors.T / np.maximum(size, 1e-14) ** 2) @ vectors
    return (inverse / np.outer(scale, scale))[:wanted, :wanted]


def ring_down_bound(
    amplitude_m: float, noise_m: float, rate_Hz: float, omega_rad_s: float, zeta: float, record_s: float
) -> tuple[float, float]:
    """Return the relative bounds of natural frequency and damping ratio for one decaying mode in closed form.

    var(ω) = var(d) = 2σ²/(f_s a² T³ g(u)), u = dT, g = E2 − E1²/E0. The offset is known; the phase has no effect. The
    formula holds for light damping (errors of 0.5 % at ζ ≤ 0.01, 2 % at 0.05). Source: docs/theory/planning.md.
    """
    decay = zeta * omega_rad_s
    u = decay * record_s
    ease = np.exp(-2 * u)
    e0 = -np.expm1(-2 * u) / (2 * u)
    e1 = (1 - ease * (1 + 2 * u)) / (4 * u**2)
    e2 = (1 - ease * (1 + 2 * u + 2 * u**2)) / (4 * u**3)
    variance = 2 * noise_m**2 / (rate_Hz * amplitude_m**2 * record_s**3 * (e2 - e1**2 / e0))
    spread = float(np.sqrt(variance))
    return spread / omega_rad_s, float(np.sqrt(1 - zeta**2)) * spread / decay


def friction_columns(rate_per_s: float, start_speed_rad_s: float, time_s: Array) -> Array:
    """Return the derivatives of a run-down by a torque and by one with the square of the speed, shape (n, 2).

    With δ for the change of an angle, J δ̈ + c δ̇ = −M − F v² e^{−2λt}, λ = c/J, gives with e = e^{−λt}
    δ = −(M/c) (t − (1 − e)/λ) − F v²/(J λ²) ((1 − e) − (1 − e²)/2). Each derivative is that by a torque of c v.
    """
    run = 1.0 - np.exp(-rate_per_s * time_s)
    twice = 1.0 - np.exp(-2.0 * rate_per_s * time_s)
    by = [time_s - run / rate_per_s, (run - 0.5 * twice) / rate_per_s]
    return -start_speed_rad_s * np.column_stack(by)


def spin_down_bound(
    rate_per_s: float,
    start_speed_rad_s: float,
    noise_rad: float,
    rate_Hz: float,
    record_s: float = np.inf,
    *,
    with_friction: bool = False,
) -> float:
    """Return the relative bound of the decay rate of a pendulum on an immovable rotor.

    For θ = θ0 + A e^{−λt}, recorded to rest (many times 1/λ), sd(λ)/λ = σ λ sqrt(8 λ/f_s)/v0. Over 4.5 time constants
    the bound is 1.65 times that, and about 20 times that with unknown dry friction and drag (with_friction; only for a
    finite record). Source: docs/theory/planning.md.
    """
    if np.isfinite(record_s):
        t = (np.arange(4000) + 0.5) * record_s / 4000
        wave = np.exp(-rate_per_s * t)
        length = start_speed_rad_s / rate_per_s
        jacobian = np.column_stack([-length * rate_per_s * t * wave, np.ones_like(t), length * wave])
        if with_friction:
            jacobian = np.hstack([jacobian, friction_columns(rate_per_s, start_speed_rad_s, t)])
        weight = np.sqrt(rate_Hz * record_s / 4000) / noise_rad
        free = np.array([np.inf] * len(jacobian.T))  # no unknown has a prior
        return float(np.sqrt(covariance(jacobian * weight, free, 1)[0, 0]))
    return noise_rad * rate_per_s / start_speed_rad_s * float(np.sqrt(8 * rate_per_s / rate_Hz))

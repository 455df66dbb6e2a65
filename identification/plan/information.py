"""Fisher information of a small model, numerically: what the best unbiased estimator could reach.

With white noise of σ per sample the information about θ is JᵀJ/σ², J the signal's derivatives; independent Gaussian
knowledge of a nuisance adds 1/s². Signals are evaluated at fewer instants than the sensor samples, dense enough to
follow them; a sample then stands for several and its noise is smaller by the square root.
Source: docs/theory/planning.md.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Signal = Callable[[np.ndarray], np.ndarray]


def derivatives(signal: Signal, theta: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Central differences of a signal, shape (n, p).

    Args:
        signal: θ to samples, shape (n,).
        theta, step: shape (p,).
    """
    columns = []
    for j, h in enumerate(step):
        ahead, behind = theta.copy(), theta.copy()
        ahead[j] += h
        behind[j] -= h
        columns.append((signal(ahead) - signal(behind)) / (2 * h))
    return np.column_stack(columns)


def covariance(jacobian: np.ndarray, prior_std: np.ndarray, wanted: int) -> np.ndarray:
    """Cramér–Rao bound of the first `wanted` parameters with all others unknown, shape (wanted, wanted).

    Args:
        jacobian: in standard deviations of the samples, shape (n, p).
        prior_std: independent knowledge, shape (p,); inf where there is none.
    """
    rows = np.diag(np.where(np.isfinite(prior_std), 1 / np.maximum(prior_std, 1e-300), 0.0))
    whole = np.concatenate([jacobian, rows])
    scale = np.linalg.norm(whole, axis=0)
    scale = np.where(scale > 0, scale, 1.0)  # what nothing shows stays open and touches nothing else
    # triangular factor instead of the normal matrix: half the digits survive
    triangle = np.linalg.qr(whole / scale, mode="r")
    size, vectors = np.linalg.svd(triangle)[1:]
    inverse = (vectors.T / np.maximum(size, 1e-14) ** 2) @ vectors
    return (inverse / np.outer(scale, scale))[:wanted, :wanted]


def ring_down_bound(
    amplitude_m: float, noise_m: float, rate_Hz: float, omega_rad_s: float, zeta: float, record_s: float
) -> tuple[float, float]:
    """Closed form for one decaying mode: relative bounds of the natural frequency and of the damping ratio.

    var(ω) = var(d) = 2σ²/(f_s a² T³ g(u)), u = dT, g = E2 − E1²/E0; offset known, phase of no importance. Exact for
    light damping (0.5 % at ζ ≤ 0.01, 2 % at 0.05). Source: docs/theory/planning.md.
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


def spin_down_bound(
    rate_per_s: float, start_speed_rad_s: float, noise_rad: float, rate_Hz: float, record_s: float = np.inf
) -> float:
    """Closed form for a pendulum on an immovable rotor: relative bound of the decay rate.

    θ = θ0 + A e^{−λt} recorded to rest (many times 1/λ): sd(λ)/λ = σ λ sqrt(8 λ/f_s)/v0; recorded over
    4.5 time constants 1.65 times that. Source: docs/theory/planning.md.
    """
    if np.isfinite(record_s):
        t = (np.arange(4000) + 0.5) * record_s / 4000
        wave = np.exp(-rate_per_s * t)
        length = start_speed_rad_s / rate_per_s
        jacobian = np.column_stack([-length * rate_per_s * t * wave, np.ones_like(t), length * wave])
        weight = np.sqrt(rate_Hz * record_s / 4000) / noise_rad
        return float(np.sqrt(covariance(jacobian * weight, np.full(3, np.inf), 1)[0, 0]))
    return noise_rad * rate_per_s / start_speed_rad_s * float(np.sqrt(8 * rate_per_s / rate_Hz))

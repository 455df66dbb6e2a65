"""The response of an oscillator to a rotating imbalance during a run-up, with exact sensitivities.

    ḧ + 2ζω ḣ + ω² h = u,        u = (ψ̇² − i ψ̈) e^{iψ}

h is complex; x = Re(A h1), y = Im(A h2) with A = S / M_S. Derivatives with respect to ln ω and ln ζ obey the same
equation with the right-hand sides −(2ζω ḣ + 2ω² h) and −2ζω ḣ and are integrated along (classical Runge–Kutta).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from dynamics.speed_history import SpeedHistory

STEP_S = 1e-3


@dataclass(frozen=True)
class Drive:
    """The rotating imbalance's u on a grid of half steps.

    Attributes:
        start_s, end_s: the span the responses cover.
        force: u at start, start + step/2, …; shape (2 n + 1,), rad²/s².
    """

    start_s: float
    end_s: float
    force: np.ndarray

    @classmethod
    def from_history(cls, history: SpeedHistory, start_s: float, end_s: float) -> Drive:
        """The drive between two instants."""
        n = int(np.ceil((end_s - start_s) / STEP_S))
        psi, speed, acceleration = history.phase(start_s + 0.5 * STEP_S * np.arange(2 * n + 1)).T
        return cls(start_s, start_s + n * STEP_S, (speed**2 - 1j * acceleration) * np.exp(1j * psi))


@dataclass(frozen=True)
class Response:
    """h and its derivatives at wanted instants, complex, shape (n,) each.

    Attributes:
        h, rate, curve: h, ḣ, ḧ.
        by_omega, by_zeta: ∂h/∂ln ω, ∂h/∂ln ζ.
    """

    h: np.ndarray
    rate: np.ndarray
    curve: np.ndarray
    by_omega: np.ndarray
    by_zeta: np.ndarray


@njit(cache=True, error_model="numpy")
def _slope(s: np.ndarray, u: complex, w2: float, g: float, out: np.ndarray):
    out[0] = s[1]
    out[1] = u - g * s[1] - w2 * s[0]
    out[2] = s[3]
    out[3] = -g * s[1] - 2 * w2 * s[0] - g * s[3] - w2 * s[2]
    out[4] = s[5]
    out[5] = -g * s[1] - g * s[5] - w2 * s[4]


@njit(cache=True, error_model="numpy")
def _march(force: np.ndarray, step: float, omega: float, zeta: float):
    n = (len(force) - 1) // 2
    out = np.empty((n + 1, 6), dtype=np.complex128)
    s = np.zeros(6, dtype=np.complex128)
    k = np.empty((4, 6), dtype=np.complex128)
    work = np.empty(6, dtype=np.complex128)
    w2, g = omega * omega, 2 * zeta * omega
    out[0] = s
    for i in range(n):
        _slope(s, force[2 * i], w2, g, k[0])
        for j in range(6):
            work[j] = s[j] + 0.5 * step * k[0, j]
        _slope(work, force[2 * i + 1], w2, g, k[1])
        for j in range(6):
            work[j] = s[j] + 0.5 * step * k[1, j]
        _slope(work, force[2 * i + 1], w2, g, k[2])
        for j in range(6):
            work[j] = s[j] + step * k[2, j]
        _slope(work, force[2 * i + 2], w2, g, k[3])
        for j in range(6):
            s[j] += step / 6 * (k[0, j] + 2 * k[1, j] + 2 * k[2, j] + k[3, j])
        out[i + 1] = s
    return out


@njit(cache=True, error_model="numpy")
def _at(times: np.ndarray, start: float, step: float, grid: np.ndarray, force: np.ndarray, w2: float, g: float):
    """Cubic Hermite interpolation of h, ḣ and the two sensitivities; ḧ from the equation."""
    out = np.empty((5, len(times)), dtype=np.complex128)
    last = len(grid) - 2
    for k in range(len(times)):
        at = (times[k] - start) / step
        i = min(max(int(np.floor(at)), 0), last)
        r = at - i
        a = (1 + 2 * r) * (1 - r) ** 2
        b = r * (1 - r) ** 2 * step
        c = r * r * (3 - 2 * r)
        d = r * r * (r - 1) * step
        for j in range(3):
            out[(0, 3, 4)[j], k] = (
                a * grid[i, 2 * j] + b * grid[i, 2 * j + 1] + c * grid[i + 1, 2 * j] + d * grid[i + 1, 2 * j + 1]
            )
        left = force[2 * i] - g * grid[i, 1] - w2 * grid[i, 0]
        right = force[2 * i + 2] - g * grid[i + 1, 1] - w2 * grid[i + 1, 0]
        out[1, k] = a * grid[i, 1] + b * left + c * grid[i + 1, 1] + d * right
        out[2, k] = (1 - r) * left + r * right
    return out


def march(drive: Drive, omega: float, zeta: float) -> np.ndarray:
    """h, ḣ and sensitivities on the drive's grid from rest, shape (n + 1, 6)."""
    return _march(drive.force, STEP_S, omega, zeta)


def response_at(times_s: np.ndarray, drive: Drive, grid: np.ndarray, omega: float, zeta: float) -> Response:
    """The response at wanted instants, shape (n,), inside the drive's span."""
    return Response(*_at(times_s, drive.start_s, STEP_S, grid, drive.force, omega * omega, 2 * zeta * omega))

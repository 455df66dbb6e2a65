"""The response of an oscillator whose rates depend on its motion to a rotating imbalance during a passage.

    q̈ + 2ζω q̇ (1 + Q |q̇|) + ω² d (1 + H d²) = Re(B u),    d = q − Re(W e^{iψ}),    u = (ψ̇² − iψ̈) e^{iψ}

from q = Re F, q̇ = Re(λF) at the drive's begin, with its derivatives by ln ω, ln ζ, B, F, H, Q and, where the shaft may
be bent, W: each obeys the equation linearised along the motion. Classical Runge–Kutta steps; between grid points a
quintic Hermite polynomial for the motion and its derivatives by B, F and W, a cubic for the others.
Source: docs/theory/run_up.md.
"""

# pyright: reportMissingParameterType=false
# Compiled functions: numba takes their types from the arguments, and their docstrings tell them.

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from identification.ring_down.modes import rate, rate_derivatives
from identification.run_up.forced_oscillator import Drive

_SUBSTEPS = 4  # a step of the drive's grid: 64 a turn at the top speed, an error of the frequency of 3e-7 there
_STRAIGHT, _BOWED = 9, 11  # the motion, its derivatives by ln ω, ln ζ, Re B, Im B, Re F, Im F, H, Q; Re W, Im W


@dataclass(frozen=True)
class BentResponse:
    """What a sensor's blocks see of one direction's motion; real but where said, shape (n,) each.

    Attributes:
        motion: q, m, averaged over the blocks.
        rate: q̇, m/s.
        by_omega, by_zeta: ∂q/∂ln ω, ∂q/∂ln ζ, m.
        by_drive: complex, T with δq = Re(T δB), averaged.
        by_free: complex, D with δq = Re(D δF), averaged.
        by_terms: ∂q/∂H, ∂q/∂Q.
        by_bow: complex, T with δq = Re(T δW); None for a straight shaft.
    """

    motion: np.ndarray
    rate: np.ndarray
    by_omega: np.ndarray
    by_zeta: np.ndarray
    by_drive: np.ndarray
    by_free: np.ndarray
    by_terms: tuple[np.ndarray, np.ndarray]
    by_bow: np.ndarray | None = None


def bent_response(
    when_s: np.ndarray, spread_s2: np.ndarray, drive: Drive, force: np.ndarray, oscillator: tuple[float, float],
    terms: tuple[float, float], amplitude: complex, free: complex, bow: complex | None = None,
) -> BentResponse:  # fmt: skip
    """The motion of one direction as a sensor's blocks see it.

    Args:
        when_s, spread_s2: blocks' mean times and variances of their samples' times, shape (n,).
        force: of the drive, as forcing has it.
        oscillator: ω, rad/s, and ζ.
        terms: H, 1/m², and Q, s/m.
        amplitude, free: B and F, m.
        bow: W, m; None for a straight shaft, whose derivatives by it are not wanted.
    """
    omega, zeta = oscillator
    unknowns = _STRAIGHT if bow is None else _BOWED
    lam, by_rate = rate(omega, zeta), rate_derivatives(omega, zeta)
    start = np.zeros((unknowns, 2))
    start[0] = free.real, (lam * free).real
    start[1, 1], start[2, 1] = ((by * free).real for by in by_rate)
    start[5] = 1.0, lam.real
    start[6] = 0.0, lam.imag
    grid = np.empty((len(drive.phasor) + 1, unknowns, 3))
    _march(force, drive.step_s / _SUBSTEPS, omega, zeta, terms[0], terms[1], amplitude, bow or 0j, start, grid)
    out = _seen(when_s, spread_s2, drive.start_s, drive.step_s, grid)
    return BentResponse(
        out[0], out[unknowns], out[1], out[2], out[3] + 1j * out[4], out[5] + 1j * out[6], (out[7], out[8]),
        None if bow is None else out[9] + 1j * out[10],
    )  # fmt: skip


def forcing(drive: Drive) -> np.ndarray:
    """u and e^{iψ} at the ends and middles of all Runge–Kutta steps of a drive's grid, shape (n, 2)."""
    n = 2 * _SUBSTEPS * len(drive.phasor)
    times = drive.start_s + drive.step_s * np.arange(n + 1) / (2 * _SUBSTEPS)
    psi, speed, acceleration = drive.history.phase(times).T
    turning = np.exp(1j * psi)
    return np.stack([(speed**2 - 1j * acceleration) * turning, turning], axis=1)


@njit(cache=True, nogil=True, error_model="numpy")
def _rates(y, drive, amplitude, bow, omega, zeta, h, g, out):
    """Accelerations of all unknowns (n, 2) into out (n,); drive: u and e^{iψ}."""
    u, p = drive[0], drive[1]
    q, v = y[0, 0] - (bow * p).real, y[0, 1]
    w2, damp = omega * omega, 2.0 * zeta * omega
    fast = abs(v)
    pull, loss = w2 * q * (1.0 + h * q * q), damp * v * (1.0 + g * fast)
    k, c = w2 * (1.0 + 3.0 * h * q * q), damp * (1.0 + 2.0 * g * fast)
    out[0] = (amplitude * u).real - pull - loss
    for i in range(1, len(y)):
        out[i] = -k * y[i, 0] - c * y[i, 1]
    out[1] -= 2.0 * pull + loss
    out[2] -= loss
    out[3] += u.real
    out[4] += u.imag  # T = ∂q/∂Re B − i ∂q/∂Im B: its imaginary part is driven by Im u
    out[7] -= w2 * q * q * q
    out[8] -= damp * v * fast
    if len(y) == 11:
        out[9] += k * p.real
        out[10] += k * p.imag


@njit(cache=True, nogil=True, error_model="numpy")
def _march(drive, step, omega, zeta, h, g, amplitude, bow, start, grid):
    """All unknowns on the drive's grid: value, rate, acceleration."""
    y, work = start.copy(), np.empty_like(start)
    unknowns = len(start)
    k = np.empty((4, unknowns))
    n, substeps = len(grid) - 1, (len(drive) - 1) // (2 * (len(grid) - 1))
    at = 0
    for i in range(n + 1):
        _rates(y, drive[at], amplitude, bow, omega, zeta, h, g, k[0])
        for m in range(unknowns):
            grid[i, m, 0], grid[i, m, 1], grid[i, m, 2] = y[m, 0], y[m, 1], k[0, m]
        if i == n:
            break
        for s in range(substeps):
            if s > 0:
                _rates(y, drive[at], amplitude, bow, omega, zeta, h, g, k[0])
            for m in range(unknowns):
                work[m, 0], work[m, 1] = y[m, 0] + 0.5 * step * y[m, 1], y[m, 1] + 0.5 * step * k[0, m]
            _rates(work, drive[at + 1], amplitude, bow, omega, zeta, h, g, k[1])
            for m in range(unknowns):
                work[m, 0] = y[m, 0] + 0.5 * step * (y[m, 1] + 0.5 * step * k[0, m])
                work[m, 1] = y[m, 1] + 0.5 * step * k[1, m]
            _rates(work, drive[at + 1], amplitude, bow, omega, zeta, h, g, k[2])
            for m in range(unknowns):
                work[m, 0] = y[m, 0] + step * (y[m, 1] + 0.5 * step * k[1, m])
                work[m, 1] = y[m, 1] + step * k[2, m]
            _rates(work, drive[at + 2], amplitude, bow, omega, zeta, h, g, k[3])
            for m in range(unknowns):
                y[m, 0] += step * (y[m, 1] + step / 6.0 * (k[0, m] + k[1, m] + k[2, m]))
                y[m, 1] += step / 6.0 * (k[0, m] + 2.0 * k[1, m] + 2.0 * k[2, m] + k[3, m])
            at += 2


@njit(cache=True, nogil=True, error_model="numpy")
def _seen(times, spread, start, step, grid):
    """Block means of every unknown and, last, the motion's rate, shape (unknowns + 1, n)."""
    unknowns = grid.shape[1]
    out = np.empty((unknowns + 1, len(times)))
    last = len(grid) - 2
    for j in range(len(times)):
        half = 0.5 * spread[j]
        x = (times[j] - start) / step
        i = min(max(int(x), 0), last)
        x -= i
        for m in range(unknowns):
            c0, c1, c2 = grid[i, m, 0], step * grid[i, m, 1], 0.5 * step * step * grid[i, m, 2]
            rest = grid[i + 1, m, 0] - c0 - c1 - c2
            rest1 = step * grid[i + 1, m, 1] - c1 - 2 * c2
            rest2 = step * step * grid[i + 1, m, 2] - 2 * c2
            c3 = 10 * rest - 4 * rest1 + 0.5 * rest2
            c4 = -15 * rest + 7 * rest1 - rest2
            c5 = 6 * rest - 3 * rest1 + 0.5 * rest2
            bent = (2 * c2 + x * (6 * c3 + x * (12 * c4 + x * 20 * c5))) / (step * step)
            out[m, j] = c0 + x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * c5)))) + half * bent
            if m == 0:
                out[unknowns, j] = (c1 + x * (2 * c2 + x * (3 * c3 + x * (4 * c4 + x * 5 * c5)))) / step
    return out

"""Response of an oscillator with amplitude-dependent rates to a rotating imbalance during a passage.

    q̈ + 2ζω q̇ (1 + Q |q̇|) + ω² d (1 + H d²) = −b̈,    b = Re(B p),    d = q − Re(W p),    p = e^{iψ}

The start values are q = Re F, q̇ = Re(λF) at the start of the drive. The derivatives by ln ω, ln ζ, B, F, H, Q and, for
a bent shaft, W obey the equation linearised along the motion. A measured phase is too noisy for derivatives. The
integrated variables are therefore s = q + b and r = ṡ − 2ζω b,

    ṡ = r + 2ζω b,    ṙ = −2ζω ṡ − 2ζω Q |q̇| q̇ − ω² d (1 + H d²),

which contain ψ̇ only in the small part of Q, where it is smoothed over a turn. The integration uses classical
Runge–Kutta steps; s and its derivatives are interpolated by a quintic Hermite polynomial between grid points. Source:
docs/theory/run_up.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics.compiled_code import compiled
from identification.ring_down.modes import rate, rate_derivatives
from identification.run_up.forced_oscillator import Excitation
from identification.run_up.slow_roll import PhasorMeans
from rig_basics.arrays import Array, Complex

_SUBSTEPS = 4  # per step of the drive's grid: 64 per turn at the top speed, frequency error 3e-7
_SMOOTHED = 16 * _SUBSTEPS  # half steps to either side over which ψ̇ is averaged: half a turn at the top speed
_STRAIGHT, _BOWED = 9, 11  # motion, derivatives by ln ω, ln ζ, Re B, Im B, Re F, Im F, H, Q; with Re W, Im W


@dataclass(frozen=True)
class BentResponse:
    """Motion of one direction in a sensor's blocks, shape (n,) each; real unless stated otherwise.

    Attributes:
        motion: q, m, averaged over the blocks.
        rate: q̇, m/s.
        by_omega, by_zeta: ∂q/∂ln ω, ∂q/∂ln ζ, m.
        by_drive: complex factor T with δq = Re(T δB), averaged.
        by_free: complex factor D with δq = Re(D δF), averaged.
        by_terms: ∂q/∂H, ∂q/∂Q.
        by_bow: complex factor T with δq = Re(T δW); None for a straight shaft.
    """

    motion: np.ndarray
    rate: np.ndarray
    by_omega: np.ndarray
    by_zeta: np.ndarray
    by_drive: np.ndarray
    by_free: np.ndarray
    by_terms: tuple[np.ndarray, np.ndarray]
    by_bow: np.ndarray | None = None


@dataclass(frozen=True)
class BentDirection:
    """One direction of the suspension and its motion.

    Attributes:
        oscillator: ω, rad/s, and ζ.
        terms: H, 1/m², and Q, s/m.
        amplitude, free: B and F, m.
        bow: W, m; None for a straight shaft, without derivatives by W.
    """

    oscillator: tuple[float, float]
    terms: tuple[float, float]
    amplitude: complex
    free: complex
    bow: complex | None = None


def bent_response(
    spread_s2: np.ndarray,
    turn: PhasorMeans,
    drive: Excitation,
    force: np.ndarray,
    direction: BentDirection,
) -> BentResponse:
    """Compute the motion of one direction in a sensor's blocks.

    Args:
        spread_s2: variances of the sample times of the blocks, s², shape (n,).
        turn: block means of p.
        drive: drive over the span of the blocks.
        force: force of the drive by `forcing`.
        direction: oscillator and amplitudes.
    """
    (omega, zeta), terms = direction.oscillator, direction.terms
    amplitude, free, bow = direction.amplitude, direction.free, direction.bow
    unknowns = _STRAIGHT if bow is None else _BOWED
    lam, by_rate = rate(omega, zeta), rate_derivatives(omega, zeta)
    damp, (p, p_rate) = 2 * zeta * omega, force[0]
    start = np.zeros((unknowns, 2))
    b, b_rate = (amplitude * p).real, (amplitude * p_rate).real
    start[0] = free.real + b, (lam * free).real + b_rate - damp * b
    start[1, 1], start[2, 1] = ((by * free).real - damp * b for by in by_rate)
    start[3] = p.real, p_rate.real - damp * p.real
    start[4] = p.imag, p_rate.imag - damp * p.imag
    start[5] = 1.0, lam.real
    start[6] = 0.0, lam.imag
    grid = np.empty((len(drive.phasor) + 1, unknowns, 3))
    _march(force, drive.step_s / _SUBSTEPS, omega, zeta, terms[0], terms[1], amplitude, bow or 0j, start, grid)
    out = _seen(turn.when_s, spread_s2, drive.start_s, drive.step_s, grid)
    return BentResponse(
        out[0] - (amplitude * turn.phasor).real,
        out[unknowns] - (amplitude * turn.rate).real,
        out[1],
        out[2],
        out[3] + 1j * out[4] - turn.phasor,
        out[5] + 1j * out[6],
        (out[7], out[8]),
        None if bow is None else out[9] + 1j * out[10],
    )


def forcing(drive: Excitation) -> np.ndarray:
    """p and iψ̇p with smoothed ψ̇ at the ends and middles of all Runge–Kutta steps of a drive's grid, shape (n, 2)."""
    n = 2 * _SUBSTEPS * len(drive.phasor)
    times = drive.start_s + drive.step_s * np.arange(n + 1) / (2 * _SUBSTEPS)
    psi = drive.history.phase(times)[:, 0]
    at = np.arange(n + 1)
    before, after = np.maximum(at - _SMOOTHED, 0), np.minimum(at + _SMOOTHED, n)
    speed = (psi[after] - psi[before]) / (times[after] - times[before])
    p = np.exp(1j * psi)
    return np.stack([p, 1j * speed * p], axis=1)


@compiled(part=True)
def _rates(  # numba kernel: a settings object is not supported
    y: Array,
    drive: Complex,
    amplitude: complex,
    bow: complex,
    omega: float,
    zeta: float,
    h: float,
    g: float,
    out: Array,
) -> None:
    """Write the rates of all unknowns, shape (n, 2), to out, shape (n, 2); drive contains p and its rate."""
    p, turning = drive[0], drive[1]
    w2, damp = omega * omega, 2.0 * zeta * omega
    b = (amplitude * p).real
    d = y[0, 0] - b - (bow * p).real
    s = y[0, 1] + damp * b
    v = s - (amplitude * turning).real
    fast = abs(v)
    pull, extra = w2 * d * (1.0 + h * d * d), damp * g * fast * v
    k, c = w2 * (1.0 + 3.0 * h * d * d), 2.0 * damp * g * fast
    out[0, 0], out[0, 1] = s, -damp * s - extra - pull
    for i in range(1, len(y)):
        by_b, by_turning = 0.0, 0.0
        out[i, 0] = y[i, 1]
        if i < 3:  # ln ω, ln ζ
            out[i, 0] += damp * b
        elif i == 3:
            by_b, by_turning = p.real, turning.real
        elif i == 4:  # T = ∂q/∂Re B − i ∂q/∂Im B: its imaginary part is driven by Im p
            by_b, by_turning = p.imag, turning.imag
        out[i, 0] += damp * by_b
        out[i, 1] = -damp * out[i, 0] - c * (out[i, 0] - by_turning) - k * (y[i, 0] - by_b)
    out[1, 1] -= 2.0 * pull + damp * s + extra
    out[2, 1] -= damp * s + extra
    out[7, 1] -= w2 * d * d * d
    out[8, 1] -= damp * v * fast
    if len(y) == 11:
        out[9, 1] += k * p.real
        out[10, 1] += k * p.imag


@compiled(nogil=True)
def _march(  # numba kernel: a settings object is not supported
    drive: Complex,
    step: float,
    omega: float,
    zeta: float,
    h: float,
    g: float,
    amplitude: complex,
    bow: complex,
    start: Array,
    grid: Array,
) -> None:
    """Compute s and its derivatives on the drive's grid: value, rate, acceleration."""
    y, work = start.copy(), np.empty_like(start)
    unknowns = len(start)
    k = np.empty((4, unknowns, 2))
    n, substeps, damp = len(grid) - 1, (len(drive) - 1) // (2 * (len(grid) - 1)), 2.0 * zeta * omega
    at = 0
    for i in range(n + 1):
        _rates(y, drive[at], amplitude, bow, omega, zeta, h, g, k[0])
        turning = drive[at, 1]
        of_b = damp * (amplitude * turning).real
        for m in range(unknowns):
            grid[i, m, 0], grid[i, m, 1] = y[m, 0], k[0, m, 0]
            grid[i, m, 2] = k[0, m, 1] + (of_b if m < 3 else 0.0)
        grid[i, 3, 2] += damp * turning.real
        grid[i, 4, 2] += damp * turning.imag
        if i == n:
            break
        for j in range(substeps):
            if j > 0:
                _rates(y, drive[at], amplitude, bow, omega, zeta, h, g, k[0])
            for m in range(unknowns):
                work[m, 0], work[m, 1] = y[m, 0] + 0.5 * step * k[0, m, 0], y[m, 1] + 0.5 * step * k[0, m, 1]
            _rates(work, drive[at + 1], amplitude, bow, omega, zeta, h, g, k[1])
            for m in range(unknowns):
                work[m, 0], work[m, 1] = y[m, 0] + 0.5 * step * k[1, m, 0], y[m, 1] + 0.5 * step * k[1, m, 1]
            _rates(work, drive[at + 1], amplitude, bow, omega, zeta, h, g, k[2])
            for m in range(unknowns):
                work[m, 0], work[m, 1] = y[m, 0] + step * k[2, m, 0], y[m, 1] + step * k[2, m, 1]
            _rates(work, drive[at + 2], amplitude, bow, omega, zeta, h, g, k[3])
            for m in range(unknowns):
                for q in range(2):
                    y[m, q] += step / 6.0 * (k[0, m, q] + 2.0 * (k[1, m, q] + k[2, m, q]) + k[3, m, q])
            at += 2


@compiled(nogil=True)
def _seen(times: Array, spread: Array, start: float, step: float, grid: Array) -> Array:
    """Block means of s and its derivatives, and in the last row the rate of s, shape (unknowns + 1, n)."""
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

"""Response of an oscillator to a rotating imbalance during a passage, exact in time, with sensitivities.

    ḧ + 2ζω ḣ + ω² h = u,        u = (ψ̇² − iψ̈) e^{iψ} = −d²/dt² e^{iψ}

Twice integrated by parts, with p = e^{iψ} and λ± the oscillator's two rates,

    h = g − p,      g = −(λ₊² z₊ − λ₋² z₋) / (λ₊ − λ₋),      z± = ∫ e^{λ±(t−s)} p(s) ds  (+ free oscillations),

so that only the phase is needed and never its derivatives: noise of a measured phase is not amplified. z and ∂z/∂λ are
integrated in steps whose homogeneous part is exact and whose integral uses three Gauss points. The step depends on the
fastest turn and not on the damping or the sweep. Fixed Runge–Kutta steps Δ would shift the frequency by (ωΔ)⁴/120,
which cancels between a simulator and an estimator with the same integrator and is then not detected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynamics.compiled_code import compiled
from dynamics.equations.speed_history import SpeedHistory, phase_at
from identification.ring_down.modes import rate, rate_derivatives
from rig_basics.arrays import Array, Complex

STEP_RAD = 0.4
"""Rotation within one step of the grid, rad. The error of the integral is 1e-7, that of the interpolation 2e-7."""

_GAUSS_AT = 0.5 * (1 + np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)]))
_GAUSS_WEIGHT = np.array([5.0, 8.0, 5.0]) / 18.0


@dataclass(frozen=True)
class Excitation:
    """Drive e^{iψ} between two instants, at the points of the integration.

    Attributes:
        history: history of the phase.
        start_s, step_s: first instant of the grid and its spacing, s.
        phasor: e^{iψ} at the Gauss points of every step, shape (n, 3).
        edge: e^{iψ} and its rate (1/s) at the n + 1 instants of the grid, shape (n + 1, 2).
        top_rad_s, low_rad_s: largest and smallest |ψ̇|, rad/s.
    """

    history: SpeedHistory
    start_s: float
    step_s: float
    phasor: np.ndarray
    edge: np.ndarray
    top_rad_s: float
    low_rad_s: float

    @classmethod
    def from_history(
        cls, history: SpeedHistory, start_s: float, end_s: float, step_rad: float = STEP_RAD
    ) -> Excitation:
        """Build the drive between two instants, with a rotation of at most step_rad per step."""
        speed = np.abs(history.phase(np.linspace(start_s, end_s, 4096))[:, 1])
        top = float(speed.max())
        n = max(8, int(np.ceil((end_s - start_s) * max(top, 1.0) / step_rad)))
        step = (end_s - start_s) / n
        edges = start_s + step * np.arange(n + 1)
        at_edges = history.phase(edges)
        phasor = np.exp(1j * at_edges[:, 0])
        inside = history.phase((edges[:-1, None] + step * _GAUSS_AT).ravel())[:, 0]
        edge = np.column_stack([phasor, 1j * at_edges[:, 1] * phasor])
        return cls(history, start_s, step, np.exp(1j * inside).reshape(n, 3), edge, top, float(speed.min()))

    def order(self, k: int) -> Excitation:
        """Return the drive of e^{ikψ}."""
        history = SpeedHistory(self.history.knots_s, k * self.history.coefficients)
        phasor, rates = self.phasor**k, self.edge[:, 1] / self.edge[:, 0]
        edge = self.edge[:, 0] ** k
        return replace(self, history=history, phasor=phasor, edge=np.column_stack([edge, k * rates * edge]))

    @property
    def end_s(self) -> float:
        """Last instant of the grid, s."""
        return self.start_s + self.step_s * len(self.phasor)


@dataclass(frozen=True)
class Response:
    """Response of one oscillator in a sensor's blocks, complex, shape (n,) each, averaged over the blocks.

    Attributes:
        h: forced response.
        rate: ḣ (not averaged).
        by_omega, by_zeta: ∂h/∂ln ω, ∂h/∂ln ζ (not averaged).
        decay, decay_slope: e^{λt} from the start of the drive, and its derivative by λ.
    """

    h: np.ndarray
    rate: np.ndarray
    by_omega: np.ndarray
    by_zeta: np.ndarray
    decay: np.ndarray
    decay_slope: np.ndarray


def march(drive: Excitation, omega: float, zeta: float, out: np.ndarray) -> None:
    """Compute g, ġ, g̈ and both sensitivities with their rates on the drive's grid, into `out` of shape (n + 1, 7).

    An oscillation before the start of the grid is a free oscillation, which a fit contains as a separate term.
    """
    up = rate(omega, zeta)
    d_omega, d_zeta = rate_derivatives(omega, zeta)
    lam: Complex = np.array([up, np.conj(up)])
    turn = np.array([[d_omega, np.conj(d_omega)], [d_zeta, np.conj(d_zeta)]])
    rest = drive.step_s * (1 - _GAUSS_AT)
    weights = np.asarray(drive.step_s * _GAUSS_WEIGHT * np.exp(lam[:, None] * rest), np.complex128)
    _march(drive.phasor, drive.edge, drive.step_s, lam, turn, weights, weights * rest, out)


Instants = tuple[np.ndarray, np.ndarray]
"""Mean times of blocks, s, and variances of their sample times, s²; shape (n,) each."""


def responses_at(
    when_s: np.ndarray, spread_s2: np.ndarray, drive: Excitation, oscillators: list[tuple[float, float]]
) -> list[Response]:
    """Compute the response of each oscillator (ω, ζ) in blocks.

    The mean of f over a block is f(t̄) + ½ v f'' with the mean time t̄ and the variance v of its sample times.

    Args:
        when_s, spread_s2: t̄ within the drive's span, s, and v, s²; shape (n,).
        drive: drive.
        oscillators: ω, rad/s, and ζ of each oscillator.
    """
    return responses_of([(when_s, spread_s2)], drive, oscillators)[0]


def responses_of(
    sensors: Sequence[Instants], drive: Excitation, oscillators: list[tuple[float, float]]
) -> list[list[Response]]:
    """Compute the responses for several sensors from one integration. Sensors with equal blocks share the result."""
    grids = np.empty((len(oscillators), len(drive.edge), 7), dtype=np.complex128)
    for grid, (omega, zeta) in zip(grids, oscillators, strict=True):
        march(drive, omega, zeta, grid)
    lam = np.array([rate(omega, zeta) for omega, zeta in oscillators])
    knots, coefficients = drive.history.knots_s, drive.history.coefficients
    answers: list[list[Response]] = []
    for i, (when, spread) in enumerate(sensors):
        if i and np.array_equal(when, sensors[i - 1][0]) and np.array_equal(spread, sensors[i - 1][1]):
            answers.append(answers[-1])
            continue
        out = _seen(when, spread, knots, coefficients, drive.start_s, drive.step_s, grids, lam)
        answers.append([Response(*one) for one in out])
    return answers


@compiled(nogil=True)
def _march(  # numba kernel: a settings object is not supported
    phasor: Complex,
    edge: Complex,
    step: float,
    lam: Complex,
    turn: Complex,
    weight: Complex,
    slope_weight: Complex,
    out: Complex,
) -> None:
    """Step z and ∂z/∂λ of each rate, and compute g and its derivatives from them, into `out`."""
    n = len(phasor)
    gap = lam[0] - lam[1]
    square = lam[0] * lam[1]  # ω²
    width = -(lam[0] + lam[1])  # 2ζω
    decay0, decay1 = np.exp(lam[0] * step), np.exp(lam[1] * step)
    z0, z1, d0, d1 = 0j, 0j, 0j, 0j
    for i in range(n + 1):
        p, p_rate = edge[i, 0], edge[i, 1]
        r0, r1 = lam[0] * z0 + p, lam[1] * z1 + p
        g = -(lam[0] * lam[0] * z0 - lam[1] * lam[1] * z1) / gap
        v = -(lam[0] * lam[0] * r0 - lam[1] * lam[1] * r1) / gap
        out[i, 0], out[i, 1] = g, v
        out[i, 2] = width * p_rate + square * p - width * v - square * g
        # ∂/∂λ of −λ² z/(λ₊ − λ₋), for either rate
        e0 = -(2 * lam[0] * z0 + lam[0] * lam[0] * d0 + g) / gap
        e1 = (2 * lam[1] * z1 + lam[1] * lam[1] * d1 + g) / gap
        f0 = -(2 * lam[0] * r0 + lam[0] * lam[0] * (lam[0] * d0 + z0) + v) / gap
        f1 = (2 * lam[1] * r1 + lam[1] * lam[1] * (lam[1] * d1 + z1) + v) / gap
        for j in range(2):
            out[i, 3 + 2 * j] = turn[j, 0] * e0 + turn[j, 1] * e1
            out[i, 4 + 2 * j] = turn[j, 0] * f0 + turn[j, 1] * f1
        if i == n:
            break
        d0 = decay0 * (d0 + step * z0)
        d1 = decay1 * (d1 + step * z1)
        z0, z1 = decay0 * z0, decay1 * z1
        for k in range(3):
            z0 += weight[0, k] * phasor[i, k]
            z1 += weight[1, k] * phasor[i, k]
            d0 += slope_weight[0, k] * phasor[i, k]
            d1 += slope_weight[1, k] * phasor[i, k]


@compiled(nogil=True)
def _seen(  # numba kernel: a settings object is not supported
    times: Array,
    spread: Array,
    knots: Array,
    coefficients: Array,
    start: float,
    step: float,
    grids: Complex,
    lam: Complex,
) -> Complex:
    """Interpolate at blocks: quintic Hermite for g and its derivatives, cubic for the sensitivities; h = g − p."""
    modes, n = len(grids), len(times)
    out = np.empty((modes, 6, n), dtype=np.complex128)
    last = grids.shape[1] - 2
    segment = 0
    phase = np.empty(3)
    for k in range(n):
        segment = phase_at(times[k], segment, knots, coefficients, phase)
        p = complex(np.cos(phase[0]), np.sin(phase[0]))
        pull = (phase[1] * phase[1] - 1j * phase[2]) * p  # −p̈
        half = 0.5 * spread[k]
        x = (times[k] - start) / step
        i = min(max(int(x), 0), last)
        x -= i
        s = 1 - x
        left, left1 = (1 + 2 * x) * s * s, x * s * s * step
        right, right1 = x * x * (3 - 2 * x), -x * x * s * step
        for m in range(modes):
            c0, c1, c2 = grids[m, i, 0], step * grids[m, i, 1], 0.5 * step * step * grids[m, i, 2]
            rest = grids[m, i + 1, 0] - c0 - c1 - c2
            rest1 = step * grids[m, i + 1, 1] - c1 - 2 * c2
            rest2 = step * step * grids[m, i + 1, 2] - 2 * c2
            c3 = 10 * rest - 4 * rest1 + 0.5 * rest2
            c4 = -15 * rest + 7 * rest1 - rest2
            c5 = 6 * rest - 3 * rest1 + 0.5 * rest2
            g = c0 + x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * c5))))
            v = (c1 + x * (2 * c2 + x * (3 * c3 + x * (4 * c4 + x * 5 * c5)))) / step
            a = (2 * c2 + x * (6 * c3 + x * (12 * c4 + x * 20 * c5))) / (step * step)
            out[m, 0, k] = g - p + half * (a + pull)
            out[m, 1, k] = v - 1j * phase[1] * p
            for j in range(2):
                b = 3 + 2 * j
                out[m, 2 + j, k] = (
                    left * grids[m, i, b]
                    + left1 * grids[m, i, b + 1]
                    + right * grids[m, i + 1, b]
                    + right1 * grids[m, i + 1, b + 1]
                )
            since = times[k] - start
            if lam[m].real * since < -60:
                out[m, 4, k] = out[m, 5, k] = 0.0
            else:
                size, turn = np.exp(lam[m].real * since), lam[m].imag * since
                wave = complex(size * np.cos(turn), size * np.sin(turn))
                curved = 1 + half * lam[m] * lam[m]
                out[m, 4, k] = wave * curved
                out[m, 5, k] = wave * (since * curved + 2 * half * lam[m])
    return out

"""Covariance at the solution: sensor noise, tests of wider and narrower models, contribution of the phase's noise.

One design matrix X contains all unknowns (φ, linear unknowns of x, of y). An error r of the data, in standard
deviations, moves them by C Xᵀ r with C = (XᵀX + prior)⁻¹. A phase error δψ(s) moves the data by the response of the
oscillators to i p δψ. Its effect on an estimate is the same filter run backwards over the estimate's row of C Xᵀ. It
acts on a run-out r as i r p δψ, on a bow by ω² (e^{λ₊τ} − e^{λ₋τ})/(λ₊ − λ₋) instead of the kernel of the imbalance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from dynamics.compiled_code import compiled
from dynamics.equations.speed_history import phase_at
from identification.ring_down.modes import rate
from identification.run_up.model import ANGLE, OMEGAS, ZETAS, RunUpRecord, Structure, run_up_blocks
from identification.run_up.rotor_phase import PhaseHistory
from identification.samples import Averages
from identification.typed_scipy import uniform_filter1d
from rig_basics.arrays import Array, Complex

Indices = NDArray[np.int64]

_SMOOTH = 33  # number of averaged periodogram ordinates
_MIN_LEFT = 0.2  # of the noise in a band that a fit leaves
_OFFSETS = 16  # random positions of a phase within an encoder's step
_DRIFT_S = 0.25  # correlation time of these positions: longer than a beat, shorter than a passage


@dataclass(frozen=True)
class Design:
    """Linearised problem at a solution.

    Attributes:
        structure, phi: solution; θ = structure.theta(φ).
        matrix: X, shape (n, p + kx + ky); rows of x, then of y, in standard deviations.
        residual: residual in standard deviations, shape (n,).
        covariance: C, priors included.
        coefficients: linear unknowns of x and y.
    """

    structure: Structure
    phi: np.ndarray
    matrix: np.ndarray
    residual: np.ndarray
    covariance: np.ndarray
    coefficients: tuple[np.ndarray, np.ndarray]

    @property
    def nonlinear(self) -> int:
        """Number of nonlinear unknowns φ."""
        return len(self.phi)

    @property
    def chi2(self) -> float:
        """Sum of squared residuals, without priors."""
        return float(self.residual @ self.residual)

    @property
    def unknowns(self) -> int:
        """Number of columns of X."""
        return self.matrix.shape[1]

    def wald(self, contrast: np.ndarray, offset: np.ndarray) -> float:
        """Increase of χ² by the constraint contrast @ unknowns = 0, where offset is its value at the solution."""
        spread = contrast @ self.covariance @ contrast.T
        return float(offset @ np.linalg.lstsq(spread, offset, rcond=1e-12)[0])

    def score(self, more: np.ndarray) -> float:
        """Reduction of χ² by further columns, shape (n, m)."""
        clean = more - self.matrix @ (self.covariance @ (self.matrix.T @ more))
        size = np.linalg.norm(clean, axis=0) + 1e-300
        keep = size > 1e-9 * (np.linalg.norm(more, axis=0) + 1e-300)
        clean = clean[:, keep] / size[keep]
        pull = clean.T @ self.residual
        best = cast(Array, np.linalg.lstsq(clean.T @ clean, pull, rcond=1e-10)[0])
        return float(pull @ best)


def design_at(record: RunUpRecord, structure: Structure, phi: np.ndarray) -> Design:
    """Linearise the problem at φ."""
    blocks = run_up_blocks(record, structure, phi)
    p = len(phi)
    counts = [len(b.data) for b in blocks]
    widths = [b.basis.shape[1] for b in blocks]
    matrix = np.zeros((sum(counts), p + sum(widths)))
    residual, coefficients = np.empty(sum(counts)), list[np.ndarray]()
    row, column = 0, p
    for block, count, width in zip(blocks, counts, widths, strict=True):
        c = _solve(block.basis, block.data)
        rows = slice(row, row + count)
        matrix[rows, :p] = block.tangent(c)
        matrix[rows, column : column + width] = block.basis
        residual[rows] = block.data - block.basis @ c
        coefficients.append(c)
        row, column = row + count, column + width
    normal = matrix.T @ matrix
    known = np.isfinite(structure.prior_std)
    normal[range(p), range(p)] += np.where(known, structure.prior_std, np.inf) ** -2.0
    size = np.sqrt(np.diag(normal)) + 1e-150
    covariance = np.linalg.pinv(normal / np.outer(size, size), rcond=1e-14, hermitian=True) / np.outer(size, size)
    return Design(structure, phi, matrix, residual, covariance, (coefficients[0], coefficients[1]))


def imbalance_gains(record: RunUpRecord, design: Design) -> tuple[float, float]:
    """Reduction of χ² in sensors x and y by the driven response (imbalance and bow).

    The reference is the fit of the other terms: free oscillations, drift and run-out.
    """
    driven = np.zeros(len(design.coefficients[0]), bool)
    driven[:2] = driven[design.structure.bow_at] = True
    gains, row, column = list[float](), 0, design.nonlinear
    for channel, c in zip(record.channels, design.coefficients, strict=True):
        rows = slice(row, row + len(channel.time_s))
        basis, residual = design.matrix[rows, column : column + len(c)], design.residual[rows]
        answer = basis[:, driven] @ c[driven]
        without = answer - basis[:, ~driven] @ _solve(basis[:, ~driven], answer)
        gains.append(float(without @ without + 2 * without @ residual))
        row, column = rows.stop, column + len(c)
    return gains[0], gains[1]


def _solve(basis: np.ndarray, data: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(basis, axis=0) + 1e-300
    scaled = cast(Array, np.linalg.lstsq(basis / size, data, rcond=1e-12)[0])
    return scaled / size


def further_columns(record: RunUpRecord, structure: Structure, phi: np.ndarray, rows: slice) -> np.ndarray:
    """Columns of further elements of θ that are zero so far, shape (n, len(rows)), in standard deviations."""
    theta = structure.theta(phi)
    only = structure.only(rows, theta)
    blocks = run_up_blocks(record, only, theta[rows])
    return np.concatenate([block.tangent(_solve(block.basis, block.data)) for block in blocks])


def phase_noise_covariance(
    record: RunUpRecord, phase: PhaseHistory, design: Design, jacobian: np.ndarray
) -> np.ndarray:
    """Contribution of the phase's noise to the covariance of jacobian @ unknowns, shape (k, k)."""
    theta = design.structure.theta(design.phi)
    rows = jacobian @ design.covariance @ design.matrix.T
    cos, sin = np.cos(theta[ANGLE]), np.sin(theta[ANGLE])
    x = record.x
    effect = np.zeros((len(jacobian), len(x.time_s)))
    begin = 0
    for axis, channel in enumerate(record.channels):
        share = rows[:, begin : begin + len(channel.time_s)] * channel.weight
        begin += len(channel.time_s)
        c, at = design.coefficients[axis], design.structure
        amplitude = complex(*c[:2])
        run_out = complex(*c[at.run_out_at]) if at.run_out else 0j
        bow = complex(*c[at.bow_at]) if at.bow else 0j
        mix = ((cos, sin), (-sin, cos))[axis]
        phasor = np.exp(1j * record.drive.history.phase(channel.time_s)[:, 0])
        # run-out shows the phase's error without filtering
        own = np.real(1j * phasor * run_out * (1.0, -1j)[axis]) * share
        for mode, turn in enumerate((1.0, -1j)):
            lam = rate(np.exp(theta[OMEGAS[mode]]), np.exp(theta[ZETAS[mode]]))
            factor = mix[mode] * turn
            driven = factor * (lam * np.conj(lam) * bow - np.array([lam, np.conj(lam)]) ** 2 * amplitude)
            own += _backwards(share, np.gradient(channel.time_s), phasor, lam, driven, factor * amplitude)
        for k in range(len(effect)):
            effect[k] += own[k] if axis == 0 else np.interp(x.time_s, channel.time_s, own[k])
    width = np.gradient(x.time_s)
    # a step of a random walk moves everything after it
    later = np.cumsum(effect[:, ::-1], axis=1)[:, ::-1]
    random = white_phase_covariance(phase, x.time_s, effect) + (later * (phase.wander_density * width)) @ later.T
    moved = effect @ rounding_errors(phase, x)
    return random + moved @ moved.T / _OFFSETS


def white_phase_covariance(phase: PhaseHistory, time_s: Array, effect: Array) -> Array:
    """Covariance due to the white noise of the phase's readings, shape (k, k).

    Between marks the phase is interpolated: the error of a mark acts like a triangle that ends at its neighbours.
    Besides its slow part, a row of `effect` oscillates at twice the speed of the rotor. White noise at all instants
    would count this oscillation too, although a phase from one mark a turn has no error that changes so fast.

    Args:
        time_s: shape (n,).
        effect: change of each result by the phase's error at each instant, shape (k, n).
    """
    if phase.marks_s is None:
        variance = np.interp(time_s, phase.noise_time_s, phase.noise_density) / np.gradient(time_s)
        return (effect * variance) @ effect.T
    marks = phase.marks_s
    before = np.clip(np.searchsorted(marks, time_s) - 1, 0, len(marks) - 2)
    share = np.clip((time_s - marks[before]) / (marks[before + 1] - marks[before]), 0.0, 1.0)
    by_mark = np.stack(
        [
            np.bincount(before, row * (1 - share), len(marks)) + np.bincount(before + 1, row * share, len(marks))
            for row in effect
        ]
    )
    variance = np.interp(marks, phase.noise_time_s, phase.noise_density) / np.gradient(marks)
    return (by_mark * variance) @ by_mark.T


def excess_covariance(record: RunUpRecord, design: Design, jacobian: np.ndarray) -> np.ndarray:
    """Contribution of noise beyond the white part to the covariance of jacobian @ unknowns, shape (k, k).

    It is Σ_f h(f) (S(f) − 1) h(f)*, where h is the influence of the data on each row and S the spectrum of the noise in
    standard deviations of the white noise. Slow noise thus affects slow terms and has little effect on a resonance. The
    fit absorbs a part of the noise near the resonances. S is therefore the power of the residuals over the share of the
    noise that the fit leaves.
    """
    scale = np.sqrt(np.diag(design.covariance)) + 1e-150
    values, vectors = np.linalg.eigh(design.covariance / np.outer(scale, scale))
    taken = design.matrix @ (scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))  # hat matrix: taken @ takenᵀ
    rows = jacobian @ design.covariance @ design.matrix.T
    out, begin = np.zeros((len(jacobian), len(jacobian))), 0
    for channel in record.channels:
        own = slice(begin, begin + len(channel.time_s))
        begin = own.stop
        count = len(channel.time_s)
        size = 1 << int(np.ceil(np.log2(count)))
        level = uniform_filter1d(np.abs(np.fft.rfft(design.residual[own], size)) ** 2, _SMOOTH, mode="nearest")
        fitted = (np.abs(np.fft.rfft(taken[own], size, axis=0)) ** 2).sum(axis=1)
        left = uniform_filter1d(count - fitted, _SMOOTH, mode="nearest")
        excess = np.maximum(level / np.maximum(left, _MIN_LEFT * count) - 1.0, 0.0)
        share = np.fft.rfft(rows[:, own], size, axis=1)
        weight = np.r_[1.0, np.full(len(level) - 2, 2.0), 1.0] / size
        out += np.real((share * (excess * weight)) @ share.conj().T)
    return out


def rounding_errors(phase: PhaseHistory, channel: Averages) -> np.ndarray:
    """Draws of an encoder's rounding error in a channel's blocks, shape (n, draws), rad.

    The rounding error is not white. The speed beats against steps and readings. While it stays close to a simple ratio
    of the two, the mean of many readings has an error of a considerable part of a step.
    """
    time, rounding = channel.time_s, phase.rounding
    if rounding is None:
        return np.zeros((len(time), 1))
    block = np.searchsorted(0.5 * (time[1:] + time[:-1]), rounding.reading_s)
    knots, coefficients = rounding.history.knots_s, rounding.history.coefficients
    windows = int((rounding.reading_s[-1] - rounding.reading_s[0]) / _DRIFT_S) + 2
    offsets = np.random.default_rng(0).uniform(size=(windows, _OFFSETS))
    return _rounded(rounding.reading_s, block, knots, coefficients, rounding.step_rad, len(time), offsets)


@compiled(nogil=True)
def _rounded(
    times: Array, block: Indices, knots: Array, coefficients: Array, step: float, blocks: int, offsets: Array
) -> Array:
    """Block means of the rounding error of ψ + offset, for offsets that change linearly between rows."""
    out = np.zeros((blocks, offsets.shape[1]))
    count = np.zeros(blocks)
    at = np.empty(3)
    segment = 0
    for i in range(len(times)):
        segment = phase_at(times[i], segment, knots, coefficients, at)
        count[block[i]] += 1
        since = (times[i] - times[0]) / _DRIFT_S
        row = int(since)
        since -= row
        for k in range(offsets.shape[1]):
            turned = at[0] / step + (1 - since) * offsets[row, k] + since * offsets[row + 1, k]
            out[block[i], k] += step * (np.floor(turned + 0.5) - turned)
    for j in range(blocks):
        out[j] /= max(count[j], 1.0)
    return out


@compiled(nogil=True)
def _backwards(share: Array, width: Array, phasor: Complex, lam: complex, driven: Complex, factor: complex) -> Array:
    """Σ_j share_j ∂signal_j/∂ψ_i for every block i; share of shape (k, n).

    The response to an impulse of e^{iψ} is (driven_0 e^{λt} − driven_1 e^{λ*t})/(λ − λ*), and −factor at the impulse.
    """
    count, n = share.shape
    out = np.empty((count, n))
    other = np.conj(lam)
    gap = lam - other
    decay = np.empty((n, 2), dtype=np.complex128)
    for i in range(n):
        decay[i, 0], decay[i, 1] = np.exp(lam * width[i]), np.exp(other * width[i])
    for k in range(count):
        b0, b1 = 0j, 0j
        for i in range(n - 1, -1, -1):
            b0 = share[k, i] + decay[i, 0] * b0
            b1 = share[k, i] + decay[i, 1] * b1
            answer = (driven[0] * b0 - driven[1] * b1) / gap * width[i] - factor * share[k, i]
            out[k, i] = (1j * phasor[i] * answer).real
    return out

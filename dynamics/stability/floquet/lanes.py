"""Type I at many points of a map at once: explicit Runge–Kutta of order 8 with eight points in parallel lanes.

In the phase as independent variable
    q'' = W(ψ) [−(κ1 x + γ1 x', κ2 y + γ2 y') + Σ_i S_i (2 θ_i' e_i − (θ_i + δ_i θ_i') n_i)],
    θ_i'' = (S_i/J_i) n_i·q'' − δ_i θ_i',        κ = k/ω², γ = c/ω, δ_i = c_i/(J_i ω).
As complex numbers e_i = e^{i(ψ+θ_i)}, n_i = −i e_i, and W a = (m a + g e^{2iψ} ā)/(m² − |g|²) (linearised.type_one).
Therefore W S_i e_i = e^{iψ} P_i and W S_i n_i = e^{iψ} Q_i with constants P_i, Q_i, and a point is 21 numbers.
Positions are integrals of rates: the stages of order one (A) and two (A²) need one stored acceleration each (the
Nyström form of the method).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Array, Complex
from dynamics.compiled_code import compiled
from dynamics.motions.dormand_prince import NODES, STAGES, STEPS, WEIGHTS
from dynamics.stability.floquet.quick_eigenvalues import eigenvalues

LANES = 8
_N = 8
_WIDE = _N * LANES  # length of one component of all columns and lanes
_STATE = 4 * _WIDE
EPS = 2.220446049250313e-16
NUMBERS = 21
_TURN = np.array([-1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0])


def _terms() -> tuple[NDArray[np.intp], Array, Array, NDArray[np.intp]]:
    """Earlier stages added at each stage (last row: the step's end), in fours: indices, weights in A, in A², count."""
    first = np.vstack([STEPS, WEIGHTS])
    second = np.vstack([STEPS @ STEPS, WEIGHTS @ STEPS])
    index, a, b = np.zeros((STAGES + 1, 12), np.intp), np.zeros((STAGES + 1, 12)), np.zeros((STAGES + 1, 12))
    count = np.zeros(STAGES + 1, np.intp)
    for stage in range(STAGES + 1):
        used = np.flatnonzero((first[stage] != 0) | (second[stage] != 0))
        index[stage, : len(used)], a[stage, : len(used)] = used, first[stage, used]
        b[stage, : len(used)] = second[stage, used]
        count[stage] = -(-len(used) // 4)
    return index, a, b, count


_INDEX, _FIRST, _SECOND, _FOURS = _terms()
_ALL_NODES = np.append(NODES, 1.0)


@compiled(part=True)
def _at_phase(phase: float, numbers: Array, c: Array) -> None:
    """Write W_xx, W_xy, W_yy and the six rotating vectors of eight points at a phase to c (15, LANES)."""
    x, y = np.cos(phase), np.sin(phase)
    x2, y2 = x * x - y * y, 2 * x * y
    for lane in range(LANES):
        real = x2 * numbers[7, lane] - y2 * numbers[8, lane]
        c[0, lane] = numbers[6, lane] + real
        c[1, lane] = x2 * numbers[8, lane] + y2 * numbers[7, lane]
        c[2, lane] = numbers[6, lane] - real
    for q in range(6):
        for lane in range(LANES):
            re, im = numbers[9 + 2 * q, lane], numbers[10 + 2 * q, lane]
            c[3 + 2 * q, lane] = x * re - y * im
            c[4 + 2 * q, lane] = x * im + y * re


@compiled(part=True)
def _accelerate(position: Array, rate: Array, c: Array, rig: Array, out: Array) -> None:
    """Write the accelerations of all columns and lanes at one node to out.

    Args:
        position, rate, out: shape (256,): component, column, lane.
        c: shape (15, LANES), of `_at_phase`.
        rig: shape (21, LANES): κ1, κ2, γ1, γ2, δ3, δ4 are read.
    """
    for column in range(_N):
        for lane in range(LANES):
            i = column * LANES + lane
            va, vb = rate[2 * _WIDE + i], rate[3 * _WIDE + i]
            fx = rig[0, lane] * position[i] + rig[2, lane] * rate[i]
            fy = rig[1, lane] * position[_WIDE + i] + rig[3, lane] * rate[_WIDE + i]
            la, lb = rig[4, lane] * va, rig[5, lane] * vb
            ga, gb = position[2 * _WIDE + i] + la, position[3 * _WIDE + i] + lb
            ax = c[3, lane] * va + c[5, lane] * vb - c[7, lane] * ga - c[9, lane] * gb
            ay = c[4, lane] * va + c[6, lane] * vb - c[8, lane] * ga - c[10, lane] * gb
            ax -= c[0, lane] * fx + c[1, lane] * fy
            ay -= c[1, lane] * fx + c[2, lane] * fy
            out[i] = ax
            out[_WIDE + i] = ay
            out[2 * _WIDE + i] = c[11, lane] * ax + c[12, lane] * ay - la
            out[3 * _WIDE + i] = c[13, lane] * ax + c[14, lane] * ay - lb


@compiled(part=True)
def _gather(stage: int, h: float, position: Array, rate: Array, k: Array, new_position: Array, new_rate: Array) -> None:
    """Compute the state at a stage (for stage 12 at the step's end) from the previous accelerations."""
    ch = _ALL_NODES[stage] * h
    for i in range(_STATE):
        new_rate[i] = rate[i]
        new_position[i] = position[i] + ch * rate[i]
    hh = h * h
    for four in range(_FOURS[stage]):
        t = 4 * four
        k0, k1 = k[_INDEX[stage, t]], k[_INDEX[stage, t + 1]]
        k2, k3 = k[_INDEX[stage, t + 2]], k[_INDEX[stage, t + 3]]
        a0, a1 = h * _FIRST[stage, t], h * _FIRST[stage, t + 1]
        a2, a3 = h * _FIRST[stage, t + 2], h * _FIRST[stage, t + 3]
        b0, b1 = hh * _SECOND[stage, t], hh * _SECOND[stage, t + 1]
        b2, b3 = hh * _SECOND[stage, t + 2], hh * _SECOND[stage, t + 3]
        for i in range(_STATE):
            v0, v1, v2, v3 = k0[i], k1[i], k2[i], k3[i]
            new_rate[i] += (a0 * v0 + a1 * v1) + (a2 * v2 + a3 * v3)
            new_position[i] += (b0 * v0 + b1 * v1) + (b2 * v2 + b3 * v3)


@compiled(part=True)
def _march(steps: int, rig: Array, work: Array, k: Array, c: Array) -> None:
    """Write fundamental matrices of eight points over half a revolution to work[0] (positions) and work[1] (rates)."""
    h = np.pi / steps
    position, rate, new_position, new_rate = work[0], work[1], work[2], work[3]
    position[:] = 0.0
    rate[:] = 0.0
    for column in range(4):
        for lane in range(LANES):
            position[column * _WIDE + column * LANES + lane] = 1.0
            rate[column * _WIDE + (4 + column) * LANES + lane] = 1.0
    k[:] = 0.0
    for step in range(steps):
        for stage in range(STAGES):
            _gather(stage, h, position, rate, k, new_position, new_rate)
            _at_phase((step + NODES[stage]) * h, rig, c)
            _accelerate(new_position, new_rate, c, rig, k[stage])
        _gather(STAGES, h, position, rate, k, new_position, new_rate)
        position[:] = new_position
        rate[:] = new_rate


@compiled(part=True)
def _eight(numbers: Array, start: int, rig: Array) -> None:
    """Write the numbers of eight points to rig (21, LANES); the last point is repeated."""
    for lane in range(LANES):
        for q in range(NUMBERS):
            rig[q, lane] = numbers[min(start + lane, numbers.shape[0] - 1), q]


@compiled(part=True)
def _half_turn(work: Array, lane: int, scale: Array, out: Array) -> float:
    """Write D Φ(π) of one lane in scaled coordinates to out (8, 8); returns its Frobenius norm."""
    total = 0.0
    for row in range(_N):
        for column in range(_N):
            value = work[row // 4, (row % 4) * _WIDE + column * LANES + lane]
            value *= _TURN[row] * scale[column] / scale[row]
            out[row, column] = value
            total += value * value
    return np.sqrt(total)


@compiled(part=True)
def largest(values: Complex) -> tuple[int, float]:
    """Index of the largest modulus, and distance of that eigenvalue to its nearest neighbour."""
    best = 0
    for i in range(1, _N):
        if abs(values[i]) > abs(values[best]):
            best = i
    gap = np.inf
    for i in range(_N):
        if i != best:
            gap = min(gap, abs(values[i] - values[best]))
    return best, gap


@compiled(part=True)
def sensitive(noise: float, norm: float, gap: float) -> float:
    """Change of an eigenvalue due to noise in the matrix, for a given distance to the nearest eigenvalue.

    A pair at distance g has condition ‖Φ‖/g: the change is of first order for a large gap and a square root if the
    pair merges.
    """
    return min(noise * (1 + norm / max(gap, 1e-300)), np.sqrt(noise * norm) + noise)


@compiled(nogil=True)
def half_turn_matrices(steps: int, numbers: Array, units: Array, found: Array) -> None:
    """Compute D Φ(π) for many points with one number of steps.

    Args:
        steps: number of steps per half revolution.
        numbers: numbers of the points, shape (points, 21); see map_rigs.MapRigs.
        units: units of the eight states, shape (8,).
        found: shape (points, 8, 8), filled, in these units.
    """
    rig, c = np.empty((NUMBERS, LANES)), np.empty((15, LANES))
    k, work = np.empty((STAGES, _STATE)), np.empty((4, _STATE))
    for start in range(0, numbers.shape[0], LANES):
        _eight(numbers, start, rig)
        _march(steps, rig, work, k, c)
        for lane in range(min(LANES, numbers.shape[0] - start)):
            _half_turn(work, lane, units, found[start + lane])


# The finer run leaves 1/255 of the change between the runs, of a merging pair's move 1/16. A quarter of the
# eigenvalue's move is therefore a bound. Where that move happens to vanish, the change of the whole matrix is used.
_MOVED, _CHANGE = 0.25, 1.0 / 16384.0


@compiled(nogil=True)
def largest_multipliers(steps: int, numbers: Array, units: Array, found: Array, errors: Array) -> None:
    """Compute the largest multiplier over a revolution and its error bound for many points with one number of steps.

    The bound of the eigenvalue is a quarter of its move between both runs (order 8 leaves 1/255 of it, a merging pair
    1/16), plus 2⁻¹⁴ of the change of the whole matrix, plus rounding (`sensitive`).

    Args:
        steps: number of steps per half revolution of the finer of two runs; even.
        numbers: numbers of the points, shape (points, 21); see map_rigs.MapRigs.
        units: units of each point's states in which the matrix's blocks are comparable, shape (points, 8).
        found, errors: shape (points,), filled; NaN where the eigenvalues did not converge.
    """
    points = numbers.shape[0]
    rig, c, k = np.empty((NUMBERS, LANES)), np.empty((15, LANES)), np.empty((STAGES, _STATE))
    first, second = np.empty((4, _STATE)), np.empty((4, _STATE))
    a, b = np.empty((_N, _N)), np.empty((_N, _N))
    values = np.empty(_N, np.complex128)
    for start in range(0, points, LANES):
        _eight(numbers, start, rig)
        _march(steps, rig, first, k, c)
        _march(steps // 2, rig, second, k, c)
        for lane in range(min(LANES, points - start)):
            scale = units[start + lane]
            norm = _half_turn(first, lane, scale, a)
            _half_turn(second, lane, scale, b)
            change = 0.0
            for i in range(_N):
                for j in range(_N):
                    change += (a[i, j] - b[i, j]) ** 2
            change = np.sqrt(change)
            found[start + lane] = errors[start + lane] = np.nan
            if not eigenvalues(a, values):
                continue
            best, gap = largest(values)
            value = values[best]
            modulus = abs(value)
            if not eigenvalues(b, values):
                continue
            coarse_best, _ = largest(values)
            coarse_value = values[coarse_best]
            moved = min(abs(value - coarse_value), abs(value - np.conj(coarse_value)))
            moved = max(moved, abs(modulus - abs(coarse_value)))
            bound = _MOVED * moved + _CHANGE * change + sensitive(4 * EPS * norm, norm, gap)
            found[start + lane] = modulus * modulus
            errors[start + lane] = (2 * modulus + bound) * bound

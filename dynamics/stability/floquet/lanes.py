"""Type I on many points of a map at once: explicit Runge–Kutta of order 8 with eight points side by side.

Points of a map share the pendulums, the balanced angles and the total mass. In the phase as independent variable
    q'' = W(ψ) [−(κ1 x + γ1 x', κ2 y + γ2 y') + Σ_i S_i (2 θ_i' e_i − (θ_i + δ_i θ_i') n_i)],
    θ_i'' = (S_i/J_i) n_i·q'' − δ_i θ_i',        κ = k/ω², γ = c/ω, δ_i = c_i/(J_i ω),
only κ, γ, δ differ, so W, e and n at the nodes are computed once for all. Positions are integrals of rates: the
stages of order one (A) and two (A²) need one stored acceleration each (the Nyström form of the same method).
"""

# pyright: reportMissingParameterType=false
# Compiled functions: numba takes their types from the arguments, and their docstrings tell them.

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dynamics.equations.parameters import RotorParameters
from dynamics.motions.dormand_prince import NODES, STAGES, STEPS, WEIGHTS
from dynamics.stability.floquet.quick_eigenvalues import eigenvalues

LANES = 8
_N = 8
_WIDE = _N * LANES  # one component of all columns and lanes
_STATE = 4 * _WIDE
_EPS = 2.220446049250313e-16
_TURN = np.array([-1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0])


def _terms() -> tuple[NDArray[np.intp], NDArray[np.floating], NDArray[np.floating], NDArray[np.intp]]:
    """Earlier stages that each stage (last row: the step's end) adds, in fours: indices, weights in A, in A², count."""
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


def node_table(parameters: RotorParameters, theta3: float, theta4: float, steps: int) -> NDArray[np.floating]:
    """What all points share at every stage of every step over half a revolution, shape (steps · 12, 15).

    Columns: W_xx, W_xy, W_yy; 2 S W e for A (x, y) and B; S W n for A and B; (S/J) n for A and B.
    """
    s, j = parameters.packed()[5:7], parameters.packed()[8:10]
    phase = ((np.arange(steps)[:, None] + NODES[None, :]) * (np.pi / steps)).ravel()
    arm = np.exp(1j * (phase[:, None] + np.array([theta3, theta4])))
    normal, mu = -1j * arm, s * s / j
    m, g = parameters.total_mass_kg - mu.sum() / 2, -0.5 * np.sum(mu * arm**2, axis=1)
    det = (m - np.abs(g)) * (m + np.abs(g))

    def softened(a: NDArray[np.complexfloating]) -> NDArray[np.complexfloating]:
        return (m * a + g[:, None] * np.conj(a)) / det[:, None]

    table = [(m + g.real) / det, g.imag / det, (m - g.real) / det]
    for vectors in (softened(2 * s * arm), softened(s * normal), s / j * normal):
        for i in range(2):
            table += [vectors[:, i].real, vectors[:, i].imag]
    return np.ascontiguousarray(np.column_stack(table))


@njit(cache=True, error_model="numpy", nogil=True)
def _accelerate(position, rate, c, rig, out):
    """Accelerations of all columns and lanes at one node.

    Args:
        position, rate, out: shape (256,): component, column, lane.
        c: row of the node table.
        rig: shape (6, 64): κ1, κ2, γ1, γ2, δ3, δ4 per column and lane.
    """
    for i in range(_WIDE):
        va, vb = rate[2 * _WIDE + i], rate[3 * _WIDE + i]
        fx = rig[0, i] * position[i] + rig[2, i] * rate[i]
        fy = rig[1, i] * position[_WIDE + i] + rig[3, i] * rate[_WIDE + i]
        la, lb = rig[4, i] * va, rig[5, i] * vb
        ga, gb = position[2 * _WIDE + i] + la, position[3 * _WIDE + i] + lb
        ax = c[3] * va + c[5] * vb - c[7] * ga - c[9] * gb - c[0] * fx - c[1] * fy
        ay = c[4] * va + c[6] * vb - c[8] * ga - c[10] * gb - c[1] * fx - c[2] * fy
        out[i] = ax
        out[_WIDE + i] = ay
        out[2 * _WIDE + i] = c[11] * ax + c[12] * ay - la
        out[3 * _WIDE + i] = c[13] * ax + c[14] * ay - lb


@njit(cache=True, error_model="numpy", nogil=True)
def _gather(stage, h, position, rate, k, new_position, new_rate):
    """State at a stage (or, for stage 12, at the step's end) from the accelerations so far."""
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


@njit(cache=True, error_model="numpy", nogil=True)
def _march(table, rig, work, k):
    """Fundamental matrices of eight points over half a revolution, into work[0] (positions) and work[1] (rates)."""
    steps = table.shape[0] // STAGES
    h = np.pi / steps
    position, rate, new_position, new_rate = work[0], work[1], work[2], work[3]
    position[:] = 0.0
    rate[:] = 0.0
    for c in range(4):
        for lane in range(LANES):
            position[c * _WIDE + c * LANES + lane] = 1.0
            rate[c * _WIDE + (4 + c) * LANES + lane] = 1.0
    k[:] = 0.0
    for step in range(steps):
        for stage in range(STAGES):
            _gather(stage, h, position, rate, k, new_position, new_rate)
            _accelerate(new_position, new_rate, table[step * STAGES + stage], rig, k[stage])
        _gather(STAGES, h, position, rate, k, new_position, new_rate)
        position[:] = new_position
        rate[:] = new_rate


@njit(cache=True, error_model="numpy", nogil=True)
def _half_turn(work, lane, scale, out):
    """One lane's D Φ(π) in scaled coordinates into out (8, 8); returns its Frobenius norm."""
    total = 0.0
    for row in range(_N):
        for column in range(_N):
            value = work[row // 4, (row % 4) * _WIDE + column * LANES + lane]
            value *= _TURN[row] * scale[column] / scale[row]
            out[row, column] = value
            total += value * value
    return np.sqrt(total)


@njit(cache=True, error_model="numpy", nogil=True)
def _largest(values):
    """Index of the largest modulus and the distance of that eigenvalue to its nearest neighbour."""
    best = 0
    for i in range(1, _N):
        if abs(values[i]) > abs(values[best]):
            best = i
    gap = np.inf
    for i in range(_N):
        if i != best:
            gap = min(gap, abs(values[i] - values[best]))
    return best, gap


@njit(cache=True, error_model="numpy", nogil=True)
def _sensitive(noise, norm, gap):
    """How far noise in a matrix moves an eigenvalue with its neighbour at a distance.

    A pair at distance g has condition ‖Φ‖/g: first order far apart, a square root where it merges.
    """
    return min(noise * (1 + norm / max(gap, 1e-300)), np.sqrt(noise * norm) + noise)


@njit(cache=True, error_model="numpy", nogil=True)
def _scales(length, rig, mass, scale):
    """Units of the state: x, y by sqrt(J/M_S), their rates by that times the frequency where it is above the speed."""
    scale[:] = 1.0
    for axis in range(2):
        scale[axis] = length
        scale[4 + axis] = length * max(1.0, np.sqrt(rig[axis] / mass))


@njit(cache=True, error_model="numpy", nogil=True)
def half_turn_matrices(
    table: NDArray[np.floating], rigs: NDArray[np.floating], units: NDArray[np.floating], found: NDArray[np.floating]
) -> None:
    """D Φ(π) for many points with one number of steps.

    Args:
        table: of the nodes.
        rigs: shape (points, 6): κ1, κ2, γ1, γ2, δ3, δ4 (per radian of phase; γ and κ in kg).
        units: of the eight states, shape (8,).
        found: shape (points, 8, 8), filled, in these units.
    """
    points = rigs.shape[0]
    rig, k, work = np.empty((6, _WIDE)), np.empty((STAGES, _STATE)), np.empty((4, _STATE))
    for start in range(0, points, LANES):
        for i in range(_WIDE):
            point = min(start + i % LANES, points - 1)
            for q in range(6):
                rig[q, i] = rigs[point, q]
        _march(table, rig, work, k)
        for lane in range(min(LANES, points - start)):
            _half_turn(work, lane, units, found[start + lane])


@njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract"})
def _four_matrices(row, weights, start, out):
    """Weighted sums of a row's matrices, shape (n, 64), at four points into out (4, 64)."""
    last = weights.shape[0] - 1
    a, b, c, d = start, min(start + 1, last), min(start + 2, last), min(start + 3, last)
    out[:] = 0.0
    for j in range(weights.shape[1]):
        wa, wb, wc, wd = weights[a, j], weights[b, j], weights[c, j], weights[d, j]
        for q in range(_N * _N):
            value = row[j, q]
            out[0, q] += wa * value
            out[1, q] += wb * value
            out[2, q] += wc * value
            out[3, q] += wd * value


@njit(cache=True, error_model="numpy", nogil=True)
def multipliers_of_row(
    row: NDArray[np.floating],
    weights: NDArray[np.floating],
    units: NDArray[np.floating],
    rigs: NDArray[np.floating],
    length: float,
    mass: float,
    error: float,
    found: NDArray[np.floating],
    errors: NDArray[np.floating],
) -> None:
    """Largest multipliers over a revolution along a row of a map whose half-turn matrices are interpolated.

    Args:
        row: matrices of the row's nodes, shape (nodes, 64), in `units`, shape (8,).
        weights: of the nodes at each point, shape (points, nodes).
        rigs, length, mass: as of `largest_multipliers`.
        error: bound on the Frobenius norm of an interpolated matrix's error, in `units`.
        found, errors: shape (points,), filled; NaN where the eigenvalues did not come out.
    """
    points = weights.shape[0]
    matrices, a = np.empty((4, _N * _N)), np.empty((_N, _N))
    values, scale = np.empty(_N, np.complex128), np.empty(_N)
    for start in range(0, points, 4):
        _four_matrices(row, weights, start, matrices)
        for i in range(start, min(start + 4, points)):
            _scales(length, rigs[i], mass, scale)
            total = stretch = 0.0
            for r in range(_N):
                stretch = max(stretch, units[r] / scale[r], scale[r] / units[r])
                for c in range(_N):
                    value = matrices[i - start, _N * r + c] * (units[r] / scale[r]) * (scale[c] / units[c])
                    a[r, c] = value
                    total += value * value
            norm = np.sqrt(total)
            found[i] = errors[i] = np.nan
            if not eigenvalues(a, values):
                continue
            best, gap = _largest(values)
            modulus = abs(values[best])
            bound = _sensitive(4 * _EPS * norm + error * stretch, norm, gap)
            found[i] = modulus * modulus
            errors[i] = (2 * modulus + bound) * bound


# Of what the finer run changed it leaves 1/255, of a merging pair's move 1/16: a quarter of the eigenvalue's move is
# on the safe side. Where that move happens to vanish the change of the whole matrix stands in.
_MOVED, _CHANGE = 0.25, 1.0 / 16384.0


@njit(cache=True, error_model="numpy", nogil=True)
def largest_multipliers(
    fine: NDArray[np.floating],
    coarse: NDArray[np.floating],
    rigs: NDArray[np.floating],
    length: float,
    mass: float,
    found: NDArray[np.floating],
    errors: NDArray[np.floating],
) -> None:
    """Largest multiplier over a revolution, and a bound on its error, for many points with one number of steps.

    Args:
        fine, coarse: node tables of n and n/2 steps.
        rigs: shape (points, 6): κ1, κ2, γ1, γ2, δ3, δ4 (per radian of phase; γ and κ in kg).
        length: sqrt(J/M_S), m, and mass M_S, kg: units in which the matrix's blocks are comparable.
        found, errors: shape (points,), filled; NaN where the eigenvalues did not come out.
    """
    points = rigs.shape[0]
    rig, k = np.empty((6, _WIDE)), np.empty((STAGES, _STATE))
    first, second = np.empty((4, _STATE)), np.empty((4, _STATE))
    a, b = np.empty((_N, _N)), np.empty((_N, _N))
    values, scale = np.empty(_N, np.complex128), np.empty(_N)
    for start in range(0, points, LANES):
        for i in range(_WIDE):
            point = min(start + i % LANES, points - 1)
            for q in range(6):
                rig[q, i] = rigs[point, q]
        _march(fine, rig, first, k)
        _march(coarse, rig, second, k)
        for lane in range(min(LANES, points - start)):
            _scales(length, rig[:, lane], mass, scale)
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
            best, gap = _largest(values)
            value = values[best]
            modulus = abs(value)
            if not eigenvalues(b, values):
                continue
            coarse_best, _ = _largest(values)
            coarse_value = values[coarse_best]
            moved = min(abs(value - coarse_value), abs(value - np.conj(coarse_value)))
            moved = max(moved, abs(modulus - abs(coarse_value)))
            bound = _MOVED * moved + _CHANGE * change + _sensitive(4 * _EPS * norm, norm, gap)
            found[start + lane] = modulus * modulus
            errors[start + lane] = (2 * modulus + bound) * bound

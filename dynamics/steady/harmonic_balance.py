"""Newton's method for the balance of a motion's Fourier coefficients, all of it compiled.

x, y and the angles are sums of cosines and sines at n equally spaced phases. The forces are evaluated at those phases
and transformed back. Newton's method solves ω² u″ − acceleration = 0 in coefficients.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Array, Flags, Indices
from dynamics.compiled_code import compiled
from dynamics.equations.kernels import rates
from dynamics.equations.quick_derivatives import rate_derivatives

_ITERATIONS = 25
_LONGEST_TURN = 0.3  # rad: largest Newton step of an angle


class Basis(NamedTuple):
    """Trigonometric functions at n phases.

    Attributes:
        value, slope: values and derivatives of each function (columns) at each phase, shape (n, n).
        transform: matrix from values to coefficients, shape (n, n).
        order: order of each function, shape (n,).
        sine: whether each function is a sine, shape (n,).
    """

    value: Array
    slope: Array
    transform: Array
    order: Array
    sine: Flags


def _basis(phase: Array, orders: NDArray[np.integer]) -> Basis:
    """cos and sin of the given orders at equally spaced phases, without the highest sine, which vanishes there."""
    functions = [(k, sine) for k in orders.tolist() for sine in (False, True) if k > 0 or not sine][: len(phase)]
    order, sine = np.array([k for k, _ in functions], float), np.array([s for _, s in functions])
    angle = phase[:, None] * order
    value = np.where(sine, np.sin(angle), np.cos(angle))
    slope = order * np.where(sine, np.cos(angle), -np.sin(angle))
    transform = value.T / np.sum(value**2, axis=0)[:, None]  # the columns are orthogonal
    return Basis(value, slope, np.ascontiguousarray(transform), order, sine)


class Grid:
    """Phases and bases of one resolution, over half a revolution if the motion has that symmetry."""

    def __init__(self, half: int, symmetric: bool) -> None:
        self.symmetric: bool = symmetric
        self.n: int = half if symmetric else 2 * half
        self.phase: Array = np.pi * np.arange(self.n) / half
        self.position: Basis = _basis(self.phase, np.arange(1, half, 2) if symmetric else np.arange(half + 1))
        self.angle: Basis = _basis(self.phase, np.arange(0, half + 1, 2)) if symmetric else self.position

    @staticmethod
    @functools.lru_cache(maxsize=16)
    def of(half: int, symmetric: bool) -> Grid:
        """The grid with `half` phases in half a revolution. It is cached."""
        return Grid(half, symmetric)

    def whole(self, states: Array) -> Array:
        """States over a whole revolution from those over the grid's span."""
        if not self.symmetric:
            return states
        return np.concatenate([states, states * [-1, -1, 1, 1, -1, -1, 1, 1]])

    def coefficients(self, positions: Array) -> Array:
        """Coefficients (n, 4) of positions (m, 4) sampled over a whole revolution, interpolated if necessary."""
        m = len(positions)
        spectrum = np.fft.rfft(positions, axis=0) * (2.0 / m)
        spectrum[0] *= 0.5
        if m % 2 == 0:
            spectrum[-1] *= 0.5
        found = np.zeros((self.n, 4))
        for columns, basis in ((slice(0, 2), self.position), (slice(2, 4), self.angle)):
            known = basis.order < len(spectrum)
            rows = spectrum[basis.order[known].astype(int), columns]
            found[known, columns] = np.where(basis.sine[known, None], -rows.imag, rows.real)
        return found


def solve_balance(
    grid: Grid,
    speed_rad_s: float,
    packed: Array,
    free: tuple[bool, bool],
    start: Array,
    least_size_m: float,
) -> tuple[Array, float] | None:
    """Solve the balance by Newton's method from a guess.

    Args:
        packed: parameters in the order of the compiled kernels, without dry friction.
        free: which pendulums move.
        start: coefficients of x, y, θ3, θ4, shape (n, 4).
        least_size_m: smallest scale of x, y, m.
    Returns:
        States (n, 8) over the grid and the size of the last step (rad; x, y relative to the orbit), or None.
    """
    kept = np.array([0, 1] + [2 + i for i in range(2) if free[i]])
    states, c = np.empty((grid.n, 8)), np.array(start, float, order="C")
    bases = (grid.position[:4], grid.angle[:4])
    last = _newton(c, bases, grid.phase, speed_rad_s, packed, kept, least_size_m, states)
    return None if last < 0 else (states, last)


@compiled(contract=True, part=True)
def _sample(
    c: Array,
    bases: tuple[tuple[Array, Array, Array, Array], tuple[Array, Array, Array, Array]],
    speed: float,
    states: Array,
) -> None:
    """Write states (n, 8) at the phases from coefficients (n, 4) to states."""
    n = len(c)
    for i in range(4):
        value, slope, _, _ = bases[i // 2]
        for j in range(n):
            at, rate = 0.0, 0.0
            for k in range(n):
                at += value[j, k] * c[k, i]
                rate += slope[j, k] * c[k, i]
            states[j, i], states[j, 4 + i] = at, speed * rate


@compiled(contract=True, part=True)
def _add_block(
    transform: Array, factor: Array, value: Array, rate_factor: Array, slope: Array, matrix: Array, top: int, left: int
) -> None:
    """Subtract transform · (diag(factor) value + diag(rate_factor) slope) from a block of the matrix."""
    n = len(factor)
    change = np.empty(n)
    for k in range(n):
        for j in range(n):
            change[j] = factor[k] * value[k, j] + rate_factor[k] * slope[k, j]
        for i in range(n):
            f, row = transform[i, k], matrix[top + i]
            for j in range(n):
                row[left + j] -= f * change[j]


@compiled(contract=True, part=True)
def _linearise(
    states: Array,
    c: Array,
    bases: tuple[tuple[Array, Array, Array, Array], tuple[Array, Array, Array, Array]],
    phase: Array,
    speed: float,
    p: Array,
    kept: Indices,
    unit: Array,
    work: tuple[Array, Array, Array, Array],
    matrix: Array,
    right: Array,
) -> None:
    """Write Newton's matrix (m n, m n) and right-hand side (m n,), in units (4,), for m kept coordinates.

    Args:
        work: scratch; rates (8,), accelerations (n, 4), their derivatives (4, 8, n), those at one phase (4, 8).
    """
    out, accelerations, slopes, one = work
    n = len(c)
    free_a, free_b = 0.0, 0.0
    for i in kept:
        free_a, free_b = (1.0 if i == 2 else free_a), (1.0 if i == 3 else free_b)
    for j in range(n):
        rates(states[j], phase[j], speed, 0.0, p, free_a, free_b, out)
        rate_derivatives(states[j], phase[j], speed, p, free_a, free_b, one)
        for i in range(4):
            accelerations[j, i] = out[4 + i]
            for k in range(8):
                slopes[i, k, j] = one[i, k] * (speed if k >= 4 else 1.0)
    for row in range(len(right)):  # numba compiles a slice assignment slowly
        for column in range(len(right)):
            matrix[row, column] = 0.0
    for r in range(len(kept)):
        i: int = kept[r]
        top = r * n
        _, _, transform, order = bases[i // 2]
        for q in range(len(kept)):
            axis: int = kept[q] // 2
            value, slope, _, _ = bases[axis]
            _add_block(transform, slopes[i, kept[q]], value, slopes[i, 4 + kept[q]], slope, matrix, top, q * n)
        for k in range(n):
            curvature, driven = -((speed * order[k]) ** 2), 0.0
            matrix[top + k, top + k] += curvature
            for j in range(n):
                driven += transform[k, j] * accelerations[j, i]
            right[top + k] = (driven - curvature * c[k, i]) / unit[i]
            for q in range(len(kept)):
                factor = unit[kept[q]] / unit[i]
                for j in range(n):
                    matrix[top + k, q * n + j] *= factor


@compiled
def _scale_rows(matrix: Array, right: Array) -> bool:
    """Scale the rows to equal size. False if a row is zero or not finite."""
    for i in range(len(right)):
        size = 0.0
        for j in range(len(right)):
            value = abs(matrix[i, j])
            if not value < np.inf:
                return False
            size = max(size, value)
        if size == 0.0:
            return False
        right[i] /= size
        for j in range(len(right)):
            matrix[i, j] /= size
    return True


@compiled(contract=True)
def _eliminate(a: Array, b: Array) -> bool:
    """Solve a x = b by elimination with column pivoting; x is written to b. False if a is singular."""
    n = len(b)
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(a[i, k]) > abs(a[pivot, k]):
                pivot = i
        if a[pivot, k] == 0.0:
            return False
        if pivot != k:
            for j in range(k, n):
                a[k, j], a[pivot, j] = a[pivot, j], a[k, j]
            b[k], b[pivot] = b[pivot], b[k]
        own = a[k]
        for i in range(k + 1, n):
            row, f = a[i], a[i, k] / a[k, k]
            if f != 0.0:
                b[i] -= f * b[k]
                for j in range(k + 1, n):
                    row[j] -= f * own[j]
    for k in range(n - 1, -1, -1):
        total = b[k]
        for j in range(k + 1, n):
            total -= a[k, j] * b[j]
        b[k] = total / a[k, k]
    return True


@compiled(part=True)
def _solve(matrix: Array, right: Array) -> bool:
    """Write the solution to right. False if it does not exist."""
    if not _scale_rows(matrix, right):
        return False
    if not _eliminate(matrix, right):
        return False
    largest = 0.0
    for value in right:
        largest = max(largest, abs(value)) if abs(value) < np.inf else np.inf
    return largest < np.inf


@compiled
def _newton(
    c: Array,
    bases: tuple[tuple[Array, Array, Array, Array], tuple[Array, Array, Array, Array]],
    phase: Array,
    speed: float,
    p: Array,
    kept: Indices,
    least_size: float,
    states: Array,
) -> float:
    """Newton's method on coefficients c (n, 4), in place.

    Args:
        states: shape (n, 8), filled.
    Returns:
        Size of the last step (rad; x, y relative to the orbit), or −1 if the iteration does not converge.
    """
    n, m = len(c), len(kept)
    work = (np.empty(8), np.empty((n, 4)), np.empty((4, 8, n)), np.empty((4, 8)))
    matrix, right, unit, previous = np.empty((m * n, m * n)), np.empty(m * n), np.ones(4), np.inf
    for _ in range(_ITERATIONS):
        _sample(c, bases, speed, states)
        size = least_size
        for k in range(n):
            size = max(size, abs(c[k, 0]), abs(c[k, 1]))
        unit[0] = unit[1] = size if size != 0.0 else 1.0
        _linearise(states, c, bases, phase, speed, p, kept, unit, work, matrix, right)
        if not _solve(matrix, right):
            return -1.0
        turn, largest = 0.0, 0.0
        for r in range(m):
            moved = 0.0
            for k in range(r * n, (r + 1) * n):
                moved += abs(right[k])
            largest = max(largest, moved)
            if r >= 2:
                turn = max(turn, moved)
        cut = min(1.0, _LONGEST_TURN / turn) if turn > 0.0 else 1.0
        for r in range(m):
            for k in range(n):
                c[k, kept[r]] += cut * right[r * n + k] * unit[kept[r]]
        if cut == 1.0 and (largest < 1e-14 or (largest < 1e-8 and largest > 0.1 * previous)):
            _sample(c, bases, speed, states)
            return largest
        previous = largest
    return -1.0

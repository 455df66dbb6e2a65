"""Periodic orbits at constant speed by harmonic balance in the rotor's phase.

A steady motion repeats with the rotor. Without gravity it even repeats after half a revolution, x and y with their
sign turned: x, y hold odd orders of the rotor's phase, θ3, θ4 even ones. The unknowns are the Fourier coefficients
that N equally spaced phases of half a revolution resolve (2N of a whole one with gravity); the forces are evaluated at
those phases and transformed back. Newton's method solves the balance, with the exact Jacobian of the compiled kernel.
No time step and no stability limit: the stiffest damping and the slowest speed cost the same as the nominal rig. The
error falls faster than any power of N; N is doubled until the orbit no longer moves.
"""

# pyright: reportMissingParameterType=false
# Compiled functions: numba takes their types from the arguments, and their docstrings tell them.

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dynamics.equations.kernels import BX, BY, FA, FB, GRAVITY, jacobian, rates
from dynamics.equations.parameters import RotorParameters

_FIRST, _LARGEST = 8, 256  # phases per half revolution
_ITERATIONS = 25
_OF_BOW = 1e-3  # of a bow: an orbit below is none
_LONGEST_TURN = 0.3  # rad: Newton's step of an angle is cut to this


@dataclass(frozen=True)
class Orbit:
    """One periodic motion.

    Attributes:
        states: shape (n, 8), at n equally spaced phases ψ_j = 2πj/n of a whole revolution.
        coarse_states: the same orbit from half as many phases, shape (n/2, 8).
        angle_error_rad, position_error_m: bounds on the error of the angles and of x, y, from doubling the number of
            phases and from Newton's last step.
    """

    states: NDArray[np.floating]
    coarse_states: NDArray[np.floating]
    angle_error_rad: float
    position_error_m: float


@njit(cache=True, error_model="numpy")
def _forces(states, phase, speed, p, free_a, free_b, accelerations, slopes):
    """Accelerations (n, 4) and their derivatives by the state (n, 4, 8) at n states and phases."""
    out = np.empty(8)
    full = np.empty((8, 8))
    for j in range(len(states)):
        rates(states[j], phase[j], speed, 0.0, p, free_a, free_b, out)
        jacobian(states[j], phase[j], speed, 0.0, p, free_a, free_b, full)
        for i in range(4):  # a slice assignment takes numba two seconds more to compile
            accelerations[j, i] = out[4 + i]
            for k in range(8):
                slopes[j, i, k] = full[4 + i, k]


@dataclass(frozen=True)
class _Basis:
    """Trigonometric functions at n phases: values and first derivative (n, n), transform (n, n), orders (n,)."""

    value: NDArray[np.floating]
    slope: NDArray[np.floating]
    transform: NDArray[np.floating]
    order: NDArray[np.floating]


def _basis(phase: NDArray[np.floating], orders: NDArray[np.integer]) -> _Basis:
    """cos and sin of the given orders at equally spaced phases; the highest sine, which vanishes there, left out."""
    n = len(phase)
    columns, slopes, degree = [], [], []
    for k in orders:
        columns.append(np.cos(k * phase))
        slopes.append(-k * np.sin(k * phase))
        degree.append(k)
        if k > 0 and len(columns) < n:
            columns.append(np.sin(k * phase))
            slopes.append(k * np.cos(k * phase))
            degree.append(k)
    value = np.column_stack(columns)
    transform = value.T / np.sum(value**2, axis=0)[:, None]  # the columns are orthogonal
    return _Basis(value, np.column_stack(slopes), transform, np.array(degree, float))


class _Grid:
    """Phases and bases of one resolution; half a revolution where the motion has that symmetry."""

    def __init__(self, half: int, symmetric: bool) -> None:
        self.symmetric = symmetric
        self.n = half if symmetric else 2 * half
        self.phase = np.pi * np.arange(self.n) / half
        if symmetric:
            odd, even = np.arange(1, half, 2), np.arange(0, half + 1, 2)
            self.position, self.angle = _basis(self.phase, odd), _basis(self.phase, even)
        else:
            self.position = self.angle = _basis(self.phase, np.arange(half + 1))

    def whole(self, states: NDArray[np.floating]) -> NDArray[np.floating]:
        """States over a whole revolution from those over the grid's span."""
        if not self.symmetric:
            return states
        return np.concatenate([states, states * [-1, -1, 1, 1, -1, -1, 1, 1]])

    def coefficients(self, positions: NDArray[np.floating]) -> NDArray[np.floating]:
        """Coefficients (n, 4) of positions (m, 4) sampled over a whole revolution, interpolated as need be."""
        m = len(positions)
        spectrum = np.fft.rfft(positions, axis=0) / m
        found = np.zeros((self.n, 4))
        for c, basis in enumerate((self.position, self.position, self.angle, self.angle)):
            seen: set[int] = set()
            for row, k in enumerate(basis.order.astype(int)):
                if k < len(spectrum):
                    twice = 1.0 if k == 0 or 2 * k == m else 2.0
                    found[row, c] = -twice * spectrum[k, c].imag if k in seen else twice * spectrum[k, c].real
                seen.add(k)
        return found


def coarse_orbit(
    parameters: RotorParameters,
    speed_rad_s: float,
    guess: NDArray[np.floating],
    released: tuple[bool, bool] = (True, True),
) -> NDArray[np.floating] | None:
    """The orbit at the lowest resolution, enough to tell it from others.

    Args:
        guess: as for periodic_orbit.
    Returns:
        States over a whole revolution, shape (16, 8); None when Newton's method does not converge.
    """
    packed, free = _frictionless(parameters, released)
    grid = _Grid(_FIRST, packed[GRAVITY] == 0.0)
    solved = _newton(grid, speed_rad_s, packed, free, grid.coefficients(guess))
    return None if solved is None else grid.whole(solved[0])


def _frictionless(
    parameters: RotorParameters, released: tuple[bool, bool]
) -> tuple[NDArray[np.floating], tuple[bool, ...]]:
    """Packed parameters without dry friction, and which pendulums are there and free."""
    packed = parameters.packed()
    packed[FA] = packed[FB] = 0.0
    return packed, tuple(bool(r and q.present) for r, q in zip(released, (parameters.a, parameters.b), strict=True))


def periodic_orbit(
    parameters: RotorParameters,
    speed_rad_s: float,
    guess: NDArray[np.floating],
    accuracy: float,
    released: tuple[bool, bool] = (True, True),
) -> Orbit | None:
    """The periodic orbit that Newton's method reaches from a guess.

    Dry friction is left out: it turns an orbit into a band of resting poses (see dynamics.steady.steady_motions).

    Args:
        guess: positions x, y (m), θ3, θ4 (rad) at equally spaced phases of a whole revolution, shape (n, 4).
        accuracy: wanted error of the angles (rad), and of x, y relative to the orbit's size.
    Returns:
        None when the iteration does not converge.
    """
    packed, free = _frictionless(parameters, released)
    positions, before, half = guess, None, _FIRST
    while half <= _LARGEST:
        grid = _Grid(half, packed[GRAVITY] == 0.0)
        solved = _newton(grid, speed_rad_s, packed, free, grid.coefficients(positions))
        if solved is None:
            return None
        whole = grid.whole(solved[0])
        if before is not None:
            size = max(float(np.max(np.abs(whole[:, :2]))), _least_size(packed))
            change = np.max(np.abs(whole[::2, :4] - before[:, :4]), axis=0)
            angle = float(max(change[2:])) + 2 * solved[1]
            position = float(max(change[:2])) + 2 * solved[1] * size
            if angle <= accuracy and position <= accuracy * size:
                return Orbit(whole, before, angle, position)
        before, positions = whole, whole[:, :4]
        half *= 2
    return None


def _least_size(packed: NDArray[np.floating]) -> float:
    """What x, y are held against at least, m: pendulums that balance a bow leave the disk at rest."""
    return _OF_BOW * float(np.hypot(packed[BX], packed[BY]))


def _newton(
    grid: _Grid, speed: float, packed: NDArray[np.floating], free: tuple[bool, ...], start: NDArray[np.floating]
) -> tuple[NDArray[np.floating], float] | None:
    """Newton's method on the balance of Fourier coefficients.

    Args:
        start: coefficients of x, y, θ3, θ4, shape (n, 4).
    Returns:
        States (n, 8) over the grid and the last step's size (rad, and of x, y relative to the orbit), or None.
    """
    n = grid.n
    kept = [0, 1] + [2 + i for i in range(2) if free[i]]
    bases = (grid.position, grid.position, grid.angle, grid.angle)
    c = start.copy()
    acceleration, slope = np.empty((n, 4)), np.empty((n, 4, 8))
    previous = np.inf
    for _ in range(_ITERATIONS):
        states = _states(c, bases, speed)
        _forces(states, grid.phase, speed, packed, float(free[0]), float(free[1]), acceleration, slope)
        size = max(float(np.max(np.abs(c[:, :2]))), _least_size(packed)) or 1.0
        unit = np.array([size, size, 1.0, 1.0])
        matrix, residual = _balance(c, bases, kept, speed, acceleration, slope, unit)
        step = _solved(matrix, -residual)
        if step is None:
            return None
        moves = step.reshape(len(kept), n)
        turn = float(np.max(np.sum(np.abs(moves[2:]), axis=1))) if len(kept) > 2 else 0.0
        cut = min(1.0, _LONGEST_TURN / turn) if turn > 0 else 1.0
        c[:, kept] += cut * moves.T * unit[kept]
        largest = float(np.max(np.sum(np.abs(moves), axis=1)))
        if cut == 1.0 and (largest < 1e-14 or (largest < 1e-8 and largest > 0.1 * previous)):
            return _states(c, bases, speed), largest
        previous = largest
    return None


def _states(c: NDArray[np.floating], bases: tuple[_Basis, ...], speed: float) -> NDArray[np.floating]:
    """States (n, 8) of the coefficients (n, 4) at the grid's phases."""
    values = [basis.value @ c[:, i] for i, basis in enumerate(bases)]
    slopes = [speed * (basis.slope @ c[:, i]) for i, basis in enumerate(bases)]
    return np.column_stack([*values, *slopes])


def _balance(
    c: NDArray[np.floating], bases: tuple[_Basis, ...], kept: list[int], speed: float,
    acceleration: NDArray[np.floating], slope: NDArray[np.floating], unit: NDArray[np.floating],
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:  # fmt: skip
    """Newton matrix and residual of ω² u″ − acceleration = 0 in Fourier coefficients, in units of `unit`."""
    n = len(c)
    matrix = np.empty((len(kept) * n, len(kept) * n))
    residual = np.empty(len(kept) * n)
    for r, i in enumerate(kept):
        rows = slice(r * n, (r + 1) * n)
        curvature = -((speed * bases[i].order) ** 2)
        residual[rows] = (curvature * c[:, i] - bases[i].transform @ acceleration[:, i]) / unit[i]
        for q, j in enumerate(kept):
            change = slope[:, i, j][:, None] * bases[j].value + slope[:, i, 4 + j][:, None] * (speed * bases[j].slope)
            block = -(bases[i].transform @ change)
            if i == j:
                block[np.diag_indices(n)] += curvature
            matrix[rows, q * n : (q + 1) * n] = block * (unit[j] / unit[i])
    return matrix, residual


def _solved(matrix: NDArray[np.floating], right: NDArray[np.floating]) -> NDArray[np.floating] | None:
    """Solution of a linear system with its rows brought to one size first; None when singular."""
    size = np.max(np.abs(matrix), axis=1)
    if not np.all(np.isfinite(size)) or np.any(size == 0):
        return None
    try:
        found = np.linalg.solve(matrix / size[:, None], right / size)
    except np.linalg.LinAlgError:
        return None
    return found if np.all(np.isfinite(found)) else None

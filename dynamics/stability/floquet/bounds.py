"""Error bounds of eigenvalues from the error of the matrix: first and second order, and clusters."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.compiled_code import compiled

_ROUNDING = float(np.finfo(float).eps)
_COARSE, _BY_CHANCE = 1e-4, 1 / 16
_SEPARATE = 0.25  # ratio of coupling to gap below which an eigenvalue is treated as separate
_MAX_ROUNDS, _MAX_UNIT = 100, 2.0**500  # of balancing; of one factor


def eigenvalues_with_bounds(matrix: Array, change: Array, roundings: float) -> tuple[Complex, Array]:
    """Eigenvalues of a matrix with a bound on the error of each.

    In the basis of the eigenvectors X the error matrix is G = X⁻¹ E X. An eigenvalue moves by G_ii at first and
    Σ_j G_ij G_ji/(σ_i − σ_j) at second order. If a neighbour is nearer than the coupling to it (nearly defective
    pairs), the bound is the k-th root of the coupling times the gaps, as in a Jordan block. The effect of rounding is
    the same in all units (a power of two does not change the rounding of sums and products), so it is bounded in the
    units that balance the matrix.

    Args:
        matrix: shape (n, n), finite.
        change: error matrix with sign (difference of two resolutions), shape (n, n).
        roundings: accumulated rounding errors, in units of eps of the balanced matrix.
    Returns:
        Eigenvalues, shape (n,), largest modulus first, and bounds, shape (n,).
    """
    n = len(matrix)
    scaled, moved, unit = np.empty((n, n)), np.empty((n, n)), np.empty(n)
    _in_balancing_units(np.ascontiguousarray(matrix, float), np.ascontiguousarray(change, float), unit, scaled, moved)
    values, right = np.linalg.eig(scaled)
    order = np.argsort(-np.abs(values), kind="stable")
    values, right = values[order], right[:, order]
    bounds = np.empty(n)
    try:
        left = np.linalg.inv(right)
    except np.linalg.LinAlgError:  # usual: a defective matrix; the bound of the whole spectrum is used
        left = np.full((n, n), np.nan)
    own, inverse, basis = (np.ascontiguousarray(m, np.complex128) for m in (values, left, right))
    if not _moves(own, inverse, basis, scaled, moved, roundings * _ROUNDING, bounds):
        spread = roundings * _ROUNDING * (np.abs(scaled) + np.linalg.norm(scaled) / n)
        bounds[:] = _whole_spectrum(scaled, np.asarray(np.abs(moved) + spread, np.float64))
    return values, bounds


def balancing_units(size: Array) -> Array:
    """Units of the states, powers of two, in which rows and columns of a matrix have similar norms, shape (n,).

    Args:
        size: absolute values of the matrix, shape (n, n); the diagonal is ignored.
    """
    unit = np.empty(len(size))
    _balance(np.array(size, float), unit)
    return unit


@compiled
def _balance(size: Array, unit: Array) -> None:
    """Write units in which columns and rows of |A| have similar norms to unit (n,); scale size (n, n) with them.

    Source: E. E. Osborne, Journal of the ACM 7 (1960) 338, with powers of two (B. N. Parlett, C. Reinsch, Numerische
    Mathematik 13 (1969) 293).
    """
    n = len(unit)
    for i in range(n):  # numba compiles a slice assignment slowly
        unit[i] = 1.0
    for _ in range(_MAX_ROUNDS):
        settled = True
        for i in range(n):
            column, row = 0.0, 0.0
            for j in range(n):
                if j != i:
                    column += size[j, i] * size[j, i]
                    row += size[i, j] * size[i, j]
            column, row = np.sqrt(column), np.sqrt(row)
            if not (0.0 < column < np.inf and 0.0 < row < np.inf):
                continue
            factor, before = 1.0, column + row
            while column < 0.5 * row and factor < _MAX_UNIT:
                factor, column, row = 2.0 * factor, 2.0 * column, 0.5 * row
            while row < 0.5 * column and factor > 1.0 / _MAX_UNIT:
                factor, column, row = 0.5 * factor, 0.5 * column, 2.0 * row
            if column + row < 0.95 * before:
                settled = False
                unit[i] *= factor
                for j in range(n):
                    size[i, j] /= factor
                    size[j, i] *= factor
        if settled:
            return


@compiled
def _in_balancing_units(matrix: Array, change: Array, unit: Array, scaled: Array, moved: Array) -> None:
    """Write matrix and change, in the units that balance the matrix, to scaled and moved; write the units to unit."""
    n = len(unit)
    for i in range(n):
        for j in range(n):
            scaled[i, j] = abs(matrix[i, j])
    _balance(scaled, unit)
    for i in range(n):
        for j in range(n):
            factor = unit[j] / unit[i]
            scaled[i, j], moved[i, j] = matrix[i, j] * factor, change[i, j] * factor


@compiled(part=True)
def _couple(left: Complex, right: Complex, matrix: Array, change: Array, rounding: float, coupling: Array) -> bool:
    """Write bounds on |G| to coupling (n, n). Returns whether they are finite.

    Args:
        left, right: inverse and matrix of the eigenvectors.
        matrix, change: in balancing units.
        rounding: relative rounding error of the matrix.
    """
    n = len(coupling)
    norm = 0.0
    for i in range(n):
        for j in range(n):
            norm += matrix[i, j] * matrix[i, j]
    norm = np.sqrt(norm)
    through, spread = np.empty(n, np.complex128), np.empty(n)
    for i in range(n):
        whole = 0.0
        for j in range(n):
            through[j], spread[j] = 0.0, 0.0
        for k in range(n):
            share = abs(left[i, k])
            whole += share * share
            for j in range(n):
                through[j] += left[i, k] * change[k, j]
                spread[j] += share * (rounding * (abs(matrix[k, j]) + norm / n))
        whole = np.sqrt(whole)
        for j in range(n):
            known, unknown, length = 0j, 0.0, 0.0
            for k in range(n):
                size = abs(right[k, j])
                known += through[k] * right[k, j]
                unknown += spread[k] * size
                length += size * size
            # eig has an error of a few roundings of the matrix's norm, in every direction
            coupling[i, j] = abs(known) + unknown + 2 * _ROUNDING * norm * whole * np.sqrt(length)
            if not np.isfinite(coupling[i, j]):
                return False
    return True


@compiled
def _moves(
    values: Complex, left: Complex, right: Complex, matrix: Array, change: Array, rounding: float, bounds: Array
) -> bool:
    """Write bounds on the moves of all eigenvalues to bounds (n,). False if only the bound of the spectrum applies."""
    n = len(values)
    coupling, gaps = np.empty((n, n)), np.empty(n - 1)
    if not _couple(left, right, matrix, change, rounding, coupling):
        return False
    for i in range(n):
        bounds[i] = _moved(values, coupling, i, gaps)
        by_chance = 0.0
        for j in range(n):
            if j != i:
                by_chance = max(by_chance, np.sqrt(coupling[i, j] * coupling[j, i]))
        # one entry of G is not reliable while the others are so large that the method is not yet in its asymptotic
        # range: two coarse resolutions may agree by chance
        if by_chance > _COARSE:
            bounds[i] += _BY_CHANCE * by_chance
    return True


@compiled(part=True)
def _moved(values: Complex, coupling: Array, i: int, gaps: Array) -> float:
    """Bound on the move of one eigenvalue; gaps (n − 1,) is scratch.

    |G_ii| + 2 Σ_j |G_ij G_ji|/|σ_i − σ_j| as long as |G_ij G_ji|^½ is under a quarter of each gap. Otherwise, with the
    gaps g_1 ≤ g_2 ≤ … and the largest coupling s, 2(k+1) (s g_1 ⋯ g_k)^{1/(k+1)} for the first k at which that is
    smaller than 2 g_{k+1}: the root that a Jordan block of size k + 1 causes.
    """
    n, own = len(values), coupling[i, i]
    second, strength, apart, count = 0.0, own, True, 0
    for j in range(n):
        if j == i:
            continue
        gap, mutual = abs(values[j] - values[i]), coupling[i, j] * coupling[j, i]
        left = gap - own - coupling[j, j]  # gap after first-order moves
        if mutual > (_SEPARATE * left) ** 2 or (left <= 0 and mutual != 0):
            apart = False
        if left > 0:
            second += mutual / left
        strength = max(strength, np.sqrt(mutual))
        place = count
        while place > 0 and gaps[place - 1] > gap:
            gaps[place] = gaps[place - 1]
            place -= 1
        gaps[place] = gap
        count += 1
    if apart:
        return own + 2 * second
    product = strength
    for k in range(n - 1):
        bound = 2 * (k + 1) * product ** (1 / (k + 1))
        if bound < 2 * gaps[k]:
            return bound
        product *= max(gaps[k], _ROUNDING * strength)
    return 2 * n * product ** (1 / n)


def _whole_spectrum(matrix: Array, error: Array) -> float:
    """Elsner's bound, for any matrix: (‖A‖ + ‖A + E‖)^(1 − 1/n) ‖E‖^(1/n)."""
    n, norm = len(matrix), float(np.linalg.norm(matrix))
    size = float(np.linalg.norm(error)) + _ROUNDING * norm
    return (2 * norm + size) ** (1 - 1 / n) * size ** (1 / n)

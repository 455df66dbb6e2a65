"""Multipliers over one revolution with a bound on their error, by any of the methods."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.equations.periodic_matrix import PeriodicMatrix
from dynamics.errors import NotConverged, OutsideDomain
from dynamics.stability.floquet.bounds import balancing_units, eigenvalues_with_bounds
from dynamics.stability.floquet.choice import BUDGET_US, METHODS, FloquetMethod, plans
from dynamics.stability.floquet.neutral import without_neutral
from rig_basics.texts import number_of

FINEST, COARSEST = 1e-13, 0.1
_ROUNDING = np.finfo(float).eps
_SHARED = 32 * _ROUNDING  # rounding of the matrix itself, which is common to both compared runs


@dataclass(frozen=True)
class Multipliers:
    """Floquet multipliers of one steady motion.

    Attributes:
        values: complex, shape (n,), over one revolution, largest modulus first.
        errors: bounds on |error| of each value, shape (n,).
        method: method of the result.
        why: method and reason for it, one line.
        steps: number of steps of the finer of the two compared runs; 0 for the autonomous closed form.
    """

    values: Complex
    errors: Array
    method: str
    why: str
    steps: int

    @property
    def largest(self) -> float:
        """Largest modulus."""
        return float(abs(self.values[0]))

    @functools.cached_property
    def error_estimate(self) -> float:
        """Bound on the error of the largest modulus."""
        moduli = np.abs(self.values)
        highest = float((moduli + self.errors).max())
        lowest = float((moduli - self.errors).max())
        rounding = 4 * _ROUNDING * max(1.0, self.largest)  # rounding of powers and moduli
        return max(highest - self.largest, self.largest - lowest) + rounding


def balanced(matrix: PeriodicMatrix) -> PeriodicMatrix:
    """The matrix in scaled coordinates with rows and columns of similar size (powers of two: no rounding)."""
    unit = balancing_units(np.abs(matrix.harmonics).sum(axis=0))
    return PeriodicMatrix(matrix.harmonics * (unit / unit[:, None]), matrix.speed_rad_s, matrix.turn)


def floquet_multipliers(matrix: PeriodicMatrix, accuracy: float = 1e-8, method: str | None = None) -> Multipliers:
    """Multipliers of δẏ = A(ψ) δy over one revolution.

    Args:
        matrix: A(ψ) along the motion.
        accuracy: bound on the error of the largest modulus, relative to max(1, largest modulus); 1e-13 … 0.1.
        method: one of METHODS, or "autonomous". None: the cheapest suitable method.
    Raises:
        OutsideDomain: accuracy or method outside the permitted values.
        NotConverged: the bound cannot be met.
    """
    if not FINEST <= accuracy <= COARSEST:
        raise OutsideDomain(f"accuracy must lie in {FINEST:g} … {COARSEST:g}, got {accuracy!r}")
    if method is not None and method != "autonomous" and method not in METHODS:
        raise OutsideDomain(f"method must be one of autonomous, {', '.join(METHODS)}, got {method!r}")
    scaled = balanced(matrix)
    still = scaled if scaled.constant else scaled.seen_from_rotor
    if method == "autonomous" and still is None:
        raise OutsideDomain("method 'autonomous' needs a constant matrix; this one depends on the phase")
    use_still = still is not None and method in (None, "autonomous")
    rest, ones = without_neutral(still if use_still and still is not None else scaled)
    if use_still:
        found = _autonomous(rest)
        if not np.all(np.isfinite(found.values)):
            raise _overflow("autonomous")
        if _met(found, accuracy) or method == "autonomous":
            return _with_ones(_checked(found, accuracy), ones)
    return _with_ones(_first_successful(rest, accuracy, plans(rest, accuracy, method)), ones)


def _with_ones(found: Multipliers, ones: int) -> Multipliers:
    """The multipliers with those of exactly 1 added again."""
    if ones == 0:
        return found
    values = np.append(found.values, np.ones(ones))
    errors = np.append(found.errors, np.full(ones, _ROUNDING))
    order = np.argsort(-np.abs(values), kind="stable")
    return dataclasses.replace(found, values=values[order], errors=errors[order])


def _first_successful(matrix: PeriodicMatrix, accuracy: float, candidates: list[FloquetMethod]) -> Multipliers:
    """Result of the first plan that meets the accuracy within the budget. Otherwise the last failure is raised."""
    failure: NotConverged | None = None
    left = BUDGET_US
    for chosen in candidates:
        if failure is not None and chosen.cost_us > left:
            continue
        try:
            found, spent = _converged(matrix, accuracy, chosen, left)
        except NotConverged as error:
            failure, spent = error, chosen.cost_us
        else:
            if _met(found, accuracy):
                return found
            failure = _missed(found, accuracy)
        left -= spent
    raise failure or NotConverged("no method to try")


def _autonomous(matrix: PeriodicMatrix) -> Multipliers:
    """exp(2πλ/ω) from the eigenvalues of the constant matrix."""
    constant = matrix.harmonics[0].real * (2 * np.pi / matrix.speed_rad_s)
    exponents, moved = eigenvalues_with_bounds(constant, np.zeros_like(constant), 4.0)
    with np.errstate(over="ignore", under="ignore"):
        values = np.exp(exponents)
        errors = np.abs(values) * np.expm1(np.minimum(moved, 700.0)) + _SHARED * np.maximum(1.0, np.abs(values))
    order = np.argsort(-np.abs(values), kind="stable")
    why = "autonomous: the equations are constant in this frame, exp(2πλ/ω) is exact"
    return Multipliers(values[order], errors[order], "autonomous", why, 0)


def _met(found: Multipliers, accuracy: float) -> bool:
    return bool(np.isfinite(found.error_estimate)) and found.error_estimate <= accuracy * max(1.0, found.largest)


def _checked(found: Multipliers, accuracy: float) -> Multipliers:
    if not _met(found, accuracy):
        raise _missed(found, accuracy)
    return found


def _overflow(how: str) -> NotConverged:
    return NotConverged(
        f"the motion overflows within one revolution ({how}), expected finite multipliers; if the equations really "
        "grow so fast, the state is unstable"
    )


def _missed(found: Multipliers, accuracy: float) -> NotConverged:
    return NotConverged(
        f"multipliers by the {found.method} method: error bound {found.error_estimate:.2g} of the largest modulus "
        f"{found.largest:.6g}, expected {accuracy:.2g} of max(1, largest); reduce the accuracy or use another method"
    )


def _converged(
    matrix: PeriodicMatrix, accuracy: float, chosen: FloquetMethod, budget_us: float
) -> tuple[Multipliers, float]:
    """Double the steps until the bound meets the accuracy, stops decreasing, or the budget is used up.

    Returns:
        The last result, whether or not it meets the accuracy, and its time by the cost model, µs.
    """
    steps, method = chosen.steps, chosen.method
    found: Multipliers | None = None
    stuck, spent = 0, steps * chosen.step_us
    with np.errstate(all="ignore"):
        coarse = method.monodromy(matrix, steps)
        earlier = coarse - method.monodromy(matrix, max(1, steps // 2)) if chosen.three else np.zeros_like(coarse)
        while stuck < 2 and (steps == chosen.steps or spent + 2 * steps * chosen.step_us <= budget_us):
            steps *= 2
            spent += steps * chosen.step_us
            fine = method.monodromy(matrix, steps)
            if np.isfinite(fine).all() and np.isfinite(coarse).all():
                change = _limited_by_order(fine - coarse, earlier, method.ORDER)
                before, found = found, _bounded(matrix, fine, change, steps, chosen)
                if _met(found, accuracy):
                    return found, spent
                stuck = stuck + 1 if before and found.error_estimate > 0.5 * before.error_estimate else 0
            earlier, coarse = (fine - coarse if chosen.three else earlier), fine
    if found is None:
        raise _overflow(f"{method.NAME} method, {number_of(steps, 'step')}")
    return found, spent


def _limited_by_order(change: Array, earlier: Array, order: int) -> Array:
    """Change between two resolutions, at least the expected change from the previous one by the method's order.

    A change that decreased by more passes through zero: the two resolutions agree by chance.
    """
    expected = earlier / 2**order
    return np.where(np.abs(change) >= np.abs(expected), change, expected)


def _bounded(matrix: PeriodicMatrix, fine: Array, change: Array, steps: int, chosen: FloquetMethod) -> Multipliers:
    """Multipliers over a revolution from the monodromy matrix of two resolutions."""
    roundings = 4 + chosen.step_roundings * steps + chosen.rate_roundings * chosen.fastest
    values, errors = eigenvalues_with_bounds(fine, change, roundings)
    if matrix.turn is not None:
        values, errors = values**2, (2 * np.abs(values) + errors) * errors
    errors = errors + _SHARED * np.maximum(1.0, np.abs(values))
    return Multipliers(values, errors, chosen.method.NAME, f"{chosen.method.NAME}: {chosen.why}", steps)

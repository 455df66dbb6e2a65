"""Selection of method and initial number of steps, by a cost model with measured constants."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dynamics.arrays import Complex
from dynamics.compiled_code import compiled
from dynamics.equations.periodic_matrix import PeriodicMatrix, evaluate
from dynamics.errors import NotConverged
from dynamics.stability.floquet import (
    chebyshev,
    commutator_free,
    explicit,
    hill,
    implicit,
    magnus,
    piecewise,
    single_pass,
)
from dynamics.stability.floquet.methods import MonodromyMethod, per_radian, span_rad
from dynamics.stability.floquet.quick_eigenvalues import eigenvalues

_ALL: tuple[MonodromyMethod, ...] = (
    explicit,
    magnus,
    commutator_free,
    implicit,
    chebyshev,
    hill,
    single_pass,
    piecewise,
)
METHODS: dict[str, MonodromyMethod] = {method.NAME: method for method in _ALL}
_EPS = float(np.finfo(float).eps)
_PHASES = 8  # phases at which the rates are computed
AUTOMATIC = (explicit.NAME, magnus.NAME, implicit.NAME, commutator_free.NAME)


@dataclass(frozen=True)
class _Cost:
    """Measured constants of one method.

    Attributes:
        step_us: time of a step with n = 8 and two harmonics, µs.
        harmonic_us: time of a step per additional harmonic, µs.
        error: e in error ≈ e · (rate × span) · (rate × step)^order for a rate that does not decay in the span.
        longest: largest permitted rate × step.
        fewest: smallest number of steps.
        step_roundings, rate_roundings: accumulated rounding errors per step, and per unit of fastest rate × span.
        three: whether a third, coarser resolution is compared, because two may agree by chance.
    """

    step_us: float
    harmonic_us: float = 0.0
    error: float = 1.0
    longest: float = math.inf
    fewest: int = 4
    step_roundings: float = 1.0
    rate_roundings: float = 0.0
    three: bool = False


# One core of an AMD EPYC (Zen 4), November 2026: time of monodromy() over 10³ … 10⁵ steps; error constants from
# Type I of the nominal rig without suspension damping at Ω = 0.001 … 0.8 against runs of twice the steps; roundings
# from runs with a million steps and with rates of 10⁵ per span against a reference in 80 bits, times two.
_COSTS = {
    explicit.NAME: _Cost(2.1, 0.2, 1.6e-8, 2.5, 4, 0.1, 0.02),
    magnus.NAME: _Cost(3.4, 0.2, 1.0, 6.0, 12, 0.25, 0.25),
    implicit.NAME: _Cost(15.0, 0.3, 7e-7, 4.0, 4, 1.5, 0.0),
    commutator_free.NAME: _Cost(6.0, 0.12, 1e-6, math.inf, 12, 1.0, 10.0, True),
    chebyshev.NAME: _Cost(300.0, step_roundings=30.0),
    hill.NAME: _Cost(2000.0, step_roundings=10.0, rate_roundings=1.0),
    single_pass.NAME: _Cost(300.0, step_roundings=10.0, rate_roundings=10.0),
    piecewise.NAME: _Cost(3.0, rate_roundings=10.0),
}
# Magnus: error ≈ (slow + fast · (rate × span)^power) · (phase per step)^6. A constant part is integrated exactly,
# independent of its rate, so at one phase per step the error grows with less than the sixth power of the rate.
_MAGNUS_SLOW, _MAGNUS_FAST, _MAGNUS_POWER = 0.3, 1.5e-8, 3.6
# Commutator-free: a step near half a period of a fast mode resonates with it; two resolutions can agree by chance.
_COMMUTATOR_FREE_SWING = 2.0  # rad of the fastest oscillation, damped or not, in the coarser run's step
_MAX_DECAY = 35.0  # decay exponent over the span above which a mode is negligible (e^−35 = 6e-16)
BUDGET_US = 1.4e6  # computing time of one call, µs


class FloquetMethod(NamedTuple):
    """A method with the coarser of its first two numbers of steps, and the reason.

    Attributes:
        step_us: expected time of a step, µs.
        step_roundings, rate_roundings, fastest: rounding error in units of eps: steps and fastest rate × span.
        three: whether a third resolution, with half as many steps, is compared with the first two.
    """

    method: MonodromyMethod
    steps: int
    why: str
    step_us: float
    step_roundings: float
    rate_roundings: float
    fastest: float
    three: bool

    @property
    def cost_us(self) -> float:
        """Expected time of the first resolutions, µs."""
        return (3.5 if self.three else 3.0) * self.steps * self.step_us


@compiled
def _eigenvalues_along(series: Complex, span: float, found: Complex) -> bool:
    """Write eigenvalues of A(ψ) at equally spaced phases of the span to found (phases, n); whether all converged."""
    phases, n = found.shape
    a = np.empty((n, n))
    for i in range(phases):
        evaluate(series, span * i / phases, a)
        if not eigenvalues(a, found[i]):
            return False
    return True


def _rates(matrix: PeriodicMatrix) -> Complex:
    """Eigenvalues of A(ψ) at eight phases times the span: growth and phase of each mode over the span."""
    span = span_rad(matrix)
    found = np.empty((_PHASES, matrix.dimension), np.complex128)
    if not _eigenvalues_along(per_radian(matrix), span, found):
        found[:] = [np.linalg.eigvals(matrix.at(phase)) for phase in span / _PHASES * np.arange(_PHASES)]
        found /= matrix.speed_rad_s
    return found.ravel() * span


@compiled
def _max_steps(
    rates: Complex, accuracy: float, error: float, order: float, longest: float, limits_decayed: bool, swing: float
) -> float:
    """Number of steps required by the most demanding rate.

    Args:
        rates: growth and phase over the span.
        error, order, longest: constants of the method; see _Cost.
        limits_decayed: whether a negligible mode still limits the step by `longest`.
        swing: largest phase of an oscillation per step, damped or not, rad.
    """
    most = 0.0
    for rate in rates:
        size = max(abs(rate), 1e-9)
        if rate.real > -_MAX_DECAY:
            left = np.exp(min(2 * rate.real, 0.0))
            most = max(most, size / min((accuracy / (error * size * left)) ** (1.0 / order), longest))
        elif limits_decayed:
            most = max(most, size / longest)
        most = max(most, abs(rate.imag) / swing)
    return most


def _steps(name: str, rates: Complex, fastest: float, accuracy: float) -> int:
    """Number of steps for which the coarser run is expected to meet the accuracy; fastest: the largest |rate|."""
    cost, order = _COSTS[name], METHODS[name].ORDER
    if name not in AUTOMATIC:
        return cost.fewest
    if name == magnus.NAME:
        size = max(fastest, 1e-9)
        turned = (_MAGNUS_SLOW + _MAGNUS_FAST * size**_MAGNUS_POWER) / accuracy
        return max(cost.fewest, math.ceil(size / cost.longest), math.ceil(np.pi * turned ** (1.0 / order)))
    limits_decayed = name == explicit.NAME  # in the other methods a negligible mode does not limit the step
    swing = _COMMUTATOR_FREE_SWING if name == commutator_free.NAME else math.inf
    needed = _max_steps(rates, accuracy, cost.error, float(order), cost.longest, limits_decayed, swing)
    return max(cost.fewest, math.ceil(needed))


def plans(matrix: PeriodicMatrix, accuracy: float, name: str | None = None) -> list[FloquetMethod]:
    """Suitable methods for a matrix, the cheapest first.

    Args:
        name: requested method of METHODS, or None.
    Raises:
        NotConverged: every method would take too many steps, or its rounding error would be too large.
    """
    rates = _rates(matrix)
    further = max(0, len(matrix.harmonics) - 3)
    fastest, swing = float(np.max(np.abs(rates))), float(np.max(np.abs(rates.imag)))
    why = f"fastest rate × span {fastest:.2g}, swing {swing:.2g} rad" if name is None else "requested"
    found: list[FloquetMethod] = []
    for candidate in (name,) if name else AUTOMATIC:
        cost = _COSTS[candidate]
        steps = _steps(candidate, rates, fastest, accuracy)
        step_us = cost.step_us + cost.harmonic_us * further
        if candidate == commutator_free.NAME:  # each doubling of rate × step adds one squaring
            step_us += 0.4 * max(0.0, math.log2(max(1.0, fastest / steps)))
        plan = FloquetMethod(
            METHODS[candidate], steps, why, step_us, cost.step_roundings, cost.rate_roundings, fastest, cost.three
        )
        rounding = _EPS * (2 * steps * cost.step_roundings + fastest * cost.rate_roundings)
        if plan.cost_us <= BUDGET_US and rounding <= accuracy:
            found.append(plan)
    if not found:
        raise NotConverged(
            f"rates × span up to {fastest:.3g} (swing {swing:.3g} rad) take more steps, or round more, than a result "
            f"of accuracy {accuracy:.2g} allows; reduce the accuracy or the stiffness ratio, or use a higher speed"
        )
    return sorted(found, key=lambda p: p.cost_us)

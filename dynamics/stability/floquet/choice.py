"""Which method, and how many steps to begin with: a cost model with measured constants."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.equations.linearised import PeriodicMatrix
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
from dynamics.stability.floquet.methods import MonodromyMethod, span_rad

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
AUTOMATIC = (explicit.NAME, magnus.NAME, implicit.NAME, commutator_free.NAME)


@dataclass(frozen=True)
class _Cost:
    """Measured figures of one method.

    Attributes:
        step_us: time of a step with n = 8 and two harmonics, µs.
        harmonic_us: time of a step per further harmonic, µs.
        error: e in error ≈ e · (rate × span) · (rate × step)^order for a rate that lives through the span.
        longest: largest rate × step at which the method works at all.
        fewest: steps to begin with.
        step_roundings, rate_roundings: rounding errors gathered per step, and per unit of fastest rate × span.
        three: whether two resolutions may agree by chance, so that a third, coarser one is held against them.
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
    explicit.NAME: _Cost(4.5, 0.7, 1.6e-8, 2.5, 4, 0.1, 0.02),
    magnus.NAME: _Cost(3.4, 0.2, 1.0, 6.0, 12, 0.25, 0.25),
    implicit.NAME: _Cost(15.0, 0.3, 7e-7, 4.0, 4, 1.5, 0.0),
    commutator_free.NAME: _Cost(6.0, 0.12, 1e-6, math.inf, 12, 1.0, 10.0, True),
    chebyshev.NAME: _Cost(300.0, step_roundings=30.0),
    hill.NAME: _Cost(2000.0, step_roundings=10.0, rate_roundings=1.0),
    single_pass.NAME: _Cost(300.0, step_roundings=10.0, rate_roundings=10.0),
    piecewise.NAME: _Cost(3.0, rate_roundings=10.0),
}
# Magnus: error ≈ (slow + fast · (rate × span)^power) · (phase per step)^6. What is constant is followed exactly,
# however fast, so at one phase per step the error grows with less than the sixth power of the rate (same runs).
_MAGNUS_SLOW, _MAGNUS_FAST, _MAGNUS_POWER = 0.3, 1.5e-8, 3.6
# Commutator-free: a step near half a turn of a fast mode resonates with it; two resolutions can then agree by chance.
_COMMUTATOR_FREE_SWING = 2.0  # rad of the fastest oscillation, damped or not, in the coarser run's step
_DEAD = 35.0  # decay exponent over the span beyond which a mode leaves nothing (e^−35 = 6e-16)
BUDGET_US = 1.4e6  # of one call


@dataclass(frozen=True)
class Plan:
    """A method with the coarser of its first two numbers of steps, and why it was taken.

    Attributes:
        step_us: expected time of a step, µs.
        step_roundings, rate_roundings, fastest: rounding error in units of eps: steps and fastest rate × span.
        three: whether a third resolution, of half as many steps, is held against the first two.
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


def _rates(matrix: PeriodicMatrix) -> NDArray[np.complexfloating]:
    """Eigenvalues of A(ψ) at eight phases times the span: growth and turns of each mode over the span."""
    span = span_rad(matrix)
    found = [np.linalg.eigvals(matrix.at(phase)) for phase in span / 8 * np.arange(8)]
    return np.concatenate(found) * (span / matrix.speed_rad_s)


def _steps(name: str, rates: NDArray[np.complexfloating], accuracy: float) -> int:
    """Steps for which the coarser run is expected to meet the accuracy."""
    cost, order = _COSTS[name], METHODS[name].ORDER
    if name not in AUTOMATIC:
        return cost.fewest
    size = np.maximum(np.abs(rates), 1e-9)
    living = rates.real > -_DEAD
    left = np.exp(np.clip(2 * rates.real, -2 * _DEAD, 0.0))
    length = (accuracy / (cost.error * size * left)) ** (1.0 / order)
    if name == magnus.NAME:
        fastest = float(np.max(size))
        turned = (_MAGNUS_SLOW + _MAGNUS_FAST * fastest**_MAGNUS_POWER) / accuracy
        return max(cost.fewest, math.ceil(fastest / cost.longest), math.ceil(np.pi * turned ** (1.0 / order)))
    if name in (implicit.NAME, commutator_free.NAME):  # what has died needs no steps
        needed = np.where(living, size / np.minimum(length, cost.longest), 0.0)
    else:
        needed = size / np.minimum(np.where(living, length, np.inf), cost.longest)
    if name == commutator_free.NAME:
        needed = np.maximum(needed, np.abs(rates.imag) / _COMMUTATOR_FREE_SWING)
    return max(cost.fewest, math.ceil(float(np.max(needed))))


def plans(matrix: PeriodicMatrix, accuracy: float, name: str | None = None) -> list[Plan]:
    """The methods worth trying for a matrix, cheapest first.

    Args:
        name: a method of METHODS that the caller insists on.
    Raises:
        NotConverged: every method would take too many steps, or round too much.
    """
    rates = _rates(matrix)
    further = max(0, len(matrix.harmonics) - 3)
    fastest, swing = float(np.max(np.abs(rates))), float(np.max(np.abs(rates.imag)))
    found: list[Plan] = []
    for candidate in (name,) if name else AUTOMATIC:
        cost = _COSTS[candidate]
        steps = _steps(candidate, rates, accuracy)
        step_us = cost.step_us + cost.harmonic_us * further
        if candidate == commutator_free.NAME:  # each doubling of rate × step is one more squaring
            step_us += 0.4 * max(0.0, math.log2(max(1.0, fastest / steps)))
        why = f"fastest rate × span {fastest:.2g}, swing {swing:.2g} rad" if name is None else "as asked"
        plan = Plan(
            METHODS[candidate], steps, why, step_us, cost.step_roundings, cost.rate_roundings, fastest, cost.three
        )
        rounding = _EPS * (2 * steps * cost.step_roundings + fastest * cost.rate_roundings)
        if plan.cost_us <= BUDGET_US and rounding <= accuracy:
            found.append(plan)
    if not found:
        raise NotConverged(
            f"rates × span up to {fastest:.3g} (swing {swing:.3g} rad) take more steps, or round more, than a result "
            f"of accuracy {accuracy:.2g} allows; ask for less accuracy, a higher speed or a smaller stiffness ratio"
        )
    return sorted(found, key=lambda p: p.cost_us)

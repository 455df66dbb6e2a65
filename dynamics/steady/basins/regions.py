# pyright: strict
"""Regions about a stable motion from which nothing returns: quadratic forms that every revolution makes smaller.

For a fixed point x of the once-a-revolution map P with the derivative M, Q = Σ (M/γ)ⁿᵀ (M/γ)ⁿ with a γ between M's
spectral radius and 1 gives V(δ) = δᵀ Q δ with V(M δ) ≤ γ² V(δ). On the nonlinear map V is asked at many states on
shells that grow until one of them does not come nearer. What the samples leave open is given away by the share of the
region that is used. Source: docs/theory/basins.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.steady.basins.turning import Turning

Array = NDArray[np.float64]

_SHELL = 1.25  # ratio of radii of neighbouring shells
_SHELLS = 60
_SAMPLES = 192  # on each shell
_FIRST_RAD = 1e-3  # largest deviation on the first shell, in the units of the state
_LARGEST_RAD = 2.0  # no region reaches farther: angles wrap
_SHRINK = 0.999  # what each sample's V must have shrunk by, at the most
_STRAIGHT = 0.02  # of V's root: how well the linear map must hold where it is used
_SEED = 20


@dataclass(frozen=True)
class Region:
    """A region about a stable motion.

    Attributes:
        form: Q with V = δᵀ Q δ = 1 on the rim, SI, shape (8, 8).
        turn_map: M, SI, shape (8, 8).
        straight: V below which δ goes on as M δ to two hundredths.
        samples: states at which V was seen to shrink.
    """

    form: Array
    turn_map: Array
    straight: float
    samples: int

    def near(self, units: Array, near_rad: float) -> float:
        """V below which no component differs by more than near_rad of its unit."""
        return near_value(self.form, units, near_rad)


def near_value(form: Array, units: Array, near_rad: float) -> float:
    """V below which no component differs by more than near_rad of its unit: max |δ_i|² = V (Q⁻¹)_ii."""
    moving = np.flatnonzero(np.diag(form) > 0)
    inverse = np.linalg.inv(form[np.ix_(moving, moving)] * np.outer(units[moving], units[moving]))
    return near_rad**2 / float(np.max(np.diag(inverse)))


def quadratic_form(turn_map: Array) -> Array:
    """Q = Σ (M/γ)ⁿᵀ (M/γ)ⁿ, γ² the spectral radius of M, by doubling, shape of M.

    Args:
        turn_map: M with a spectral radius below 1.
    """
    gamma = math.sqrt(max(float(np.max(np.abs(np.linalg.eigvals(turn_map)))), 0.25))
    power, found = turn_map / gamma, np.eye(len(turn_map))
    for _ in range(64):
        added = power.T @ found @ power
        found = found + added
        if np.max(np.abs(added)) <= 1e-12 * np.max(np.abs(found)):
            break
        power = power @ power
    return 0.5 * (found + found.T)


def attracting_region(turning: Turning, start: Array) -> Region | None:
    """The largest sampled region about a stable fixed point of the map; None where not even the smallest shrinks.

    Args:
        start: the fixed point, shape (8,).
    """
    free, units = turning.free, turning.units
    whole = turning.derivatives(start[None, :])[0]
    own = (whole * units[None, :] / units[:, None])[np.ix_(free, free)]
    form = quadratic_form(own)

    def placed(deviations: Array) -> Array:
        states = np.tile(start, (len(deviations), 1))
        states[:, free] += deviations * units[free]
        return states

    def deviation(states: Array) -> Array:
        return ((states - start) / units)[:, free]

    radius, straight, samples = grown(turning, form, placed, deviation, lambda d: d @ own.T)
    if radius == 0.0:
        return None
    full = np.zeros((8, 8))
    full[np.ix_(free, free)] = form / radius**2 / np.outer(units[free], units[free])
    return Region(full, whole, (straight / radius) ** 2, samples)


def grown(
    turning: Turning, form: Array, placed: Callable[[Array], Array], deviation: Callable[[Array], Array],
    straight_on: Callable[[Array], Array] | None,
) -> tuple[float, float, int]:  # fmt: skip
    """Radius of the largest shell up to which every sample came nearer, that up to which the linear map held, samples.

    Args:
        form: of deviations in units.
        placed: states (n, 8) at deviations (n, m); deviation: the way back.
        straight_on: deviations by the linear map, or None.
    """
    lower = np.linalg.cholesky(form)
    outward = np.linalg.inv(lower).T  # δ = outward ξ has V = |ξ|²
    largest = math.sqrt(float(np.max(np.sum(outward**2, axis=1))))
    rng, radius, passed, straight, samples = np.random.default_rng(_SEED), _FIRST_RAD / largest, 0.0, 0.0, 0
    axes = np.concatenate([np.eye(len(form)), -np.eye(len(form))])
    holds = straight_on is not None
    for _ in range(_SHELLS):
        if radius * largest > _LARGEST_RAD:
            break
        ways = rng.standard_normal((_SAMPLES, len(form)))
        ways = np.concatenate([axes, ways / np.linalg.norm(ways, axis=1)[:, None]])
        away = radius * ways @ outward.T
        moved = deviation(turning.after(placed(away)))
        value = np.sum((moved @ lower) ** 2, axis=1)
        if not np.all(value < _SHRINK * radius**2):  # nan counts as not nearer
            break
        passed, samples = radius, samples + len(ways)
        if holds and straight_on is not None:
            off = np.sum(((moved - straight_on(away)) @ lower) ** 2, axis=1)
            holds = bool(np.all(off < (_STRAIGHT * radius) ** 2))
            straight = radius if holds else straight
        radius *= _SHELL
    return passed, straight, samples

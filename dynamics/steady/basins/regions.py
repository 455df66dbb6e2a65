"""Attracting regions about a stable motion: quadratic forms that decrease with every revolution.

For a fixed point x of the once-a-revolution map P with the derivative M, Q = Σ (M/γ)ⁿᵀ (M/γ)ⁿ with γ between the
spectral radius of M and 1 gives V(δ) = δᵀ Q δ with V(M δ) ≤ γ² V(δ). For the nonlinear map, V is evaluated at many
states on growing shells, up to the shell on which a state does not approach: this is the core. Beyond it, shells are
added on which every sample, simulated further, ends in the core. Only a fraction of the region is used, as a margin for
states between the samples. Source: docs/theory/basins.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.steady.basins.turning import COARSE_RAD, RevolutionMap

_THOROUGH, _QUICK = (1.25, 60, 192), (1.6, 26, 40)  # ratio of neighbouring shells' radii, shells, samples on each
_FIRST_RAD = 1e-3  # largest deviation on the first shell, in the units of the state
_MAX_RAD = 2.0  # largest deviation of a region: angles are periodic
_SHRINK = 0.999  # largest ratio of V after and before a revolution for each sample
_STRAIGHT = 0.02  # relative error, in the root of V, up to which the linear map is used
_OUTER_SHELL, _OUTER_SHELLS, _OUTER_SAMPLES = 1.3, 24, 160  # ratio of radii, shells, samples beyond the core
_AT_A_TIME = 8  # revolutions between checks
_E_FOLDS, _MAX_REVOLUTIONS = 8.0, 1200  # time limit for a sample to reach the core: e-folds of the slowest multiplier
_SEED = 20


@dataclass(frozen=True)
class Region:
    """An attracting region about a stable motion.

    Attributes:
        form: Q with V = δᵀ Q δ = 1 on the rim, SI, shape (8, 8).
        turn_map: M, SI, shape (8, 8).
        straight: V below which M δ describes the motion within two per cent.
        samples: number of states at which V decreased.
    """

    form: Array
    turn_map: Array
    straight: float
    samples: int

    def near(self, units: Array, near_rad: float) -> float:
        """V below which no component deviates by more than near_rad of its unit."""
        return near_value(self.form, units, near_rad)


def near_value(form: Array, units: Array, near_rad: float) -> float:
    """V below which no component deviates by more than near_rad of its unit: max |δ_i|² = V (Q⁻¹)_ii."""
    moving = np.flatnonzero(np.diag(form) > 0)
    inverse = np.linalg.inv(form[np.ix_(moving, moving)] * np.outer(units[moving], units[moving]))
    return near_rad**2 / float(np.max(np.diag(inverse)))


def spectral_radius(matrix: Array) -> float:
    """Largest modulus of the eigenvalues."""
    values: Complex = np.linalg.eigvals(matrix).astype(np.complex128)
    return float(np.max(np.abs(values)))


def quadratic_form(turn_map: Array) -> Array:
    """Q = Σ (M/γ)ⁿᵀ (M/γ)ⁿ, γ² the spectral radius of M, by doubling; shape of M.

    Args:
        turn_map: M with a spectral radius below 1.
    """
    gamma = math.sqrt(max(spectral_radius(turn_map), 0.25))
    power, found = turn_map / gamma, np.eye(len(turn_map))
    for _ in range(64):
        added = power.T @ found @ power
        found = found + added
        if np.max(np.abs(added)) <= 1e-12 * np.max(np.abs(found)):
            break
        power = power @ power
    return 0.5 * (found + found.T)


def attracting_region(turning: RevolutionMap, start: Array, *, quick: bool = False) -> Region | None:
    """The largest sampled region about a stable fixed point of the map; None if the smallest shell is not attracted.

    Args:
        start: the fixed point, shape (8,).
        quick: fewer samples, and the core only.
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
        away = states - start
        away[:, 2:4] = (away[:, 2:4] + math.pi) % (2 * math.pi) - math.pi
        return (away / units)[:, free]

    core, straight, samples = _core(turning, form, placed, deviation, own, *(_QUICK if quick else _THOROUGH))
    if core == 0.0:
        return None
    radius = core
    if not quick:
        radius, more = _outer(turning, form, placed, deviation, core, _patience(own))
        samples += more
    full = np.zeros((8, 8))
    full[np.ix_(free, free)] = form / radius**2 / np.outer(units[free], units[free])
    return Region(full, whole, (straight / radius) ** 2, samples)


def _patience(own: Array) -> int:
    """Number of revolutions within which a sample must reach the core."""
    slowest = min(max(spectral_radius(own), 1e-3), 1.0 - 1e-9)
    return max(_AT_A_TIME, min(_MAX_REVOLUTIONS, math.ceil(-_E_FOLDS / math.log(slowest))))


def mirrored(region: Region) -> Region:
    """Region about the state in which A and B, two equal pendulums, are exchanged."""
    over = [0, 1, 3, 2, 4, 5, 7, 6]
    form, turn_map = (each[np.ix_(over, over)] for each in (region.form, region.turn_map))
    return Region(form, turn_map, region.straight, region.samples)


def _core(
    turning: RevolutionMap,
    form: Array,
    placed: Callable[[Array], Array],
    deviation: Callable[[Array], Array],
    own: Array,
    ratio: float,
    most: int,
    number: int,
) -> tuple[float, float, int]:
    """Radius up to which every sample approached, radius up to which the linear map holds, number of samples.

    Args:
        form: quadratic form of deviations in units.
        placed: states (n, 8) from deviations (n, m).
        deviation: deviations from states.
        own: linear map of deviations.
        ratio, most, number: ratio of neighbouring radii, number of shells, number of random samples on each.
    """
    shells, radius, straight, samples, holds = _Shells(form), 0.0, 0.0, 0, True
    for wanted in shells.radii(_FIRST_RAD / shells.reach, ratio, most):
        away = shells.on(wanted, number)
        moved = deviation(turning.after(placed(away), 1, COARSE_RAD))
        if not np.all(shells.values(moved) < _SHRINK * wanted**2):  # NaN counts as not approaching
            break
        radius, samples = wanted, samples + len(away)
        holds = holds and bool(np.all(shells.values(moved - away @ own.T) < (_STRAIGHT * wanted) ** 2))
        straight = wanted if holds else straight
    return radius, straight, samples


def _outer(
    turning: RevolutionMap,
    form: Array,
    placed: Callable[[Array], Array],
    deviation: Callable[[Array], Array],
    core: float,
    patience: int,
) -> tuple[float, int]:
    """Radius up to which every sample reached the core within `patience` revolutions, and number of samples."""
    shells, radius, samples = _Shells(form), core, 0
    for wanted in shells.radii(core * _OUTER_SHELL, _OUTER_SHELL, _OUTER_SHELLS):
        states = placed(shells.on(wanted, _OUTER_SAMPLES))
        number, done = len(states), 0
        while len(states) and done < patience:
            states = turning.after(states, _AT_A_TIME, COARSE_RAD)
            states = states[~(shells.values(deviation(states)) < core**2)]
            done += _AT_A_TIME
        if len(states):
            break
        radius, samples = wanted, samples + number
    return radius, samples


class _Shells:
    """Deviations on the shells δᵀ Q δ = r²: along the principal axes and at random."""

    def __init__(self, form: Array) -> None:
        self._lower = np.linalg.cholesky(form)
        self._outward = np.linalg.inv(self._lower).T  # δ = outward ξ has V = |ξ|²
        self.reach = math.sqrt(float(np.max(np.sum(self._outward**2, axis=1))))  # largest component for r = 1
        self._rng, self._own = np.random.default_rng(_SEED), len(form)
        self._axes = np.linalg.svd(self._outward)[2]

    def radii(self, first: float, ratio: float, most: int) -> list[float]:
        """Radii of the shells that do not exceed the largest deviation."""
        return [r for r in (first * ratio**i for i in range(most)) if r * self.reach <= _MAX_RAD]

    def on(self, radius: float, samples: int) -> Array:
        """Deviations on a shell."""
        ways = self._rng.standard_normal((samples, self._own))
        ways = np.concatenate([self._axes, -self._axes, ways / np.linalg.norm(ways, axis=1)[:, None]])
        return radius * ways @ self._outward.T

    def values(self, deviations: Array) -> Array:
        """δᵀ Q δ of each deviation."""

        return np.sum((deviations @ self._lower) ** 2, axis=1)

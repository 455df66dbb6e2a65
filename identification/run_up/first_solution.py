"""A passage's first solution: from start values, or about what ring-downs know of the suspension."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from identification.errors import FitFailed, NotIdentifiable
from identification.least_squares import Solution, solve_separable
from identification.run_up.bent_passage import BentPassage, KnownSuspension
from identification.run_up.choice import alike
from identification.run_up.design import design_at
from identification.run_up.forced_oscillator import Drive
from identification.run_up.model import (
    ANGLE,
    AXIS_PRIOR_STD,
    DELAYS,
    DRIFTS,
    OMEGAS,
    PARAMETERS,
    ZETAS,
    RunUpRecord,
    Structure,
    free_structure,
    run_up_blocks,
)
from identification.run_up.start import RunUpStart, run_up_starts

_EXCESS = 1.5  # χ²/dof at which other start values are tried
_TERMS_WIDE = 20.0  # standard deviations of a ring-down: what it knows of the terms counts once
_RATIO_STD = 0.1  # of the sensors' gains, ln: far beyond what calibration leaves
_ALIKE = 4.0  # one resonance as a start is worth a fit when it leaves at most so many times the best start's χ²
_TRIED = 6


@dataclass(frozen=True)
class Clocks:
    """How well the sensors' clocks agree with the phase's: 1 σ of delay (s) and of rate (relative), per sensor."""

    delay_std_s: float
    drift_std: tuple[float, float]

    @property
    def apart(self) -> bool:
        """Whether there is anything to find."""
        return self.delay_std_s > 0 or max(self.drift_std) > 0


def first_structure(drive: Drive, clocks: Clocks) -> Structure:
    """Both resonances, turned axes, offset and slope; clocks as far as they are apart."""
    prior, prior_std = np.zeros(PARAMETERS), np.zeros(PARAMETERS)
    # so wide that a passed resonance does not feel it; one that is not passed would wander off to infinity
    prior[list(OMEGAS)], prior_std[list(OMEGAS)] = np.log(drive.top_rad_s), 2.0
    prior[list(ZETAS)], prior_std[list(ZETAS)] = np.log(0.02), 3.0
    prior_std[ANGLE] = AXIS_PRIOR_STD
    # clocks that agree, and ripple, stay at zero unless the data ask for them
    prior_std[DELAYS], prior_std[DRIFTS] = clocks.delay_std_s, clocks.drift_std
    return free_structure(prior, prior_std, drift_order=1)


def about_known(
    record: RunUpRecord, structure: Structure, known: KnownSuspension, slow_roll: bool
) -> tuple[RunUpRecord, Structure, Solution]:
    """The fit with the suspension's terms, from what ring-downs have found."""
    structure = _with_terms(structure, known)
    record = replace(record, bent=BentPassage.of(record.drive, known.amplitude_m))
    start = np.r_[_theta(RunUpStart(known.omegas, known.zetas, known.angle_rad, 0.0)), known.terms, 0.0]
    solution = solve(record, structure, structure.project(start))
    if slow_roll and solution.chi2_per_dof > _EXCESS:  # what turns with the shaft at any speed bends the motion as well
        both, whole = replace(structure, run_out=True, bow=True), _afresh(record)
        other = solve(whole, both, structure.project(start))
        if other.chi2_per_dof < _EXCESS and other.minimum.converged:
            return whole, both, other
    return record, structure, solution


def from_starts(record: RunUpRecord, structure: Structure, slow_roll: bool) -> tuple[Structure, Solution]:
    """The best solution; further starts are tried as long as residuals exceed the noise.

    Directions that are alike have no axes: there the angle is left out, as it would wander along a valley.
    """
    starts = run_up_starts(record.channels, record.drive)
    equal = [s for s in starts if s.alike and s.cost < _ALIKE * starts[0].cost]
    if equal:
        straight = structure.without(ANGLE)
        solution = solve(record, straight, straight.project(_theta(equal[0])))
        good = solution.minimum.converged and solution.chi2_per_dof < _EXCESS
        if good and alike(design_at(record, straight, solution.minimum.theta)):
            return straight, solution
    best: Solution | None = None
    for start in _apart(record, starts):
        solution = solve(record, structure, structure.project(_theta(start)))
        if slow_roll and solution.chi2_per_dof > _EXCESS:  # what turns with the shaft at any speed may hide it
            wider = replace(structure, run_out=True, bow=True)
            other = solve(record, wider, solution.minimum.theta)
            if other.chi2_per_dof < _EXCESS and other.minimum.converged:
                return wider, other
        settled = solution.minimum.converged and solution.chi2_per_dof < _EXCESS  # noise is left, by whatever start
        if settled or best is None or solution.chi2_per_dof < best.chi2_per_dof:
            best = solution
        if settled:
            break
    if best is None:
        raise NotIdentifiable("neither sensor shows a resonance in this record; does the speed pass one?")
    if not best.minimum.converged or not np.all(np.isfinite(best.minimum.theta)):
        raise FitFailed(
            f"run-up: no convergence in {best.minimum.iterations} iterations, χ²/dof {best.chi2_per_dof:.3g}; "
            "is the phase the rotor's, and were the pendulums locked?"
        )
    return structure, best


def solve(record: RunUpRecord, structure: Structure, phi: np.ndarray, iterations: int = 40) -> Solution:
    """A structure's solution from φ."""
    return solve_separable(
        lambda p: run_up_blocks(record, structure, p), phi, structure.prior, structure.prior_std, iterations
    )


def _afresh(record: RunUpRecord) -> RunUpRecord:
    """The record without what an earlier fit has found of a bent passage."""
    assert record.bent is not None
    return replace(record, bent=BentPassage(record.bent.force, record.bent.amplitude_m), recent={})


def _with_terms(structure: Structure, known: KnownSuspension) -> Structure:
    """With the suspension's terms, where there are any, and the gains' ratio free in ranges that the data narrow."""
    value, std = np.r_[known.terms, 0.0], np.r_[_TERMS_WIDE * known.terms_std, _RATIO_STD]
    base = np.r_[structure.base, np.where(std > 0, 0.0, value)]
    spread = np.zeros((len(base), structure.spread.shape[1]))
    spread[:PARAMETERS] = structure.spread
    free = np.eye(len(base))[:, PARAMETERS:][:, std > 0]
    return replace(
        structure,
        base=base,
        spread=np.hstack([spread, free]),
        prior=np.r_[structure.prior, value[std > 0]],
        prior_std=np.r_[structure.prior_std, std[std > 0]],
    )


def _apart(record: RunUpRecord, starts: list[RunUpStart]) -> Iterator[RunUpStart]:
    """Starts with two resonances: the best one, and only when that is not enough a thorough search's."""
    apart = [s for s in starts if not s.alike]
    yield from apart[:1]
    thorough = run_up_starts(record.channels, record.drive, thorough=True)
    yield from [s for s in thorough if not s.alike and s not in apart[:1]][:_TRIED]


def _theta(start: RunUpStart) -> np.ndarray:
    theta = np.zeros(PARAMETERS)
    theta[list(OMEGAS)], theta[list(ZETAS)] = np.log(start.omegas), np.log(start.zetas)
    theta[ANGLE] = start.angle_rad
    return theta

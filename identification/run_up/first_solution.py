"""First solution of a passage, from start values or from the suspension's parameters of ring-downs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from identification.errors import NotIdentifiable, UnexplainedPassage
from identification.least_squares import Solution, solve_separable
from identification.run_up.bent_passage import BentPassage, KnownSuspension
from identification.run_up.choice import alike
from identification.run_up.design import design_at
from identification.run_up.forced_oscillator import Excitation
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
from rig_basics.texts import number_of

_MAX_CHI2 = 1.5  # χ²/dof above which other start values are tried
_TERMS_WIDENING = 20.0  # factor on the std of a ring-down's terms, so that its information counts only once
_RATIO_STD = 0.1  # of ln(gain ratio), far above the error of a calibration
_MAX_COST_RATIO = 4.0  # χ² of a start with a single resonance over the best start's, up to which it is fitted
_MAX_STARTS = 6


@dataclass(frozen=True)
class Clocks:
    """Standard deviations of the sensors' clocks against that of the phase: delay (s) and rate of each (relative)."""

    delay_std_s: float
    drift_std: tuple[float, float]

    @property
    def apart(self) -> bool:
        """Whether the clocks may differ."""
        return self.delay_std_s > 0 or max(self.drift_std) > 0


def first_structure(drive: Excitation, clocks: Clocks) -> Structure:
    """Structure with both resonances, turned axes, offset, slope, and clock errors within their priors."""
    prior, prior_std = np.zeros(PARAMETERS), np.zeros(PARAMETERS)
    # a prior without influence on a passed resonance, which keeps the frequency of a resonance not passed finite
    prior[list(OMEGAS)], prior_std[list(OMEGAS)] = np.log(drive.top_rad_s), 2.0
    prior[list(ZETAS)], prior_std[list(ZETAS)] = np.log(0.02), 3.0
    prior_std[ANGLE] = AXIS_PRIOR_STD
    # errors of common clocks and ripple stay at zero unless the data require them
    prior_std[DELAYS], prior_std[DRIFTS] = clocks.delay_std_s, clocks.drift_std
    return free_structure(prior, prior_std, drift_order=1)


def about_known(
    record: RunUpRecord, structure: Structure, known: KnownSuspension, slow_roll: bool
) -> tuple[RunUpRecord, Structure, Solution]:
    """Fit with the suspension's terms, starting at the values of ring-downs."""
    structure = _with_terms(structure, known)
    record = replace(record, bent=BentPassage.of(record.drive, known.amplitude_m))
    start = np.r_[_theta(RunUpStart(known.omegas, known.zetas, known.angle_rad, 0.0)), known.terms, 0.0]
    solution = solve(record, structure, structure.project(start))
    if slow_roll and solution.chi2_per_dof > _MAX_CHI2:  # a slow roll changes the motion as well
        both, whole = replace(structure, run_out=True, bow=True), _afresh(record)
        other = solve(whole, both, structure.project(start))
        if other.chi2_per_dof < _MAX_CHI2 and other.minimum.converged:
            return whole, both, other
    return record, structure, solution


def from_starts(record: RunUpRecord, structure: Structure, slow_roll: bool) -> tuple[Structure, Solution]:
    """Find the best solution. Further start values are tried as long as residuals exceed the noise.

    The axis angle is left out if both directions have equal rates, since the data do not determine it.
    """
    starts = run_up_starts(record.channels, record.drive)
    equal = [s for s in starts if s.alike and s.cost < _MAX_COST_RATIO * starts[0].cost]
    if equal:
        straight = structure.without(ANGLE)
        solution = solve(record, straight, straight.project(_theta(equal[0])))
        good = solution.minimum.converged and solution.chi2_per_dof < _MAX_CHI2
        if good and alike(design_at(record, straight, solution.minimum.theta)):
            return straight, solution
    best: Solution | None = None
    for start in _apart(record, starts):
        solution = solve(record, structure, structure.project(_theta(start)))
        if slow_roll and solution.chi2_per_dof > _MAX_CHI2:  # a slow roll may hide a resonance
            wider = replace(structure, run_out=True, bow=True)
            other = solve(record, wider, solution.minimum.theta)
            if other.chi2_per_dof < _MAX_CHI2 and other.minimum.converged:
                return wider, other
        settled = solution.minimum.converged and solution.chi2_per_dof < _MAX_CHI2
        if settled or best is None or solution.chi2_per_dof < best.chi2_per_dof:
            best = solution
        if settled:
            break
    if best is None:
        raise NotIdentifiable("neither sensor shows a resonance in this record; does the speed pass one?")
    if not best.minimum.converged:
        tried = number_of(best.minimum.iterations, "iteration")
        if best.chi2_per_dof < _MAX_CHI2:
            raise NotIdentifiable(
                f"after {tried} the values still change, although residuals are as small as noise: the record "
                "determines neither resonance; does the speed pass one?"
            )
        raise UnexplainedPassage(f"run-up: no convergence in {tried}, χ²/dof {best.chi2_per_dof:.3g}")
    return structure, best


def solve(record: RunUpRecord, structure: Structure, phi: np.ndarray, iterations: int = 40) -> Solution:
    """Solve a structure from start values of φ."""
    return solve_separable(
        lambda p: run_up_blocks(record, structure, p), phi, structure.prior, structure.prior_std, iterations
    )


def _afresh(record: RunUpRecord) -> RunUpRecord:
    """Return the record without the start values of earlier fits of a bent passage."""
    assert record.bent is not None
    return replace(record, bent=BentPassage(record.bent.force, record.bent.amplitude_m), recent={})


def _with_terms(structure: Structure, known: KnownSuspension) -> Structure:
    """Return the structure with the suspension's terms and the ratio of the gains free, with wide priors."""
    value, std = np.r_[known.terms, 0.0], np.r_[_TERMS_WIDENING * known.terms_std, _RATIO_STD]
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
    """Start values with two resonances: first the best one, then those of a thorough search."""
    apart = [s for s in starts if not s.alike]
    yield from apart[:1]
    thorough = run_up_starts(record.channels, record.drive, thorough=True)
    yield from [s for s in thorough if not s.alike and s not in apart[:1]][:_MAX_STARTS]


def _theta(start: RunUpStart) -> np.ndarray:
    theta = np.zeros(PARAMETERS)
    theta[list(OMEGAS)], theta[list(ZETAS)] = np.log(start.omegas), np.log(start.zetas)
    theta[ANGLE] = start.angle_rad
    return theta

"""Selection of run-out, bow, both or neither for a passage, by χ² + k ln n and by the remaining misfit.

Both are first judged by their score. If it requires one of them, every combination is fitted, since a linearisation
far from the solution does not distinguish a bow from run-out. The noise is that of the best fit, including the
correlation of its residuals. A slow roll that leaves most of the misfit is rejected: the model has another error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from identification.least_squares import Solution
from identification.run_up.design import Design
from identification.run_up.model import RunUpRecord, Structure, slow_roll_columns
from identification.samples import correlation_inflation
from identification.setting import ModelChoice
from rig_basics.arrays import Array

Solve = Callable[[Structure, Array], Solution]

_UNKNOWNS = 4  # one complex amplitude per sensor
_MIN_EXPLAINED = 0.5  # share of the misfit that a slow roll must explain
_MIN_DIFFERENCE = 10.0  # of χ², below which run-out and bow are not distinguished
_WORDS: Mapping[tuple[bool, bool], str] = {
    (True, False): "run-out",
    (False, True): "bow",
    (True, True): "run-out and bow",
}


@dataclass(frozen=True)
class Doubt:
    """Model that is not excluded instead of the chosen one, its solution and its probability."""

    structure: Structure
    solution: Solution
    probability: float


@dataclass(frozen=True)
class SlowRollChoice:
    """Result of the selection.

    Attributes:
        structure, solution: structure and solution with the slow roll, or the given ones without it.
        table: compared rungs.
        warnings: consequences of the selection.
        doubt: model with the other one of run-out and bow, if the passage does not exclude it.
    """

    structure: Structure
    solution: Solution
    table: list[ModelChoice]
    warnings: list[str]
    doubt: Doubt | None = None


def slow_roll_choice(
    record: RunUpRecord, design: Design, solution: Solution, solve: Solve, at_least: float = 0.0
) -> SlowRollChoice:
    """Select run-out, bow, both or neither.

    Args:
        record: record of the passage.
        design, solution: linearisation and solution of the fitted model. It contains both if its fit required them.
        solve: fit of a structure from start values of φ.
        at_least: gain of another rung in χ² + k ln n. The slow roll must gain more.
    """
    fitted = design.structure
    if not (fitted.run_out or fitted.bow):
        gains, table = _scores(record, design)
        if max(gains) <= max(0.0, at_least):
            return SlowRollChoice(fitted, solution, table, [])
    phi = solution.minimum.theta
    kinds = [(False, False), *_WORDS]
    models = {kind: replace(fitted, run_out=kind[0], bow=kind[1]) for kind in kinds}
    fits = {
        kind: solution if kind == (fitted.run_out, fitted.bow) else solve(model, phi) for kind, model in models.items()
    }
    return _chosen(models, fits, design.unknowns - _UNKNOWNS * (fitted.run_out + fitted.bow), solution)


def _scores(record: RunUpRecord, design: Design) -> tuple[list[float], list[ModelChoice]]:
    """Gains of run-out, bow and both by the linearisation of the fitted model."""
    n = len(design.residual)
    run_out, bow = slow_roll_columns(record, design.structure, design.phi)
    scores = [design.score(columns) for columns in (run_out, bow, np.hstack([run_out, bow]))]
    noise = max(1.0, (design.chi2 - max(scores)) / max(1, n - design.unknowns - 2 * _UNKNOWNS))
    base, gains, table = design.chi2 / noise + design.unknowns * np.log(n), list[float](), list[ModelChoice]()
    for (kind, word), score in zip(_WORDS.items(), scores, strict=True):
        more = _UNKNOWNS * sum(kind)
        gains.append(float(score / noise - more * np.log(n)))
        why = f"χ² {-score:+.3g} for {more:+d} unknowns (score)"
        table.append(ModelChoice(word, design.unknowns + more, float(base - gains[-1]), False, why))
    return gains, table


def _chosen(
    models: Mapping[tuple[bool, bool], Structure],
    fits: Mapping[tuple[bool, bool], Solution],
    unknowns: int,
    given: Solution,
) -> SlowRollChoice:
    n = sum(len(r) for r in given.residuals)
    chi2 = {kind: sum(float(r @ r) for r in found.residuals) for kind, found in fits.items()}
    widest = min(fits, key=lambda kind: chi2[kind])
    correlated = max(correlation_inflation(r) for r in fits[widest].residuals)
    noise = max(1.0, chi2[widest] / max(1, n - unknowns - 2 * _UNKNOWNS)) * correlated**2
    criterion = {
        kind: value / noise + (unknowns + _UNKNOWNS * sum(kind)) * float(np.log(n)) for kind, value in chi2.items()
    }
    none = (False, False)
    best = min(criterion, key=lambda kind: criterion[kind])
    beyond = max(0.0, chi2[none] - n)
    if chi2[none] - chi2[best] < _MIN_EXPLAINED * beyond:
        best = none
    table = [
        ModelChoice(
            word,
            unknowns + _UNKNOWNS * sum(kind),
            criterion[kind],
            kind == best,
            f"χ² {chi2[kind] - chi2[none]:+.3g} for {_UNKNOWNS * sum(kind):+d} unknowns (refitted)",
        )
        for kind, word in _WORDS.items()
    ]
    warnings: list[str] = []
    other, doubt = (best[1], best[0]), None
    off = (chi2[other] - chi2[best]) / noise
    if best[0] != best[1] and off < _MIN_DIFFERENCE:
        warnings.append(
            f"the passage hardly distinguishes {_WORDS[best]} from {_WORDS[other]} (χ² {off:+.3g}): intervals cover "
            "both; a slower passage distinguishes them"
        )
        doubt = Doubt(models[other], fits[other], 1 / (1 + math.exp(0.5 * max(off, 0.0))))
    return SlowRollChoice(models[best], fits[best], table, warnings, doubt)

"""Selection of run-out, bow and growing motion for a passage, by χ² + k ln n and by the remaining misfit.

All are first judged by their score. If it requires one of them, every combination is fitted, since a linearisation
far from the solution does not distinguish them. The noise is that of the best fit, including the correlation of its
residuals. A combination that leaves most of the misfit is rejected: the model has another error. A combination whose
bow is not possible (`bow_objection`) is rejected too.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from identification.least_squares import Solution
from identification.run_up.design import Design, design_at
from identification.run_up.model import RunUpRecord, Structure, slow_roll_columns
from identification.samples import correlation_inflation
from identification.setting import ModelChoice
from rig_basics.arrays import Array
from rig_basics.texts import number_of

Solve = Callable[[Structure, Array], Solution]
Kind = tuple[bool, bool, bool]
"""Whether a model contains run-out, a bow and a growing motion."""

_UNKNOWNS = 4  # one complex amplitude per sensor
_MIN_EXPLAINED = 0.5  # share of the misfit that a slow roll must explain
_MIN_DIFFERENCE = 10.0  # of χ², below which two models with equally many unknowns are not distinguished
# Bow and run-out have separate causes, hence independent angles. If the logarithm of the ratio of their sizes is
# uniform within a factor of ten, their sum is below ρ times the bow with probability ρ²/(2 ln 100), 0.4 % for ρ = 0.2.
_MIN_SHOWN = 0.2
# One bow has the same size in both sensors up to their gains, whose ratio is never further off than this; beyond it,
# 5 standard deviations have a probability of 6e-7.
_MAX_GAIN_RATIO, _MAX_DEVIATION_STD = 0.1, 5.0
_NONE: Kind = (False, False, False)
_PARTS = ("run-out", "bow", "motion that grows with the speed squared")


def words(kind: Kind) -> list[str]:
    """Names of the parts of a model."""
    return list(itertools.compress(_PARTS, kind))


_KINDS: tuple[Kind, ...] = (
    _NONE,
    (True, False, False),
    (False, True, False),
    (False, False, True),
    (True, True, False),
    (True, False, True),
    (False, True, True),
    (True, True, True),
)


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
        structure, solution: structure and solution with the chosen combination.
        table: compared rungs.
        warnings: consequences of the selection.
        doubt: model with another combination of as many unknowns, if the passage does not exclude it.
    """

    structure: Structure
    solution: Solution
    table: list[ModelChoice]
    warnings: list[str]
    doubt: Doubt | None = None


def slow_roll_choice(
    record: RunUpRecord, design: Design, solution: Solution, solve: Solve, at_least: float = 0.0
) -> SlowRollChoice:
    """Select a combination of run-out, bow and growing motion.

    Args:
        record: record of the passage.
        design, solution: linearisation and solution of the fitted model. It contains parts that its fit required.
        solve: fit of a structure from start values of φ.
        at_least: gain of another rung in χ² + k ln n. The slow roll must gain more.
    """
    fitted = design.structure
    if not any(fitted.turning):
        gains, table = _scores(record, design)
        if max(gains) <= max(0.0, at_least):
            return SlowRollChoice(fitted, solution, table, [])
    phi = solution.minimum.theta
    models = {kind: replace(fitted, run_out=kind[0], bow=kind[1], growing=kind[2]) for kind in _KINDS}
    fits = {kind: solution if kind == fitted.turning else solve(model, phi) for kind, model in models.items()}
    return _chosen(record, models, fits, design.unknowns - _UNKNOWNS * sum(fitted.turning))


def bow_objection(design: Design) -> str | None:
    """Why the bow of a fitted model is not possible; None if it is, or if the model has none.

    - A bow and a run-out that cancel at slow speed leave a change of the imbalance and a motion of the bow's size
      within the half-power width. Any small error of the model at the resonance takes this form.
    - A bow is one vector of the rotor. Both sensors measure it.
    """
    at = design.structure
    if not at.bow:
        return None
    bows = [complex(*c[at.bow_at]) for c in design.coefficients]
    for axis, bow, c in zip("xy", bows, design.coefficients, strict=True):
        shown = bow + (complex(*c[at.run_out_at]) if at.run_out else 0j)
        if abs(shown) < _MIN_SHOWN * abs(bow):
            return (
                f"a bow of {1e6 * abs(bow):.3g} µm of which laser {axis} shows {1e6 * abs(shown):.2g} µm at slow "
                "speed, because an opposite run-out cancels it"
            )
    pick = np.zeros((2, design.unknowns))
    first = design.nonlinear + at.bow_at.start
    second = first + len(design.coefficients[0])
    for row in range(2):
        pick[row, first + row], pick[row, second + row] = 1.0, -1.0
    std = math.sqrt(float(np.trace(pick @ design.covariance @ pick.T)) * _noise(design.chi2, design))
    if abs(bows[0] - bows[1]) > _MAX_GAIN_RATIO * max(map(abs, bows)) + _MAX_DEVIATION_STD * std:
        return (
            f"a bow of {1e6 * abs(bows[0]):.3g} µm by laser x and of {1e6 * abs(bows[1]):.3g} µm by laser y, "
            f"{1e6 * abs(bows[0] - bows[1]):.2g} µm apart"
        )
    return None


def _noise(chi2: float, design: Design) -> float:
    return max(1.0, chi2 / max(1, len(design.residual) - design.unknowns))


def _scores(record: RunUpRecord, design: Design) -> tuple[list[float], list[ModelChoice]]:
    """Gains of all combinations by the linearisation of the fitted model."""
    n = len(design.residual)
    parts = slow_roll_columns(record, design.structure, design.phi)
    kinds = _KINDS[1:]
    scores = [design.score(np.hstack(list(itertools.compress(parts, kind)))) for kind in kinds]
    noise = max(1.0, (design.chi2 - max(scores)) / max(1, n - design.unknowns - _UNKNOWNS * len(parts)))
    base, gains, table = design.chi2 / noise + design.unknowns * np.log(n), list[float](), list[ModelChoice]()
    for kind, score in zip(kinds, scores, strict=True):
        more = _UNKNOWNS * sum(kind)
        gains.append(float(score / noise - more * np.log(n)))
        why = f"χ² {-score:+.3g} for {number_of(more, 'unknown', form='+d')} (score)"
        table.append(ModelChoice(" and ".join(words(kind)), design.unknowns + more, base - gains[-1], False, why))
    return gains, table


def _chosen(
    record: RunUpRecord, models: Mapping[Kind, Structure], fits: Mapping[Kind, Solution], unknowns: int
) -> SlowRollChoice:
    n = sum(len(r) for r in fits[_NONE].residuals)
    chi2 = {kind: sum(float(r @ r) for r in found.residuals) for kind, found in fits.items()}
    widest = min(fits, key=lambda kind: chi2[kind])
    correlated = max(correlation_inflation(r) for r in fits[widest].residuals)
    noise = max(1.0, chi2[widest] / max(1, n - unknowns - _UNKNOWNS * len(_PARTS))) * correlated**2
    criterion = {
        kind: value / noise + (unknowns + _UNKNOWNS * sum(kind)) * float(np.log(n)) for kind, value in chi2.items()
    }
    beyond = max(0.0, chi2[_NONE] - n)
    warnings, refused = list[str](), dict[Kind, str]()
    best = _NONE
    for kind in sorted(criterion, key=lambda kind: criterion[kind]):
        enough = chi2[_NONE] - chi2[kind] >= _MIN_EXPLAINED * beyond
        objection = bow_objection(design_at(record, models[kind], fits[kind].minimum.theta))
        if objection is not None:
            refused[kind] = objection
        elif kind == _NONE or enough:
            best = kind
            break
    if refused:
        warnings.append(f"refused as an explanation: {next(iter(refused.values()))}")
    table = [
        ModelChoice(
            " and ".join(words(kind)),
            unknowns + _UNKNOWNS * sum(kind),
            criterion[kind],
            kind == best,
            f"χ² {chi2[kind] - chi2[_NONE]:+.3g} for "
            f"{number_of(_UNKNOWNS * sum(kind), 'unknown', form='+d')} (refitted)"
            + (f"; not possible: {refused[kind]}" if kind in refused else ""),
        )
        for kind in _KINDS[1:]
    ]
    others = [kind for kind in _KINDS if sum(kind) == sum(best) and kind != best and kind not in refused]
    other = min(others, key=lambda kind: chi2[kind], default=best)
    off, doubt = (chi2[other] - chi2[best]) / noise, None
    if other != best and off < _MIN_DIFFERENCE:
        warnings.append(
            f"the passage hardly distinguishes {' and '.join(words(best))} from {' and '.join(words(other))} "
            f"(χ² {off:+.3g}): intervals cover both; a slower passage distinguishes them"
        )
        doubt = Doubt(models[other], fits[other], 1 / (1 + math.exp(0.5 * max(off, 0.0))))
    return SlowRollChoice(models[best], fits[best], table, warnings, doubt)

"""Selection of the smallest adequate model of a passage by χ² + k ln n.

The fitted model (two resonances, turned axes, offset and slope) is compared with narrower and wider models by its
linearisation: a constraint increases χ² by its Wald statistic, further columns reduce it by their score statistic. If a
constraint is not clearly rejected, the narrower model is fitted. The reported values are from a model with free slope
and axis angle even if these are not significant: the slope has no cost, and the interval of the angle must be valid.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from identification.least_squares import solve_separable
from identification.run_up.design import Design, further_columns
from identification.run_up.model import (
    ANGLE,
    CLOCKS,
    OMEGAS,
    RIPPLE,
    RunUpRecord,
    Structure,
    run_up_blocks,
)
from identification.rungs import Rung
from identification.setting import ModelChoice, Setting
from rig_basics.texts import number_of

_MAX_REFIT_CHI2 = 200.0  # Wald χ² above which the narrower model is rejected without a fit
_CLOCK_STD = (10e-3, 10e-3, 1e-4, 1e-4)  # s, s, relative rates
_RIPPLE_STD = (0.01,) * 4
_RUNG_OF: Mapping[Rung, str] = {"wander": "cubic", "ripple": "ripple", "clocks": "clocks"}


@dataclass(frozen=True)
class ModelSelection:
    """Result of the model selection.

    Attributes:
        structure: structure for the reported values.
        model: description of the smallest adequate model.
        table: compared models.
        warnings: consequences of the selection.
        gained: reduction of χ² + k ln n by the best wider model; not above 0 if none is selected.
    """

    structure: Structure
    model: str
    table: list[ModelChoice]
    warnings: list[str]
    gained: float


@dataclass(frozen=True)
class _Other:
    """Neighbour of the fitted model: its name, changes of χ² and of the number of unknowns, and the method."""

    name: str
    chi2: float
    unknowns: int
    how: str


def compare(
    record: RunUpRecord,
    design: Design,
    clocks_apart: bool,
    marks_only: bool,
    setting: Setting,
    without: frozenset[Rung] = frozenset(),
) -> ModelSelection:
    """Compare the fitted model with its neighbours.

    Args:
        record: record of the passage.
        design: linearised problem at the solution.
        clocks_apart: whether the model already contains delays, or whether a wandering phase hides them.
        marks_only: whether the phase is known once per turn, so that it may contain unknown ripple.
        setting: effort; fast uses the linearisation only.
        without: rungs that are not used. The table contains them nevertheless.
    """
    n, per_unknown = len(design.residual), float(np.log(len(design.residual)))
    noise = max(1.0, design.chi2 / max(1, n - design.unknowns))
    refit = setting != "fast"
    others = {
        "flat": _flat(design),
        "single": _single(design),
        "cubic": _Other("cubic drift", -design.score(_cubic_columns(record, design)), 4, "score"),
    }
    if design.structure.spread[ANGLE].any():
        others["straight"] = _straight(record, design, refit)
    if not clocks_apart:
        others["clocks"] = _wider(record, design, CLOCKS, "sensors' clocks apart from the phase's")
    if marks_only:
        others["ripple"] = _wider(record, design, RIPPLE, "speed ripple between the marks")
    gain = {key: -(o.chi2 / noise + o.unknowns * per_unknown) for key, o in others.items()}
    for rung, key in _RUNG_OF.items():
        if rung in without and key in gain:
            gain[key] = min(gain[key], 0.0)
    structure, warnings = design.structure, list[str]()
    if gain["single"] > 0:
        structure = structure.without(ANGLE)
        warnings.append(
            "axes not resolved: one resonance describes both directions; f1, ζ1 are those along sensor x, f2, ζ2 those "
            "along sensor y"
        )
    if gain["cubic"] > 0:
        structure = replace(structure, drift_order=3)
    if gain.get("ripple", -1.0) > 0:
        structure = structure.with_more(RIPPLE, _RIPPLE_STD)
    if gain.get("clocks", -1.0) > 0:
        structure = structure.with_more(CLOCKS, _CLOCK_STD)
        warnings.append("the sensors' clocks are apart from the phase's; delays and drifts are fitted as well")
    base = design.chi2 / noise + design.unknowns * per_unknown
    wider = max(gain[key] for key, other in others.items() if other.unknowns > 0)
    return ModelSelection(structure, *_table(others, gain, base, design.unknowns), warnings, wider)


def _table(
    others: dict[str, _Other], gain: dict[str, float], base: float, unknowns: int
) -> tuple[str, list[ModelChoice]]:
    taken = [k for k in others if gain[k] > 0]
    words = [
        "one resonance" if "single" in taken else "two resonances",
        "axes turned" if "straight" in others and not {"straight", "single"} & set(taken) else "axes along the sensors",
        "cubic drift" if "cubic" in taken else "offset" if "flat" in taken else "offset and slope",
        *(["clocks apart"] if "clocks" in taken else []),
        *(["speed ripple between the marks"] if "ripple" in taken else []),
    ]
    axes = "turned" if "straight" in others else "along the sensors"
    table = [
        ModelChoice(
            f"two resonances, axes {axes}, offset and slope",
            unknowns,
            base,
            not taken,
            "smallest adequate" if not taken else "a neighbour is better by χ² + k ln n",
        )
    ]
    for key, other in others.items():
        why = f"χ² {other.chi2:+.3g} for {number_of(other.unknowns, 'unknown', form='+d')} ({other.how})"
        table.append(ModelChoice(other.name, unknowns + other.unknowns, base - gain[key], key in taken, why))
    return ", ".join(words), table


def _flat(design: Design) -> _Other:
    """Model without slopes, the last linear unknown of each sensor."""
    p, k = design.nonlinear, len(design.coefficients[0])
    contrast = np.zeros((2, design.unknowns))
    contrast[0, p + k - 1] = contrast[1, -1] = 1.0
    offset = np.array([c[-1] for c in design.coefficients])
    return _Other("offset without slope", design.wald(contrast, offset), -2, "Wald")


def alike(design: Design) -> bool:
    """Whether one resonance is sufficient for both directions."""
    other = _single(design)
    return other.chi2 + other.unknowns * np.log(len(design.residual)) < 0


def _single(design: Design) -> _Other:
    """Model with the same ω and ζ for both directions."""
    theta, spread = design.structure.theta(design.phi), design.structure.spread
    rows = np.zeros((2, len(theta)))
    rows[range(2), OMEGAS[0] + np.arange(2)] = 1.0
    rows[range(2), OMEGAS[1] + np.arange(2)] = -1.0
    contrast = np.pad(rows @ spread, ((0, 0), (0, design.unknowns - design.nonlinear)))
    fewer = 2 + 4 + int(spread[ANGLE].any())  # ω and ζ, free oscillations of the second mode, and the angle
    return _Other("one resonance for both directions", design.wald(contrast, rows @ theta), -fewer, "Wald")


def _straight(record: RunUpRecord, design: Design, refit: bool) -> _Other:
    """Model with stiffness axes along the sensors."""
    column = np.flatnonzero(design.structure.spread[ANGLE])[0]
    wald = float(design.phi[column] ** 2 / design.covariance[column, column])
    if not refit or wald > _MAX_REFIT_CHI2:
        return _Other("axes along the sensors", wald, -1, "Wald")
    narrow = design.structure.without(ANGLE)
    start = np.delete(design.phi, column)
    found = solve_separable(lambda q: run_up_blocks(record, narrow, q), start, narrow.prior, narrow.prior_std, 12)
    return _Other("axes along the sensors", sum(float(r @ r) for r in found.residuals) - design.chi2, -1, "refitted")


def _wider(record: RunUpRecord, design: Design, rows: slice, name: str) -> _Other:
    """Model with further free elements of θ."""
    columns = further_columns(record, design.structure, design.phi, rows)
    return _Other(name, -design.score(columns), columns.shape[1], "score")


def _cubic_columns(record: RunUpRecord, design: Design) -> np.ndarray:
    """Columns s², s³ of both sensors, shape (n, 4), in standard deviations."""
    x, y = record.channels
    out = np.zeros((len(x.time_s) + len(y.time_s), 4))
    for i, (channel, rows) in enumerate(((x, slice(0, len(x.time_s))), (y, slice(len(x.time_s), None)))):
        s = channel.time_s - record.middle_s
        s = s / np.abs(s).max()
        out[rows, 2 * i], out[rows, 2 * i + 1] = s**2 * channel.weight, s**3 * channel.weight
    return out

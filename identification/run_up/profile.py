"""Intervals from the profile likelihood: values at which χ², with all other unknowns fitted, has risen by 1.96²."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identification.least_squares import solve_separable
from identification.run_up.design import Design
from identification.run_up.model import ANGLE, RunUpRecord, run_up_blocks
from identification.run_up.result import RunUpFit
from identification.setting import Setting

_RISE = 1.96**2
_MAX_ANGLE_STD_DEG = 3.0  # std of β above which the model is not linear in β


def intervals(record: RunUpRecord, design: Design, fit: RunUpFit, setting: Setting) -> dict[str, tuple[float, float]]:
    """95 % intervals from the covariance, or from the profile for badly resolved axes and for the reference setting."""
    std = fit.std
    found = {n: (v - 1.96 * std[n], v + 1.96 * std[n]) for n, v in fit.values.items()}
    badly_resolved = std.get("axis_angle_deg", 0.0) > _MAX_ANGLE_STD_DEG
    if setting == "fast" or not (badly_resolved or setting == "reference"):
        return found
    for row, name in enumerate(("f1_Hz", "zeta1", "f2_Hz", "zeta2", "axis_angle_deg")):
        column = np.flatnonzero(design.structure.spread[row])
        if name not in found or not len(column):
            continue
        at = int(column[0])
        # φ is the logarithm of f and ζ, and β in rad
        scale = np.degrees(1.0) if row == ANGLE else fit.values[name]
        stretch = std[name] / scale / float(np.sqrt(design.covariance[at, at]))
        low, high = (end - design.phi[at] for end in profile_interval(record, design, at, stretch))
        if row == ANGLE:
            found[name] = (fit.values[name] + scale * low, fit.values[name] + scale * high)
        else:
            found[name] = (scale * float(np.exp(low)), scale * float(np.exp(high)))
    return found


def profile_interval(record: RunUpRecord, design: Design, column: int, stretch: float) -> tuple[float, float]:
    """95 % interval of one element of φ.

    Args:
        record: record of the passage.
        design: linearised problem at the solution.
        column: index of the element.
        stretch: reported standard deviation over that of the covariance (noise above white noise). The permitted rise
            of χ² is multiplied by its square.
    Returns:
        Lower and upper end, limited to four standard deviations.
    """
    std = float(np.sqrt(design.covariance[column, column]))
    rise = _RISE * stretch**2
    bottom = _chi2_at(record, design, column, float(design.phi[column]))
    ends: list[float] = []
    for sign in (-1.0, 1.0):
        low, high = 0.0, 4.0 * stretch
        guess = 1.96 * stretch
        for _ in range(6):
            value = _chi2_at(record, design, column, float(design.phi[column] + sign * guess * std)) - bottom
            if abs(value - rise) < 0.02 * rise:
                break
            low, high = (guess, high) if value < rise else (low, guess)
            wanted = guess * float(np.sqrt(rise / max(value, 1e-9)))  # exact for a parabola
            guess = wanted if low < wanted < high else 0.5 * (low + high)
        ends.append(float(design.phi[column] + sign * guess * std))
    return ends[0], ends[1]


def _chi2_at(record: RunUpRecord, design: Design, column: int, value: float) -> float:
    """Sum of squared residuals and priors with one element of φ held and the others fitted again."""
    structure = design.structure
    keep = np.arange(design.nonlinear) != column
    held = replace(
        structure,
        base=structure.base + structure.spread[:, column] * value,
        spread=structure.spread[:, keep],
        prior=structure.prior[keep],
        prior_std=structure.prior_std[keep],
    )
    along = design.covariance[: design.nonlinear, column] / design.covariance[column, column]
    start = (design.phi + along * (value - design.phi[column]))[keep]
    found = solve_separable(lambda p: run_up_blocks(record, held, p), start, held.prior, held.prior_std, 12)
    pull = (value - structure.prior[column]) / structure.prior_std[column]
    return found.minimum.cost + pull**2

"""Conversion of the run-out and bow of a passage's fit to vectors relative to the rotor's phase."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from identification.run_up.result import RunUpFit
from rig_basics.arrays import Array
from rig_configs.slow_roll import SlowRoll

_MAX_DEVIATION_STD = 5.0  # standard deviations between two passages


def slow_roll_of(fit: RunUpFit, source: str = "", digest: str = "") -> SlowRoll | None:
    """Return the run-out and bow of a fit; None if it has neither.

    Both sensors measure the same bow with different gains. The result is the weighted mean.
    """
    if "run_out_x_m" not in fit.values and "bow_x_m" not in fit.values:
        return None
    names = list(fit.values)
    values, slope = np.zeros(8), np.zeros((8, len(names)))
    for k, stem in enumerate(("run_out_x", "run_out_y", "bow_x", "bow_y")):
        if f"{stem}_m" not in fit.values:
            continue
        size, angle = fit.values[f"{stem}_m"], math.radians(fit.values[f"{stem}_deg"])
        values[2 * k : 2 * k + 2] = size * math.cos(angle), size * math.sin(angle)
        slope[2 * k : 2 * k + 2, names.index(f"{stem}_m")] = math.cos(angle), math.sin(angle)
        slope[2 * k : 2 * k + 2, names.index(f"{stem}_deg")] = (
            np.radians(1.0) * size * np.array([-math.sin(angle), math.cos(angle)])
        )
    covariance = slope @ fit.covariance @ slope.T
    pick = np.zeros((6, 8))
    pick[:4, :4] = np.eye(4)
    pick[4:, 4:] = _mean_of(covariance[4:, 4:])
    x, y, bow = (complex(a, b) for a, b in (pick @ values).reshape(3, 2).tolist())
    return SlowRoll(
        x, y, bow, pick @ covariance @ pick.T, (float(pick[4, 4]), float(pick[4, 6])), Path(source).name, digest
    )


def slow_roll_of_all(found: Sequence[SlowRoll]) -> tuple[SlowRoll | None, list[str]]:
    """Return the slow roll with the smallest uncertainty, and a message for each other one that deviates from it."""
    if not found:
        return None, []
    best = min(found, key=lambda one: float(np.trace(one.covariance)))
    warnings: list[str] = []
    for other in found:
        off = other.values - best.values
        spread = np.sqrt(np.maximum(np.diag(other.covariance + best.covariance), 1e-18))
        worst = float(np.max(np.abs(off) / spread))
        if worst > _MAX_DEVIATION_STD:
            warnings.append(
                f"{other.log} and {best.log} show different run-out or bow, by {worst:.3g} standard deviations; the "
                "latter is taken. Were the lasers, the target or the shaft moved between them?"
            )
    return best, warnings


def _mean_of(covariance: Array) -> Array:
    """Weights (2, 4) of two vectors in the plane by their covariance; zeros if a covariance is zero."""
    own = [float(np.trace(covariance[at, at])) for at in (slice(0, 2), slice(2, 4))]
    if min(own) <= 0.0:
        return np.zeros((2, 4))
    share = np.array([1 / own[0], 1 / own[1]]) / (1 / own[0] + 1 / own[1])
    return np.hstack([share[0] * np.eye(2), share[1] * np.eye(2)])

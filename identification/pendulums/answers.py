"""Selection of several minima that explain one record nearly equally well, and intervals that contain all of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from identification.least_squares import Minimum
from identification.pendulums.transient import TransientFit, intervals_of

_MAX_CHI2_ABOVE_BEST = 8.0  # odds of 50 to 1 against a minimum, which exclude it from a 95 % interval
_MAX_SAME_DISTANCE = 1.0  # squared standard deviations between minima that count as the same


def plausible_answers(minima: Iterable[Minimum]) -> list[Minimum]:
    """Return the minima that differ in ln c3, ln c4, the best first, without those that are far worse.

    Args:
        minima: minima of one problem over one stretch, at least one. θ begins with ln c3, ln c4.
    Source: docs/theory/pendulum_damping.md.
    """
    found: list[Minimum] = []
    for minimum in minima:
        shift = [
            (minimum.theta[:2] - m.theta[:2]) @ np.linalg.inv(m.covariance[:2, :2]) @ (minimum.theta[:2] - m.theta[:2])
            for m in found
        ]
        if min(shift, default=np.inf) > _MAX_SAME_DISTANCE:
            found.append(minimum)
        else:
            at = int(np.argmin(shift))
            found[at] = min(found[at], minimum, key=lambda m: m.cost)
    best = min(m.cost for m in found)
    unit = max(1.0, best / len(found[0].residual))
    return sorted((m for m in found if m.cost < best + _MAX_CHI2_ABOVE_BEST * unit), key=lambda m: m.cost)


def covering(fit: TransientFit, answers: Sequence[Minimum], where: str, advice: str) -> TransientFit:
    """Return the fit of the best minimum with intervals extended to the other plausible minima.

    Args:
        fit: fit of the first minimum.
        answers: minima from `plausible_answers`.
        where: condition under which the other minima were found, for the warning.
        advice: measurement that distinguishes the minima, for the warning.
    """
    if len(answers) == 1:
        return fit
    best, *others = (np.exp(m.theta[:2]) for m in answers)
    more = sum((np.outer(c - best, c - best) for c in others), np.zeros((2, 2))) / 1.96**2
    covariance = fit.covariance + more
    named = ", ".join(f"c3 {c3:.3e} with c4 {c4:.3e}" for c3, c4 in others)
    warning = f"{named}, {where}, explain the readings nearly as well; the intervals contain them. {advice}"
    return replace(
        fit,
        covariance=covariance,
        intervals=intervals_of(np.array(list(fit.values.values())), covariance),
        warnings=[*fit.warnings, warning],
        open_friction=None if fit.open_friction is None else fit.open_friction.widened(more),
    )

"""Answers that explain one record nearly alike: which of several minima count, and intervals that reach them all."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from identification.least_squares import Minimum
from identification.pendulums.transient import TransientFit, log_intervals

_PLAUSIBLE = 8.0  # χ² above the best answer: such odds, 50 to 1, leave nothing of a 95 % interval
_ALIKE = 1.0  # squared standard deviations between answers that are one


def plausible_answers(minima: Iterable[Minimum]) -> list[Minimum]:
    """The minima that differ in ln c3, ln c4, the best first; those far worse are left out.

    Args:
        minima: of one problem over one stretch, at least one; θ begins with ln c3, ln c4.
    Source: docs/theory/pendulum_damping.md.
    """
    found: list[Minimum] = []
    for minimum in minima:
        shift = [
            (minimum.theta[:2] - m.theta[:2]) @ np.linalg.inv(m.covariance[:2, :2]) @ (minimum.theta[:2] - m.theta[:2])
            for m in found
        ]
        if min(shift, default=np.inf) > _ALIKE:
            found.append(minimum)
        else:
            at = int(np.argmin(shift))
            found[at] = min(found[at], minimum, key=lambda m: m.cost)
    best = min(m.cost for m in found)
    unit = max(1.0, best / len(found[0].residual))
    return sorted((m for m in found if m.cost < best + _PLAUSIBLE * unit), key=lambda m: m.cost)


def covering(fit: TransientFit, answers: Sequence[Minimum], where: str, advice: str) -> TransientFit:
    """The best answer's fit with intervals that reach the others that explain the readings nearly as well.

    Args:
        fit: of the first answer.
        answers: of plausible_answers.
        where, advice: how the others differ from it, and what tells them apart, for the warning.
    """
    if len(answers) == 1:
        return fit
    c = np.array(list(fit.values.values()))
    apart = [m.theta[:2] - answers[0].theta[:2] for m in answers[1:]]
    more = sum((np.outer(d, d) for d in apart), np.zeros((2, 2))) / 1.96**2
    covariance = fit.covariance / np.outer(c, c) + more
    others = ", ".join(f"c3 {x:.3e} with c4 {y:.3e}" for x, y in (np.exp(m.theta[:2]) for m in answers[1:]))
    warning = f"nearly as well the readings are explained, {where}, by {others}; the intervals reach so far. {advice}"
    return replace(
        fit,
        covariance=covariance * np.outer(c, c),
        intervals=log_intervals(c, covariance),
        warnings=[*fit.warnings, warning],
        open_friction=None if fit.open_friction is None else fit.open_friction.widened(more),
    )

# pyright: strict
"""The suspension's terms of all ring-downs, and how errors of theirs go with what else the tests find.

A ring-down finds k and ζ at zero amplitude together with H and Q, so their errors are correlated. With C_t the terms'
covariance, L its lower Cholesky factor and C_kt that with k and ζ, C_kt C_t⁻¹ L are the shifts of k and ζ for one
standard deviation of independent errors, which a prediction shares; what is left of the covariance is the test's own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from identification.estimate import Estimate
from identification.ring_down.direction_terms import DirectionTerms
from identification.ring_down.result import RingDownFit
from rig_configs.suspension_terms import LABEL, TERMS, SuspensionTerms, term_label

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ChosenTerms:
    """Which ring-down shows the terms of which direction.

    Attributes:
        terms: of both directions.
        directions: source of the ring-down and what it found, by direction.
    """

    terms: SuspensionTerms
    directions: Mapping[int, tuple[str, DirectionTerms]]


def terms_of_all(fits: Sequence[tuple[str, RingDownFit]], digests: Mapping[str, str] | None = None) -> ChosenTerms:
    """Of each direction the terms that the ring-down found in which it moves most.

    Args:
        fits: source and fit of every ring-down.
        digests: of the logs, by source.
    """
    chosen = dict[int, tuple[str, DirectionTerms]]()
    for source, fit in fits:
        for own in fit.terms:
            if own.direction not in chosen or own.largest_m > chosen[own.direction][1].largest_m:
                chosen[own.direction] = source, own
    values, covariance, found = np.zeros(4), np.zeros((4, 4)), list[str]()
    for direction, (_, own) in chosen.items():
        at = [direction - 1, direction + 1]
        values[at], covariance[np.ix_(at, at)] = own.values, own.covariance[2:, 2:]
        found += [TERMS[i] for i, there in zip(at, own.found, strict=True) if there]
    sources = list(dict.fromkeys(source for source, own in chosen.values() if np.any(own.covariance[2:, 2:])))
    logs = tuple(" + ".join(Path(part).name for part in source.split(" + ")) for source in sources)
    known = tuple((digests or {}).get(source, "") for source in sources)
    return ChosenTerms(SuspensionTerms(values, covariance, tuple(n for n in TERMS if n in found), logs, known), chosen)


def sharing_terms(estimates: Sequence[Estimate], chosen: ChosenTerms) -> list[Estimate]:
    """Ring-downs' estimates with the part of their errors that they share with the terms under its label.

    One that had such a part before has it made anew.
    """
    return [_sharing(_plain(one), chosen) if one.method.startswith("two coupled decays") else one for one in estimates]


def _plain(estimate: Estimate) -> Estimate:
    """All of a ring-down's errors its own again, but clocks."""
    of_terms = [shift for label, shift in estimate.shared.items() if label.startswith(f"{LABEL} ")]
    if not of_terms:
        return estimate
    shared = {label: shift for label, shift in estimate.shared.items() if not label.startswith(f"{LABEL} ")}
    covariance = estimate.covariance + np.sum([np.outer(shift, shift) for shift in of_terms], axis=0)
    return replace(estimate, covariance=covariance, shared=shared)


def _sharing(estimate: Estimate, chosen: ChosenTerms) -> Estimate:
    shared, own = dict(estimate.shared), estimate.covariance
    for direction, (source, terms) in chosen.directions.items():
        if source != estimate.source:
            continue
        k, zeta = f"k{direction}_N_per_m", f"zeta{direction}"
        if k not in estimate.names or zeta not in estimate.names:
            continue
        for label, (by_f, by_zeta) in _shifts(terms).items():
            shift = np.zeros(len(estimate.names))
            shift[estimate.names.index(k)] = 2 * estimate.value(k) * by_f
            shift[estimate.names.index(zeta)] = by_zeta
            shared[label] = shift
            own = own - np.outer(shift, shift)
    return replace(estimate, covariance=own, shared=shared)


def _shifts(terms: DirectionTerms) -> dict[str, tuple[float, float]]:
    """Label → shifts of ln f and ζ for one standard deviation of that error."""
    of_terms, with_rates = terms.covariance[2:, 2:], terms.covariance[:2, 2:]
    std = np.sqrt(np.diag(of_terms))
    names = [TERMS[terms.direction - 1], TERMS[terms.direction + 1]]
    there = [i for i in range(2) if std[i] > 0]
    if not there:
        return {}
    unit = std[there]
    lower = np.linalg.cholesky(of_terms[np.ix_(there, there)] / np.outer(unit, unit))
    # C_kt C_t⁻¹ L = C_kt L⁻ᵀ
    shifts = np.linalg.solve(lower, (with_rates[:, there] / unit).T)
    return {term_label(names[i]): (float(f), float(z)) for i, (f, z) in zip(there, shifts, strict=True)}

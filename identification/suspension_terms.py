"""Suspension terms H and Q of all tests, and the correlation of their errors with the other parameters.

A test estimates k and ζ at zero amplitude together with H and Q; their errors are correlated. Let C_t be the covariance
of the terms, L its lower Cholesky factor and C_kt the covariance of k and ζ with the terms. C_kt C_t⁻¹ L are the shifts
of k and ζ for one standard deviation of independent errors, which a prediction shares. The remaining covariance is the
test's own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynamics.equations.parameters import RotorParameters
from identification.estimate import Estimate
from identification.ring_down.direction_terms import DirectionTerms
from identification.run_up.bent_passage import KnownSuspension
from identification.sources import Sources, log_names
from rig_configs.suspension_terms import TERMS, SuspensionTerms, term_label


@dataclass(frozen=True)
class ChosenTerms:
    """Suspension terms and the test that determines them for each direction.

    Attributes:
        terms: terms of both directions.
        directions: direction → logs of the test and its terms.
    """

    terms: SuspensionTerms
    directions: Mapping[int, tuple[Sources, DirectionTerms]]


def terms_of_all(
    ring_downs: Sequence[tuple[Sources, Sequence[DirectionTerms]]],
    passages: Sequence[tuple[Sources, Sequence[DirectionTerms]]] = (),
    digests: Mapping[Sources, str] | None = None,
) -> ChosenTerms:
    """Select the terms of each direction: those of the ring-down with the largest motion, or of a sharper passage.

    Args:
        ring_downs, passages: logs and terms of each direction, for every test.
        digests: digest of each test, by its logs.
    """
    chosen = dict[int, tuple[Sources, DirectionTerms]]()
    for logs, found_there in ring_downs:
        for own in found_there:
            if own.direction not in chosen or own.largest_m > chosen[own.direction][1].largest_m:
                chosen[own.direction] = logs, own
    for logs, found_there in passages:
        for own in found_there:
            before = chosen.get(own.direction)
            if before is not None and _is_sharper(own, before[1]):
                chosen[own.direction] = logs, replace(own, found=before[1].found)
    values, covariance, found = np.zeros(4), np.zeros((4, 4)), list[str]()
    for direction, (_, own) in chosen.items():
        at = [direction - 1, direction + 1]
        values[at], covariance[np.ix_(at, at)] = own.values, own.covariance[2:, 2:]
        found += [TERMS[i] for i, there in zip(at, own.found, strict=True) if there]
    tests = list(dict.fromkeys(logs for logs, own in chosen.values() if np.any(own.covariance[2:, 2:])))
    names = tuple(log_names(logs) for logs in tests)
    known = tuple((digests or {}).get(logs, "") for logs in tests)
    return ChosenTerms(SuspensionTerms(values, covariance, tuple(n for n in TERMS if n in found), names, known), chosen)


def _is_sharper(one: DirectionTerms, other: DirectionTerms) -> bool:
    """Whether `one` determines every term of `other` with a smaller standard deviation."""
    stds = [np.sqrt(np.diag(each.covariance)[2:]) for each in (one, other)]
    there = stds[1] > 0
    return bool(there.any() and np.all(stds[0][there] > 0) and np.all(stds[0][there] < stds[1][there]))


def known_suspension(physics: RotorParameters, terms: SuspensionTerms, angle_deg: float) -> KnownSuspension | None:
    """Return the start values of a passage; None if no ring-down shows an amplitude dependence of the suspension.

    Args:
        physics: rig with the values of the ring-downs.
        terms: suspension terms of the ring-downs.
        angle_deg: angle from the stiffness x axis to the mounted sensor's x axis, deg.
    """
    if not terms.found:
        return None
    p = physics
    moment = p.forcing_moment_kg_m + p.a.first_moment_kg_m - p.b.first_moment_kg_m  # locked at 0° and 180°
    return KnownSuspension(
        terms.values,
        terms.std,
        p.natural_frequencies_rad_s,
        (p.zeta1, p.zeta2),
        math.radians(angle_deg),
        complex(moment / p.total_mass_kg),
    )


def sharing_terms(estimates: Sequence[Estimate], chosen: ChosenTerms) -> list[Estimate]:
    """Return the estimates with the errors that they share with the terms under the terms' labels.

    Former errors under these labels are replaced.
    """
    return [_sharing(_plain(one), chosen) for one in estimates]


def _plain(estimate: Estimate) -> Estimate:
    """Return the estimate with the errors shared with terms moved back to its own covariance."""
    of_terms = [shift for label, shift in estimate.shared.items() if label.kind == "suspension"]
    if not of_terms:
        return estimate
    shared = {label: shift for label, shift in estimate.shared.items() if label.kind != "suspension"}
    covariance = estimate.covariance + np.sum([np.outer(shift, shift) for shift in of_terms], axis=0)
    return replace(estimate, covariance=covariance, shared=shared)


def _sharing(estimate: Estimate, chosen: ChosenTerms) -> Estimate:
    shared, own = dict(estimate.shared), estimate.covariance
    for direction, (logs, terms) in chosen.directions.items():
        if logs != estimate.sources:
            continue
        names = [TERMS[direction - 1], TERMS[direction + 1]]
        there = [
            i for i, name in enumerate(names) if name in estimate.with_terms and terms.covariance[2 + i, 2 + i] > 0
        ]
        if not there:
            continue
        of_terms = terms.covariance[2:, 2:][np.ix_(there, there)]
        unit = np.sqrt(np.diag(of_terms))
        lower = np.linalg.cholesky(of_terms / np.outer(unit, unit))
        crossed = np.array([estimate.with_terms[names[i]] for i in there]) / unit[:, None]
        # C_kt C_t⁻¹ L = C_kt L⁻ᵀ
        for i, shift in zip(there, np.linalg.solve(lower, crossed), strict=True):
            shared[term_label(names[i])] = shift
            own = own - np.outer(shift, shift)
    return replace(estimate, covariance=own, shared=shared)

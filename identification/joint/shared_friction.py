"""Joint dry friction of the pendulums: the damping of every transient is recomputed with the friction of all of them.

Dry friction is a property of the rig. Its error is one shared error of all transients (Estimate.shared) and does not
reduce their weights. Tests with the same friction therefore count once for the friction, and their values of c are not
taken as independent. Source: docs/theory/joint_estimate.md.
"""

# pyright: strict

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from identification.estimate import Estimate
from identification.joint.combine import joint_estimate
from identification.pendulums.known_numbers import knowing, zeros_std
from identification.pendulums.open_friction import OpenFriction, Together, together
from identification.pendulums.transient import TransientFit
from identification.sources import Sources
from rig_configs.error_label import ErrorLabel
from rig_configs.known import KnownSource

_MAX_ROUNDS = 3  # repetitions of leaving out deviating tests and computing the friction without them
_MIN_POSITIVE_STD, _MIN_NEGATIVE_STD = 4.0, 6.0  # standard deviations above and below zero that yield a message
_NAMES = (
    ("a torque of A", "N m"),
    ("a torque of B", "N m"),
    ("contact friction of A", "kg m²"),
    ("contact friction of B", "kg m²"),
)


def with_shared_friction(
    estimates: Sequence[Estimate],
    fits: Mapping[Sources, TransientFit],
    zero_std_rad: float = 0.0,
    sources: Sequence[KnownSource] = (),
) -> tuple[list[Estimate], Together | None]:
    """Return the estimates with the pendulums' friction shared by all tests that determine damping.

    Args:
        estimates: estimates of all tests.
        fits: transients among them, by their logs.
        zero_std_rad: standard uncertainty of the encoder zeros, rad. All tests share these errors; the estimates have
            them in `by_number` and not in their covariance.
        sources: uncertainty sources of the numbers that the rig takes as known; also in `by_number`.
    Returns:
        Estimates in the same order, and the joint friction. With fewer than two transients, the estimates without
        shared friction, and None.
    """
    own = [_alone(e, fits[e.sources], zero_std_rad) if e.sources in fits else e for e in estimates]
    at = [i for i, e in enumerate(own) if e.sources in fits and _is_open(e, fits[e.sources])]
    if len(at) < 2:
        return own, None
    opens = [without_known(fits[own[i].sources], zero_std_rad) for i in at]
    trusted = list(range(len(at)))
    found, shared = _each(own, at, together(opens, None, sources))
    for _ in range(_MAX_ROUNDS):
        bad = joint_estimate([e.with_sources(sources) for e in found]).left_out
        less = [k for k in trusted if at[k] not in bad]
        if len(less) == len(trusted) or not less:
            break
        trusted = less
        found, shared = _each(own, at, together(opens, trusted, sources))
    return found, shared


def friction_messages(shared: Together) -> list[str]:
    """Return a message about significant friction, and one about friction that is significantly negative."""
    std = np.sqrt(np.diag(shared.covariance))
    sure = shared.friction / std
    parts = [
        f"{name} {v:.3g} ± {1.96 * s:.2g} {unit}"
        for (name, unit), v, s, z in zip(_NAMES, shared.friction, std, sure, strict=True)
        if z > _MIN_POSITIVE_STD
    ]
    below = [
        f"{name} {v:.3g} ± {1.96 * s:.2g} {unit}"
        for (name, unit), v, s, z in zip(_NAMES, shared.friction, std, sure, strict=True)
        if z < -_MIN_NEGATIVE_STD
    ]
    out = [f"dry friction in addition to viscous damping, by all pendulum tests together: {', '.join(parts)} (95 %)"]
    less = [
        f"{', '.join(below)} (95 %) by all pendulum tests together: negative friction is impossible, so that the model "
        "is wrong; check masses, lengths and what drove or touched a pendulum"
    ]
    return (out if parts else []) + (less if below else [])


def without_known(fit: TransientFit, zero_std_rad: float) -> OpenFriction:
    """Open friction of a fit without the uncertainty of the known numbers that the fit estimated."""
    assert fit.open_friction is not None
    return fit.open_friction.knowing({**zeros_std(zero_std_rad), **fit.number_std})


def _each(own: Sequence[Estimate], at: Sequence[int], shared: Together) -> tuple[list[Estimate], Together]:
    found = list(own)
    for k, i in enumerate(at):
        found[i] = _with(own[i], shared, k)
    return found, shared


def _is_open(estimate: Estimate, fit: TransientFit) -> bool:
    return fit.open_friction is not None and estimate.names == tuple(fit.values)


def _alone(estimate: Estimate, fit: TransientFit, zero_std_rad: float) -> Estimate:
    """Estimate without the friction that it shared with other tests before."""
    if not _is_open(estimate, fit):
        return estimate
    shared = {label: v for label, v in estimate.shared.items() if label.kind != "friction"}
    values, by_number = np.array(list(fit.values.values())), fit.slopes
    own = knowing(fit.covariance, by_number, {**zeros_std(zero_std_rad), **fit.number_std})
    return replace(estimate, values=values, covariance=own, shared=shared, by_number=by_number)


def _with(estimate: Estimate, found: Together, at: int) -> Estimate:
    by_friction = {ErrorLabel("friction", f"{k + 1}"): v for k, v in enumerate(found.shared[at].T)}
    return replace(
        estimate,
        values=found.damping[at],
        covariance=found.own[at],
        shared={**estimate.shared, **by_friction},
        by_number=found.by_number[at],
    )

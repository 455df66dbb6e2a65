"""Stiffness that changes from test to test, as the springs' temperature does.

The joint estimate takes each parameter as constant, and its agreement test looks for a deviating test. If a stiffness
changes evenly over the tests, no test is bad. The drift is then added to the own variance of the stiffness in each
test, so that the interval of the joint stiffness covers it, and the trend is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from identification.estimate import Estimate
from identification.joint.agreement import ALARM
from rig_basics.arrays import Array

_STIFFNESSES = ("k1_N_per_m", "k2_N_per_m")
_MIN_TESTS = 3
_MIN_EXPLAINED = 0.9
"""Share of the disagreement that a straight line over the tests explains.

A single deviating test of three or four, which is a case for the agreement test, leaves more than a sixth.
"""


def with_drift(estimates: Sequence[Estimate]) -> tuple[list[Estimate], list[str]]:
    """Add a drift of a stiffness over the tests to its variance in each of them.

    Args:
        estimates: tests in the order in which they were recorded.
    Returns:
        Estimates, and a message for each stiffness that drifts.
    """
    found, messages = list(estimates), list[str]()
    for name in _STIFFNESSES:
        having = [i for i, e in enumerate(found) if name in e.names]
        values = np.array([found[i].value(name) for i in having])
        stds = np.array([found[i].std[name] for i in having])
        slope = _trend(values, stds)
        if slope is None:
            continue
        spread = float(np.std(values, ddof=1))
        for i in having:
            found[i] = _widened(found[i], name, spread)
        listed = ", ".join(f"{value:.5g}" for value in values)
        messages.append(
            f"{name} drifts by {slope / float(np.mean(values)):+.2%} from test to test: {listed} N/m in their order. "
            f"Springs that warm up, a clamp that settles? The value is a mean, and its interval covers the change; "
            "repeat the tests at a constant temperature"
        )
    return found, messages


def _trend(values: Array, stds: Array) -> float | None:
    """Change per test if the values disagree and a straight line over the tests explains it, else None."""
    if len(values) < _MIN_TESTS:
        return None
    weight, place = 1 / stds**2, np.arange(len(values)) - 0.5 * (len(values) - 1)
    chi2 = float(weight @ (values - weight @ values / weight.sum()) ** 2)
    off = values - np.mean(values)  # equal weights: a line through two sharp values would explain all
    slope = float(place @ off / (place @ place))
    explained = slope**2 * float(place @ place) / max(float(off @ off), 1e-300)
    disagree = float(chdtrc(len(values) - 1, chi2)) < ALARM
    return slope if disagree and explained > _MIN_EXPLAINED else None


def _widened(estimate: Estimate, name: str, spread: float) -> Estimate:
    covariance = estimate.covariance.copy()
    at = estimate.names.index(name)
    covariance[at, at] += spread**2
    return replace(estimate, covariance=covariance)

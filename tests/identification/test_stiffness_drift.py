"""Stiffness that drifts from test to test: named, covered, and without effect on the damping ratios."""

from __future__ import annotations

from collections.abc import Sequence

import decay_worlds
import numpy as np
import pytest

from identification import Estimate, combine, fit_ring_down
from identification.joint.drift import with_drift

NAMES = ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2")
MASS_KG = 7.0


def ring_downs(stiffness: Sequence[float]) -> list[Estimate]:
    """Estimates of ring-downs along x and y in turn, each with its own stiffness over the nominal one."""
    out: list[Estimate] = []
    for seed, factor in enumerate(stiffness):
        start_m = decay_worlds.START_M if seed % 2 == 0 else decay_worlds.START_M[::-1]
        fit = fit_ring_down(*decay_worlds.ideal(seed, stiffness=factor, start_m=start_m), MASS_KG)
        at = [list(fit.values).index(name) for name in NAMES]
        values = np.array([fit.values[name] for name in NAMES])
        out.append(Estimate("ring-down-x", (f"{seed:02}.mcap",), NAMES, values, fit.covariance[np.ix_(at, at)]))
    return out


def test_a_drift_is_named_and_does_not_move_the_damping() -> None:
    """The message was that it cannot be decided which of the four tests is bad."""
    stiffness = 1 - 0.005 * np.arange(4)
    found, (of_k1, of_k2) = with_drift(ring_downs(stiffness))
    assert of_k1.startswith("k1_N_per_m drifts by -0.50% from test to test")
    assert of_k2.startswith("k2_N_per_m drifts by -0.50% from test to test")
    parameters, _, warnings = combine(found)
    assert not any("disagree" in warning for warning in warnings)
    for name, true in (("zeta1", 0.010), ("zeta2", 0.008)):
        assert abs(parameters.values[name] - true) < 3.5 * parameters.std[name], name
    for name, omega in zip(("k1_N_per_m", "k2_N_per_m"), decay_worlds.OMEGA, strict=True):
        middle = MASS_KG * omega**2 * float(np.mean(stiffness))
        assert parameters.values[name] == pytest.approx(middle, rel=1e-3)
        assert parameters.std[name] > 0.2 * MASS_KG * omega**2 * float(np.std(stiffness))


@pytest.mark.parametrize("stiffness", [(1.0, 1.0, 1.0), (1.0, 1.0, 0.995), (0.995, 1.0, 1.0, 1.0), (1.0, 0.99)])
def test_tests_that_agree_and_a_single_deviating_one_are_left_to_the_agreement_test(
    stiffness: tuple[float, ...],
) -> None:
    estimates = ring_downs(stiffness)
    found, messages = with_drift(estimates)
    assert messages == []
    assert all(one is other for one, other in zip(found, estimates, strict=True))

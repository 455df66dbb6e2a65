"""Stiffnesses that contradict the rig file: exchanged lasers are named and cost k and ζ, other causes are doubts."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from synthetic import Campaign

from daq.signals.run import Run
from identification import Estimate, NotIdentifiable, identify
from identification.physical import keep_directed
from rig_configs import load_rig

RIG = load_rig("virtual")
K1, K2 = RIG.physics.k1_N_per_m, RIG.physics.k2_N_per_m
ALL = ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "SP_kg_m")


def exchanged(run: Run) -> Run:
    """The run as recorded with laser x on the channel of laser y and the other way round."""
    return dataclasses.replace(run, x_time_s=run.y_time_s, x_m=run.y_m, y_time_s=run.x_time_s, y_m=run.x_m)


def estimate(names: tuple[str, ...], *values: float) -> Estimate:
    return Estimate("ring-down-x", ("01.mcap",), names, np.array(values), np.diag(np.square(values)) * 1e-8)


def test_ring_downs_with_exchanged_lasers_are_refused_with_the_cause() -> None:
    """k1 and k2 were exchanged, 15 times the rig file, with exit code 0."""
    campaign = Campaign(1)
    runs = [campaign.ring_down("x"), campaign.ring_down("y")]
    assert not any("exchanged" in warning for warning in identify(runs, campaign.rig).warnings)
    with pytest.raises(NotIdentifiable, match="lasers x and y are exchanged"):
        identify([exchanged(run) for run in runs], campaign.rig)


def test_what_does_not_depend_on_the_directions_is_kept() -> None:
    found, (message,) = keep_directed(estimate(ALL, K2, K1, 0.01, 0.01, 2e-3), RIG)
    assert found is not None
    assert found.names == ("SP_kg_m",)
    assert "k1_N_per_m = 3.849e+04 N/m is 14.9 times the rig file's" in message
    assert "k2_N_per_m = 2583 N/m is 0.0671 times" in message


@pytest.mark.parametrize(("name", "value"), [("k1_N_per_m", K2), ("k2_N_per_m", K1)])
def test_a_single_laser_is_found_exchanged_too(name: str, value: float) -> None:
    found, (message,) = keep_directed(estimate((name,), 1.1 * value), RIG)
    assert found is None
    assert "exchanged" in message


@pytest.mark.parametrize("factor", [0.3, 3.0])
def test_stiffnesses_far_off_the_file_in_both_orders_are_a_doubt(factor: float) -> None:
    whole = estimate(ALL, factor * K1, factor * K2, 0.01, 0.01, 2e-3)
    found, (message,) = keep_directed(whole, RIG)
    assert found is whole
    assert "in the units that were given?" in message


@pytest.mark.parametrize("factors", [(1.0, 1.0), (1.5, 0.7), (0.6, 0.6)])
def test_stiffnesses_about_those_of_the_file_are_accepted(factors: tuple[float, float]) -> None:
    whole = estimate(ALL, factors[0] * K1, factors[1] * K2, 0.01, 0.01, 2e-3)
    assert keep_directed(whole, RIG) == (whole, [])


def test_equal_stiffnesses_cannot_be_exchanged() -> None:
    rig = load_rig("isotropic")
    k = rig.physics.k1_N_per_m
    whole = estimate(ALL, 1.02 * k, 0.98 * k, 0.01, 0.01, 2e-3)
    assert keep_directed(whole, rig) == (whole, [])

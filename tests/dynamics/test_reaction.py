"""A sudden change at speed: where it ends, when, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dynamics import steady_states
from dynamics.errors import OutsideDomain
from dynamics.steady.reaction import reaction
from tests.dynamics.nominal import rig

B, E = 1.6, 5.8


def test_the_pendulums_balance_a_larger_imbalance():
    p = rig()
    more = replace(p, imbalance_radius_m=1.2 * p.imbalance_radius_m)
    found = reaction(p, more, p.speed_rad_s(E))
    assert found.after is not None
    assert (found.before.type, found.after.type) == ("I", "I")
    assert found.amplitude_m[-1] < 1e-6
    assert found.peak_m > 1e-4
    assert math.degrees(found.theta_rad[-1, 0]) % 360 == pytest.approx(math.degrees(found.after.theta_rad[0]), abs=0.01)
    late = found.amplitude_m[found.time_s > found.reaction_s]
    assert np.all(late <= 0.05 * found.peak_m * 1.001)
    assert found.amplitude_m[np.searchsorted(found.time_s, found.reaction_s) - 1] > 0.05 * found.peak_m
    modulus = found.after.multiplier_max
    assert found.time_constant_s == pytest.approx(-2 * math.pi / p.speed_rad_s(E) / math.log(modulus))


def test_deviations_end_with_the_time_constant():
    p = rig()
    found = reaction(p, replace(p, imbalance_radius_m=1.02 * p.imbalance_radius_m), p.speed_rad_s(B))
    late = found.time_s > found.time_s[-1] / 2
    slope = np.polyfit(found.time_s[late], np.log(found.amplitude_m[late]), 1)[0]
    assert -1 / slope == pytest.approx(found.time_constant_s, rel=0.12), "two motions are nearly as slow"


def test_no_change_is_no_reaction():
    p = rig()
    found = reaction(p, p, p.speed_rad_s(B), seconds=5.0)
    assert found.peak_m < 1e-9
    assert found.after is not None


def test_a_change_that_takes_the_balanced_state_away():
    p = rig()
    far = replace(p, imbalance_radius_m=4.0 * p.imbalance_radius_m)
    assert all(state.type != "I" for state in steady_states(far, p.speed_rad_s(E)))
    found = reaction(p, far, p.speed_rad_s(E))
    assert found.after is not None
    assert found.after.type == "III"
    assert found.amplitude_m[-1] == pytest.approx(found.after.amplitude_m, rel=1e-3)


def test_what_has_no_beginning_is_refused():
    p = rig(zeta=0.05)
    with pytest.raises(OutsideDomain, match="no stable state from which a change could start"):
        reaction(p, p, p.speed_rad_s(3.3))
    with pytest.raises(OutsideDomain, match="share must lie between 0 and 1"):
        reaction(rig(), rig(), rig().speed_rad_s(B), share=1.0)
    with pytest.raises(OutsideDomain, match="seconds must be finite"):
        reaction(rig(), rig(), rig().speed_rad_s(B), seconds=-1.0)

"""Where singular points are lost, against the singular points themselves on both sides of every border."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dynamics import Pendulum
from dynamics.errors import OutsideDomain
from dynamics.steady.point_loss import damping_at_loss, point_losses, speeds_at_loss
from dynamics.steady.singular_points import singular_points
from tests.dynamics.nominal import rig


def _exists(p, ratio: float, kind: str) -> bool:
    return any(point.type == kind for point in singular_points(p, p.speed_rad_s(ratio)))


@settings(max_examples=150, deadline=None)
@given(
    st.floats(-4, 4).map(lambda e: 10**e) | st.just(1.0),
    st.floats(-3, 0.5).map(lambda e: 10**e),
    st.floats(-3, 0.5).map(lambda e: 10**e),
    st.floats(-3, 1).map(lambda e: 10**e),
    st.floats(0.02, 3.0),
)
def test_points_exist_on_one_side_of_each_border_only(stiffness_ratio, zeta1, zeta2, share, mass_ratio) -> None:
    p = replace(rig(stiffness_ratio, mass_b=0.075 * mass_ratio), zeta1=zeta1, zeta2=zeta2)
    p = p.with_values(SP_kg_m=share * (p.a.first_moment_kg_m + p.b.first_moment_kg_m))
    for loss in point_losses(p):
        for low, high in loss.speed_ratios:
            assert 0 < low < high
            # rounding of the moments moves the ends of a narrow interval by some 1e-16 / (high - low)
            width = max(1e-3 * min(high - low, low), 2e-15 * low / (high - low))
            if width > 0.3 * (high - low):
                continue
            assert _exists(p, low - width, loss.type)
            assert _exists(p, high + width, loss.type)
            assert not _exists(p, low + width, loss.type)
            assert not _exists(p, high - width, loss.type)
        for ratio in np.geomspace(0.01, 100 * max(1.0, math.sqrt(stiffness_ratio)), 200):
            near = any(abs(ratio / edge - 1) < 1e-9 for pair in loss.speed_ratios for edge in pair)
            assert near or _exists(p, float(ratio), loss.type) != loss.holds(float(ratio))


def test_closed_form_of_an_isotropic_suspension() -> None:
    share = 0.3
    ratio = np.array([0.5, 0.9, 1.0, 1.25, 4.0])
    zeta = damping_at_loss(share, ratio)
    lag = np.arctan2(2 * zeta * ratio, 1 - ratio**2)
    assert np.sin(lag)[[0, 1, 3, 4]] == pytest.approx(np.full(4, share))
    assert zeta[2] == 0
    low, high = speeds_at_loss(share, zeta)
    assert low * high == pytest.approx(np.ones(5))
    assert np.where(ratio < 1, low, high) == pytest.approx(ratio)
    assert speeds_at_loss(1.0, np.array([0.0, 5.0]))[1] == pytest.approx([1, 1]), "never lost"
    assert np.isinf(damping_at_loss(2.0, ratio)).all()


def test_extremes() -> None:
    equal = rig(1.0, zeta=0.1)
    assert point_losses(equal)[0].speed_ratios == (), "equal pendulums opposed make no moment"
    assert point_losses(rig(1.0, zeta=0.1, sp=0.0))[1].speed_ratios == ((0.0, math.inf),)
    assert point_losses(rig(1.0, zeta=0.0, sp=0.0))[1].speed_ratios == ()
    assert point_losses(rig(1.0, zeta=0.0))[1].speed_ratios == ()
    absent = replace(equal, b=Pendulum.absent())
    assert {loss.moment_kg_m for loss in point_losses(absent)} == {0.075 * 0.054}
    (_, three) = point_losses(rig(14.9, zeta=0.02))
    assert len(three.speed_ratios) == 3, "at each resonance, and where the forward whirl of both directions cancels"
    for ratio in (1.0, math.sqrt((1 + 14.9) / 2), math.sqrt(14.9)):
        assert three.holds(ratio)
    assert not three.holds(2.0)


def test_what_has_no_such_condition_is_refused() -> None:
    with pytest.raises(OutsideDomain, match="without pivot shift and bow"):
        point_losses(replace(rig(), bow_x_m=1e-4))
    with pytest.raises(OutsideDomain, match=r"share S_P/S_T"):
        speeds_at_loss(-0.1, np.array([0.1]))
    with pytest.raises(OutsideDomain, match="damping ratios"):
        speeds_at_loss(0.1, np.array([-0.1]))
    with pytest.raises(OutsideDomain, match="speed ratios"):
        damping_at_loss(0.1, np.array([0.0]))

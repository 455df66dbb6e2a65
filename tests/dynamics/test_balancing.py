"""Regions, balanced angles on and near the borders, and the ring of the centre of gravity."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from hypothesis import given, strategies as st

from dynamics.equations.balancing import balanced_angles, balancing_region, closing_angles, gravity_disk
from dynamics.equations.parameters import Pendulum, RotorParameters
from tests.dynamics.nominal import rig

moments = st.floats(1e-9, 1.0)


@pytest.mark.parametrize(
    ("a", "b", "s", "region"),
    [
        (1.0, 1.0, 1.5, "properly oversized"),
        (1.0, 1.0, 2.0, "properly oversized"),
        (1.0, 1.0, 2.001, "undersized"),
        (1.0, 0.5, 0.5, "properly oversized"),
        (1.0, 0.5, 0.499, "improperly oversized"),
        (1.0, 1.0, 0.0, "properly oversized"),
        (0.1, 0.2, 0.1 + 0.2, "properly oversized"),  # 0.1 + 0.2 is rounded up: still the border
    ],
)
def test_regions_and_their_borders(a: float, b: float, s: float, region: str) -> None:
    assert balancing_region(a, b, s) == region
    assert (len(closing_angles(a, b, -s)) == 2) == (region == "properly oversized")


@given(moments, moments, st.floats(0.0, 1.0))
def test_balanced_angles_close_the_triangle(a: float, b: float, share: float) -> None:
    s = abs(a - b) + share * (a + b - abs(a - b))
    for theta3, theta4 in closing_angles(a, b, complex(-s)):
        rest = a * np.exp(1j * theta3) + b * np.exp(1j * theta4) + s
        assert abs(rest) <= 4e-16 * 4 * (a + b + s)


@given(moments, st.integers(1, 10), st.floats(0.1, 1.0))
def test_angles_keep_their_digits_next_to_the_border(a: float, ulps: int, ratio: float) -> None:
    """A few ulps inside S_A + S_B = S_P the cosine formula has lost half its digits; ours has not."""
    b = ratio * a
    s = a + b
    for _ in range(ulps):
        s = math.nextafter(s, 0)
    found = closing_angles(a, b, complex(-s))
    with mpmath.workdps(60):
        A, B, S = mpmath.mpf(a), mpmath.mpf(b), mpmath.mpf(s)
        cosine = (B * B - A * A - S * S) / (2 * A * S)
        if cosine < -1:
            return  # the exact sum of the moments is below S_P by less than its rounding: taken for the border
        theta3 = float(mpmath.acos(cosine))
    assert min(abs(f[0] - theta3) for f in found) < 2e-15 * theta3


def test_no_imbalance_and_equal_pendulums_take_the_limit() -> None:
    angles = balanced_angles(rig(sp=0.0))
    assert np.allclose(angles[0], (math.pi / 2, 3 * math.pi / 2), atol=1e-15)
    assert balanced_angles(rig(sp=0.0, mass_b=0.07)) == []


def test_a_turned_target_turns_the_angles() -> None:
    plain, turned = closing_angles(2.0, 1.0, -1.5 + 0j), closing_angles(2.0, 1.0, -1.5 * np.exp(0.7j))
    for p, t in zip(plain, turned, strict=True):
        assert np.allclose(np.exp(1j * (np.array(t) - np.array(p))), np.exp(0.7j), atol=1e-15)


@given(moments, moments, moments)
def test_the_ring_holds_the_axis_exactly_when_balance_exists(a: float, b: float, s: float) -> None:
    p = RotorParameters(7.0, 1.0, s, Pendulum(a, 1.0, 0.0), Pendulum(b, 1.0, 0.0), 1e3, 2e3, 0.02, 0.02)
    disk = gravity_disk(p)
    margin = min(abs(a + b - s), abs(abs(a - b) - s))
    if margin > 1e-12:
        assert disk.holds_axis == bool(balanced_angles(p))
    poses = np.exp(1j * np.linspace(0, 2 * np.pi, 60))
    centre = np.abs(a * poses[:, None] + b * poses[None, :]) / p.total_mass_kg
    assert centre.max() <= disk.outer_m * (1 + 1e-12)
    assert centre.min() >= disk.inner_m * (1 - 1e-9) - 1e-15
    assert disk.centre_m == pytest.approx(s / p.total_mass_kg)

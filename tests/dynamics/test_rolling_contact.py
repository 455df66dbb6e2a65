"""Hertz's contact against a direct integration of its pressure, and at its extremes."""

from __future__ import annotations

import math

import pytest
from hypothesis import example, given, strategies as st
from scipy.integrate import quad

from dynamics.equations.parameters import rolling_arm
from dynamics.equations.rolling_contact import Contact, Material, hertz_contact, hysteresis_resistance, plastic_depth
from dynamics.errors import OutsideDomain

STEEL, ALUMINIUM = Material(208e9, 0.3, 2e9), Material(68.9e9, 0.33, 276e6)
STIFF = 1 / (STEEL.plane_compliance_per_Pa + ALUMINIUM.plane_compliance_per_Pa)


def _sunk(contact: Contact) -> float:
    """Displacement in the middle under p0 sqrt(1 − ρ²/R(φ)²): the integral of p/(π E* ρ) over the ellipse."""
    a, b = contact.half_axes_m
    reach = quad(lambda phi: 1 / math.hypot(math.cos(phi) / a, math.sin(phi) / b), 0, 2 * math.pi, limit=200)[0]
    return contact.peak_pressure_Pa / (math.pi * STIFF) * math.pi / 4 * reach


def test_a_ball_on_a_plane_by_the_textbook() -> None:
    found = hertz_contact(40.0, 0.0075, STEEL, ALUMINIUM)
    half = (3 * 40.0 * 0.0075 / (4 * STIFF)) ** (1 / 3)
    assert found.half_axes_m == pytest.approx((half, half))
    assert found.approach_m == pytest.approx(half**2 / 0.0075)
    assert found.peak_pressure_Pa == pytest.approx(1.5 * 40.0 / (math.pi * half**2))


@example(path=817.0, groove=818.0, force=1.0)
@given(path=st.floats(1.02, 1e3), groove=st.floats(1.02, 1e3), force=st.floats(0.1, 1e3))
def test_an_ellipse_carries_the_force_and_sinks_as_its_pressure_makes_it(
    path: float, groove: float, force: float
) -> None:
    r = 0.0075
    found = hertz_contact(force, r, STEEL, ALUMINIUM, path * r, groove * r)
    a, b = found.half_axes_m
    assert a >= b > 0
    assert 2 / 3 * math.pi * a * b * found.peak_pressure_Pa == pytest.approx(force)
    assert _sunk(found) == pytest.approx(found.approach_m, rel=1e-6)
    assert found.approach_m <= hertz_contact(force, r, STEEL, ALUMINIUM).approach_m * (1 + 1e-9)


def test_what_cannot_be_a_contact_is_refused() -> None:
    with pytest.raises(OutsideDomain, match=r"touches a wall of 0\.007 m along more than a spot"):
        hertz_contact(1.0, 0.0075, STEEL, ALUMINIUM, 0.121, 0.007)
    for force, radius in ((0.0, 0.0075), (math.inf, 0.0075), (1.0, 0.0)):
        with pytest.raises(OutsideDomain, match="force and a ball radius above 0"):
            hertz_contact(force, radius, STEEL, ALUMINIUM)


def test_dent_and_rolling_resistance() -> None:
    depth = plastic_depth(38.8, 0.0075, 276e6)
    assert math.pi * 2 * 0.0075 * depth * 3 * 276e6 == pytest.approx(38.8)
    contact = Contact(3e-6, (1.6e-4, 1.6e-4), 7e8)
    assert hysteresis_resistance(contact, 0.02) == pytest.approx(6e-7)
    assert rolling_arm(1e-5, 0.114, 0.0075) == pytest.approx(1.52e-4)

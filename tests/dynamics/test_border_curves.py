"""Borders between their points: cubics with exact tangents, held against level lines that are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from dynamics.stability.border_curves import WANTED, BorderCurve, Slopes, curve_tangents, curve_through

Array = NDArray[np.floating]
Complex = NDArray[np.complexfloating]
MIDDLE = 0.5 + 0.5j


def turned(modulus: Array, along_x: Array, along_y: Array, at: Complex) -> tuple[Complex, Complex, Complex]:
    """λ of a modulus with known slopes whose argument is 1 + X + Y² / 2."""
    way = np.exp(1j * (1 + at.real + at.imag**2 / 2))
    return modulus * way, (along_x + 1j * modulus) * way, (along_y + 1j * modulus * at.imag) * way


def island(radius: float, steep: float = 3.0) -> Slopes:
    """Stable within a circle."""

    def slopes(at: Complex) -> tuple[Complex, Complex, Complex]:
        off = at - MIDDLE
        far = np.abs(off)
        return turned(1 + steep * (far - radius), steep * off.real / far, steep * off.imag / far, at)

    return slopes


def round_the_island(radius: float, count: int) -> Complex:
    return MIDDLE + radius * np.exp(2j * np.pi * np.linspace(0, 1, count))


@settings(max_examples=25, deadline=None)
@given(radius=st.floats(1e-3, 0.4), count=st.integers(60, 120), spacing=st.floats(1e-3, 0.05))
def test_the_curve_between_few_points_is_the_circle(radius: float, count: int, spacing: float) -> None:
    curve = curve_through(round_the_island(radius, count), island(radius))
    at, root = curve.between(spacing * radius)
    assert curve.off <= WANTED
    assert np.max(np.abs(np.abs(at - MIDDLE) - radius)) <= WANTED / 8
    assert np.max(np.abs(np.diff(at))) <= spacing * radius
    assert np.abs(root) == pytest.approx(1, abs=1e-11)
    assert np.angle(root) == pytest.approx(1 + at.real + at.imag**2 / 2, abs=1e-9)
    assert np.isin(curve.points, at).all()


def test_points_next_to_the_border_are_of_no_use_unless_they_are_its_own() -> None:
    """Halfway places are moved on to the border, so the curve does not depend on where the points lie on it."""
    few, many = (curve_through(round_the_island(0.3, count), island(0.3)) for count in (25, 97))
    sparse, dense = few.between(0.4 / 4000)[0], many.between(0.4 / 4000)[0]
    for place in dense[::50]:
        assert np.min(np.abs(sparse - place)) <= 0.4 / 4000
    assert len(few.points) < 600


def wave(at: Array) -> Array:
    return 0.5 + 0.2 * np.sin(9 * at)


def below_a_wave(at: Complex) -> tuple[Complex, Complex, Complex]:
    return turned(1 + at.imag - wave(at.real), -1.8 * np.cos(9 * at.real), np.ones(len(at)), at)


def test_a_wave_from_thirty_points_is_exact_where_it_is_level_too() -> None:
    x = np.linspace(1, 0, 31)
    at = curve_through(x + 1j * wave(x), below_a_wave).between(1 / 4000)[0]
    assert np.max(np.abs(at.imag - wave(at.real))) <= 1e-11


def the_larger_of_two(at: Complex) -> tuple[Complex, Complex, Complex]:
    """Stable left of X = 0.6 and below Y = 0.7: two multipliers leave the circle at the corner."""
    first, one, none = at.real - 0.6 >= at.imag - 0.7, np.ones(len(at)), np.zeros(len(at))
    modulus = 1 + np.where(first, at.real - 0.6, at.imag - 0.7)
    return turned(modulus, np.where(first, one, none), np.where(first, none, one), at)


def test_a_corner_is_cut_by_no_more_than_its_own_size() -> None:
    points = np.array([0.6, 0.6 + 0.3j, 0.6 + 0.6997j, 0.5997 + 0.7j, 0.3 + 0.7j, 0.7j])
    at = curve_through(points, the_larger_of_two).between(1e-3)[0]
    assert np.min(np.abs(at - (0.6 + 0.7j))) <= 2e-6
    off = np.maximum(at.real - 0.6, at.imag - 0.7)
    assert np.max(np.abs(off[np.abs(at - (0.6 + 0.7j)) > 2e-6])) <= 1e-11
    assert np.max(np.abs(off)) <= 2e-6


def test_where_no_point_is_found_the_curve_states_its_possible_error() -> None:
    def with_a_gap(at: Complex) -> tuple[Complex, Complex, Complex]:
        root, along_x, along_y = below_a_wave(at)
        return np.where(np.abs(at.real - 0.505) < 0.004, np.nan, root), along_x, along_y

    x = np.linspace(1, 0, 101)
    curve = curve_through(x + 1j * wave(x), with_a_gap)
    assert 0.002 <= curve.off <= 0.02


def test_the_other_side_of_a_thin_band_is_not_held() -> None:
    """Two borders 2e-9 apart, between which it is unstable, run opposite ways."""
    level = np.linspace(1, 0, 40) + 0.5j
    curve = curve_through(level, lambda at: turned(0.5 + at.imag, 0 * at.real, np.ones(len(at)), at))
    there = np.array([0.2 + 0.5j, 0.7123 + 0.5j])
    beyond = there + 2e-9j
    assert curve.holds(there, np.array([-1.0 + 0j, -1.0])).all()
    assert not curve.holds(beyond, np.array([1.0 + 0j, 1.0])).any()
    assert not curve.holds(there + 1e-6j, np.array([-1.0 + 0j, -1.0])).any()


def test_all_points_of_a_curve_are_held_and_few_others() -> None:
    curve = curve_through(round_the_island(0.3, 60), island(0.3))
    at = round_the_island(0.3, 500)
    assert curve.holds(at, curve_tangents(at, island(0.3))).all()
    nearby = MIDDLE + (at - MIDDLE) * (1 + 1e-6)
    assert not curve.holds(nearby, curve_tangents(nearby, island(0.3))).any()


def test_points_that_coincide_are_one() -> None:
    points = round_the_island(0.2, 50)
    twice = np.insert(points, 10, points[10] + 1e-12)
    ends = np.append(twice[:-1], [twice[-1] - 1e-13, twice[-1]])
    curve = curve_through(ends, island(0.2))
    assert isinstance(curve, BorderCurve)
    assert curve.points[0] == points[0]
    assert curve.points[-1] == points[-1]
    assert np.min(np.abs(np.diff(curve.points))) > 1e-9
    assert float(np.sum(np.abs(np.diff(curve.between(1e-4)[0])))) == pytest.approx(2 * math.pi * 0.2, rel=1e-7)

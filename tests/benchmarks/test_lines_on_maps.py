"""What a map can show of a line: each stretch between two points by the parity of its crossings."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from numpy.typing import NDArray

from benchmarks.lines_on_maps import compare

Array = NDArray[np.floating]
X, Y = np.linspace(0, 1, 101), np.linspace(0, 2, 81)


def circle(radius: float, by: complex = 0.0) -> tuple[Array, Array]:
    at = 0.5 + 1j + by + radius * np.exp(2j * np.pi * np.linspace(0, 1, 20_001))
    at[-1] = at[0]
    return at.real, at.imag


FAR = np.hypot(X - 0.5, Y[:, None] - 1)


def inside(radius: float) -> NDArray[np.bool_]:
    return radius > FAR


@given(radius=st.floats(0.02, 0.45))
def test_the_right_line_has_every_crossing_in_its_stretch(radius: float) -> None:
    assume(np.min(np.abs(FAR - radius)) > 1e-7)
    found = compare(inside(radius), X, Y, [circle(radius)])
    assert found.crossings - 2 * found.pairs == found.changes > 0
    assert (found.misplaced, found.worst_pitches, found.unseen) == (0, 0.0, [])


def test_a_line_that_is_shifted_is_off_by_that_much() -> None:
    found = compare(inside(0.3012), X, Y, [circle(0.3012, 0.013)])
    assert found.misplaced > 20
    assert found.worst_pitches <= 1.3
    assert found.worst_pitches == pytest.approx(1.0, abs=0.31)


def test_what_is_missing_and_what_is_too_much_is_counted() -> None:
    nothing = compare(inside(0.3), X, Y, [])
    assert nothing.worst_pitches == np.inf
    assert nothing.changes == nothing.misplaced
    ghost = compare(np.zeros((81, 101), bool), X, Y, [circle(0.3)])
    assert len(ghost.unseen) == ghost.crossings - 2 * ghost.pairs > 0
    assert "denies" in str(ghost)


def test_two_crossings_within_a_pitch_are_a_pair() -> None:
    y = np.linspace(-1, 3, 9)
    band = [(np.full(9, 0.50201), y), (np.full(9, 0.50799), y)]
    found = compare(np.zeros((81, 101), bool), X, Y, band)
    assert (found.pairs, found.crossings, found.unseen) == (81, 162, [])


def test_a_long_piece_crosses_every_line_between_its_ends() -> None:
    found = compare(0.3333 + 0.2 * Y[:, None] > X, X, Y, [(np.array([0.3133, 0.7533]), np.array([-0.1, 2.1]))])
    assert found.crossings == 81
    assert (found.misplaced, found.unseen) == (0, [])

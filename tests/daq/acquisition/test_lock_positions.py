"""Counters at closed locks: a wrong zero, an exchange or an offset is reported with its remedy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from daq.acquisition.lock_positions import battery_low, flagged, lock_positions, lock_tolerance_deg, misplaced
from daq.drivers.rotorlink import wire as rotorlink

A, B = rotorlink.FLAG_LOCK_A_CLOSED, rotorlink.FLAG_LOCK_B_CLOSED
ZERO_STD_DEG = 0.05


def misplacement(a_deg: float, b_deg: float, flags: int = A | B, swing_deg: float = 0.0) -> str:
    swing = swing_deg * np.sin(np.linspace(0, 6.28, 40))
    theta = np.radians(np.column_stack([np.full(40, a_deg) + swing, np.full(40, b_deg)]))
    return misplaced(lock_positions(theta, np.full(40, flags, np.uint32), ZERO_STD_DEG))


@given(
    turns=st.tuples(st.integers(-500, 500), st.integers(-500, 500)),
    play=st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4)),
)
def test_a_pendulum_at_its_own_lock_is_plausible_after_any_number_of_turns(turns, play) -> None:
    assert misplacement(360 * turns[0] + play[0], 180 + 360 * turns[1] + play[1]) == ""


@given(where=st.floats(-3600, 3600))
def test_a_counter_zeroed_elsewhere_is_reported_with_what_to_do(where: float) -> None:
    off = (where + 180) % 360 - 180
    text = misplacement(where, 180.0)
    if abs(off) > lock_tolerance_deg(ZERO_STD_DEG) + 1e-6:
        assert "pendulum A reads" in text
        assert "expected 0°" in text
        assert "zero the counters there, which `rig check` can do" in text
    elif abs(off) < lock_tolerance_deg(ZERO_STD_DEG) - 1e-6:
        assert text == ""


def test_a_b_zeroed_at_its_own_lock_and_an_exchange_are_called_by_name() -> None:
    assert "its zero is A's lock, half a revolution away" in misplacement(0.0, 0.0)
    assert "A and B are exchanged" in misplacement(180.0, 0.3)
    assert "moves by" in misplacement(0.0, 180.0, swing_deg=4.0)


def test_an_open_lock_yields_nothing_about_its_pendulum() -> None:
    assert misplacement(77.0, 180.0, flags=B) == ""
    assert misplacement(77.0, 33.0, flags=0) == ""
    assert lock_positions(np.empty((0, 2)), np.empty(0, np.uint32), ZERO_STD_DEG) == ()


@pytest.mark.parametrize(("bit", "words"), [(1, ["encoder A"]), (2, ["encoder B"]), (3, ["encoder A", "encoder B"])])
def test_fault_flags_are_heeded_wherever_they_stand_in_the_stretch(bit: int, words: list[str]) -> None:
    flags = np.array([96, 96 | bit, 96], np.uint32)
    assert [word for word in words if not any(word in text for text in flagged(flags))] == []
    assert len(flagged(flags)) == len(words)
    assert flagged(np.array([96, 96 | 8], np.uint32)) == ()
    assert battery_low(np.array([96, 96 | 8], np.uint32))
    assert not battery_low(np.array([96 | 8, 96], np.uint32))

"""The thirty-digit reference against known digits, ball arithmetic and its own refusal."""

from __future__ import annotations

import pytest

from dynamics.bench import arb_peer, mpmath_peer
from dynamics.equations.balancing import balanced_angles
from dynamics.equations.linearised import type_one
from dynamics.stability.floquet.multipliers import balanced
from tests.dynamics.nominal import rig


def reference(ratio: float) -> float | None:
    p = rig()
    return mpmath_peer.largest_multiplier(balanced(type_one(p, *balanced_angles(p)[0], p.speed_rad_s(ratio))))


def test_thirty_digits_agree_with_the_known_value_and_with_ball_arithmetic() -> None:
    found = reference(5.8)
    assert found == pytest.approx(0.978556, abs=5e-7)
    pytest.importorskip("flint")
    p = rig()
    assert found == pytest.approx(arb_peer.reference(p, p.speed_rad_s(5.8)).largest, rel=1e-13)


def test_what_would_take_minutes_is_left_out() -> None:
    assert reference(1e-3) is None

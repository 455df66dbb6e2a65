"""The search for the best value, on shares whose maximum is known."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, strategies as st

from analysis.maps.families import BorderFamily, SearchRange, best_value
from rig_configs import RigFileError

KEYS = ("suspension.zeta1",)


def ignored(share: float) -> None:
    assert 0 <= share <= 1


@given(top=st.floats(0.02, 1.9), left=st.floats(0.05, 1), right=st.floats(0.05, 1), corner=st.booleans())
def test_the_maximum_lies_in_the_interval(top: float, left: float, right: float, corner: bool) -> None:
    def share(value: float) -> tuple[float, float]:
        off = math.log(value / top)
        lost = abs(off) * (left if off < 0 else right)
        return 0.9 - (lost if corner else lost**2) / 10, 0.0

    found = best_value(share, lambda value: 1e-6, SearchRange(KEYS, 0.01, 2.0, True), ignored)
    assert found.interval[0] <= top <= found.interval[1]
    assert found.value == pytest.approx(top, rel=0.05)
    assert found.share == share(found.value)[0] == max(found.shares)
    assert found.share == pytest.approx(0.9, abs=3e-4)
    assert len(found.values) < 45
    assert (found.values[0], found.values[-1]) == (0.01, 2.0)


@pytest.mark.parametrize(("sign", "end"), [(1, 2.0), (-1, 0.0)])
def test_a_best_value_at_an_end_of_the_range_is_marked(sign: int, end: float) -> None:
    within = SearchRange(KEYS, 0.0, 2.0)
    found = best_value(lambda value: (0.5 + 0.1 * sign * value, 0.0), lambda value: 1e-9, within, ignored)
    assert found.at_end
    assert found.value == end
    assert found.interval[0 if end == 0.0 else 1] == end


def test_an_error_widens_the_interval() -> None:
    within = SearchRange(KEYS, 0.0, 2.0)

    def share(value: float) -> tuple[float, float]:
        return 0.8 - (value - 0.7) ** 2, 0.0

    wide, narrow = (best_value(share, lambda value, e=error: e, within, ignored).interval for error in (1e-2, 1e-8))
    assert wide[0] <= 0.6
    assert wide[1] >= 0.8
    assert narrow[1] - narrow[0] < 0.02


def test_what_is_not_resolved_may_hold_the_best() -> None:
    def share(value: float) -> tuple[float, float]:
        return (0.5 + 0.1 * value, 0.0) if value < 1.0 else (0.5, 0.2 if value < 1.5 else 0.01)

    found = best_value(share, lambda value: 1e-6, SearchRange(KEYS, 0.0, 2.0), ignored)
    assert 0.9 < found.value < 1.0
    assert 1.5 <= found.interval[1] < 2.0
    assert found.unresolved[-1] == 0.01


@pytest.mark.parametrize("side", [0, 1])
def test_where_nothing_is_clearly_worse_the_interval_reaches_the_end(side: int) -> None:
    def share(value: float) -> tuple[float, float]:
        off = (1.0 - value) if side else (value - 1.0)
        return 0.8 - (off if off > 0 else -1e-4 * off), 0.0

    found = best_value(share, lambda value: 1e-3, SearchRange(KEYS, 0.0, 2.0), ignored)
    assert found.value == pytest.approx(1.0, abs=0.01)
    assert found.interval[side] == 2.0 * side
    assert found.interval[1 - side] == pytest.approx(1.0, abs=0.3)


def test_what_is_no_family_is_refused() -> None:
    for values in ((), (0.2, 0.1), (math.nan,)):
        with pytest.raises(RigFileError, match="rise"):
            BorderFamily(KEYS, values)
    with pytest.raises(RigFileError, match="zeta1"):
        BorderFamily(("suspension.zeta",), (0.1,))

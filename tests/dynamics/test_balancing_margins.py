"""How far an imbalance is from its region's borders: the region changes there and not before."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from dynamics.equations.balancing import (
    IMPROPERLY_OVERSIZED,
    PROPERLY_OVERSIZED,
    UNDERSIZED,
    balancing_margins,
    balancing_region,
)

_MOMENT = st.floats(0.0, 1.0).map(lambda x: 1e-6 * round(1e6 * x))


@given(_MOMENT, _MOMENT, _MOMENT)
def test_the_region_changes_at_the_margins_only(a: float, b: float, s: float) -> None:
    found = balancing_margins(a, b, s)
    assert found.region == balancing_region(a, b, s)
    offset = 1e-9
    for margin, sign in ((found.may_grow_kg_m, 1), (found.may_shrink_kg_m, -1)):
        if margin is None:
            far = s + 10.0 if sign > 0 else 0.0
            assert balancing_region(a, b, far) == found.region
            continue
        assert margin >= 0
        if margin > 2 * offset:
            assert balancing_region(a, b, s + sign * (margin - offset)) == found.region
        if s + sign * (margin + offset) >= 0:
            assert balancing_region(a, b, s + sign * (margin + offset)) != found.region


def test_three_regions() -> None:
    proper = balancing_margins(3.0, 2.0, 4.0)
    assert (proper.region, proper.may_grow_kg_m, proper.may_shrink_kg_m) == (PROPERLY_OVERSIZED, 1.0, 3.0)
    under = balancing_margins(1.0, 2.0, 4.0)
    assert (under.region, under.may_grow_kg_m, under.may_shrink_kg_m) == (UNDERSIZED, None, 1.0)
    improper = balancing_margins(1.0, 6.0, 4.0)
    assert (improper.region, improper.may_grow_kg_m, improper.may_shrink_kg_m) == (IMPROPERLY_OVERSIZED, 1.0, None)
    assert balancing_margins(1.0, 1.0, 0.5).may_shrink_kg_m is None, "equal pendulums balance any smaller imbalance"
    assert balancing_margins(1.0, 6.0, 4.0).least_kg_m == pytest.approx(5.0)

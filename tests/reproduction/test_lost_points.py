"""3.6, 3.7 and the open question: borders, what is stable, and where releases end; few points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from reproduction.items import lost_points, open_lost_points, slips
from tests.reproduction.judged import column, made, verdicts


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (lost_points, open_lost_points):
        monkeypatch.setattr(module, "ZETAS", module.ZETAS[::6])
        monkeypatch.setattr(module, "RATIOS", module.RATIOS[::5])
        monkeypatch.setattr(module, "RELEASED", (2, 4))
    monkeypatch.setattr(slips, "MOST_REVOLUTIONS", 2500)


def test_properly_oversized(tmp_path: Path) -> None:
    found = made("3.6", tmp_path)
    judged = verdicts(found)
    assert judged["The area ends upwards at the critical speed, at any damping: above it Type I is stable."] == (
        "holds in part"
    )
    assert judged["At most one type of singular point is stable."] == "holds"
    zeta, ratio = (column(found, "map", name) for name in ("zeta", "speed_ratio"))
    stable = column(found, "map", "stable_c34_0.1")
    share = 1 / 1.8  # S_P over S_A + S_B
    lost = 2 * zeta * ratio > np.abs(1 - ratio**2) * share / np.sqrt(1 - share**2)
    below = ratio < 0.99
    assert np.array_equal(stable[below] == "none", lost[below])
    assert set(stable[ratio > 1.05]) == {"I"}
    ends = column(found, "releases", "ends")
    assert {"I", "III"} <= set(ends)


def test_improperly_oversized(tmp_path: Path) -> None:
    found = made("3.7", tmp_path)
    judged = verdicts(found)
    assert judged["Undersized pendulums lose no singular point at any speed or damping."] == "holds"
    slipping = "Where no singular point is stable the pendulums slip on the rotor for ever."
    assert judged[slipping] == "holds"
    ends, turns = column(found, "releases", "ends"), column(found, "releases", "turns_per_revolution_A")
    assert np.all(turns[ends == "slipping"] < -1e-3), "behind the rotor"


def test_a_rig_that_slips_is_no_rig_that_locks() -> None:
    ends = slips.Ends(np.array(["I", slips.SLIPPING, slips.SWINGING]), np.array([[0, 0], [-0.1, 0], [0, 0.0]]))
    bare = np.array([False, True, True])
    assert slips.turning(ends).tolist() == [False, True, False]
    assert slips.slip_verdict(ends, bare) == "holds in part"
    assert slips.slip_verdict(ends, np.array([False, True, False])) == "holds"
    assert slips.slip_verdict(ends, np.array([True, True, False])) == "does not hold"
    text = slips.slip_rates_text(ends, bare, np.array([1.0, 2.0, 3.0]))
    assert "0.1000 … 0.100 turns" in text
    assert "1.80 … 1.80 ω_n" in text
    assert slips.slip_rates_text(ends, np.array([True, False, False]), np.ones(3)) == "none slips"


def test_two_stiffnesses(tmp_path: Path) -> None:
    found = made("open-lost-points", tmp_path)
    judged = verdicts(found)
    assert judged["Where Type I is unstable another type is stable instead."] == "does not hold"
    stable, ratio = column(found, "map", "stable"), column(found, "map", "speed_ratio")
    assert set(stable[np.abs(ratio - 1.9) < 0.3]) == {"I"}, "point B's area"
    assert "none" in set(stable[np.abs(ratio - 3.9) < 0.3]), "the second resonance"

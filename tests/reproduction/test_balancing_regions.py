"""3.2 to 3.5: which claims hold, and numbers known otherwise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynamics.equations.balancing import balancing_region
from reproduction.items import balancing_regions
from tests.reproduction.judged import column, made, verdicts


def test_regions_are_where_releases_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(balancing_regions, "GRID", 6)
    monkeypatch.setattr(balancing_regions, "STEP", 0.3)
    found = made("3.2", tmp_path)
    assert set(verdicts(found).values()) == {"holds"}
    a, b = (column(found, "releases", name) / 2.5404 for name in ("S_A_g_m", "S_B_g_m"))
    inside = (a + b >= 1) & (np.abs(a - b) <= 1)
    assert np.array_equal(column(found, "releases", "reached") == "I", inside)
    assert 20 < inside.sum() < len(a) - 10, "sets on both sides"


def test_a_region_named_wrongly_is_refuted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(balancing_regions, "GRID", 2)
    monkeypatch.setattr(balancing_regions, "STEP", 0.3)
    monkeypatch.setattr(balancing_regions, "balancing_region", lambda a, b, s: balancing_region(a, b, 1.4 * s))
    found = verdicts(made("3.2", tmp_path))
    assert list(found.values()) == ["does not hold"] * 4


def test_equal_pendulums_are_never_improperly_oversized(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(balancing_regions, "EQUAL", (0.1, 0.45, 1.1))
    found = made("3.3", tmp_path)
    assert set(verdicts(found).values()) == {"holds"}
    assert set(column(found, "equal", "reached")) == {"I", "III"}


def test_rings_and_what_opposed_pendulums_are_worth(tmp_path: Path) -> None:
    found = made("3.4", tmp_path)
    wrong = [statement for statement, verdict in verdicts(found).items() if verdict != "holds"]
    assert wrong == ["Improperly oversized pendulums reduce the vibration where |S_A − S_B| < S_P, else they raise it."]
    share, far = column(found, "opposed", "difference_over_S_P"), column(found, "opposed", "speed_ratio_20")
    assert np.interp(1.5, share, far) == pytest.approx(0.5, abs=0.01), "far above resonance |1 − 1.5|"
    assert np.interp(2.5, share, far) == pytest.approx(1.5, abs=0.01)
    place = (column(found, "rings", "S_A_g_m") - column(found, "rings", "S_B_g_m")) == 0
    assert np.array_equal(column(found, "rings", "inner_mm") == 0, place)


def test_poses_have_the_numbers_of_the_closed_form(tmp_path: Path) -> None:
    found = made("3.5", tmp_path)
    wrong = [statement for statement, verdict in verdicts(found).items() if verdict != "holds"]
    assert wrong == ["Singular points fulfil the four equations as printed."]
    assert column(found, "points", "theta3_deg")[1:] == pytest.approx([174.456, 303.708], abs=5e-4)
    assert column(found, "points", "radius_mm") == pytest.approx([0, 0.334778, 2.325497], abs=5e-7)

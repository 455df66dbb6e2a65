"""Figures 3.15, 3.18 and 3.21 to 3.24 with few recordings: verdicts, and the one that is refuted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from reproduction.items import recorded_shifts, shifted_pivots
from tests.effort import thorough
from tests.reproduction.judged import column, made, verdicts


@pytest.mark.parametrize("number", [pytest.param("3.15", marks=thorough), "3.18"])
def test_a_release_is_followed(number: str, tmp_path: Path) -> None:
    found = made(number, tmp_path)
    assert set(verdicts(found).values()) == {"holds"}
    time, theta = column(found, "angles", "time_s"), column(found, "angles", "theta3_deg")
    assert np.ptp(theta[time < 0]) < 0.5, "locked"
    assert abs(theta[-1] - theta[0]) > 60


def test_shifted_pivots_computed(tmp_path: Path) -> None:
    found = made("3.21", tmp_path)
    wrong = [statement for statement, verdict in verdicts(found).items() if verdict != "holds"]
    assert wrong == ["The eccentricity that ρ_C counts in is M_P P_3/(M_D + M_P)."]
    assert set(verdicts(made("3.22", tmp_path)).values()) == {"holds"}


@thorough
def test_shifted_pivots_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorded_shifts, "RECORDED", (0.0, 0.5, 1.5, 2.6, 3.0))
    monkeypatch.setattr(recorded_shifts, "_FRICTION_STARTS", 4)
    for number in ("3.23", "3.24"):
        assert set(verdicts(made(number, tmp_path)).values()) == {"holds"}


def test_mirrored_pairs_come_to_one_side() -> None:
    pairs = np.radians([[120.0, 240.0], [240.0, 120.0]])
    first, second = shifted_pivots.one_side(pairs)
    assert np.degrees(first) % 360 == pytest.approx([120, 120])
    assert np.degrees(second) % 360 == pytest.approx([240, 240])
    assert shifted_pivots.apart_deg(pairs) == pytest.approx([120, 120])

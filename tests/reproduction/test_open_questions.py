"""The source's open questions and its run-up program: answers, and numbers they rest on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from reproduction.items import open_questions
from tests.reproduction.judged import column, made, verdicts


def test_gravity_unlocks_slow_pendulums(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(open_questions, "_GRAVITY_RATIOS", np.array([1.6, 2.6, 3.3, 5.8, 8.0]))
    found = made("open-gravity", tmp_path)
    assert list(column(found, "gravity", "state")) == ["none", "none", "III", "I", "I"]
    assert verdicts(found)["(Question) The balancer works on a horizontal shaft."] == "holds in part"
    swing = column(found, "gravity", "swing_deg")
    assert swing[-1] == pytest.approx(np.degrees(9.81 / (0.054 * (2 * np.pi * 3 * 8.0) ** 2)), rel=0.05)


def test_the_best_damping_lies_between(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(open_questions, "_C34", np.geomspace(1e-4, 0.1, 7))
    found = made("open-damping", tmp_path)
    assert verdicts(found)["(Question) There is a best damping of the pendulums."] == "holds"
    times = column(found, "time-constants", "B_s")
    assert times[-1] > 50 * np.min(times)


def test_type_three_is_stable_at_some_points_where_type_one_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(open_questions, "_GRID", (12, 4))
    found = made("open-type-iii", tmp_path)
    assert set(verdicts(found).values()) == {"holds in part"}
    classes = column(found, "classes", "class_zeta_0.02")
    assert {"I alone", "III alone", "neither"} <= set(classes)


def test_reaction_over_the_damping(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(open_questions, "_STEP_C34", np.array([2e-4, 1e-3, 3e-2]))
    found = made("open-step", tmp_path)
    assert verdicts(found)["(Question) The pendulums balance the changed rotor again."] == "holds"
    assert column(found, "reaction", "C_s")[2] > 5 * column(found, "reaction", "C_s")[1]


def test_the_run_up_program(tmp_path: Path) -> None:
    found = made("script", tmp_path)
    assert list(verdicts(found).values()) == ["does not hold", "does not hold", "does not hold", "holds"]
    right, wrong = (column(found, "run", f"theta3_deg_{name}") for name in ("right", "programmed"))
    time = column(found, "run", "time_s")
    assert np.max(np.abs(right[time < 3])) < 1e-9
    assert np.max(np.abs(right - wrong)) > 50

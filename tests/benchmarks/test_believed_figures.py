"""The driver of the coverage campaigns: its statistics, what it keeps, what it resumes; one campaign end to end."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, strategies as st
from scipy.stats import binom

from benchmarks import believed_figures as figures
from benchmarks.worlds import Effects, Spread, campaign as laboratory
from benchmarks.worlds.campaign import Plan, campaign, is_routine, names_effect
from uncertainty.binomial import binomial_interval

PLAN = Plan(Spread(), Effects())


def row(seed: int, z: float = 0.5, passed: bool = True, warnings: tuple[str, ...] = ()) -> dict[str, Any]:
    """A campaign's line."""
    verdict = "pass" if passed else "fail"
    return {
        "seed": seed,
        "z": {"k1_N_per_m": z},
        "std": {"k1_N_per_m": 0.1},
        "parameters": {"k1_N_per_m": 2600.0},
        "axis": {"found_deg": 1.0, "std_deg": 0.1, "true_deg": 1.0},
        "warnings": list(warnings),
        "passed": passed,
        "points": {"A": {"verdict": verdict, "state": "III", "why": "", "z": {"theta3": z}}},
        "wrong": "",
        "by": 0.0,
        "seconds": {"data": 1.0, "identification": 2.0 + seed, "validation": 3.0},
    }


@given(trials=st.integers(1, 200), share=st.floats(0, 1))
def test_the_binomial_interval_leaves_a_fortieth_on_each_side(trials: int, share: float) -> None:
    hits = round(share * trials)
    low, high = binomial_interval(hits, trials)
    assert 0 <= low <= hits / trials <= high <= 1
    if hits:
        assert binom.sf(hits - 1, trials, low) == pytest.approx(0.025, rel=1e-6)
    if hits < trials:
        assert binom.cdf(hits, trials, high) == pytest.approx(0.025, rel=1e-6)


def test_the_summary_counts() -> None:
    rows = [row(0), row(1, z=2.5, passed=False, warnings=("dry friction of A",)), row(2, z=-1.0)]
    text = figures.summary(rows, Effects())
    assert "k1_N_per_m                3  0.667" in text
    assert "pass: 2 of 3" in text
    assert "A: 2 pass, 1 fail" in text
    assert "false alarms: 1 of 3" in text
    assert "identification 3.00 s" in text
    assert "1 of 1 warnings name it, in 1 of 3 campaigns" in figures.summary(rows, Effects(dry=0.01))
    twice = rows[1] | {"joint": rows[1]}  # a warning of both identifications is one warning
    assert "1 of 1 warnings name it, in 1 of 1 campaigns" in figures.summary([twice], Effects(dry=0.01))
    broken = figures.summary([*rows, {"seed": 3, "error": "NotIdentifiable: none"}], Effects())
    assert "4 campaigns, 1 broke off" in broken
    assert "seed 3: NotIdentifiable" in broken


def test_which_warnings_name_an_effect() -> None:
    usual = "spin-down: by itself it does not exclude dry friction of A and B"
    assert is_routine(usual)
    assert not names_effect(usual, Effects(dry=0.01))
    assert names_effect("a line at 50.00 Hz of 20 µm", Effects(hum_m=1e-5))
    assert not names_effect("a line at 50.00 Hz of 20 µm", Effects(bow_m=1e-4))


def test_an_interrupted_series_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def made(seed: int, plan: Plan) -> dict[str, Any]:
        asked.append(seed)
        return row(seed)

    monkeypatch.setattr(figures, "campaign", made)
    out = tmp_path / "series.jsonl"
    figures.run(range(3), PLAN, 1, out, resume=False)
    text = out.read_text()
    out.write_text(text + text.splitlines()[0][:40] + "\n")  # a line that was cut off
    found = figures.run(range(5), PLAN, 1, out, resume=True)
    assert asked == [0, 1, 2, 3, 4]
    assert [one["seed"] for one in found] == [0, 1, 2, 3, 4]
    figures.run(range(1), Plan(Spread(), Effects(hum_m=1e-5)), 1, out, resume=True)
    assert asked[-1] == 0, "a line of another series was taken"


def test_the_command_line_is_read(capsys: pytest.CaptureFixture[str]) -> None:
    given_, plan = figures.parsed(["--seeds", "3:5", "--effect", "hum=1e-5", "--effect", "dry", "--wrong", "k2=7"])
    assert given_.seeds == range(3, 5)
    assert (plan.effects.hum_m, plan.effects.dry, plan.wrong, plan.by) == (1e-5, 0.01, "k2", 7.0)
    for arguments, word in (
        (["--effect", "colour"], "cubic"),
        (["--wrong", "k9"], "zeta1"),
        (["--resume"], "--out"),
        (["--seeds", "5:5"], "A < B"),
        (["--seeds", "5"], "A < B"),
        (["--out", __file__], "--resume"),
    ):
        with pytest.raises(SystemExit):
            figures.parsed(arguments)
        assert word in capsys.readouterr().err


def test_a_campaign_that_breaks_off_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("somewhere")

    monkeypatch.setattr(laboratory, "identified", broken)
    found = campaign(0, PLAN)
    assert found["error"] == "ZeroDivisionError: somewhere"
    assert found["truth"]
    assert "seed 0: ZeroDivisionError" in figures.summary([found, row(1)], Effects())


@pytest.mark.lengthy
def test_a_campaign_end_to_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was identified lies near the truth, the points and a further run-up are judged, and all of it is JSON."""
    seen, check = list[tuple[str, ...]](), laboratory.check_run_ups
    monkeypatch.setattr(
        laboratory, "check_run_ups", lambda *a: [rows for rows in check(*a) if seen.append(rows.rows) or True]
    )
    found = json.loads(json.dumps(campaign(0, replace(PLAN, run_up_after=True))))
    assert len(seen) == 1
    assert "zeta1" in seen[0]  # not taken for the run-up that has identified it
    assert "error" not in found
    assert max(abs(z) for z in found["z"].values()) < 5
    assert all(abs(found["parameters"][n] / found["truth"][n] - 1) < 0.01 for n in found["truth"])
    assert {name: point["state"] for name, point in found["points"].items()} == {
        "A": "III",
        "B": "I",
        "C": "I",
        "D": "III",
        "E": "I",
    }
    assert set(found["seconds"]) == {"data", "identification", "validation"}

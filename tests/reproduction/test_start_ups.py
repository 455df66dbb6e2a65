"""Section 3.3.2: which claims hold for recorded start-ups of both balancers, and the numbers of the contact."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from reproduction.items import friction_arms, start_ups
from tests.effort import thorough
from tests.reproduction.judged import column, made, verdicts


@thorough
def test_balls_scatter_and_reduce(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(start_ups, "COUNT", 3)
    found = made("3.27", tmp_path)
    verdict_of = verdicts(found)
    assert verdict_of["Without balls the amplitude is 0.80475 mm."] == "holds in part"
    assert [verdict for statement, verdict in verdict_of.items() if "0.80475" not in statement] == ["holds"] * 3
    assert "requires a rotor of 3.37 kg as an amplitude (0–peak) and of 6.76 kg" in found.claims[0]["computed"]
    assert column(found, "start-ups", "amplitude_pp_mm").max() < 0.80475
    places = column(found, "start-ups", "higher_deg") - column(found, "start-ups", "lower_deg")
    assert np.all(places > 0)
    assert np.ptp(column(found, "start-ups", "lower_deg")) > 3


@thorough
def test_pendulums_settle_alike(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(start_ups, "COUNT", 4)
    found = made("3.29", tmp_path)
    verdict_of = verdicts(found)
    assert verdict_of["With the pendulums locked at 0° and 180° the amplitude is 1.75 mm."] == "holds in part"
    assert list(verdict_of.values())[1:] == ["holds", "holds"]
    assert np.ptp(column(found, "start-ups", "lower_deg")) < 0.3
    assert column(found, "start-ups", "amplitude_pp_mm").max() < 0.02
    closer = made("3.30", tmp_path)
    assert set(verdicts(closer).values()) == {"holds"}


def test_contact_and_arms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(friction_arms, "COUNT", 6)
    found = made("3.28", tmp_path)
    verdict_of = verdicts(found)
    assert verdict_of["Ball and channel come together by 16 µm at 1500 rpm."] == "does not hold"
    assert verdict_of["A chrome-steel ball of 15 mm weighs 13.8 g."] == "holds"
    assert verdict_of["Friction holds a ball on a longer lever than it holds a pendulum."] == "holds in part"
    assert verdict_of["Pendulum balancers are less susceptible to friction than ball balancers."] == "holds in part"
    assert verdict_of["Rolling resistance stops the balls before they balance, and that leaves a vibration."] == "holds"
    arms = column(found, "arms", "friction_arm_um")
    assert arms[1] == pytest.approx(152, abs=0.1)
    balls, pendulums = (column(found, f"scatter-{n}", "scatter_deg") for n in (1, 3))
    assert np.all(balls[:6] > 5 * pendulums[:6]), "arms up to 60 µm"

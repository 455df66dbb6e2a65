"""Chapter 3.2: curves over the imbalance with few recordings, verdicts, and what is different when it is wrong."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from dynamics import steady_states
from reproduction.items import identical_pendulums, nonidentical_pendulums, switching
from reproduction.items.imbalance_curves import Series, StartUpComparison, amplitude_claim, angle_claim
from reproduction.recorded import as_stated
from reproduction.workspace import Workspace
from rig_configs import load_rig
from tests.dynamics.nominal import rig
from tests.effort import thorough
from tests.reproduction.judged import column, made, verdicts


def _few(module, name: str, monkeypatch: pytest.MonkeyPatch, moments: tuple[float, ...], count: int = 1) -> None:
    series: Series = getattr(module, name)
    monkeypatch.setattr(module, name, replace(series, recorded_kg_m=moments, count=count))


def test_the_truth_is_what_the_file_states() -> None:
    settings = ("imbalance.radius_m=0.03", "suspension.zeta1=0.01")
    found = load_rig("isotropic", settings=list(as_stated("isotropic", settings)))
    assert found.true_physics == found.physics
    assert found.physics.imbalance_radius_m == 0.03
    assert load_rig("isotropic", settings=list(settings)).true_physics != found.physics


def test_below_resonance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _few(nonidentical_pendulums, "BELOW", monkeypatch, (0.0030,))
    found = made("3.11", tmp_path)
    judged = verdicts(found)
    assert judged.pop("Below resonance the rotor whirls steadily even without imbalance.") == "holds in part"
    assert set(judged.values()) == {"holds"}
    slip, p = column(found, "slipping", "slip_rad_s"), rig(1.0, 0.05, mass_b=0.037)
    assert np.all(slip < -1e-3)
    own = p.speed_rad_s(found.record["parameters"]["speed_ratio"]) + slip[0]  # the pendulums' whirl, without imbalance
    response = complex(p.k1_N_per_m - p.total_mass_kg * own**2, own * p.damping_Ns_per_m[0])
    moment = p.a.first_moment_kg_m + p.b.first_moment_kg_m
    assert column(found, "slipping", "radius_mm")[0] == pytest.approx(1e3 * own**2 * moment / abs(response), rel=0.02)
    positions = made("3.12", tmp_path)
    wrong = [statement for statement, verdict in verdicts(positions).items() if verdict != "holds"]
    assert wrong == ["Below resonance the pendulums stay together, wherever the balancing area lies."], "one area only"


@thorough
def test_above_resonance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _few(nonidentical_pendulums, "ABOVE", monkeypatch, (0.0013, 0.0040))
    for number in ("3.13", "3.14"):
        assert set(verdicts(made(number, tmp_path)).values()) == {"holds"}
    assert list(column(made("3.13", tmp_path), "recorded", "type")) == ["II", "I"]


@thorough
def test_equal_pendulums(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _few(identical_pendulums, "SERIES", monkeypatch, (0.0040,), 2)
    monkeypatch.setattr(identical_pendulums, "GRID", 3)
    found = made("3.16", tmp_path)
    judged = verdicts(found)
    assert judged.pop("Small differences of the pendulums make the two positions leave different vibration.") == (
        "holds in part"
    )
    assert set(judged.values()) == {"holds"}
    differ = dict(
        zip(column(found, "imperfections", "imperfection"), column(found, "imperfections", "differ"), strict=True)
    )
    assert differ["B heavier by 0.5 %"] == "no"
    assert differ["both pivots 25 µm across"] == "no"
    assert differ["pivots ± 25 µm across"] == "yes"
    assert differ["pivot of A 25 µm oblique"] == "yes"
    assert differ["torque of 10 µN m on both"] == "no"
    assert differ["bent shaft, 25 µm across"] == "no"
    positions = verdicts(made("3.17", tmp_path))
    assert positions["The wishbone of equal pendulums is symmetric."] == "holds"
    assert positions["Above S_P = 0.005 kg m the settled positions no longer depend on the start."] == "holds in part"


def test_a_release_falls_to_the_side_of_the_unstable_rest() -> None:
    p = rig(1.0, 0.01)
    lag = math.degrees(math.atan2(2 * 0.01 * 3.5, 3.5**2 - 1))
    starts = np.array([[lag - 0.05, lag - 0.05], [lag + 0.05, lag + 0.05]])
    ends = identical_pendulums._released(p, 0.003, starts)
    assert (np.sin(ends[:, 0]) < 0).tolist() == [True, False]


def test_left_vibration_ends_where_the_positions_meet() -> None:
    p = rig(1.0, 0.01)
    curves = switching.imperfect_curves(p, 2.5)
    common, across, *_ = curves
    assert np.nanmax(np.abs(common.first_m - common.second_m)) < 1e-12
    assert common.first_m[~np.isnan(common.first_m)] == pytest.approx(25e-6)
    low = np.searchsorted(across.moment_kg_m, [0.001, 0.005])
    difference = np.abs(across.first_m - across.second_m)[low]
    assert difference[0] < difference[1]


def test_a_wrong_model_is_refuted(tmp_path: Path) -> None:
    work = Workspace(tmp_path)
    ((moment, one),) = replace(nonidentical_pendulums.ABOVE, recorded_kg_m=(0.0092,)).recordings(work)
    speed = one.measured.speed_rad_s.value
    (state,) = [s for s in steady_states(one.rig.physics, speed) if s.stable]
    right = [StartUpComparison(moment, one, state)]
    assert amplitude_claim("", right).verdict == "holds"
    assert angle_claim("", right).verdict == "holds"
    heavier = replace(one.rig.physics, k1_N_per_m=1.1 * state_stiffness(one), k2_N_per_m=1.1 * state_stiffness(one))
    (other,) = [s for s in steady_states(heavier, speed) if s.stable]
    assert amplitude_claim("", [StartUpComparison(moment, one, other)]).verdict == "does not hold"
    turned = SimpleNamespace(type="III", theta_rad=(state.theta_rad[0] + 0.01,) * 2, amplitude_m=state.amplitude_m)
    assert angle_claim("", [StartUpComparison(moment, one, turned)]).verdict == "does not hold"


def state_stiffness(one) -> float:
    """k1 of a recording's rig."""
    return one.rig.physics.k1_N_per_m

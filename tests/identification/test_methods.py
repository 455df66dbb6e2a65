"""The row of a test states what identification takes from it; an added row needs no change of the estimators."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from synthetic import Campaign

from daq import guided_test_kinds as kinds
from daq.guided_test_kinds import KINDS, TestKind
from identification import NotIdentifiable, identify
from identification.methods import advice, methods_of, pulled_along
from rig_configs import load_rig
from tests.identification.added_rows import row

Add = Callable[[TestKind], None]


@pytest.fixture
def add(monkeypatch: pytest.MonkeyPatch) -> Add:
    table = dict(KINDS)
    monkeypatch.setattr(kinds, "KINDS", table)
    monkeypatch.setattr("identification.methods.KINDS", table)

    def add_row(kind: TestKind) -> None:
        table[kind.name] = kind

    return add_row


def test_the_rows_that_there_are_select_the_estimators_that_there_are() -> None:
    assert {name: methods_of(kind) for name, kind in KINDS.items()} == {
        "ring-down-x": ("ring-down",),
        "ring-down-y": ("ring-down",),
        "spin-down": ("spin-down",),
        "run-up": ("passage",),
        "run-down": ("passage",),
        "point": ("release",),
        "start-ups": (),
    }
    assert [pulled_along(name) for name in ("ring-down-x", "ring-down-y", "run-up", "spin-down", "none")] == [
        "x",
        "y",
        None,
        None,
        None,
    ]


def test_another_ring_down_gives_what_its_row_states(add: Add) -> None:
    campaign = Campaign(1)
    struck = dataclasses.replace(campaign.ring_down("x"), test="ring-down-struck")
    along_y = campaign.ring_down("y")
    with pytest.raises(NotIdentifiable, match="ring-down-struck passed over: no known kind of test"):
        identify([struck], campaign.rig)
    add(row("ring-down-struck", ("x",), turns=False, gives=("k1_N_per_m", "zeta1")))
    found = identify([struck, along_y], campaign.rig)
    assert [(e.test, e.names) for e in found.estimates] == [
        ("ring-down-struck", ("k1_N_per_m", "zeta1")),
        ("ring-down-y", ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2")),
    ]
    truth, std = campaign.truth.identified(), found.parameters.std
    for name, value in found.parameters.values.items():
        assert abs(value - truth[name]) < 4 * std[name]


def test_a_lone_sensor_shows_the_axis_that_the_row_needs(add: Add) -> None:
    campaign, none = Campaign(1), np.empty(0)
    struck = dataclasses.replace(campaign.ring_down("y"), test="struck", x_time_s=none, x_m=none)
    add(row("struck", ("x",), turns=False, gives=("k1_N_per_m", "zeta1")))
    with pytest.raises(NotIdentifiable, match="pulled along x, but only laser y works"):
        identify([struck], campaign.rig)
    add(row("struck", ("y",), turns=False, gives=("k2_N_per_m",)))
    assert list(identify([struck], campaign.rig).parameters.values) == ["k2_N_per_m"]


def test_a_test_with_the_rotor_turning_gives_what_its_row_states(add: Add) -> None:
    campaign = Campaign(2)
    passage = dataclasses.replace(campaign.run_up(), test="slow-sweep")
    add(row("slow-sweep", ("x", "y", "phase"), turns=True, gives=("SP_kg_m",)))
    found = identify([passage], campaign.rig)
    assert list(found.parameters.values) == ["SP_kg_m"]
    assert abs(found.parameters.values["SP_kg_m"] / campaign.truth.identified()["SP_kg_m"] - 1) < 5e-3


def test_a_spin_down_of_one_pendulum(add: Add) -> None:
    campaign = Campaign(2)
    run = dataclasses.replace(campaign.spin_down(), test="spin-down-a")
    add(row("spin-down-a", ("angles",), turns=False, gives=("c3_Nms_per_rad",)))
    assert list(identify([run], campaign.rig).parameters.values) == ["c3_Nms_per_rad"]


def test_a_row_that_gives_nothing_is_passed_over_in_words(add: Add) -> None:
    campaign = Campaign(1)
    add(row("slow-roll", ("x", "y", "phase"), turns=True))
    runout = dataclasses.replace(campaign.ring_down("x"), test="slow-roll")
    found = identify([runout, campaign.ring_down("x")], campaign.rig)
    (message,) = [w for w in found.warnings if "passed over" in w]
    assert message.startswith("slow-roll passed over: it determines no parameter")


def test_advice_names_tests_that_the_rig_can_do(add: Add) -> None:
    one = load_rig("one_laser").roles
    names = ["k1_N_per_m", "c3_Nms_per_rad", "SP_kg_m"]
    assert advice(names, []) == "record ring-down-x, ring-down-y, spin-down, run-up"
    assert advice(names, [], one) == "record ring-down-x"
    assert advice(["c3_Nms_per_rad"], [], one) == "no test that this rig can do gives them"
    add(row("free-spin", ("x",), turns=False, gives=("c3_Nms_per_rad",)))
    assert advice(["c3_Nms_per_rad"], [], one) == "record free-spin"

"""Requests of guided tests are checked before a device is opened."""

from __future__ import annotations

import math

import pytest

from daq.guided_tests import test_inputs
from rig_configs import load_rig

RIG = load_rig("virtual")


@pytest.mark.parametrize(
    ("test", "top_rpm", "duration_s", "words"),
    [
        ("run-up", 5000.0, 40.0, "5000 rpm requested, limits.speed_rpm is 1200: nothing was turned"),
        ("run-down", 1200.5, 40.0, "limits.speed_rpm"),
        ("run-up", 900.0, 0.0, "duration above 0 s"),
        ("run-up", 900.0, -5.0, "duration above 0 s"),
        ("run-up", 900.0, math.nan, "duration above 0 s"),
        ("run-up", 900.0, math.inf, "duration above 0 s"),
        ("run-up", math.nan, 40.0, "expected a speed of 1 to 1200 rpm"),
        ("run-up", -900.0, 40.0, "expected a speed"),
        ("run-up", 0.0, 40.0, "expected a speed"),
        ("run-up", 900.0, 1e-9, "is a ramp of"),
        ("run-up", 900.0, 1e9, "is a ramp of"),
        ("run-up", 150.0, 40.0, "passes no resonance"),
        ("point-Z", 0.0, 1.0, "no such test. Known: ring-down-x"),
        ("run-sideways", 900.0, 40.0, "no such test"),
    ],
)
def test_what_cannot_be_run_is_refused_with_what_can(test: str, top_rpm: float, duration_s: float, words: str) -> None:
    ramp = {"top_rpm": top_rpm, "duration_s": duration_s} if test.startswith("run-") else {}
    assert words in test_inputs.refusal(RIG, test, ramp)


def test_what_the_rig_has_is_not_refused() -> None:
    top = test_inputs.default_top_rpm(RIG)
    one_speed = {"start-ups": {"speed_rpm": 300.0}}
    refused = [test_inputs.refusal(RIG, test, one_speed.get(test)) for test in test_inputs.test_names(RIG)]
    assert refused == [""] * 11
    assert test_inputs.ramp_warning(RIG, top) == ""
    assert test_inputs.refusal(RIG, "run-up", {"top_rpm": 600.0}) == ""
    assert "below the resonance expected at 695 rpm" in test_inputs.ramp_warning(RIG, 600.0)


def test_a_point_beyond_the_limit_is_refused() -> None:
    stiff = load_rig("virtual", settings={"limits.speed_rpm": 300.0})
    assert test_inputs.refusal(stiff, "point-A") == ""
    assert "limits.speed_rpm is 300" in test_inputs.refusal(stiff, "point-E")

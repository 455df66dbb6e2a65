"""The speed of a drive against the index marks: simulated rotors whose drive is right, late, coarse or wrong."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from daq.signals.speed_agreement import SpeedAgreement, speed_agreement


def compared(
    true_rpm: float, scale: float = 1.0, *, ramp_rpm_s: float = 0.0, late_s: float = 0.02, span_s: float = 3.0
) -> SpeedAgreement | None:
    """Compare the marks of a rotor with a drive that reports `scale` × its speed in whole rpm, `late_s` later."""
    fine = np.arange(0.0, span_s, 1e-4)
    speed = true_rpm + ramp_rpm_s * (fine - span_s)
    turns = np.cumsum(speed) / 60.0 * 1e-4
    whole = np.arange(math.ceil(turns[0]), math.floor(turns[-1]) + 1)
    jitter = 1e-4 * np.random.default_rng(1).standard_normal(len(whole))
    marks = np.interp(whole, turns, fine) + jitter
    reports = np.arange(0.0, span_s, 0.01)
    rpm = np.trunc(scale * np.interp(reports - late_s, fine, speed))
    return speed_agreement(marks, whole, reports, rpm)


@settings(max_examples=60, deadline=None)
@given(
    st.floats(200.0, 1200.0),
    st.floats(-0.005, 0.005),
    st.floats(-60.0, 60.0),
    st.floats(0.0, 0.1),
)
def test_a_drive_that_is_right_agrees_on_every_ramp(true_rpm: float, slip: float, ramp: float, late_s: float) -> None:
    found = compared(true_rpm, 1 + slip, ramp_rpm_s=ramp if ramp < true_rpm / 4 else 0.0, late_s=late_s)
    assert found.agrees, found.words


@pytest.mark.parametrize("ramp", [0.0, 22.0])
@pytest.mark.parametrize(
    ("true", "set_", "named"),
    [(7, 8, "8:7"), (8, 7, "7:8"), (4, 3, "3:4"), (2, 1, "1:2"), (1, 2, "2:1"), (14, 13, "13:14")],
)
def test_a_wrong_number_of_pole_pairs_is_found_and_named(true: int, set_: int, named: str, ramp: float) -> None:
    """A drive divides the electrical speed by the number set, so it reports true/set of the rotor's speed."""
    found = compared(544.0, true / set_, ramp_rpm_s=ramp, span_s=6.0)
    assert not found.agrees
    assert f"likely {named}. " in found.words
    assert "544 rpm" in found.words or ramp


@pytest.mark.parametrize(
    ("scale", "named"),
    [(60.0, "revolutions per second"), (math.pi / 30, "rad/s taken for rpm"), (10.0, "0.1 rpm"), (0.1, "0.1 rpm")],
)
def test_a_wrong_unit_is_named(scale: float, named: str) -> None:
    found = compared(900.0, scale)
    assert named in found.words


@pytest.mark.parametrize("share", [0.97, 1.04, 0.947])
def test_a_slow_drive_is_found_without_a_ratio_that_it_is_not(share: float) -> None:
    found = compared(700.0, share)
    assert not found.agrees
    assert "no simple ratio" in found.words


def test_the_uncertainty_follows_the_interval_and_the_change_of_speed() -> None:
    steady, short, ramp = compared(600.0), compared(600.0, span_s=0.7), compared(600.0, ramp_rpm_s=60.0)
    assert steady.ratio_std < short.ratio_std < ramp.ratio_std


@pytest.mark.parametrize("case", ["standing", "few turns", "no reports", "a gap in the reports"])
def test_what_cannot_be_compared_has_no_ratio(case: str) -> None:
    times, turns, reports = np.arange(0.0, 3.0, 0.1), np.arange(30), np.arange(0.0, 3.0, 0.01)
    rpm = np.full(len(reports), 600.0)
    if case == "standing":
        rpm[:] = 0.0
    elif case == "few turns":
        times, turns = times[:4], turns[:4]
    elif case == "no reports":
        reports, rpm = reports[:0], rpm[:0]
    else:
        rpm[40] = np.nan
    assert speed_agreement(times, turns, reports, rpm) is None

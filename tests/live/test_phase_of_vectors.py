"""Phases of the page's 1× vectors: without the lag of the stamps where it is estimated, else with its uncertainty."""

from __future__ import annotations

import math

import numpy as np
import pytest

from analysis.quantities.stamp_lag import UNKNOWN_LAG_STD_S
from live.vectors import clocks_of, without_lags
from rig_configs import load_rig

CLOCKS = {"x": "laser", "y": "laser", "phase": "radio"}
RPM = np.linspace(100.0, 900.0, 200)


def rows(lag_s: float, turned_deg: float = 0.0) -> np.ndarray:
    """Vectors through two resonances with stamps that are late."""
    speed = RPM * math.pi / 30
    turn = np.exp(1j * (math.radians(turned_deg) - speed * lag_s))
    x, y = (speed**2 / (w**2 - speed**2 + 0.1j * w * speed) * turn for w in (36.0, 49.0))
    return np.column_stack([RPM, x.real, x.imag, y.real, y.imag])


def test_the_lag_by_the_planned_ramp_is_taken_out() -> None:
    shown, lags = without_lags(rows(12e-3), rows(0.0), CLOCKS)
    assert shown == pytest.approx(rows(0.0), abs=1e-6)
    assert [lag.lag_s for lag in lags.values()] == pytest.approx([12e-3, 12e-3], abs=1e-6)


@pytest.mark.parametrize("planned", [None, rows(0.0)[:0]])
def test_an_unknown_lag_is_stated(planned: np.ndarray | None) -> None:
    shown, lags = without_lags(rows(12e-3), planned, CLOCKS)
    assert np.array_equal(shown, rows(12e-3))
    assert {axis: lag.std_s for axis, lag in lags.items()} == {"x": UNKNOWN_LAG_STD_S, "y": UNKNOWN_LAG_STD_S}


def test_another_difference_than_a_lag_stays() -> None:
    shown, lags = without_lags(rows(0.0, turned_deg=30.0), rows(0.0), CLOCKS)
    assert np.array_equal(shown, rows(0.0, turned_deg=30.0))
    assert not any(lag.is_line for lag in lags.values())


def test_one_clock_has_no_lag() -> None:
    _, lags = without_lags(rows(0.0), None, dict.fromkeys(CLOCKS, "converter"))
    assert [lag.std_s for lag in lags.values()] == [0.0, 0.0]


def test_the_clocks_are_those_of_the_devices() -> None:
    assert clocks_of(load_rig("virtual").roles) == {"x": "laser_x", "y": "laser_y", "phase": "encoder"}

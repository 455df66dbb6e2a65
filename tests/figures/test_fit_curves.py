"""Curves of fits in the units of figures: angles end within a turn, residuals have a unit of their size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from analysis import FitCurve, fit_curves


@dataclass(frozen=True)
class Signal:
    unit: str
    measured: NDArray[np.float64]
    fitted: NDArray[np.float64]
    label: str = "signal"

    @property
    def time_s(self) -> NDArray[np.float64]:
        return np.arange(float(len(self.fitted)))


@dataclass(frozen=True)
class Fit:
    curves: list[Signal]


@dataclass(frozen=True)
class Named:
    fit: Fit
    test: str = "point-A"


def shown(*signals: Signal) -> list[FitCurve]:
    return fit_curves([Named(Fit(list(signals)))])


@pytest.mark.parametrize("turns", [-3, -1, 0, 4])
def test_angles_end_within_a_turn_and_go_where_they_went(turns: int) -> None:
    angle = np.radians([10.0, 190.0, 460.0]) + 2 * np.pi * turns
    (curve,) = shown(Signal("rad", np.append(angle[:2], np.nan), angle))
    assert curve.fitted == pytest.approx([-350.0, -170.0, 100.0])
    assert curve.measured[:2] == pytest.approx(curve.fitted[:2])


def test_displacements_are_left_where_they_are() -> None:
    (curve,) = shown(Signal("m", np.array([5.0, -5.0]), np.array([5.0, -5.0])))
    assert curve.fitted == pytest.approx([5000.0, -5000.0])


@pytest.mark.parametrize(("off_mm", "unit"), [(2e-3, "µm"), (0.5, "mm"), (np.nan, "mm")])
def test_a_residual_has_a_unit_of_its_size(off_mm: float, unit: str) -> None:
    fitted = 1e-3 * np.array([1.0, -2.0, 1.5])
    (curve,) = shown(Signal("m", fitted + 1e-3 * off_mm, fitted))
    assert curve.residual_unit == (unit, 1e3 if unit == "µm" else 1.0)

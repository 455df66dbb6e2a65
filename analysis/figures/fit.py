"""A fitted curve over its data, with the residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from analysis.figures.style import GREY, MEASURED, MODEL, band, bins_for, drawing, label, outline, pin, to_svg
from daq.guided_test_kinds import point_of
from rig_basics.arrays import Array

_FINE_RATIO = 1e3  # curve over residual above which the residual is shown in thousandths of the unit
_SMALLER = {"mm": ("µm", 1e3), "°": ("m°", 1e3)}
_TURN = {"°": 360.0}


@dataclass(frozen=True)
class FitCurve:
    """One signal of one fit.

    Attributes:
        title: title of the fit, for example "ring-down x".
        time_s, measured, fitted: shape (n,); values in `unit`; NaN where nothing was measured.
        unit: unit of the values, for example "mm".
        y_label: quantity of the values.
        notes: sentence for the caption.
        aside: whether the figure belongs to the appendix, as that of a release at a point.
    """

    title: str
    time_s: Array
    measured: Array
    fitted: Array
    unit: str
    y_label: str
    notes: str = ""
    aside: bool = False

    @property
    def residual_rms(self) -> float:
        """Root mean square of measured − fitted, in `unit`; NaN without a common sample."""
        rest = self.measured - self.fitted
        rest = rest[np.isfinite(rest)]
        return float(np.sqrt(np.mean(rest**2))) if len(rest) else float("nan")

    @property
    def residual_unit(self) -> tuple[str, float]:
        """Unit of the residual (1/1000 of `unit` for small residuals) and the factor to it."""
        rest = np.abs(self.measured - self.fitted)
        if self.unit not in _SMALLER or not np.isfinite(rest).any():
            return self.unit, 1.0
        size, swing = float(np.nanmax(rest)), float(np.nanmax(np.abs(self.measured)))
        fine = size < 0.1 * max(1.0, swing / _FINE_RATIO) and size < 0.1
        return _SMALLER[self.unit] if fine else (self.unit, 1.0)


class FittedSignal(Protocol):
    """A measured signal with its fit, as returned by the identification."""

    @property
    def label(self) -> str:
        """Name of the signal."""
        ...

    @property
    def unit(self) -> str:
        """Unit of the values."""
        ...

    @property
    def time_s(self) -> Array:
        """Times, shape (n,), s."""
        ...

    @property
    def measured(self) -> Array:
        """Measured values, shape (n,)."""
        ...

    @property
    def fitted(self) -> Array:
        """Fitted values, shape (n,)."""
        ...


class Fit(Protocol):
    """A fit with its signals."""

    @property
    def curves(self) -> Sequence[FittedSignal]:
        """Signals of the fit."""
        ...


class TestFit(Protocol):
    """The fit of one test, as in `Identification.fits`."""

    @property
    def test(self) -> str:
        """Name of the test."""
        ...

    @property
    def fit(self) -> Fit:
        """Fit of the test."""
        ...


def fit_curves(fits: Sequence[TestFit]) -> list[FitCurve]:
    """Convert the signals of all fits to the units of figures: mm and degrees, angles ending in 0…360°.

    Args:
        fits: `Identification.fits`; their curves in m and rad.
    """
    return [
        FitCurve(
            title=f"{named.test}: {curve.label}",
            time_s=curve.time_s,
            measured=curve.measured * scale - turns,
            fitted=curve.fitted * scale - turns,
            unit=unit,
            y_label=label,
            aside=bool(point_of(named.test)),
        )
        for named in fits
        for curve in named.fit.curves
        for scale, unit, label in (_shown(curve.unit),)
        for turns in (_whole_turns(curve.fitted * scale, unit),)
    ]


def _whole_turns(fitted: Array, unit: str) -> float:
    """Return the whole turns to subtract so that the last value lies within one turn; 0 for other units."""
    last = fitted[np.isfinite(fitted)][-1:]
    return float(np.floor(last[0] / _TURN[unit]) * _TURN[unit]) if unit in _TURN and len(last) else 0.0


def _shown(unit: str) -> tuple[float, str, str]:
    return {"m": (1e3, "mm", "displacement"), "rad": (180 / np.pi, "°", "angle")}.get(unit, (1.0, unit, "value"))


def draw_fit(curve: FitCurve, name: str) -> str:
    """Return an SVG of the whole record and an interval near its start, each with its residuals below."""
    time, (unit, scale) = np.asarray(curve.time_s, float), curve.residual_unit
    rest = scale * (curve.measured - curve.fitted)
    with drawing(8.6, 3.4) as figure:
        grid = figure.subplots(2, 2, sharex="col", height_ratios=(3, 1), width_ratios=(1.7, 1))
        figure.subplots_adjust(left=0.115, right=0.975, top=0.92, bottom=0.14, wspace=0.16, hspace=0.12)
        crossings = _crossings(np.asarray(curve.fitted, float))
        near = slice(0, _stretch(len(time), crossings))
        bins = bins_for(len(crossings) / 2)
        for column, part, title in ((0, slice(None), "whole record"), (1, near, "a stretch of it")):
            top, bottom = grid[0, column], grid[1, column]
            band(top, time[part], curve.measured[part], MEASURED, "measured", bins=bins)
            outline(top, time[part], curve.fitted[part], MODEL, "fitted", bins=bins)
            band(bottom, time[part], rest[part], GREY, "residual", bins=bins)
            label(top, title=title)
            label(bottom, "time, s")
        label(grid[0, 0], y=f"{curve.y_label}, {curve.unit}")
        label(grid[1, 0], y=f"residual, {unit}")
        grid[0, 0].legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, fontsize=8, borderaxespad=0.2)
        pin(figure, grid, 0.03, 0.07)
        return to_svg(figure, name, f"Measured and fitted curve of {curve.title} with residuals")


def _crossings(fitted: Array) -> NDArray[np.intp]:
    """Return the samples at which the fit passes its mean."""
    swing = np.nan_to_num(fitted - np.nanmean(fitted))
    return np.flatnonzero(np.diff(np.signbit(swing)))


def _stretch(samples: int, crossings: NDArray[np.intp]) -> int:
    """Return the number of samples in about eight swings of the fit, or in an eighth of the record."""
    end = int(crossings[16]) if len(crossings) > 24 else samples // 8
    return min(max(end, 16), samples)

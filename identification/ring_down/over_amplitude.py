"""Reported dependence of the rates on amplitude, from the fitted terms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from identification.ring_down.backbone import REFERENCE_M
from identification.ring_down.decay import FittedDecay
from rig_basics.arrays import Array

Kind = Literal["frequency", "damping"]
_CUBIC = 8 / (3 * REFERENCE_M**2)  # κ over η


@dataclass(frozen=True)
class RatesOverAmplitude:
    """Direction whose frequency or damping ratio depends on amplitude. Terms that are left out are 0 with a std of 0.

    Attributes:
        direction: 1 or 2.
        kinds: rates that depend on amplitude.
        f_Hz, zeta: frequency, Hz, and damping ratio at zero amplitude.
        f_change_at_1mm, f_change_std: relative change of frequency at an amplitude of 1 mm and its std.
        cubic_stiffness_per_m2, cubic_stiffness_std: κ of a spring k (1 + κ q²) and its std, 1/m².
        zeta_slope_per_m, zeta_slope_std: change of the damping ratio over amplitude and its std, 1/m.
        covariance: covariance of (ln f, ζ, f_change_at_1mm, change of ζ at 1 mm), shape (4, 4).
        largest_m: largest amplitude of the direction in the records, m.
    """

    direction: int
    kinds: tuple[Kind, ...]
    f_Hz: float
    zeta: float
    f_change_at_1mm: float
    f_change_std: float
    cubic_stiffness_per_m2: float
    cubic_stiffness_std: float
    zeta_slope_per_m: float
    zeta_slope_std: float
    covariance: Array
    largest_m: float

    @property
    def fall(self) -> float:
        """Decrease of the damping ratio from zero amplitude to the largest one; 0 if it grows."""
        return max(-self.zeta_slope_per_m * self.largest_m, 0.0)

    @property
    def short(self) -> str:
        """Short description of the dependence."""
        own = f"direction {self.direction}"
        parts = {
            "frequency": f"{own} {'hardens' if self.f_change_at_1mm > 0 else 'softens'}",
            "damping": f"{own}'s damping {'grows' if self.zeta_slope_per_m > 0 else 'falls'} with amplitude",
        }
        return ", ".join(parts[kind] for kind in self.kinds)

    @property
    def sentence(self) -> str:
        """Sentence with the dependence and its size."""
        parts: list[str] = []
        if "frequency" in self.kinds:
            change, std = 100 * self.f_change_at_1mm, 100 * self.f_change_std
            verb, more = ("hardens", "higher") if change > 0 else ("softens", "lower")
            parts.append(
                f"direction {self.direction} {verb}: its frequency is {_given(abs(change), std)} % {more} at 1 mm "
                f"(cubic stiffness {_given(1e-6 * self.cubic_stiffness_per_m2, 1e-6 * self.cubic_stiffness_std)} 1/mm²)"
            )
        if "damping" in self.kinds:
            slope, std = 1e-3 * self.zeta_slope_per_m, 1e-3 * self.zeta_slope_std
            verb, more = ("grows", "higher") if slope > 0 else ("falls", "lower")
            parts.append(
                f"direction {self.direction}'s damping {verb} with amplitude: its damping ratio is "
                f"{_given(abs(slope), std)} {more} at 1 mm, {abs(slope) / self.zeta:.0%} of {self.zeta:.4g}"
            )
        names = {"frequency": f"f{self.direction}", "damping": f"zeta{self.direction}"}
        named = " and ".join(names[kind] for kind in self.kinds)
        at_zero = f"the values of {named} are" if len(parts) > 1 else f"the value of {named} is"
        rubs = ", and its interval covers dry friction" if self.fall > 0 else ""
        return f"{'; '.join(parts)}; {at_zero} at zero amplitude{rubs}"


def _given(value: float, std: float) -> str:
    """Text of a value and its standard deviation, with two digits of the latter."""
    digits = max(0, 1 - int(np.floor(np.log10(max(std, 1e-12)))))
    return f"{value:.{digits}f} ± {std:.{digits}f}"


def rates_over_amplitude(fitted: FittedDecay, labels: tuple[str, ...], stretch: Array) -> list[RatesOverAmplitude]:
    """Return the directions with significant terms of amplitude.

    Args:
        fitted: solved fit.
        labels: numbers of the directions.
        stretch: factor on the standard deviation of each parameter, shape (size,).
    """
    model, out = fitted.model, list[RatesOverAmplitude]()
    if model.backbone is None:
        return out
    full = fitted.solution.minimum.covariance * np.outer(stretch, stretch)
    for mode, label in enumerate(labels):
        hardens, drags = model.backbone.hardens[mode], model.backbone.drags[mode]
        if not (hardens or drags):
            continue
        at = np.array([2 * mode, 2 * mode + 1, model.tail + 2 * mode, model.tail + 2 * mode + 1])
        keep = np.array([1.0, 1.0, float(hardens), float(drags)])
        covariance = full[np.ix_(at, at)] * np.outer(keep, keep)
        std, rates = np.sqrt(np.diag(covariance)), model.mode_rates(fitted.theta, mode)
        rates = replace(rates, hardening=rates.hardening * keep[2], drag=rates.drag * keep[3])  # significant terms only
        kinds: tuple[Kind, ...] = (*(("frequency",) if hardens else ()), *(("damping",) if drags else ()))
        out.append(
            RatesOverAmplitude(
                direction=int(label),
                kinds=kinds,
                f_Hz=rates.omega / (2 * np.pi),
                zeta=rates.zeta,
                f_change_at_1mm=rates.hardening,
                f_change_std=float(std[2]),
                cubic_stiffness_per_m2=_CUBIC * rates.hardening,
                cubic_stiffness_std=_CUBIC * float(std[2]),
                zeta_slope_per_m=rates.drag / REFERENCE_M,
                zeta_slope_std=float(std[3]) / REFERENCE_M,
                covariance=covariance,
                largest_m=model.backbone.largest_m[mode],
            )
        )
    return out

"""Equivalent linear spring and damper of a direction at an amplitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.errors import IdentificationError
from identification.ring_down.backbone import REFERENCE_M
from identification.ring_down.result import RingDownFit


@dataclass(frozen=True)
class EquivalentLinear:
    """Equivalent linear values of a direction at one amplitude, each with its standard deviation.

    Attributes:
        amplitude_m: amplitude of the motion, m.
        f_Hz, f_std: frequency sqrt(k_eq/M)/2π, Hz.
        zeta, zeta_std: damping ratio c_eq/(2 sqrt(k M)).
        k_N_per_m, k_std: stiffness k (1 + ¾ κ a²), N/m; None if the fit had no mass.
    """

    amplitude_m: float
    f_Hz: float
    f_std: float
    zeta: float
    zeta_std: float
    k_N_per_m: float | None
    k_std: float | None


def equivalent_linear(fit: RingDownFit, direction: int, amplitude_m: float) -> EquivalentLinear:
    """Compute frequency, damping ratio and stiffness of a direction at an amplitude.

    The values of a direction without fitted amplitude terms are the same for all amplitudes.

    Args:
        fit: fit of the ring-down.
        direction: 1 or 2.
        amplitude_m: amplitude of the motion, m, at least 0. Beyond the amplitudes of the records the fitted law is
            extrapolated.
    Raises:
        IdentificationError: the fit does not contain the direction, the amplitude is negative, or the equivalent
            stiffness is not positive.
    Source: docs/theory/ring_down.md, "Rates that depend on amplitude".
    """
    names = [f"f{direction}_Hz", f"zeta{direction}"]
    if any(name not in fit.values for name in names):
        raise IdentificationError(f"the ring-down contains no direction {direction}; it has {', '.join(fit.values)}")
    if not amplitude_m >= 0:
        raise IdentificationError(f"expected amplitude_m >= 0, got {amplitude_m!r}")
    f, zeta = (fit.values[name] for name in names)
    places = [list(fit.values).index(name) for name in names]
    covariance = np.zeros((4, 4))  # of ln f, ζ and their changes at 1 mm
    covariance[:2, :2] = fit.covariance[np.ix_(places, places)] / np.outer([f, 1.0], [f, 1.0])
    level, hardening, drag = amplitude_m / REFERENCE_M, 0.0, 0.0
    for one in fit.nonlinear:
        if one.direction == direction:
            hardening, drag = one.f_change_at_1mm, one.zeta_slope_per_m * REFERENCE_M
            covariance[2:, :], covariance[:2, 2:] = one.covariance[2:, :], one.covariance[:2, 2:]
    stiffer = 1 + 2 * hardening * level**2
    if stiffer <= 0:
        raise IdentificationError(
            f"the spring of direction {direction} has no stiffness left at {1e3 * amplitude_m:.3g} mm"
        )
    f_at = f * float(np.sqrt(stiffer))
    by_f = f_at * np.array([1.0, 0.0, level**2 / stiffer, 0.0])
    by_zeta = np.array([0.0, 1.0, 0.0, level])
    f_std, zeta_std = (float(np.sqrt(max(by @ covariance @ by, 0.0))) for by in (by_f, by_zeta))
    k = fit.values.get(f"k{direction}_N_per_m")
    return EquivalentLinear(
        amplitude_m=amplitude_m,
        f_Hz=f_at,
        f_std=f_std,
        zeta=zeta + drag * level,
        zeta_std=zeta_std,
        k_N_per_m=None if k is None else k * stiffer,
        k_std=None if k is None else 2 * k * stiffer * f_std / f_at,
    )

# pyright: strict
"""Decays whose rates depend on amplitude: a spring that hardens, damping that grows with speed.

A mode of amplitude a(t) has the frequency ω (1 + η (a/A)²) and the damping ratio ζ + S a/A, A = 1 mm. Averaged over a
cycle its motion is Re(c e^{P(t)}) with

    P = −σ t − ln(1 + b E) + i ω_d (t + η (a0/A)² I),    σ = ζ ω,  b = S ω a0/A,  E = (1 − e^{−σt})/σ,
    I = ∫ (a/a0)² dt = E/w + σ E² G(bE),    w = 1 + b E,  G(x) = 1/(x(1 + x)) − ln(1 + x)/x².

Derivation: docs/theory/ring_down.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

REFERENCE_M = 1e-3
"""A: the amplitude at which changes of frequency and damping ratio are counted."""
_SERIES = 0.02  # |x| below which G comes from its series, whose eighth term is below 1e-13
_SMALL = 1e-4  # σt below which the slope of E comes from its series
_LEAST_W = 0.05  # a decay continued backwards past where its amplitude is infinite
_MOST_BENT, _MOST_DRAG, _MOST_GROWN = 0.3, 50.0, 20.0


@dataclass(frozen=True)
class Backbone:
    """Which modes' rates depend on amplitude.

    Attributes:
        hardens: per mode whether its frequency does.
        drags: per mode whether its damping ratio does.
        amplitudes_m: per record and mode, a0 at the record's zero.
        plausible: of the terms that are not taken, in the order of θ, the standard deviation about zero that they are
            likely to have; 0 where they are left out, as are all of an empty tuple.
    """

    hardens: tuple[bool, ...]
    drags: tuple[bool, ...]
    amplitudes_m: tuple[tuple[float, ...], ...]
    plausible: tuple[float, ...] = ()

    @property
    def taken(self) -> tuple[bool, ...]:
        """In the order of θ: η1, S1, η2, S2."""
        return tuple(on for pair in zip(self.hardens, self.drags, strict=True) for on in pair)

    @property
    def prior_std(self) -> Floats:
        """Of the same: infinite where the term is fitted, 0 where it is left out."""
        return np.where(self.taken, np.inf, self.plausible or 0.0)

    @property
    def opened(self) -> tuple[bool, ...]:
        """Of the same: whether the term is taken or plausible."""
        return tuple(bool(std > 0) for std in self.prior_std)

    @property
    def largest_m(self) -> tuple[float, ...]:
        """Each mode's largest amplitude of all records."""
        return tuple(max(own) for own in zip(*self.amplitudes_m, strict=True))

    def in_order(self, modes: tuple[int, ...]) -> Backbone:
        """Some modes, in another order."""
        return Backbone(
            tuple(self.hardens[m] for m in modes),
            tuple(self.drags[m] for m in modes),
            tuple(tuple(own[m] for m in modes) for own in self.amplitudes_m),
            tuple(self.plausible[2 * m + k] for m in modes for k in range(2)) if self.plausible else (),
        )


@dataclass(frozen=True)
class Rates:
    """One mode's four parameters.

    Attributes:
        omega, zeta: at zero amplitude, rad/s and dimensionless.
        hardening: η, relative change of frequency at 1 mm.
        drag: S, change of the damping ratio at 1 mm.
    """

    omega: float
    zeta: float
    hardening: float
    drag: float

    def is_absurd(self, amplitude_m: float, span_s: float) -> bool:
        """Whether the frequency changes beyond all reason, or the amplitude becomes infinite."""
        level, decay = amplitude_m / REFERENCE_M, self.zeta * self.omega * span_s
        if decay < -_MOST_GROWN:
            return True
        reach = span_s if abs(decay) < 1e-12 else span_s * -float(np.expm1(-decay)) / decay
        x = self.drag * level * self.omega * reach
        return not (abs(self.hardening) * level**2 < _MOST_BENT and _LEAST_W - 1 < x < _MOST_DRAG)


@dataclass(frozen=True)
class Course:
    """A mode over time.

    Attributes:
        power: P, complex, shape (n,).
        rate: dP/dt, 1/s, complex, shape (n,).
        by: ∂P/∂(ln ω, ζ, η, S), complex, shape (n,) each.
        rate_by: the same of the rate, without what is of second order.
    """

    power: Complexes
    rate: Complexes
    by: tuple[Complexes, ...]
    rate_by: tuple[Complexes | complex, ...]


def course(rates: Rates, amplitude_m: float, time_s: Floats) -> Course:
    """P and its derivatives.

    Args:
        amplitude_m: a0, at time 0.
        time_s: shape (n,); may be negative, the decay is then continued backwards.
    """
    omega, zeta, level = rates.omega, rates.zeta, amplitude_m / REFERENCE_M
    root = float(np.sqrt(1 - zeta * zeta))
    sigma, b, wave, bent = zeta * omega, rates.drag * omega * level, omega * root, rates.hardening * level**2
    e, e_sigma = _reach(sigma, time_s)
    w = np.maximum(1 + b * e, _LEAST_W)
    left = 1 - sigma * e  # e^{−σt}
    g, g_slope = _curved(w - 1)
    i = e / w + sigma * e**2 * g
    i_sigma, i_b = e_sigma * left / w**2 + e**2 * g, -((e / w) ** 2) + sigma * e**3 * g_slope
    log_sigma, log_b = b * e_sigma / w, e / w
    shown = (left / w) ** 2
    by = (
        -sigma * (time_s + log_sigma) - b * log_b + 1j * wave * (time_s + bent * (i + sigma * i_sigma + b * i_b)),
        omega * (-time_s - log_sigma + 1j * (bent * wave * i_sigma - zeta / root * (time_s + bent * i))),
        1j * wave * level**2 * i,
        omega * level * (-log_b + 1j * wave * bent * i_b),
    )
    drag = np.asarray(-omega * level * left / w, np.complex128)
    rate = -sigma - b * left / w + 1j * wave * (1 + bent * shown)
    return Course(
        -sigma * time_s - np.log(w) + 1j * wave * (time_s + bent * i),
        rate,
        tuple(np.asarray(part, np.complex128) for part in by),
        (rate, complex(-omega), np.asarray(1j * wave * level**2 * shown, np.complex128), drag),
    )


def averaged_course(
    rates: Rates, amplitude_m: float, time_s: Floats, spread_s2: Floats
) -> tuple[Complexes, tuple[Complexes, ...]]:
    """e^P averaged over blocks, shape (n,), and its derivatives with respect to ln ω, ζ, η and S.

    Args:
        amplitude_m: a0, at time 0.
        time_s, spread_s2: mean and variance of the times of each block's samples, shape (n,).
    """
    own = course(rates, amplitude_m, time_s)
    wave = np.exp(own.power)
    curved = wave * (1 + 0.5 * spread_s2 * own.rate**2)
    widened = wave * spread_s2 * own.rate
    pairs = zip(own.by, own.rate_by, strict=True)
    return curved, tuple(curved * by + widened * rate_by for by, rate_by in pairs)


def _reach(sigma: float, time_s: Floats) -> tuple[Floats, Floats]:
    """E = (1 − e^{−σt})/σ and ∂E/∂σ."""
    power = sigma * time_s
    small = np.abs(power) < _SMALL
    if small.all():
        return time_s * (1 - 0.5 * power * (1 - power / 3)), -0.5 * time_s**2 * (1 - 2 / 3 * power)
    e = -np.expm1(-power) / sigma
    slope = (time_s * (1 - sigma * e) - e) / sigma
    return e, np.where(small, -0.5 * time_s**2 * (1 - 2 / 3 * power), slope)


def _curved(x: Floats) -> tuple[Floats, Floats]:
    """G and its slope; about zero from G = Σ (−1)^{n+1} (n + 1)/(n + 2) xⁿ."""
    small = np.abs(x) < _SERIES
    safe = np.where(small, 1.0, x)
    log = np.log1p(safe)
    g = 1 / (safe * (1 + safe)) - log / safe**2
    slope = 2 * log / safe**3 - (1 + 2 * safe) / (safe * (1 + safe)) ** 2 - 1 / (safe**2 * (1 + safe))
    if not small.any():
        return g, slope
    n = np.arange(8)
    series = np.polynomial.Polynomial((-1.0) ** (n + 1) * (n + 1) / (n + 2))
    near = np.where(small, x, 0.0)
    return np.where(small, series(near), g), np.where(small, series.deriv()(near), slope)

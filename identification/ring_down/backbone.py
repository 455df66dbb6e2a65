"""Decays whose rates depend on amplitude: a hardening spring, damping that grows with speed.

A mode of amplitude a(t) has the frequency ω (1 + η (a/A)²) and the damping ratio ζ + S a/A with A = 1 mm. Its motion
averaged over a cycle is Re(c e^{P(t)}) with

    P = −σ t − ln(1 + b E) + i ω_d (t + η (a0/A)² I),    σ = ζ ω,  b = S ω a0/A,  E = (1 − e^{−σt})/σ,
    I = ∫ (a/a0)² dt = E/w + σ E² G(bE),    w = 1 + b E,  G(x) = 1/(x(1 + x)) − ln(1 + x)/x².

Derivation: docs/theory/ring_down.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rig_basics.arrays import Array, Complex

REFERENCE_M = 1e-3
"""Reference amplitude A for the changes of frequency and damping ratio, m."""
_MAX_SERIES_X = 0.02  # |x| below which G comes from its series, whose eighth term is below 1e-13
_MAX_SERIES_POWER = 1e-4  # σt below which the slope of E comes from its series
_MIN_W = 0.05  # smaller values belong to a decay that is continued backwards beyond its infinite amplitude
_MAX_BEND, _MAX_DRAG, _MAX_GROWTH = 0.3, 50.0, 20.0


@dataclass(frozen=True)
class Backbone:
    """Amplitude dependence of the modes' rates.

    Attributes:
        hardens: whether the frequency of each mode depends on amplitude.
        drags: whether the damping ratio of each mode depends on amplitude.
        amplitudes_m: amplitude a0 of each record and mode at the record's zero, m.
        plausible: prior standard deviation about zero of the terms that are not taken, in the order of θ; 0 for terms
            that are left out. An empty tuple leaves out all of them.
    """

    hardens: tuple[bool, ...]
    drags: tuple[bool, ...]
    amplitudes_m: tuple[tuple[float, ...], ...]
    plausible: tuple[float, ...] = ()

    @property
    def taken(self) -> tuple[bool, ...]:
        """Whether each term is fitted, in the order of θ: η1, S1, η2, S2."""
        return tuple(on for pair in zip(self.hardens, self.drags, strict=True) for on in pair)

    @property
    def prior_std(self) -> Array:
        """Prior standard deviation of each term: infinite for fitted terms, 0 for terms that are left out."""
        return np.where(self.taken, np.inf, self.plausible or 0.0)

    @property
    def opened(self) -> tuple[bool, ...]:
        """Whether each term is taken or plausible."""
        return tuple(bool(std > 0) for std in self.prior_std)

    @property
    def largest_m(self) -> tuple[float, ...]:
        """Largest amplitude of each mode in all records, m."""
        return tuple(max(own) for own in zip(*self.amplitudes_m, strict=True))

    def in_order(self, modes: tuple[int, ...]) -> Backbone:
        """Return the backbone for a selection of modes in the given order."""
        return Backbone(
            tuple(self.hardens[m] for m in modes),
            tuple(self.drags[m] for m in modes),
            tuple(tuple(own[m] for m in modes) for own in self.amplitudes_m),
            tuple(self.plausible[2 * m + k] for m in modes for k in range(2)) if self.plausible else (),
        )


@dataclass(frozen=True)
class Rates:
    """Parameters of one mode.

    Attributes:
        omega, zeta: natural frequency, rad/s, and damping ratio at zero amplitude.
        hardening: relative change η of the frequency at 1 mm.
        drag: change S of the damping ratio at 1 mm.
    """

    omega: float
    zeta: float
    hardening: float
    drag: float

    def is_absurd(self, amplitude_m: float, span_s: float) -> bool:
        """Whether the frequency changes by more than 30 %, or the amplitude becomes infinite or grows by e²⁰."""
        level, decay = amplitude_m / REFERENCE_M, self.zeta * self.omega * span_s
        if decay < -_MAX_GROWTH:
            return True
        reach = span_s if abs(decay) < 1e-12 else span_s * -float(np.expm1(-decay)) / decay
        x = self.drag * level * self.omega * reach
        return not (abs(self.hardening) * level**2 < _MAX_BEND and _MIN_W - 1 < x < _MAX_DRAG)


@dataclass(frozen=True)
class Course:
    """Exponent of a mode's motion over time.

    Attributes:
        power: P, complex, shape (n,).
        rate: dP/dt, 1/s, complex, shape (n,).
        by: ∂P/∂(ln ω, ζ, η, S), complex, shape (n,) each.
        rate_by: derivatives of the rate by the same parameters, to first order.
    """

    power: Complex
    rate: Complex
    by: tuple[Complex, ...]
    rate_by: tuple[Complex | complex, ...]


def course(rates: Rates, amplitude_m: float, time_s: Array) -> Course:
    """Compute P and its derivatives.

    Args:
        rates: parameters of the mode.
        amplitude_m: amplitude a0 at time 0, m.
        time_s: shape (n,), s. For negative times the decay is continued backwards.
    """
    omega, zeta, level = rates.omega, rates.zeta, amplitude_m / REFERENCE_M
    root = float(np.sqrt(1 - zeta * zeta))
    sigma, b, wave, bent = zeta * omega, rates.drag * omega * level, omega * root, rates.hardening * level**2
    e, e_sigma = _reach(sigma, time_s)
    w = np.maximum(1 + b * e, _MIN_W)
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
    rates: Rates, amplitude_m: float, time_s: Array, spread_s2: Array
) -> tuple[Complex, tuple[Complex, ...]]:
    """Average e^P over blocks, shape (n,), with its derivatives by ln ω, ζ, η and S.

    Args:
        rates: parameters of the mode.
        amplitude_m: amplitude a0 at time 0, m.
        time_s, spread_s2: mean and variance of the sample times of each block, shape (n,).
    """
    own = course(rates, amplitude_m, time_s)
    wave = np.exp(own.power)
    curved = wave * (1 + 0.5 * spread_s2 * own.rate**2)
    widened = wave * spread_s2 * own.rate
    pairs = zip(own.by, own.rate_by, strict=True)
    return curved, tuple(curved * by + widened * rate_by for by, rate_by in pairs)


def _reach(sigma: float, time_s: Array) -> tuple[Array, Array]:
    """E = (1 − e^{−σt})/σ and ∂E/∂σ."""
    power = sigma * time_s
    small = np.abs(power) < _MAX_SERIES_POWER
    if small.all():
        return time_s * (1 - 0.5 * power * (1 - power / 3)), -0.5 * time_s**2 * (1 - 2 / 3 * power)
    e = -np.expm1(-power) / sigma
    slope = (time_s * (1 - sigma * e) - e) / sigma
    return e, np.where(small, -0.5 * time_s**2 * (1 - 2 / 3 * power), slope)


def _curved(x: Array) -> tuple[Array, Array]:
    """G and its slope; for small x from G = Σ (−1)^{n+1} (n + 1)/(n + 2) xⁿ."""
    small = np.abs(x) < _MAX_SERIES_X
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

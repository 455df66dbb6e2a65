"""Stable motions with permanently slipping pendulums, as solutions of Newton's method.

Strobed once a revolution, such a motion lies on a closed curve u(χ). The once-a-revolution map P turns it along itself,
    P(u(χ)) = u(χ + ρ) + 2π (turns of the pendulums),
with ρ turns of the curve per revolution. Newton's method solves for its Fourier coefficients and ρ together. If ρ is
rational and the motion is locked, q points remain that P^q maps to themselves up to whole turns: an orbit with a period
of q revolutions. Source: docs/theory/basins.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dynamics.arrays import Array
from dynamics.steady.basins.fibres import Fibres, caught_scale, derivative, moduli_across, positive, series, turned
from dynamics.steady.basins.periodic import PeriodicMotion, periodic_motion, repeats
from dynamics.steady.basins.regions import near_value
from dynamics.steady.basins.turning import RevolutionMap

_MIN_TURNS = 4.0  # turns within the strobed interval of a slipping motion
_ODD = (33, 65, 129)  # numbers of values along the curve
_NEWTON = 12
_CLOSED = 1e-9  # residual of the equation, in the units of the state
_BETWEEN = 1e-5  # residual between the values at which the equation is solved
_ROWS = 720  # along a turn of the lead pendulum, for compiled code
_MAX_WINDING = 3
_MAX_PERIOD, _REPEATS = 24, 1e-4  # revolutions of a locked slipping orbit, and permitted difference after a period


@dataclass(frozen=True)
class SlippingOrbit:
    """A stable slipping motion.

    turns_per_revolution: slip of A and B, turns relative to the rotor per revolution.
    winding: turns of A and B along the whole curve, or in the whole period of a periodic orbit.
    period_revolutions: period of a periodic orbit; 0 if the rate is irrational and the orbit a closed curve.
    rotation: the curve's rate ρ, or turns of the faster pendulum per revolution of a periodic orbit.
    residual: largest residual of the invariance equation, in the units of the state.
    multipliers: moduli over one revolution, largest first, shape (8,). For a curve one of them is 1, along it.
    multiplier_across: the largest of the others; for a periodic orbit the largest of all.
    amplitude_m: root mean square distance of the disk centre from its mean.
    points, forms, lead, sheets, near: for dynamics.steady.basins.pursuit; empty if no region is known.
    values: the curve at equal steps of χ without winding, shape (m, 8), or the q states.
    """

    turns_per_revolution: tuple[float, float]
    winding: tuple[int, int]
    period_revolutions: int
    rotation: float
    residual: float
    multipliers: Array
    multiplier_across: float
    amplitude_m: float
    points: Array
    forms: Array
    lead: int
    sheets: int
    near: float
    values: Array

    @property
    def stable(self) -> bool:
        """Whether every deviation transverse to the orbit decreases."""
        return self.multiplier_across < 1.0

    @property
    def catches(self) -> bool:
        """Whether an attracting region is known."""
        return len(self.forms) > 0


def slipping_orbit(
    turning: RevolutionMap, strobe: Array, near_rad: float | None, *, quick: bool = False
) -> SlippingOrbit | None:
    """The stable slipping orbit near a strobed motion, or None.

    Args:
        strobe: states once a revolution at ψ = 0, angles not reduced, shape (n, 8), after the transient.
        near_rad: deviation at which a motion counts as on the orbit, in units of the state. None: without a region.
        quick: compute the region from fewer samples.
    """
    locked = repeats(turning, strobe, _MAX_PERIOD, _REPEATS)
    if locked is not None:
        if locked[1] == (0, 0):
            return None
        motion = periodic_motion(turning, strobe[-1], *locked)
        return _of_periodic(turning, motion, near_rad, quick) if motion is not None and motion.stable else None
    rates = mean_rates(strobe[:, 2:4])
    there = list(turning.there)
    if not np.all(np.isfinite(strobe)) or np.max(np.abs(rates[there])) * len(strobe) < _MIN_TURNS:
        return None
    for rate, winding in _windings(rates, there):
        curve: tuple[Array, float, float] | None = None
        for count in _ODD:
            guess = _guess(strobe, rate, winding, count) if curve is None else _finer(curve[0], count)
            curve = curve_by_newton(turning, guess, rate if curve is None else curve[1], winding)
            if curve is None:
                continue
            orbit = described(turning, curve, winding, near_rad, quick)
            if orbit is None or not orbit.stable:
                break
            if near_rad is None or orbit.catches:
                return orbit
    return None


def continued(turning: RevolutionMap, known: SlippingOrbit) -> SlippingOrbit | None:
    """Continue a slipping orbit to a rig and speed close to its own; None if Newton's method does not converge.

    The result has no region.
    """
    if known.period_revolutions:
        motion = periodic_motion(turning, known.values[0], known.period_revolutions, known.winding)
        return _of_periodic(turning, motion, None) if motion is not None and motion.stable else None
    found = curve_by_newton(turning, known.values, known.rotation, known.winding)
    orbit = None if found is None else described(turning, found, known.winding, None)
    return orbit if orbit is not None and orbit.stable else None


def mean_rates(angles: Array) -> Array:
    """Mean rates in turns per revolution, shape (2,), with a smooth window, whose error decreases fast with length."""
    window = _window(len(angles) - 1)
    return window @ np.diff(angles, axis=0) / (2 * math.pi)


def _window(count: int) -> Array:
    t = (np.arange(count) + 0.5) / count
    weights = np.exp(-1.0 / (t * (1.0 - t)))
    return weights / weights.sum()


def _windings(rates: Array, there: list[int]) -> list[tuple[float, tuple[int, int]]]:
    """Rates ρ of a curve with the whole numbers of turns (m, n) = rates/ρ, the simplest first."""
    lead, found = max(there, key=lambda i: abs(rates[i])), list[tuple[float, tuple[int, int]]]()
    for turns in range(1, _MAX_WINDING + 1):
        rate = float(rates[lead]) / turns
        other = round(float(rates[1 - lead]) / rate) if len(there) == 2 else 0
        if len(there) == 1 or abs(rates[1 - lead] - other * rate) < 1e-4:
            found.append((rate, (turns, other) if lead == 0 else (other, turns)))
    return found


def _guess(strobe: Array, rate: float, winding: tuple[int, int], count: int) -> Array:
    """The curve's values at equal steps of χ, without its winding, from windowed means; shape (count, 8)."""
    phase = rate * np.arange(len(strobe))
    plain = strobe.copy()
    plain[:, 2:4] -= 2 * math.pi * np.outer(phase, winding)
    window, half = _window(len(strobe)), count // 2
    orders = np.arange(-half, half + 1)
    coefficients = np.exp(-2j * math.pi * np.outer(orders, phase)) @ (window[:, None] * plain)
    coefficients[half, 2:4] -= 2 * math.pi * np.round(coefficients[half, 2:4].real / (2 * math.pi))
    steps = np.arange(count) / count
    return np.real(np.exp(2j * math.pi * np.outer(steps, orders)) @ coefficients)


def curve_by_newton(
    turning: RevolutionMap, values: Array, rate: float, winding: tuple[int, int]
) -> tuple[Array, float, float] | None:
    """The invariant curve near a guess: (values without winding, ρ, largest residual); None if it does not converge.

    Args:
        values: at an odd number of equal steps of χ, without winding, shape (m, 8).
    """
    free, units, count = turning.free, turning.units, len(values)
    turns = np.zeros(8)
    turns[2:4] = 2 * math.pi * np.array(winding)
    steps = np.arange(count) / count
    u, n = values.copy(), len(free)
    for _ in range(_NEWTON):
        residual = _residual(turning, u, steps, rate, turns) / units
        size = float(np.max(np.abs(residual)))
        if not math.isfinite(size) or size > 3.0:
            return None
        if size < _CLOSED:
            middle = steps + 0.5 / count
            between = _residual(turning, turned(u, 0.5 / count), middle, rate, turns, u) / units
            worst = float(np.max(np.abs(between)))
            return (u, rate, worst) if worst < _BETWEEN else None
        maps = turning.derivatives(u + np.outer(steps, turns))
        own = (maps * units[None, :] / units[:, None])[:, free][:, :, free]
        shift, slope = _shift(count, rate)
        matrix = np.zeros((count * n + 1, count * n + 1))
        blocks = matrix[:-1, :-1].reshape(count, n, count, n)
        for j in range(count):
            blocks[j, :, j, :] = own[j]
        for i in range(n):
            blocks[:, i, :, i] -= shift
        along = (slope @ (u / units) + turns / units)[:, free]
        matrix[:-1, -1] = -along.ravel()
        matrix[-1, :-1] = (derivative(u / units) + turns / units)[:, free].ravel() / count
        right = np.append(-residual[:, free].ravel(), 0.0)
        try:
            step = np.linalg.solve(matrix, right)
        except np.linalg.LinAlgError:  # usual: Newton's method fails from this start
            return None
        u[:, free] += step[:-1].reshape(count, n) * units[free]
        rate += float(step[-1])
    return None


def _residual(
    turning: RevolutionMap, u: Array, steps: Array, rate: float, turns: Array, knots: Array | None = None
) -> Array:
    """P(u(χ)) − u(χ + ρ) without whole turns, at χ = steps; u is given there, or interpolated from knots."""
    after = turning.after(u + np.outer(steps, turns)) - np.outer(steps + rate, turns)
    curve = u if knots is None else knots
    return after - turned(curve, rate + (0.0 if knots is None else float(steps[0])))


def _shift(count: int, rate: float) -> tuple[Array, Array]:
    """Matrix that shifts values by ρ, and its derivative by ρ; shapes (count, count)."""
    orders = np.fft.fftfreq(count, 1 / count)
    waves = np.exp(2j * math.pi * np.outer(np.arange(count) / count, orders))
    turn = np.exp(2j * math.pi * orders * rate)
    forth = np.conj(waves).T / count
    return np.real((waves * turn) @ forth), np.real((waves * (2j * math.pi * orders * turn)) @ forth)


def _finer(values: Array, count: int) -> Array:
    """Values of a curve at more equal steps."""
    return series(values, np.arange(count) / count)


def described(
    turning: RevolutionMap,
    curve: tuple[Array, float, float],
    winding: tuple[int, int],
    near_rad: float | None,
    quick: bool = False,
) -> SlippingOrbit | None:
    """A curve with its multipliers, and its region if it has one; None if the multipliers are not finite.

    Args:
        curve: result of curve_by_newton.
        near_rad: deviation at which a motion counts as on the curve. None: no region is computed.
        quick: compute the region from fewer samples.
    """
    u, rate, residual = curve
    moduli = moduli_across(turning, u, rate, winding)
    if not np.all(np.isfinite(moduli)):
        return None
    multipliers = np.zeros(8)
    multipliers[: len(moduli) + 1] = np.sort(np.append(moduli, 1.0))[::-1]
    radius = turning.mean_radius(u[0], min(400, max(20, math.ceil(4 / abs(rate)))))
    rates = (rate * winding[0], rate * winding[1])
    orbit = SlippingOrbit(
        rates,
        winding,
        0,
        rate,
        residual,
        multipliers,
        float(moduli[0]),
        radius,
        np.zeros((0, 8)),
        np.zeros((0, 8, 8)),
        0,
        0,
        0.0,
        u,
    )
    return orbit if near_rad is None or not orbit.stable else _with_region(turning, orbit, near_rad, quick)


def _with_region(turning: RevolutionMap, orbit: SlippingOrbit, near_rad: float, quick: bool) -> SlippingOrbit:
    """A stable curve with its region; without one if its lead pendulum reverses or the contraction is not verified."""
    fibres = Fibres.of(turning, orbit.values, orbit.rotation, orbit.winding)
    if fibres is None:
        return orbit
    along = fibres.forms(math.sqrt(max(orbit.multiplier_across, 0.25)))
    if along is None:
        return orbit
    points, forms = fibres.rows(_ROWS * fibres.sheets, along)
    if not positive(forms, fibres.across):
        return orbit
    scale = caught_scale(turning, points, forms, fibres.lead, fibres.sheets, quick=quick)
    if scale == 0.0:
        return orbit
    forms = forms / scale
    near = min(near_value(form, turning.units, near_rad) for form in forms)
    return replace(orbit, points=points, forms=forms, lead=fibres.lead, sheets=fibres.sheets, near=near)


def _of_periodic(
    turning: RevolutionMap, motion: PeriodicMotion, near_rad: float | None, quick: bool = False
) -> SlippingOrbit | None:
    """A slipping orbit of q states, each with a form that decreases with a revolution; None without a region."""
    free, units, count = turning.free, turning.units, len(motion.states)
    gamma = math.sqrt(max(float(motion.moduli[0]), 0.25))
    own = (motion.maps * units[None, :] / units[:, None])[:, free][:, :, free] / gamma
    found = np.tile(np.eye(len(free)), (count, 1, 1))
    for _ in range(5000):
        then, before = found.copy(), found.copy()
        for j in range(count - 1, -1, -1):
            then[j] = np.eye(len(free)) + own[j].T @ then[(j + 1) % count] @ own[j]
        found = then
        if np.max(np.abs(then - before)) <= 1e-9 * np.max(np.abs(then)):
            break
    forms = np.zeros((count, 8, 8))
    forms[:, np.array(free)[:, None], np.array(free)[None, :]] = found
    forms = forms / units[:, None] / units[None, :]
    near = 0.0
    if near_rad is not None:
        scale = caught_scale(turning, motion.states, forms, -1, 1, quick=quick)
        if scale == 0.0:
            return None
        forms = forms / scale
        near = min(near_value(form, units, near_rad) for form in forms)
    multipliers = np.zeros(8)
    multipliers[: len(motion.moduli)] = motion.moduli
    rates = (motion.turns[0] / count, motion.turns[1] / count)
    return SlippingOrbit(
        rates,
        motion.turns,
        count,
        max(rates, key=abs),
        motion.residual,
        multipliers,
        float(motion.moduli[0]),
        turning.mean_radius(motion.states[0], count),
        motion.states,
        forms,
        -1,
        1,
        near,
        motion.states,
    )

"""Closed curve of the once-a-revolution map, parametrised by a pendulum's angle, and its transverse contraction.

A state near the curve is compared with the state of the curve at which the lead pendulum has the same angle. The
deviation then has no component along the curve. A revolution maps it from one such fibre to another by
    A = (1 − t eᵀ) DP,   t = du/dα where it arrives, e the lead's direction,
and Q(χ) = 1 + γ⁻² Aᵀ Q(χ + ρ) A is the quadratic form that decreases by γ² on every fibre. Source:
docs/theory/basins.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array, Indices
from dynamics.compiled_code import compiled
from dynamics.steady.basins.pursuit import deviation
from dynamics.steady.basins.turning import RevolutionMap

_FOLLOWED, _DROPPED = 1600, 150  # revolutions of the deviations, and initial ones that are discarded
_THOROUGH, _QUICK = (1.3, 50, 400), (1.8, 22, 100)  # ratio of neighbouring shells' radii, shells, samples on each
_FIRST_RAD, _MAX_RAD, _SHRINK = 2e-3, 2.0, 0.999
_SEED = 21
_MAX_TERMS, _MAX_FORM = 5000, 1e12


@dataclass(frozen=True)
class Fibres:
    """A curve u(χ) and its transverse maps.

    Attributes:
        turning: the rig.
        values: u without winding at equal steps of χ, shape (m, 8).
        turns: increase of the angles along the whole curve, shape (8,).
        rate: ρ, turns of the curve per revolution.
        lead: pendulum whose angle parametrises the curve, 0 or 1.
        across: components of a deviation.
        maps: A at the steps of χ, in the units of the state, shape (m, a, a).
    """

    turning: RevolutionMap
    values: Array
    turns: Array
    rate: float
    lead: int
    across: list[int]
    maps: Array

    @classmethod
    def of(cls, turning: RevolutionMap, values: Array, rate: float, winding: tuple[int, int]) -> Fibres | None:
        """None if the lead pendulum's angle does not increase along the whole curve."""
        turns = np.zeros(8)
        turns[2:4] = 2 * math.pi * np.array(winding)
        lead = 0 if abs(winding[0]) >= abs(winding[1]) else 1
        at, steps, units = 2 + lead, np.arange(len(values)) / len(values), turning.units
        along = derivative(values) + turns
        if not np.all(along[:, at] > 0):
            return None
        tangent = along / along[:, at][:, None] / units * units[at]
        arrived = turned(tangent, rate)
        maps = turning.derivatives(values + np.outer(steps, turns)) * units[None, :] / units[:, None]
        maps = maps - arrived[:, :, None] * maps[:, at, None, :]
        across = [i for i in turning.free if i != at]
        return cls(turning, values, turns, rate, lead, across, maps[:, across][:, :, across])

    @property
    def sheets(self) -> int:
        """Turns of the lead pendulum along the whole curve."""
        return round(abs(self.turns[2 + self.lead]) / (2 * math.pi))

    def forms(self, gamma: float) -> Array | None:
        """Q at the steps of χ, shape (m, a, a), in the units of the state; None if the sum does not converge.

        The sum diverges if there are too few steps for A, which varies faster along the curve than u.

        Args:
            gamma: contraction of deviations per revolution, above the largest modulus.
        """
        number = len(self.across)
        one = np.eye(number)
        maps, found = self.maps / gamma, np.tile(one, (len(self.maps), 1, 1))
        for _ in range(_MAX_TERMS):
            then = one + np.swapaxes(maps, 1, 2) @ turned(found, self.rate) @ maps
            then = 0.5 * (then + np.swapaxes(then, 1, 2))
            size = float(np.max(np.abs(then)))
            if not size < _MAX_FORM:
                return None
            if float(np.max(np.abs(then - found))) <= 1e-7 * size:
                return then
            found = then
        return None

    def rows(self, count: int, forms: Array) -> tuple[Array, Array]:
        """States and forms (SI) at equal steps of the lead's angle, shapes (count, 8) and (count, 8, 8)."""
        at, units = 2 + self.lead, self.turning.units
        fine = np.arange(-16 * len(self.values), 32 * len(self.values)) / (16 * len(self.values))
        angle = (series(self.values, fine) + np.outer(fine, self.turns))[:, at]
        wanted = 2 * math.pi * self.sheets * np.arange(count) / count
        place = np.interp(wanted, angle, fine)
        slopes = derivative(self.values)
        for _ in range(3):
            here = series(self.values, place)[:, at] + place * self.turns[at]
            place -= (here - wanted) / (series(slopes, place)[:, at] + self.turns[at])
        states = series(self.values, place) + np.outer(place, self.turns)
        found = np.zeros((count, 8, 8))
        found[:, np.array(self.across)[:, None], np.array(self.across)[None, :]] = series(forms, place)
        return states, found / units[:, None] / units[None, :]


def moduli_across(turning: RevolutionMap, values: Array, rate: float, winding: tuple[int, int]) -> Array:
    """Factors of deviations transverse to a curve per revolution, largest first, shape (free − 1,).

    The deviations are followed along the curve in its normal planes, so its angles need not increase monotonically.

    Args:
        values, rate, winding: u at equal steps of χ without winding, ρ, and turns of A and B along the whole curve.
    """
    free, units = turning.free, turning.units
    turns, steps = np.zeros(8), np.arange(len(values)) / len(values)
    turns[2:4] = 2 * math.pi * np.array(winding)
    tangents = ((derivative(values) + turns) / units)[:, free]
    maps = (turning.derivatives(values + np.outer(steps, turns)) * units[None, :] / units[:, None])[:, free][:, :, free]
    places = rate * np.arange(_FOLLOWED + 1, dtype=np.float64)
    along = series(tangents, places)
    along /= np.linalg.norm(along, axis=1)[:, None]
    number = len(free) - 1
    frame = np.linalg.qr(along[0][:, None], mode="complete")[0][:, 1:]
    logs = np.zeros((_FOLLOWED, number))
    for i, each in enumerate(series(maps, places[:-1])):
        moved = each @ frame
        moved -= np.outer(along[i + 1], along[i + 1] @ moved)
        frame, r = np.linalg.qr(moved)
        logs[i] = np.log(np.maximum(np.abs(np.diag(r)), 1e-300))
    t = (np.arange(_FOLLOWED - _DROPPED) + 0.5) / (_FOLLOWED - _DROPPED)
    window = np.exp(-1.0 / (t * (1.0 - t)))
    return np.sort(np.exp(window @ logs[_DROPPED:] / window.sum()))[::-1]


def positive(forms: Array, across: list[int]) -> bool:
    """Whether every form is finite and positive definite on the components of a deviation."""
    own = forms[:, across][:, :, across]
    scale = np.sqrt(np.abs(np.einsum("nii->ni", own)))
    if not (np.all(np.isfinite(own)) and np.all(scale > 0)):
        return False
    values: Array = np.linalg.eigvalsh(own / scale[:, :, None] / scale[:, None, :]).astype(np.float64)
    return bool(np.min(values) > 0)


def caught_scale(
    turning: RevolutionMap, points: Array, forms: Array, lead: int, sheets: int, *, quick: bool = False
) -> float:
    """V on the largest shell about a curve up to which every sample approached in a revolution; 0 if none did.

    Args:
        points, forms, lead, sheets: as for dynamics.steady.basins.pursuit.deviation.
        quick: fewer shells and samples.
    """
    units = turning.units
    across = [i for i in turning.free if lead < 0 or i != 2 + lead]
    ends = (points, forms, np.array([0, len(points)]), np.array([lead]), np.array([sheets]))
    outward = np.linalg.inv(np.linalg.cholesky(forms[:, across][:, :, across])).swapaxes(1, 2)
    largest = float(np.sqrt(np.max(np.sum((outward / units[across][None, :, None]) ** 2, axis=2))))
    rng, radius, passed = np.random.default_rng(_SEED), _FIRST_RAD / largest, 0.0
    ratio, shells, samples = _QUICK if quick else _THOROUGH
    for _ in range(shells):
        if radius * largest > _MAX_RAD:
            break
        rows = rng.integers(0, len(points), samples)
        ways = rng.standard_normal((samples, len(across)))
        ways *= radius / np.linalg.norm(ways, axis=1)[:, None]
        states = points[rows]
        states[:, across] += np.einsum("nij,nj->ni", outward[rows], ways)
        if not np.all(_values(turning.after(states), ends) < _SHRINK * radius**2):
            break
        passed = radius**2
        radius *= ratio
    return passed


def series(values: Array, places: Array) -> Array:
    """Trigonometric interpolation of values at equal steps (first axis, an odd number) at places χ."""
    count = len(values)
    away = places[:, None] - np.arange(count)[None, :] / count
    away -= np.round(away)
    own = np.abs(away) < 1e-12
    sine = np.sin(math.pi * np.where(own, 0.5, away))
    weights = np.where(own, 1.0, np.sin(math.pi * count * away) / (count * sine))  # the Dirichlet kernel
    return (weights @ values.reshape(count, -1)).reshape(len(places), *values.shape[1:])


def turned(values: Array, shift: float) -> Array:
    """Values at χ + shift, from those at equal steps χ; first axis."""
    count = len(values)
    orders = np.fft.fftfreq(count, 1 / count)
    flat = values.reshape(count, -1)
    moved = np.fft.ifft(np.fft.fft(flat, axis=0) * np.exp(2j * math.pi * orders * shift)[:, None], axis=0)
    return np.real(moved).reshape(values.shape)


def derivative(values: Array) -> Array:
    """Derivative d/dχ at the same steps."""
    count = len(values)
    orders = np.fft.fftfreq(count, 1 / count)
    return np.real(np.fft.ifft(2j * math.pi * orders[:, None] * np.fft.fft(values, axis=0), axis=0))


@compiled(nogil=True)
def _values(states: Array, ends: tuple[Array, Array, Indices, Indices, Indices]) -> Array:
    found, away = np.empty(len(states)), np.empty(8)
    for i in range(len(states)):
        found[i] = deviation(states[i], 0, ends, away)
    return found

"""States that repeat after some revolutions, up to whole turns of the pendulums, by Newton's method."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Array, Complex
from dynamics.steady.basins.turning import RevolutionMap

_NEWTON = 12
_CLOSED = 1e-10  # largest residual, in the units of the state
_STEP = 0.5  # largest Newton step, in units
_MAX_DISTANCE = 1.0  # largest distance of a solution from the guess, in units


@dataclass(frozen=True)
class PeriodicMotion:
    """A motion that is periodic in the rotor's frame.

    Attributes:
        states: states at the start of each revolution, angles not reduced, shape (q, 8).
        turns: turns of A and B relative to the rotor in the whole period.
        maps: derivatives of the once-a-revolution map at the states, SI, shape (q, 8, 8).
        moduli: moduli of the multipliers over one revolution, largest first: |eigenvalues of the product|^(1/q).
        residual: residual of the equation, in the units of the state.
    """

    states: Array
    turns: tuple[int, int]
    maps: Array
    moduli: Array
    residual: float

    @property
    def stable(self) -> bool:
        """Whether every multiplier lies inside the unit circle."""
        return bool(self.moduli[0] < 1.0)


def periodic_motion(
    turning: RevolutionMap, guess: Array, period: int = 1, turns: tuple[int, int] = (0, 0)
) -> PeriodicMotion | None:
    """The periodic motion near a state, or None if Newton's method leaves the neighbourhood.

    Args:
        guess: state at ψ = 0, shape (8,).
        period: period in revolutions.
        turns: whole turns of A and B relative to the rotor in a period.
    """
    free, units = turning.free, turning.units
    y, whole = guess.copy(), np.zeros(8)
    whole[2:4] = 2 * math.pi * np.array(turns)
    for _ in range(_NEWTON):
        states = turning.strobed(y, period)
        residual = ((states[-1] - y - whole) / units)[free]
        size = float(np.max(np.abs(residual)))
        if not math.isfinite(size) or np.max(np.abs((y - guess) / units)) > _MAX_DISTANCE:
            return None
        maps = turning.derivatives(states[:-1])
        own = (maps * units[None, :] / units[:, None])[:, free][:, :, free]
        product = np.eye(len(free))
        for each in own:
            product = each @ product
        if size < _CLOSED * period:
            values: Complex = np.linalg.eigvals(product).astype(np.complex128)
            moduli = np.sort(np.abs(values) ** (1.0 / period))[::-1]
            return PeriodicMotion(states[:-1], turns, maps, moduli, size)
        try:
            step = _solved(product - np.eye(len(free)), -residual)
        except np.linalg.LinAlgError:  # usual: Newton's method fails from this start
            return None
        largest = float(np.max(np.abs(step)))
        y[free] += step * min(1.0, _STEP / max(largest, 1e-300)) * units[free]
    return None


def _solved(matrix: Array, right: Array) -> Array:
    return np.linalg.solve(matrix, right).astype(np.float64)


def repeats(turning: RevolutionMap, strobe: Array, most: int, within: float) -> tuple[int, tuple[int, int]] | None:
    """Period of a strobed motion in revolutions, and its turns; None if it is not periodic.

    Args:
        strobe: shape (n, 8).
        most: longest period, revolutions.
        within: permitted difference, in the units of the state.
    """
    for period in range(1, min(most, len(strobe) - 1) + 1):
        gap: Array = strobe[-1] - strobe[-1 - period]
        turns: Array = np.round(gap[2:4] / (2 * math.pi))
        gap[2:4] -= 2 * math.pi * turns
        if np.max(np.abs((gap / turning.units)[turning.free])) < within:
            return period, (int(turns[0]), int(turns[1]))
    return None

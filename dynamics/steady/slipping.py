"""Evidence that pendulums slip for ever: an attracting closed curve of the once-a-revolution map.

Strobed once a revolution, a motion that slips regularly lies on a closed curve in the space of states: u(χ) with
χ growing by the slip rate ρ each revolution (on a single set of points of it when ρ is rational: a periodic slipping
orbit). Two things are asked, and neither holds in a transient:
- the curve fitted to one stretch of the motion foretells the next stretch;
- the linearised map, from where the motion has come to lie on the curve until its end, shrinks every deviation
  across the curve, and none along it grows more than the curve itself is stretched.
Chaotic slipping and slipping at two rates meet neither; nobody can tell those from a long transient by watching.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from dynamics.equations.parameters import RotorParameters
from dynamics.stability.turn_map import turn_derivatives

_LEAST_TURNS = 6.0  # against the rotor within the stretch, to call it going on
_HARMONICS = (16, 64, 200)  # of the slip's phase
_CURVE_RAD = 2e-3  # how well the curve must foretell the next stretch
_SHRUNK = 0.1  # what a deviation across the curve must have shrunk to
_STRETCH = 20.0  # growth along the curve beyond the curve's own
_MOST_FITTED, _MOST_JUDGED = 3000, 1500  # revolutions fitted, and judged
_TOGETHER = 5  # maps multiplied before deviations along and across are told apart again
_RATES = 4  # the largest whole number of turns one pendulum makes while the curve is passed once
_SAME_RATE = 1e-5  # turns per revolution


@dataclass(frozen=True)
class SlippingMotion:
    """A stable motion in which at least one pendulum turns against the rotor for ever.

    Attributes:
        turns_per_revolution: mean slip of A and of B, turns for each revolution of the rotor.
        misfit_rad: largest difference between the closed curve and strobes it was not fitted to (angles in rad, the
            rest in their own scales).
        shrinkage: what a deviation across the curve is multiplied with over `judged` revolutions.
        judged: revolutions over which that was found.
    """

    turns_per_revolution: tuple[float, float]
    misfit_rad: float
    shrinkage: float
    judged: int


def slipping_motion(
    parameters: RotorParameters, speed_rad_s: float, strobe: NDArray[np.float64]
) -> SlippingMotion | None:
    """The stable slipping motion that a stretch of strobed states lies on, or None.

    Args:
        parameters: without dry friction.
        strobe: states once a revolution at ψ = 0, angles counted on over whole turns, shape (n, 8).
    """
    present = [i for i, q in enumerate((parameters.a, parameters.b)) if q.present]
    whole = strobe[-(_MOST_FITTED + _MOST_JUDGED) :]
    if not present or len(whole) < 60 or not np.all(np.isfinite(whole)):
        return None
    rates = _mean_rates(whole[:, 2:4])
    if np.max(np.abs(rates[present])) * len(whole) < _LEAST_TURNS:
        return None
    kept = [0, 1, *(2 + i for i in present), 4, 5, *(6 + i for i in present)]
    arm = max((parameters.a, parameters.b)[i].length_m for i in present)
    scale = np.array([arm, arm, 1, 1, arm * speed_rad_s, arm * speed_rad_s, speed_rad_s, speed_rad_s])
    fitted = max(len(whole) - _MOST_JUDGED, 2 * len(whole) // 3)
    found, turns = None, (0, 0)
    for rate, turns in _windings(rates):
        phase = rate * np.arange(len(whole), dtype=np.float64)
        scaled = whole / scale
        scaled[:, 2:4] -= 2 * math.pi * np.outer(phase, turns)
        found = _curve(phase, scaled, fitted)
        if found is not None:
            break
    if found is None:
        return None
    misfit, begin, along = found
    along[2:4] += 2 * math.pi * np.array(turns)
    judged = _shrinkage(parameters, speed_rad_s, whole[begin:], scale, kept, along)
    if judged is None or judged[0] > _SHRUNK:
        return None
    return SlippingMotion((float(rates[0]), float(rates[1])), misfit, *judged)


def _mean_rates(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turns per revolution, shape (2,), by a smooth window: the error falls faster than any power of the length."""
    t = (np.arange(len(angles) - 1) + 0.5) / (len(angles) - 1)
    window = np.exp(-1.0 / (t * (1.0 - t)))
    return window @ np.diff(angles, axis=0) / window.sum() / (2 * math.pi)


def _windings(rates: NDArray[np.float64]) -> list[tuple[float, tuple[int, int]]]:
    """Slip rates ρ of a curve and whole numbers (m, n) with rates = ρ (m, n), the simplest first."""
    lead, found = int(np.argmax(np.abs(rates))), []
    for turns in range(1, _RATES + 1):
        rate = float(rates[lead]) / turns
        other = round(float(rates[1 - lead]) / rate)
        if abs(rates[1 - lead] - other * rate) < _SAME_RATE:
            found.append((rate, (turns, other) if lead == 0 else (other, turns)))
    return found


def _curve(
    phase: NDArray[np.floating], states: NDArray[np.float64], fitted: int
) -> tuple[float, int, NDArray[np.float64]] | None:
    """A closed curve through the first states that foretells the others.

    Args:
        phase: of the slip, turns, shape (n,).
        states: scaled and without whole turns, shape (n, 8).
    Returns:
        Largest misfit of the states not fitted, the first state from which on all lie as near, and du/dχ (8,) there;
        None when no curve does.
    """
    middle = states[:fitted].mean(axis=0)
    for count in _HARMONICS:
        if 4 * count > fitted:
            return None
        order = np.arange(1, count + 1)
        waves = np.exp(2j * math.pi * np.outer(phase, order))
        basis = np.column_stack([np.ones(len(phase)), np.real(waves), np.imag(waves)])
        train = basis[:fitted]
        gram = train.T @ train + 1e-9 * fitted * np.eye(basis.shape[1])
        weights = np.linalg.solve(gram, train.T @ (states[:fitted] - middle))
        off = np.max(np.abs(basis @ weights + middle - states), axis=1)
        misfit = float(np.max(off[fitted:]))
        if misfit < _CURVE_RAD:
            begin = len(off) - int(np.argmax(off[::-1] >= _CURVE_RAD)) if np.any(off >= _CURVE_RAD) else 0
            at = waves[begin]
            slope = 2 * math.pi * np.concatenate([[0.0], -order * np.imag(at), order * np.real(at)])
            return misfit, begin, slope @ weights
    return None


def _shrinkage(
    parameters: RotorParameters,
    speed: float,
    states: NDArray[np.float64],
    scale: NDArray[np.float64],
    kept: list[int],
    along: NDArray[np.float64],
) -> tuple[float, int] | None:
    """What deviations across the curve are multiplied with, and over how many revolutions.

    Returns:
        None when one along the curve grows, or where the map's derivatives can't be had.
    """
    n = len(kept)
    first = np.eye(n)[:, np.argsort(-np.abs(along[kept]))]
    frame, _ = np.linalg.qr(np.column_stack([along[kept], first[:, 1:]]))
    across, growth, done = np.eye(n - 1), 0.0, 0
    block = 100
    for begin in range(0, len(states) - 1, block):
        maps = turn_derivatives(parameters, speed, states[begin : min(begin + block, len(states) - 1)])
        if maps is None or not np.all(np.isfinite(maps)):
            return None
        own = (maps * scale[None, :] / scale[:, None])[:, kept][:, :, kept]
        for at in range(0, len(own), _TOGETHER):
            frame, r = np.linalg.qr(reduce(lambda after, turn: turn @ after, own[at : at + _TOGETHER], frame))
            growth += math.log(abs(r[0, 0]))
            if growth > math.log(1e4):
                return None
            across = r[1:, 1:] @ across
        done += len(own)
        if np.linalg.norm(across, 2) < 0.1 * _SHRUNK and done >= 0.5 * len(states):
            break
    # along the curve a deviation is stretched as the curve is: bounded, however long it is watched
    if growth > math.log(_STRETCH):
        return None
    return float(np.linalg.norm(across, 2)), done

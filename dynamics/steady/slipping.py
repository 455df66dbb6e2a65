"""Evidence of permanent slipping of the pendulums: an attracting closed curve of the once-a-revolution map.

Strobed once a revolution, a regularly slipping motion lies on a closed curve u(χ) in the space of states, with χ
growing by the slip rate ρ each revolution (on a finite set of its points if ρ is rational: a periodic slipping orbit).
Two conditions are required. A transient satisfies neither.
- The curve fitted to one interval of the motion predicts the next interval.
- The linearised map, from the point where the motion lies on the curve until its end, reduces every deviation
  transverse to the curve, and no deviation along the curve grows more than the stretch of the curve itself.
Chaotic slipping and slipping at two rates satisfy neither. They cannot be distinguished from a long transient by
observation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from dynamics.arrays import Array
from dynamics.equations.parameters import RotorParameters
from dynamics.stability.turn_map import turn_derivatives

_linear_algebra: Any = np.linalg  # numpy types its results as unions
_MIN_TURNS = 6.0  # turns relative to the rotor within the interval of a slipping motion
_HARMONICS = (16, 64, 200)  # of the slip's phase
_CURVE_RAD = 2e-3  # largest error of the curve's prediction
_SHRUNK = 0.1  # largest remaining part of a deviation transverse to the curve
_STRETCH = 20.0  # largest growth along the curve relative to the curve's own
_MAX_FITTED, _MAX_JUDGED = 3000, 1500  # revolutions fitted, and evaluated
_TOGETHER = 5  # number of maps multiplied before deviations are separated into components again
_RATES = 4  # largest whole number of turns of a pendulum along the whole curve
_SAME_RATE = 1e-5  # turns per revolution


@dataclass(frozen=True)
class SlippingMotion:
    """A stable motion in which at least one pendulum slips permanently.

    Attributes:
        turns_per_revolution: mean slip of A and of B, turns per revolution of the rotor.
        misfit_rad: largest difference between the closed curve and strobes to which it was not fitted (angles in rad,
            other components in their own scales).
        shrinkage: factor of a deviation transverse to the curve over `judged` revolutions.
        judged: number of evaluated revolutions.
    """

    turns_per_revolution: tuple[float, float]
    misfit_rad: float
    shrinkage: float
    judged: int


def slipping_motion(parameters: RotorParameters, speed_rad_s: float, strobe: Array) -> SlippingMotion | None:
    """The stable slipping motion of an interval of strobed states, or None.

    Args:
        parameters: parameters without dry friction.
        strobe: states once a revolution at ψ = 0, angles not reduced, shape (n, 8).
    """
    present = [i for i, q in enumerate((parameters.a, parameters.b)) if q.present]
    whole = strobe[-(_MAX_FITTED + _MAX_JUDGED) :]
    if not present or len(whole) < 60 or not np.all(np.isfinite(whole)):
        return None
    rates = _mean_rates(whole[:, 2:4])
    if np.max(np.abs(rates[present])) * len(whole) < _MIN_TURNS:
        return None
    kept = [0, 1, *(2 + i for i in present), 4, 5, *(6 + i for i in present)]
    arm = max((parameters.a, parameters.b)[i].length_m for i in present)
    scale = np.array([arm, arm, 1, 1, arm * speed_rad_s, arm * speed_rad_s, speed_rad_s, speed_rad_s])
    fitted = max(len(whole) - _MAX_JUDGED, 2 * len(whole) // 3)
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


def _mean_rates(angles: Array) -> Array:
    """Mean rates in turns per revolution, shape (2,), with a smooth window, whose error decreases fast with length."""
    t = (np.arange(len(angles) - 1) + 0.5) / (len(angles) - 1)
    window = np.exp(-1.0 / (t * (1.0 - t)))
    return window @ np.diff(angles, axis=0) / window.sum() / (2 * math.pi)


def _windings(rates: Array) -> list[tuple[float, tuple[int, int]]]:
    """Slip rates ρ of a curve and whole numbers (m, n) with rates = ρ (m, n), the simplest first."""
    lead, found = int(np.argmax(np.abs(rates))), list[tuple[float, tuple[int, int]]]()
    for turns in range(1, _RATES + 1):
        rate = float(rates[lead]) / turns
        other = round(float(rates[1 - lead]) / rate)
        if abs(rates[1 - lead] - other * rate) < _SAME_RATE:
            found.append((rate, (turns, other) if lead == 0 else (other, turns)))
    return found


def _curve(phase: Array, states: Array, fitted: int) -> tuple[float, int, Array] | None:
    """A closed curve through the first states that predicts the others.

    Args:
        phase: phase of the slip, turns, shape (n,).
        states: scaled and without whole turns, shape (n, 8).
    Returns:
        Largest misfit of the states not fitted, the first state from which all are as near, and du/dχ (8,) there;
        None if such a curve is not found.
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
        weights: Array = _linear_algebra.solve(gram, train.T @ (states[:fitted] - middle))
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
    states: Array,
    scale: Array,
    kept: list[int],
    along: Array,
) -> tuple[float, int] | None:
    """Factor of deviations transverse to the curve, and the number of revolutions.

    Returns:
        None if a deviation along the curve grows, or if the map's derivatives cannot be computed.
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
    # a deviation along the curve is stretched like the curve itself: bounded for any number of revolutions
    if growth > math.log(_STRETCH):
        return None
    return float(np.linalg.norm(across, 2)), done

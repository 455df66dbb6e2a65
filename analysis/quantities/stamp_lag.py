"""Lag of a displacement's stamps behind the rotor's phase, from 1× vectors over speed and those of a reference.

Lasers and rotor phase have clocks of their own, and a stamp lacks the least delay of its device's path (`daq.clock`): a
radio adds some 10 ms. A lag τ turns a vector of order k by −kωτ, in proportion to the speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig_basics.arrays import Array, Complex

UNKNOWN_LAG_STD_S = 10e-3
"""Standard uncertainty of a lag between separate clocks before it is estimated, as in identification: radios and
drivers' buffers delay by up to some 20 ms."""
_LEAST_STD_S = 1e-5
_MAX_REST_RAD, _MAX_REST_SHARE = math.radians(1.5), 0.25  # rms residual of a line, absolute and of the whole phase


@dataclass(frozen=True)
class StampLag:
    """Lag of a displacement's stamps.

    Attributes:
        lag_s: lag, s; positive: the stamps are later than those of the rotor's phase.
        std_s: standard uncertainty.
        rest_rad: rms phase that the line leaves, weighted by the amplitudes.
        is_line: whether the phase is a line over speed through 0; else the difference has another cause.
    """

    lag_s: float
    std_s: float
    rest_rad: float
    is_line: bool

    def without(self, speed_rad_s: Array, amplitude_m: Complex) -> Complex:
        """Return 1× vectors as they would be without the lag."""
        return amplitude_m * np.exp(1j * speed_rad_s * self.lag_s)


def unknown_lag(clocks: Mapping[str, str], name: str) -> StampLag:
    """Return the lag before it is estimated: none with one clock for both; clocks as in daq.signals.run.Run."""
    one_clock = name in clocks and clocks[name] == clocks.get("phase")
    return StampLag(0.0, 0.0 if one_clock else UNKNOWN_LAG_STD_S, 0.0, is_line=False)


def fitted_lag(speed_rad_s: Array, measured_m: Complex, reference_m: Complex) -> StampLag | None:
    """Return the lag for which measured less reference phase is a straight line through 0 at standstill.

    The line is weighted by the amplitudes. Its uncertainty is half the difference of the lags of the slow and the fast
    half of the weight, and what a constant angle would add: the phase at standstill of a line that is free there, over
    the mean speed. A constant angle, as of an index mark elsewhere, is no lag: near one resonance both look alike, so
    the free line must begin near 0.

    Args:
        speed_rad_s: speeds, shape (n,), rad/s.
        measured_m, reference_m: 1× vectors at these speeds, shape (n,).

    Returns:
        None with too few vectors.
    """
    ahead = np.angle(measured_m * np.conj(reference_m))
    weight = np.abs(reference_m) * np.abs(measured_m)
    good = np.isfinite(ahead) & np.isfinite(weight)
    speed, ahead, weight = speed_rad_s[good], ahead[good], weight[good]

    def lag_of(part: NDArray[np.bool_] | slice) -> float:
        return -float((weight * speed * ahead)[part].sum() / (weight * speed**2)[part].sum())

    passed = np.cumsum(weight * speed**2)
    slow = passed <= 0.5 * passed[-1:]
    if not 0 < np.count_nonzero(slow) < len(slow) or not passed[slow][-1] > 0:
        return None
    lag, std = lag_of(slice(None)), 0.5 * abs(lag_of(slow) - lag_of(~slow))
    middle = float(np.average(speed, weights=weight))
    about = speed - middle
    slope = float((weight * about * ahead).sum() / max(float((weight * about**2).sum()), 1e-300))
    constant = float(np.average(ahead, weights=weight)) - slope * middle
    std = math.hypot(std, constant / middle)
    rest = math.sqrt(float(np.average((ahead + lag * speed) ** 2, weights=weight)))
    most = max(_MAX_REST_RAD, _MAX_REST_SHARE * math.sqrt(float(np.average(ahead**2, weights=weight))))
    return StampLag(lag, max(std, _LEAST_STD_S), rest, max(rest, abs(constant)) <= most)

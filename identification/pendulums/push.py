"""When each pendulum of a spin-down was pushed and how it then slows: what the coupled fit starts from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.signals.phase_noise import encoder_step
from identification.errors import NotIdentifiable
from identification.pendulums.decline import decline_of
from identification.pendulums.run_down import RunDown, stop_time
from identification.pendulums.spin_down import first_fit
from identification.pendulums.transient import Readings
from identification.samples import block_averages, encoder_noise

TIME_CONSTANTS = 4.5
_BLOCK_S, _SPEED_S = 0.008, 0.04
_FEWEST = 400


@dataclass(frozen=True)
class Decline:
    """The stretch of a record in which a pendulum runs down, and when its push began.

    Attributes:
        push_s, start_s, end_s: the push's begin, the fastest instant, four and a half time constants on.
        rate_per_s, speed_rad_s: of the bare exponential.
        friction_share, stop_s: dry friction's share of the first torque as the angle alone shows it, and when it stops
            the pendulum; inf where it does not.
    """

    push_s: float
    start_s: float
    end_s: float
    rate_per_s: float
    speed_rad_s: float
    friction_share: float = 0.0
    stop_s: float = np.inf


def find_decline(time_s: np.ndarray, angle_rad: np.ndarray) -> Decline:
    """The run-down after the last push.

    Args:
        time_s, angle_rad: shape (n,).
    Raises:
        NotIdentifiable: no motion worth the name, or the speed does not fall.
    """
    data = decline_of(time_s, angle_rad)
    start = float(data.time_s[0])
    theta = first_fit(RunDown(data.time_s - start, data.angle_rad, data.noise_rad, data.step_rad))
    rate, speed = float(np.exp(theta[2])), abs(float(theta[1]))
    end = min(float(data.time_s[-1]), start + TIME_CONSTANTS / rate)
    share = float(theta[3])
    stop = start + stop_time(rate, share)
    return Decline(_push(time_s, angle_rad, start, speed), start, end, rate, speed, share, stop)


def _push(time_s: np.ndarray, angle_rad: np.ndarray, start_s: float, speed_rad_s: float) -> float:
    """The last instant before the start at which the pendulum hardly moved."""
    before = np.isfinite(angle_rad) & (time_s < start_s)
    t, angle = time_s[before], angle_rad[before]
    if len(t) < 3:
        return float(time_s[0])
    earlier = np.interp(t - _SPEED_S, t, angle)
    slow = np.flatnonzero(np.abs(angle - earlier) < 0.05 * speed_rad_s * _SPEED_S)
    return float(t[slow[-1]]) if len(slow) else float(t[0])


def spin_down_readings(time_s: np.ndarray, angle_rad: np.ndarray, rate_per_s: float) -> Readings:
    """One encoder's samples with blocks short against the decay, and the noise where the pendulum moves.

    Raises:
        NotIdentifiable: too few samples.
    """
    good = np.isfinite(angle_rad)
    if np.count_nonzero(good) < _FEWEST:
        raise NotIdentifiable(f"{np.count_nonzero(good)} valid encoder samples are too few, {_FEWEST} are needed")
    time, angle = time_s[good], angle_rad[good]
    step = encoder_step(angle)
    averages = block_averages(time, angle, min(_BLOCK_S, 0.2 / rate_per_s), encoder_noise(angle, step or 1e-6))
    return Readings(time, angle, averages, step)

"""Start values of the coupled fit of a spin-down: push and run-down of each pendulum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.signals.phase_noise import encoder_step
from identification.errors import NotIdentifiable
from identification.pendulums.decline import decline_of
from identification.pendulums.run_down import RunDown, stop_time
from identification.pendulums.spin_down import first_fit
from identification.pendulums.transient import EncoderReadings
from identification.samples import block_averages, encoder_noise
from rig_basics.texts import number_of

TIME_CONSTANTS = 4.5
"""Length of the fitted run-down in time constants."""
_BLOCK_S, _SPEED_S = 0.008, 0.04
_FEWEST = 400


@dataclass(frozen=True)
class Decline:
    """Stretch of a record in which a pendulum runs down.

    Attributes:
        push_s: begin of the push, s.
        start_s: instant of the largest speed, s.
        end_s: end of the stretch, TIME_CONSTANTS time constants later, s.
        rate_per_s, speed_rad_s: decay rate and initial speed of the fitted exponential.
        friction_share: share of dry friction in the initial torque, from the angle alone.
        stop_s: instant at which dry friction stops the pendulum, s; inf if it does not.
    """

    push_s: float
    start_s: float
    end_s: float
    rate_per_s: float
    speed_rad_s: float
    friction_share: float = 0.0
    stop_s: float = np.inf


def find_decline(time_s: np.ndarray, angle_rad: np.ndarray) -> Decline:
    """Find the run-down after the last push.

    Args:
        time_s, angle_rad: shape (n,).
    Raises:
        NotIdentifiable: the pendulum hardly moves, or its speed does not decrease.
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
    """Return the last instant before the start at which the pendulum hardly moved, s."""
    before = np.isfinite(angle_rad) & (time_s < start_s)
    t, angle = time_s[before], angle_rad[before]
    if len(t) < 3:
        return float(time_s[0])
    earlier = np.interp(t - _SPEED_S, t, angle)
    slow = np.flatnonzero(np.abs(angle - earlier) < 0.05 * speed_rad_s * _SPEED_S)
    return float(t[slow[-1]]) if len(slow) else float(t[0])


def spin_down_readings(time_s: np.ndarray, angle_rad: np.ndarray, rate_per_s: float) -> EncoderReadings:
    """Return one encoder's samples with averages over blocks that are short compared with the decay.

    Args:
        time_s, angle_rad: samples, shape (n,).
        rate_per_s: decay rate, 1/s.
    Raises:
        NotIdentifiable: there are too few samples.
    """
    good = np.isfinite(angle_rad)
    if np.count_nonzero(good) < _FEWEST:
        raise NotIdentifiable(
            f"{number_of(np.count_nonzero(good), 'valid encoder sample is', 'valid encoder samples are')} "
            f"too few, {_FEWEST} are needed"
        )
    time, angle = time_s[good], angle_rad[good]
    step = encoder_step(angle)
    averages = block_averages(time, angle, min(_BLOCK_S, 0.2 / rate_per_s), encoder_noise(angle, step or 1e-6))
    return EncoderReadings(time, angle, averages, step)

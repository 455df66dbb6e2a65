"""Where in an encoder's record a pendulum runs down, and what one of its readings is worth.

Found from the readings themselves, on their own scale of time: strong damping leaves twenty milliseconds, weak damping
minutes.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter

from daq.signals.phase_noise import encoder_step
from identification.errors import NotIdentifiable
from identification.pendulums.run_down import RunDown
from identification.samples import encoder_noise, white_noise

_FEWEST = 40  # samples of a decline
_DIFFERENCE = 1.5  # noise of two readings' difference, in a reading's; a little above √2
_RISE = 0.1  # of the fastest speed: less is no push
_LEAST_TRAVEL = 60  # in noise standard deviations


def decline_of(time_s: np.ndarray, angle_rad: np.ndarray) -> RunDown:
    """The record from its fastest instant on, up to the next push if there is one.

    Args:
        time_s, angle_rad: shape (n,). NaN and single readings off the track are left out; a wrapped angle is unwrapped.
    Raises:
        NotIdentifiable: too few readings, or the pendulum hardly moves.
    """
    t, angle = _valid(np.asarray(time_s, float), np.asarray(angle_rad, float))
    step = encoder_step(angle)
    # the noise of an angle that is not quantised needs no motion to be seen; a quantised one's does
    noise = encoder_noise(angle, step) if step else max(white_noise(angle), 1e-12 * float(np.ptp(angle)) + 1e-15)
    keep = _on_track(angle, 8 * max(noise, 0.3 * step))
    t, angle = t[keep], angle[keep]
    begin, end = _stretch(t, angle, noise)
    t, angle = t[begin:end], angle[begin:end]
    travel = float(np.ptp(angle)) if len(angle) else 0.0
    if travel < _LEAST_TRAVEL * noise:
        raise NotIdentifiable(
            f"the pendulum travels only {travel:.2g} rad where a reading's noise is {noise:.2g}; flick it harder"
        )
    if len(t) < _FEWEST:
        raise NotIdentifiable(f"the pendulum stops within {len(t)} samples of its push, {_FEWEST} are needed")
    return RunDown(t, angle, noise, step)


def _valid(time_s: np.ndarray, angle_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if time_s.shape != angle_rad.shape or time_s.ndim != 1:
        raise NotIdentifiable(
            f"time and angle of one pendulum in two arrays of one length are needed, got shapes {time_s.shape} and "
            f"{angle_rad.shape}"
        )
    good = np.isfinite(time_s) & np.isfinite(angle_rad)
    if np.count_nonzero(good) < _FEWEST:
        raise NotIdentifiable(f"{np.count_nonzero(good)} valid encoder samples are too few")
    t, angle = time_s[good], angle_rad[good]
    if np.any(np.diff(t) < 0):
        order = np.argsort(t, kind="stable")
        t, angle = t[order], angle[order]
    if np.ptp(angle) <= 2 * np.pi and np.any(np.abs(np.diff(angle)) > np.pi):
        angle = np.unwrap(angle)
    return t, angle


def _on_track(angle: np.ndarray, limit: float) -> np.ndarray:
    """False for readings that stand apart from their neighbours: a monotonic motion is its own running median."""
    usual = median_filter(angle, 5, mode="constant")
    return np.abs(angle - usual) <= limit + np.abs(np.gradient(usual))


def _stretch(t: np.ndarray, angle: np.ndarray, noise: float) -> tuple[int, int]:
    """Indices of the fastest instant and of the next push after it (or the end).

    A speed is a difference over a span as long as the motion needs, not the sampling: all n of them are to be within
    a tenth of the fastest, the largest of n normal errors being √(2 ln n) standard deviations.
    """
    reach, stride = float(np.sqrt(2 * np.log(len(t)))) if len(t) > 1 else 1.0, 2
    while True:
        moved = angle[stride:] - angle[:-stride]
        if np.max(np.abs(moved)) > reach * _DIFFERENCE / _RISE * noise or stride * 8 > len(t):
            break
        stride *= 2
    span = np.maximum(t[stride:] - t[:-stride], 1e-12)
    speed, uncertain = np.abs(moved / span), reach * _DIFFERENCE * noise / span
    begin = int(np.argmax(speed - uncertain))
    slowest = np.minimum.accumulate(speed[begin:] + uncertain[begin:])
    pushed = np.flatnonzero(speed[begin:] - uncertain[begin:] > slowest + _RISE * speed[begin])
    end = begin + int(pushed[0]) if len(pushed) else len(t)
    # in motion from the record's first reading on
    first = 0 if begin <= stride and speed[0] > 0.7 * speed[begin] else begin
    return first, end

"""Detection of the run-down in an encoder's record, and noise of its readings.

The time scale is derived from the readings: the run-down lasts twenty milliseconds with strong damping and minutes with
weak damping.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from daq.signals.phase_noise import encoder_step
from identification.errors import NotIdentifiable
from identification.pendulums.run_down import RunDown
from identification.samples import encoder_noise, white_noise
from rig_basics.texts import distinct, number_of

_FEWEST = 40  # smallest number of samples of a run-down
_DIFFERENCE = 1.5  # noise of the difference of two readings over that of a reading; slightly above √2
_RISE = 0.1  # smallest increase of the speed that counts as a push, over the largest speed
_LEAST_TRAVEL = 60  # smallest travel in standard deviations of the noise


def decline_of(time_s: np.ndarray, angle_rad: np.ndarray) -> RunDown:
    """Return the record from its fastest instant up to the next push, or to its end without a further push.

    Args:
        time_s, angle_rad: shape (n,). NaN and single outliers are left out; a wrapped angle is unwrapped.
    Raises:
        NotIdentifiable: there are too few readings, or the pendulum hardly moves.
    """
    t, angle = _valid(np.asarray(time_s, float), np.asarray(angle_rad, float))
    step = encoder_step(angle)
    # the noise of a quantised angle is visible only during motion, that of other angles always
    noise = encoder_noise(angle, step) if step else max(white_noise(angle), 1e-12 * float(np.ptp(angle)) + 1e-15)
    keep = _on_track(angle, 8 * max(noise, 0.3 * step))
    t, angle = t[keep], angle[keep]
    begin, end = _stretch(t, angle, noise)
    t, angle = t[begin:end], angle[begin:end]
    travel = float(np.ptp(angle)) if len(angle) else 0.0
    if travel < _LEAST_TRAVEL * noise:
        found, needed = distinct(travel, _LEAST_TRAVEL * noise)
        raise NotIdentifiable(
            f"the pendulum travels only {found} rad, at least {needed} rad are needed "
            f"({_LEAST_TRAVEL} times the noise of a reading); flick it harder"
        )
    if len(t) < _FEWEST:
        raise NotIdentifiable(
            f"the pendulum stops within {number_of(len(t), 'sample')} of its push, {_FEWEST} are needed"
        )
    return RunDown(t, angle, noise, step)


def _valid(time_s: np.ndarray, angle_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if time_s.shape != angle_rad.shape or time_s.ndim != 1:
        raise NotIdentifiable(
            f"expected time and angle of one pendulum as arrays of shape (n,), got shapes {time_s.shape} and "
            f"{angle_rad.shape}"
        )
    good = np.isfinite(time_s) & np.isfinite(angle_rad)
    if np.count_nonzero(good) < _FEWEST:
        raise NotIdentifiable(
            f"{number_of(np.count_nonzero(good), 'valid encoder sample is', 'valid encoder samples are')} "
            f"too few, {_FEWEST} are needed"
        )
    t, angle = time_s[good], angle_rad[good]
    if np.any(np.diff(t) < 0):
        order = np.argsort(t, kind="stable")
        t, angle = t[order], angle[order]
    if np.ptp(angle) <= 2 * np.pi and np.any(np.abs(np.diff(angle)) > np.pi):
        angle = np.unwrap(angle)
    return t, angle


def _on_track(angle: np.ndarray, limit: float) -> np.ndarray:
    """Return False for outliers: readings far from the running median, which a monotonic motion equals."""
    usual: NDArray[np.float64] = cast("Any", ndimage).median_filter(angle, 5, mode="constant")  # scipy has no types
    return np.abs(angle - usual) <= limit + np.abs(np.gradient(usual))


def _stretch(t: np.ndarray, angle: np.ndarray, noise: float) -> tuple[int, int]:
    """Return the indices of the fastest instant and of the next push after it, or of the end.

    A speed is a difference over a span that is long enough for the noise: all n errors must be below a tenth of the
    largest speed. The largest of n normal errors is √(2 ln n) standard deviations.
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
    # the pendulum moves from the first reading of the record on
    first = 0 if begin <= stride and speed[0] > 0.7 * speed[begin] else begin
    return first, end

"""Checks of arrays of times from a caller, with the caller's class of errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from rig_basics.arrays import Array
from rig_basics.texts import number_of


def seconds(time_s: ArrayLike, error: type[Exception]) -> Array:
    """Return times as C-contiguous floats of the same shape.

    Args:
        time_s: any shape, s.
        error: class of the error, which is raised for dates, text and anything else that is not real.
    """
    try:
        given = np.asarray(time_s)
    except ValueError:  # usual: rows of unequal lengths
        raise error("expected times in seconds, got rows of unequal lengths") from None
    if given.dtype.kind not in "fiu":
        raise error(
            f"expected times in seconds as real numbers, got an array of {given.dtype}; convert dates, e.g. by "
            "(time - time[0]) / numpy.timedelta64(1, 's')"
        )
    return np.asarray(given, float, order="C")


def need_ascending(time_s: Array, error: type[Exception]) -> None:
    """Raise an error of the class `error` if times, shape (n,), s, run backwards; repeated times are permitted."""
    back = np.diff(time_s) < 0
    if np.any(back):
        at = int(np.argmax(back))
        raise error(f"time runs backwards after sample {at} ({time_s[at]:.6g} s); sort the samples by time")


def checked_times(time_s: ArrayLike, error: type[Exception], *, any_order: bool = False) -> Array:
    """Return sample times as floats, after a check of what no evaluation can use.

    Args:
        time_s: shape (n,), s, ascending; NaN is permitted. A few repeated times are permitted.
        error: class of the error, which is raised if the times are dates or text, run backwards, or most of them are
            repeated.
        any_order: whether times may also run backwards, for an evaluation that sorts them.
    """
    time = seconds(time_s, error)
    if time.ndim != 1:
        raise error(f"expected times of shape (n,), got {time.shape}")
    finite = time[np.isfinite(time)]
    finite = np.sort(finite) if any_order else finite
    need_ascending(finite, error)
    repeated = np.flatnonzero(np.diff(finite) == 0)
    if 2 * len(repeated) >= len(finite) - 1 > 0:
        raise error(
            f"{len(repeated)} of {number_of(len(finite), 'time')} repeat the time before, "
            f"first {finite[repeated[0]]:.6g} s; give "
            "each sample its own time. A time with too few digits, or that of a packet, belongs to one sample only"
        )
    return time

"""Detection of a pendulum that moves although its lock is reported closed.

A worn or half-closed lock lets its pendulum slip. The angles remain plausible, and every test that takes the pendulum
for locked is wrong: its unbalance, and the bow and S_P that follow from it. The module has no clock and no I/O.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.lock_positions import lock_tolerance_deg
from daq.channels import LOCK_A_CLOSED, LOCK_B_CLOSED

SETTLE_S = 0.5
"""Time after a lock closes in which its mechanism may still pull the pendulum, s of samples."""
MOVED_S = 0.1
"""Time for which a pendulum must be elsewhere, s of samples: the flag of a lock that opens may be a block late."""


@dataclass
class _Held:
    """A pendulum in its closed lock.

    Attributes:
        closed_ns: time of the first sample with the lock closed; None while it is open.
        at_rad: its angle after `SETTLE_S`; NaN before.
        off_ns: time since which it is elsewhere; None if it is not.
        reported: whether the motion was reported since the lock closed.
    """

    closed_ns: int | None = None
    at_rad: float = math.nan
    off_ns: int | None = None
    reported: bool = False


class LockedWatch:
    """Compares the angles of locked pendulums with their first one in the closed lock.

    Args:
        zero_std_deg: standard uncertainty of each encoder's zero, degrees.
    """

    def __init__(self, zero_std_deg: float) -> None:
        self._most_deg = lock_tolerance_deg(zero_std_deg)
        self._held = [_Held(), _Held()]

    def restart(self) -> None:
        """Take the present angles as those of the locks, since the counters were set."""
        self._held = [_Held(), _Held()]

    def feed(
        self, time_ns: NDArray[np.int64], theta_rad: tuple[NDArray[np.floating], ...], flags: NDArray[np.integer]
    ) -> list[tuple[int, str]]:
        """Evaluate the samples of one read.

        Args:
            time_ns: times, ns, shape (n,), n ≥ 1.
            theta_rad: angles of A and B, each of shape (n,).
            flags: flags of the samples, shape (n,).

        Returns:
            Pendulum (0 or 1) and text of each motion that was not reported since its lock closed.
        """
        found: list[tuple[int, str]] = []
        for i, bit in enumerate((LOCK_A_CLOSED, LOCK_B_CLOSED)):
            if not np.all(flags & bit):
                self._held[i] = _Held()
                continue
            text = self._moved(self._held[i], "AB"[i], int(time_ns[0]), int(time_ns[-1]), theta_rad[i])
            if text:
                found.append((i, text))
        return found

    def _moved(self, held: _Held, name: str, first_ns: int, last_ns: int, theta: NDArray[np.floating]) -> str:
        if held.closed_ns is None:
            held.closed_ns = first_ns
        angle = _median(theta)
        if math.isnan(angle) or last_ns - held.closed_ns < SETTLE_S * 1e9:
            return ""
        if math.isnan(held.at_rad):
            held.at_rad = angle
        off_deg = abs(math.degrees(math.remainder(angle - held.at_rad, 2 * math.pi)))
        if off_deg <= self._most_deg:
            held.off_ns = None
            return ""
        held.off_ns = first_ns if held.off_ns is None else held.off_ns
        if held.reported or last_ns - held.off_ns < MOVED_S * 1e9:
            return ""
        held.reported = True
        return (
            f"pendulum {name} has moved by {off_deg:.1f}° although its lock is reported closed. Look at the lock's "
            "mechanism and at the pendulum on its shaft; what was recorded with it as locked is wrong"
        )


def _median(values: NDArray[np.floating]) -> float:
    """Return the median of a few values, for which a sorted list is faster than `np.median`; NaN if one is NaN."""
    ordered: list[float] = np.sort(values).tolist()  # NaN last
    middle = len(ordered) // 2
    return ordered[-1] if math.isnan(ordered[-1]) else 0.5 * (ordered[middle] + ordered[-1 - middle])

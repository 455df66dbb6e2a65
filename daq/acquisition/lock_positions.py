"""Check of the pendulums' counters at their closed locks: A at 0°, B at 180°.

A closed lock holds its pendulum at a known angle, which is the only reference for its counter. If a counter was zeroed
elsewhere, if B was zeroed at its own lock, or if A and B are exchanged, all angles of all later tests are shifted, and
the samples do not show it. A reversed sense of counting is not detected, since 0° and 180° remain.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq import channels

EXPECTED_DEG = (0.0, 180.0)
"""Angles of A and B at their closed locks relative to the rotor, degrees."""

_CLOSED = (channels.LOCK_A_CLOSED, channels.LOCK_B_CLOSED)
_PLAY_DEG = 1.0  # play of a lock and error of its mount
_ZERO_STDS = 5.0  # tolerance in standard uncertainties of the encoder's zero


@dataclass(frozen=True)
class LockPosition:
    """Angle of a locked pendulum, measured by its encoder.

    Attributes:
        pendulum: "A" or "B".
        angle_deg: mean angle, in [0, 360).
        moved_deg: peak-to-peak value of the angle.
        expected_deg, tolerance_deg: angle at the closed lock and its tolerance.
    """

    pendulum: str
    angle_deg: float
    moved_deg: float
    expected_deg: float
    tolerance_deg: float

    @property
    def off_deg(self) -> float:
        """Deviation from the expected angle, in [−180, 180)."""
        return (self.angle_deg - self.expected_deg + 180.0) % 360.0 - 180.0

    @property
    def plausible(self) -> bool:
        """Whether deviation and motion are within the tolerance."""
        return abs(self.off_deg) <= self.tolerance_deg and self.moved_deg <= self.tolerance_deg


def lock_tolerance_deg(zero_std_deg: float) -> float:
    """Return the tolerance of the angle at a closed lock, degrees: the encoder's zero plus the play of the lock."""
    return _PLAY_DEG + _ZERO_STDS * zero_std_deg


def lock_positions(
    theta_rad: NDArray[np.floating], flags: NDArray[np.integer], zero_std_deg: float
) -> tuple[LockPosition, ...]:
    """Return the positions of the pendulums whose locks are closed in all samples.

    Args:
        theta_rad: newest angles of A and B relative to the rotor, rad, shape (n, 2).
        flags: flags of the encoder blocks, shape (n,).
        zero_std_deg: standard uncertainty of each encoder's zero, degrees.
    """
    if len(theta_rad) == 0:
        return ()
    tolerance = lock_tolerance_deg(zero_std_deg)
    out: list[LockPosition] = []
    for i, (name, expected, closed) in enumerate(zip("AB", EXPECTED_DEG, _CLOSED, strict=True)):
        if not bool(np.all(flags & closed)):
            continue
        degrees = np.degrees(theta_rad[:, i])
        moved = float(np.ptp(degrees))
        out.append(LockPosition(name, float(np.mean(degrees)) % 360.0, moved, expected, tolerance))
    return tuple(out)


def misplaced(positions: Sequence[LockPosition]) -> str:
    """Return the error of the counters and its remedy as text; empty if all positions are plausible."""
    moving = [p for p in positions if p.moved_deg > p.tolerance_deg]
    if moving:
        words = " and ".join(f"{p.pendulum} moves by {p.moved_deg:.1f}°" for p in moving)
        return f"pendulum {words} although its lock is reported closed. Look at lock and encoder"
    wrong = [p for p in positions if not p.plausible]
    if not wrong:
        return ""
    seen = " and ".join(
        f"pendulum {p.pendulum} reads {p.angle_deg:.1f}° at its own closed lock, expected {p.expected_deg:.0f}° "
        f"± {p.tolerance_deg:.2g}°"
        for p in wrong
    )
    if len(wrong) == 2 and all(math.isclose(abs(p.off_deg), 180.0, abs_tol=p.tolerance_deg) for p in wrong):
        return f"{seen}: A and B are exchanged. Exchange the encoders' plugs, or if the plugs are correct, {_ZERO}"
    if [p.pendulum for p in wrong] == ["B"] and abs(abs(wrong[0].off_deg) - 180.0) <= wrong[0].tolerance_deg:
        return f"{seen}: its zero is A's lock, half a revolution away, not its own. {_ZERO[0].upper()}{_ZERO[1:]}"
    return f"{seen}: its counter was zeroed elsewhere, or has lost counts. {_ZERO[0].upper()}{_ZERO[1:]}"


_ZERO = "close both locks and zero the counters there, which `rig check` can do"


def flagged(flags: NDArray[np.integer]) -> tuple[str, ...]:
    """Return one sentence for each encoder fault that any of the flags reports."""
    seen = int(np.bitwise_or.reduce(flags)) if len(flags) else 0
    faults = (("A", channels.ENCODER_FAULT_A), ("B", channels.ENCODER_FAULT_B))
    return tuple(
        f"the node reports a fault of encoder {name}: its angles are unreliable. Look at its magnet and its plug"
        for name, bit in faults
        if seen & bit
    )


def battery_low(flags: NDArray[np.integer]) -> bool:
    """Return whether the newest flags report a low battery of the node."""
    return len(flags) > 0 and bool(int(flags[-1]) & channels.BATTERY_LOW)

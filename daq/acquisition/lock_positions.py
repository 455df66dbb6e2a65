# pyright: strict
"""Whether the pendulums' counters say what their closed locks say: A at 0°, B half a revolution away.

A closed lock holds its pendulum at a known place, so it is the one place where a counter can be held against the
truth. A counter that was zeroed elsewhere, a B that was zeroed at its own lock, A and B exchanged: each shifts every
angle of every later test without a sign of it in the samples. A reversed sense of counting can't be seen here: 0° and
180° stay where they are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq import channels

EXPECTED_DEG = (0.0, 180.0)
"""Where A and B stand when their locks are closed, relative to the rotor."""

_CLOSED = (channels.LOCK_A_CLOSED, channels.LOCK_B_CLOSED)
_PLAY_DEG = 1.0  # a lock's play and the mount's own error; far below what a wrong zero is off by
_ZERO_STDS = 5.0


@dataclass(frozen=True)
class LockPosition:
    """A locked pendulum by its own encoder.

    Attributes:
        pendulum: "A" or "B".
        angle_deg: its mean angle, in [0, 360).
        moved_deg: peak to peak of its angle.
        expected_deg, tolerance_deg: where a closed lock holds it.
    """

    pendulum: str
    angle_deg: float
    moved_deg: float
    expected_deg: float
    tolerance_deg: float

    @property
    def off_deg(self) -> float:
        """How far it is from where it should be, in [−180, 180)."""
        return (self.angle_deg - self.expected_deg + 180.0) % 360.0 - 180.0

    @property
    def plausible(self) -> bool:
        """Whether the encoder stands where the closed lock holds the pendulum."""
        return abs(self.off_deg) <= self.tolerance_deg and self.moved_deg <= self.tolerance_deg


def lock_tolerance_deg(zero_std_deg: float) -> float:
    """How far a locked pendulum may read from its place: the encoder's zero and the lock's play together."""
    return _PLAY_DEG + _ZERO_STDS * zero_std_deg


def lock_positions(
    theta_rad: NDArray[np.floating], flags: NDArray[np.integer], zero_std_deg: float
) -> tuple[LockPosition, ...]:
    """The pendulums whose locks are closed all the while.

    Args:
        theta_rad: newest angles of A and B relative to the rotor, shape (n, 2).
        flags: flags of their encoder blocks, shape (n,).
        zero_std_deg: standard uncertainty of each encoder's zero.
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
    """What is wrong with the counters and what to do about it, in a sentence or two; empty when all is plausible."""
    moving = [p for p in positions if p.moved_deg > p.tolerance_deg]
    if moving:
        words = " and ".join(f"{p.pendulum} moves by {p.moved_deg:.1f}°" for p in moving)
        return f"pendulum {words} although its lock is said to be closed. Look at lock and encoder"
    wrong = [p for p in positions if not p.plausible]
    if not wrong:
        return ""
    seen = " and ".join(
        f"pendulum {p.pendulum} reads {p.angle_deg:.1f}° at its own closed lock, expected {p.expected_deg:.0f}° "
        f"± {p.tolerance_deg:.2g}°"
        for p in wrong
    )
    if len(wrong) == 2 and all(math.isclose(abs(p.off_deg), 180.0, abs_tol=p.tolerance_deg) for p in wrong):
        return f"{seen}: A and B are exchanged. Exchange the encoders' plugs, or where that is not it, {_ZERO}"
    if [p.pendulum for p in wrong] == ["B"] and abs(abs(wrong[0].off_deg) - 180.0) <= wrong[0].tolerance_deg:
        return f"{seen}: its zero is A's lock, half a revolution away, not its own. {_ZERO[0].upper()}{_ZERO[1:]}"
    return f"{seen}: its counter was zeroed elsewhere, or has lost counts. {_ZERO[0].upper()}{_ZERO[1:]}"


_ZERO = "close both locks and zero the counters there (`rig check RIG --zero`)"


def flagged(flags: NDArray[np.integer]) -> tuple[str, ...]:
    """Encoder faults that the node reports in any of these flags, a sentence each."""
    seen = int(np.bitwise_or.reduce(flags)) if len(flags) else 0
    faults = (("A", channels.ENCODER_FAULT_A), ("B", channels.ENCODER_FAULT_B))
    return tuple(
        f"the node reports a fault of encoder {name}: its angles cannot be trusted. Look at its magnet, its plug"
        for name, bit in faults
        if seen & bit
    )


def battery_low(flags: NDArray[np.integer]) -> bool:
    """Whether the newest block says that the node's battery is low."""
    return len(flags) > 0 and bool(int(flags[-1]) & channels.BATTERY_LOW)

"""Calibration of the pendulum encoders: sense by hand, zero and its uncertainty from repeated closings of the locks.

A closed lock holds A at 0° and B at 180°. The counters keep the zero of one closing, with the play of that closing;
the spread of repeated closings is therefore the uncertainty of the zero, not the uncertainty of their mean. A reversed
sense does not show at the locks, since 0° and 180° stay; a turn by hand shows it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.lock_positions import EXPECTED_DEG, LockPosition, lock_positions, misplaced
from daq.acquisition.session import Session
from daq.calibration.line import widening
from daq.channels import LOCKS_CLOSED
from daq.errors import DeviceError, ProcedureError
from daq.guided_tests.hands import HUMAN_S, Locks, Operator
from daq.guided_tests.measures import ANGLE_FIELDS
from daq.items import DeviceEvent
from rig_basics.arrays import Array
from rig_configs.roles import PendulumAngles

_TURNED_RAD = math.radians(15.0)  # smallest turn by hand whose sign is read
_OTHER_SHARE = 0.5  # of the turn that the other pendulum may move
_READ_S = 0.3  # of a closed lock
MIN_CLOSINGS = 3


class TurnsPendulums(Operator, Protocol):
    """Operator who can also turn single pendulums."""

    def turn_pendulum(self, pendulum: int) -> None:
        """Turn a free pendulum counter-clockwise by about a quarter of a turn; the rotor is at rest.

        Args:
            pendulum: 0 for A, 1 for B.
        """
        ...


@dataclass(frozen=True)
class EncoderCalibration:
    """Result for the encoders.

    Attributes:
        closings_deg: deviation of A and B from 0° and 180° at each closing, shape (n, 2).
        zero_deg: mean deviation of each, which the present zero of the counters has.
        spread_deg: standard deviation of one closing of each.
        zero_std_deg: standard uncertainty of a zero that is set at one closing, of the pendulum with the larger spread,
            with the uncertainty of the places of the locks.
        senses: signs of the angle's change at a turn counter-clockwise, of A and B.
        refusals: reasons why the encoders must not be used, each with what to do.
    """

    closings_deg: tuple[tuple[float, float], ...]
    zero_deg: tuple[float, float]
    spread_deg: tuple[float, float]
    zero_std_deg: float
    senses: tuple[int, int]
    refusals: tuple[str, ...]

    def settings(self) -> dict[str, float]:
        """Return the settings for the rig file."""
        return {"zero_std_deg": float(f"{self.zero_std_deg:.3g}")}


def check_senses(session: Session, operator: TurnsPendulums, locks: Locks, notify: Callable[[str], None]) -> list[int]:
    """Read the sign of each pendulum's angle when the operator turns it counter-clockwise.

    Returns:
        +1 or −1 for A and B; 0 if the other encoder moved: A and B are exchanged.

    Raises:
        DeviceError: no pendulum was turned in time.
    """
    role = _angles(session)
    locks.release(turning=False)
    senses: list[int] = []
    for pendulum in (0, 1):
        session.clock.wait(0.5)
        begun, columns = session.channels.newest(role.topic, ANGLE_FIELDS, 0.1)
        if not len(begun):
            raise DeviceError(f"{role.device}: no angles arrive. Look at the node and its radio")
        start = np.array([float(column[-1]) for column in columns])
        operator.turn_pendulum(pendulum)
        session.wait_for(
            lambda start=start: bool(np.max(np.abs(_moved(session, role, start))) > _TURNED_RAD),
            HUMAN_S,
            f"pendulum {'AB'[pendulum]} to be turned by more than 15°",
        )
        moved = _moved(session, role, start)
        own, other = moved[pendulum], moved[1 - pendulum]
        exchanged = abs(other) * _OTHER_SHARE > abs(own)
        senses.append(0 if exchanged else int(np.sign(own)))
        text = f"pendulum {'AB'[pendulum]} turned: A {math.degrees(moved[0]):+.1f}°, B {math.degrees(moved[1]):+.1f}°"
        session.note(DeviceEvent("calibration", role.device, text, {"pendulum": pendulum, "sense": senses[-1]}))
        notify(text)
    return senses


def _moved(session: Session, role: PendulumAngles, start: Array) -> Array:
    _, columns = session.channels.newest(role.topic, ANGLE_FIELDS, 0.1)
    now = np.array([float(column[-1]) if len(column) else math.nan for column in columns])
    return np.nan_to_num(now - start)


def close_repeatedly(
    session: Session, operator: TurnsPendulums, locks: Locks, count: int, notify: Callable[[str], None]
) -> list[tuple[LockPosition, LockPosition]]:
    """Close the locks several times, with the pendulums moved in between, and read the angles.

    Raises:
        DeviceError: a lock does not close, or no angles arrive.
    """
    role = _angles(session)
    found: list[tuple[LockPosition, LockPosition]] = []
    for number in range(1, count + 1):
        locks.lock()
        session.clock.wait(_READ_S + 0.2)
        _, (a, b, flags) = session.channels.newest(role.topic, (*ANGLE_FIELDS, "flags"), _READ_S)
        places = lock_positions(np.column_stack([a, b]), _closed(flags, session), role.zero_std_deg)
        if len(places) != 2:
            raise DeviceError(f"{role.device}: a lock is reported open after it was closed. Look at the locks")
        found.append((places[0], places[1]))
        text = (
            f"closing {number} of {count}: A {places[0].off_deg:+.3f}° from 0°, B {places[1].off_deg:+.3f}° from 180°"
        )
        facts = {"a_deg": places[0].off_deg, "b_deg": places[1].off_deg}
        session.note(DeviceEvent("calibration", role.device, text, facts))
        notify(text)
        if number < count:
            locks.release(turning=False)
            operator.scatter()
            session.clock.wait(1.0)
    return found


def _closed(flags: NDArray[np.integer], session: Session) -> NDArray[np.integer]:
    """Return the flags; of a rig without commanded locks, those of closed locks, which the operator has confirmed."""
    return flags if session.rig.roles.locks is not None else np.full(len(flags), LOCKS_CLOSED)


def judge(
    closings: Sequence[tuple[LockPosition, LockPosition]], senses: Sequence[int], lock_std_deg: float
) -> EncoderCalibration:
    """Return zero, its uncertainty and the sense, with what speaks against them.

    Args:
        closings: of `close_repeatedly`.
        senses: of `check_senses`.
        lock_std_deg: standard uncertainty of the places of the locks relative to the imbalance, from the drawing or a
            measurement.
    Raises:
        ProcedureError: fewer than three closings.
    """
    if len(closings) < MIN_CLOSINGS:
        raise ProcedureError(f"expected at least {MIN_CLOSINGS} closings of the locks, got {len(closings)}")
    off = np.array([[place.off_deg for place in closing] for closing in closings])
    mean, spread = off.mean(axis=0), off.std(axis=0, ddof=1)
    zero_std = math.hypot(widening(len(off) - 1) * float(spread.max()), lock_std_deg)
    return EncoderCalibration(
        tuple((float(a), float(b)) for a, b in off),
        (float(mean[0]), float(mean[1])),
        (float(spread[0]), float(spread[1])),
        zero_std,
        (senses[0], senses[1]),
        tuple(_refusals(closings, senses, mean, zero_std)),
    )


def _refusals(
    closings: Sequence[tuple[LockPosition, LockPosition]], senses: Sequence[int], mean: Array, zero_std: float
) -> list[str]:
    found = [f"pendulum {name}: {text}" for name, sense in zip("AB", senses, strict=True) if (text := _SENSE[sense])]
    wrong = next((text for closing in closings if (text := misplaced(closing))), "")
    if wrong:
        return [*found, wrong]
    for name, off, expected in zip("AB", mean.tolist(), EXPECTED_DEG, strict=True):
        if abs(off) > 3 * zero_std:
            found.append(
                f"pendulum {name} reads {expected + off:.2f}° at its closed lock, {abs(off) / zero_std:.0f} standard "
                "uncertainties from its place: zero the counters at the closed locks and calibrate again"
            )
    return found


_SENSE = {
    1: "",
    -1: "its angle falls at a turn counter-clockwise: exchange the encoder's two channels, or its sense in the node",
    0: "the other encoder has counted its turn: exchange the plugs of both encoders",
}


def _angles(session: Session) -> PendulumAngles:
    role = session.rig.roles.angles
    if role is None:
        raise ProcedureError(f"rig {session.rig.name} has no pendulum encoders")
    return role

# pyright: strict
"""What turns the rotor and what holds the pendulums: a device, or the operator's hand.

Tests ask for the same either way. A device is commanded; a hand is asked for, and what it did is judged by what the
sensors see. Where no sensor sees it, the operator has to say that it was done.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.channel_watch import HOST
from daq.acquisition.lock_positions import lock_positions, misplaced
from daq.acquisition.session import Session
from daq.channels import LOCKS_CLOSED
from daq.drivers.items import Event
from daq.errors import DeviceError
from rig_configs.roles import PendulumAngles

Array = NDArray[np.floating[Any]]

HUMAN_S = 120.0
"""How long a person may take, wall s."""
_LOCK_S = 10.0  # how long a mechanism may take, wall s
_STOP_RAMP_RPM_S = 400.0
_REST_S = 30.0  # wall s
_SEEN_S = 1.0  # wall s
_STANDS_S = 0.4  # how long pendulums are looked at before they count as held, rig s
_STANDS_RAD = math.radians(0.3)
SEEN_RAD = math.radians(0.35)
"""A pendulum that has moved this far moves: four steps of an ordinary encoder."""
_FREE_RAD = 5 * SEEN_RAD
_LEAST_S = 0.03  # of its uncertainty: identification takes no damping from a release that is known no better
HAND_RAMP_RPM_S = 20.0
"""What a hand is asked for where a test has no ramp of its own."""

Tell = Callable[[str, float | None], None]
Wait = Callable[[Callable[[], bool], float, str], None]
"""Wait for a condition, at most so many wall seconds, in words for what, as `Session.wait_for`."""


class Operator(Protocol):
    """Who does by hand what the rig cannot do: a person at the terminal, or the simulated operator of the demo."""

    def pluck(self, axis: str) -> None:
        """Displace the column by a few mm along an axis and let go."""
        ...

    def flick(self) -> None:
        """Set both pendulums spinning by hand, slower than two turns a second."""
        ...

    def scatter(self) -> None:
        """Leave both free pendulums (or balls) anywhere, elsewhere each time; the rotor stands."""
        ...

    def lock(self, seen: bool) -> None:
        """Hold both pendulums at their places: A at 0°, B at 180°.

        Args:
            seen: whether sensors will tell that it was done; else return only when it is.
        """
        ...

    def release(self) -> None:
        """Let both pendulums go, both at once."""
        ...

    def turn(self, rpm: float, ramp_rpm_per_s: float) -> None:
        """Bring the rotor to a speed, steadily, and hold it there; 0: to rest."""
        ...


class Rotor(Protocol):
    """How a test turns the rotor."""

    ramp_rpm_per_s: float
    """How fast it speeds up where the test has no ramp of its own."""

    @property
    def speed_rpm(self) -> float:
        """How fast it turns now; NaN when nobody can tell."""
        ...

    def begin(self) -> str:
        """Make ready to turn it, at rest; returns what the operator has to know, empty when nothing."""
        ...

    def go(self, rpm: float, ramp_rpm_per_s: float) -> None:
        """Ramp to a speed; returns at once.

        Raises:
            DeviceError, ProcedureError: it must not turn now, or not so fast.
        """
        ...

    def stop(self) -> None:
        """Bring it to rest and let go of it.

        Raises:
            DeviceError: it does not stand, or nobody can tell.
        """
        ...

    def quick_stop(self) -> None:
        """Stop it as fast as can be; returns at once."""
        ...


class Locks(Protocol):
    """How a test holds the pendulums and lets them go."""

    def lock(self) -> None:
        """Hold both at their places, rotor at rest.

        Raises:
            DeviceError: they are not held in time.
        """
        ...

    def release(self, turning: bool) -> int:
        """Let both go.

        Args:
            turning: whether the rotor turns, so that pendulums that are free move.

        Returns:
            When, ns since 1970.

        Raises:
            DeviceError: refused, or nothing moved.
        """
        ...


class DrivenRotor:
    """See Rotor: turned by the rig's speed source."""

    def __init__(self, session: Session) -> None:
        role = session.rig.roles.speed
        assert role is not None, "the rig has no speed source"
        self._s, self.ramp_rpm_per_s = session, role.ramp_rpm_per_s

    @property
    def speed_rpm(self) -> float:
        """See Rotor."""
        return self._s.drive.actual_rpm

    def begin(self) -> str:
        """See Rotor."""
        drive = self._s.drive
        drive.enable()
        told, drive.was_reset = drive.was_reset, ""
        return told

    def go(self, rpm: float, ramp_rpm_per_s: float) -> None:
        """See Rotor."""
        self._s.drive.set_ramp(ramp_rpm_per_s)
        self._s.drive.set_speed(rpm)

    def stop(self) -> None:
        """See Rotor."""
        drive = self._s.drive
        if abs(drive.actual_rpm) <= self._s.rig.roles.rest_rpm and not drive.enabled:
            return
        drive.set_ramp(_STOP_RAMP_RPM_S)
        if not drive.enabled:  # it coasts, perhaps since a host was killed: brake it
            self.begin()
        drive.set_speed(0)
        self._s.wait_for_rest(_REST_S)
        self._s.clock.sleep(0.5)
        self._s.wait_for_rest(_REST_S)
        drive.disable()

    def quick_stop(self) -> None:
        """See Rotor."""
        self._s.drive.quick_stop()


class HandRotor:
    """See Rotor: turned by the operator, judged by the rotor's phase.

    Args:
        tell: told what is waited for.
    """

    ramp_rpm_per_s = HAND_RAMP_RPM_S

    def __init__(self, session: Session, operator: Operator, tell: Tell) -> None:
        self._s, self._operator, self._tell = session, operator, tell

    @property
    def speed_rpm(self) -> float:
        """See Rotor."""
        return self._s.rotor_rpm()

    def begin(self) -> str:
        """See Rotor."""
        self._s.permit_by_hand(None)
        return ""

    def go(self, rpm: float, ramp_rpm_per_s: float) -> None:
        """See Rotor."""
        self._s.permit_by_hand(rpm)
        self._operator.turn(rpm, ramp_rpm_per_s)

    def stop(self) -> None:
        """See Rotor; a rotor of which nobody can tell whether it turns is the operator's to know."""
        if not self._s.turning():
            self._s.permit_by_hand(0.0)
            return
        self._tell("stop the rotor", None)
        self._operator.turn(0.0, HAND_RAMP_RPM_S)
        self._s.permit_by_hand(0.0)
        self._s.wait_for_rest(HUMAN_S)

    def quick_stop(self) -> None:
        """See Rotor."""
        self._operator.turn(0.0, _STOP_RAMP_RPM_S)


class CommandedLocks:
    """See Locks: the rig's own, which tell their state in the flags of the pendulum samples."""

    def __init__(self, session: Session, wait: Wait) -> None:
        self._s, self._wait_for = session, wait

    def lock(self) -> None:
        """See Locks."""
        self._s.command_node("lock both")
        self._wait(closed=True)

    def release(self, turning: bool) -> int:
        """See Locks."""
        self._s.command_node("release both")
        self._wait(closed=False)
        return self._opened_ns()

    def _wait(self, closed: bool) -> None:
        def there() -> bool:
            _, (flags,) = self._newest(0.1)
            return len(flags) > 0 and flags[-1] & LOCKS_CLOSED == (LOCKS_CLOSED if closed else 0)

        self._wait_for(there, _LOCK_S, f"both locks to {'close' if closed else 'open'}")

    def _opened_ns(self) -> int:
        """Time of the first sample with both locks open, after the last one with a lock closed."""
        time_ns, (flags,) = self._newest(19.0)
        closed = np.flatnonzero((flags & LOCKS_CLOSED) != 0)
        return int(time_ns[min(closed[-1] + 1, len(time_ns) - 1)]) if len(closed) else int(time_ns[0])

    def _newest(self, seconds: float) -> tuple[np.ndarray, list[np.ndarray]]:
        return self._s.newest("pendulums", ("flags",), seconds)


class HandLocks:
    """See Locks: the operator's hand, seen by the encoders where there are any."""

    def __init__(self, session: Session, operator: Operator, tell: Tell, wait: Wait) -> None:
        self._s, self._operator, self._tell, self._wait_for = session, operator, tell, wait
        self._angles: PendulumAngles | None = session.rig.roles.angles

    def lock(self) -> None:
        """See Locks."""
        if self._angles is None:
            self._operator.lock(seen=False)
            return
        with contextlib.suppress(DeviceError):  # nobody is asked for what a host that was late has only not seen yet
            self._wait_for(lambda: self._wrong() == "", _SEEN_S, "both pendulums to be seen at their places")
            return
        self._tell("lock both pendulums: A at 0°, B at 180°", None)
        self._operator.lock(seen=True)
        self._wait_for(lambda: self._wrong() == "", HUMAN_S, "both pendulums to stand at their places")

    def release(self, turning: bool) -> int:
        """See Locks; at rest nothing shows it."""
        if not turning or self._angles is None:
            self._operator.release()
            return self._s.clock.now_ns()
        topic = self._angles.topic
        _, columns = self._s.newest(topic, _THETA, _STANDS_S)
        stood = np.array([np.median(column) for column in columns])
        asked = self._s.clock.now_ns()
        self._operator.release()

        def moved() -> bool:
            _, columns = self._s.recent.last(topic, _THETA, asked)
            return bool(np.any(np.abs(np.column_stack(columns) - stood) > _FREE_RAD))

        self._wait_for(moved, HUMAN_S, "the pendulums to be let go")
        time_ns, columns = self._s.recent.last(topic, _THETA, asked)
        since_s, std_s = let_go((time_ns - asked) * 1e-9, np.abs(np.column_stack(columns) - stood))
        let_go_ns = asked + int(since_s * 1e9)
        for pendulum in (0, 1):
            facts = {"pendulum": pendulum, "state": "released", "time_ns": let_go_ns, "time_std_s": std_s}
            self._s.note(Event("lock", HOST, f"pendulum {'AB'[pendulum]} let go by hand, as its angle shows", facts))
        return let_go_ns

    def _wrong(self) -> str:
        """What keeps the pendulums from counting as held; empty when they are."""
        assert self._angles is not None
        time_ns, columns = self._s.newest(self._angles.topic, _THETA, _STANDS_S)
        if len(time_ns) < _STANDS_S * self._angles.rate_Hz / 3:
            return "their angles are missing"
        theta = np.column_stack(columns)
        if np.any(np.ptp(theta, axis=0) > _STANDS_RAD):
            return "they move"
        held = np.full(len(theta), LOCKS_CLOSED)
        return misplaced(lock_positions(theta, held, self._angles.zero_std_deg))


_THETA = ("theta3_rad", "theta4_rad")


def let_go(time_s: Array, moved_rad: Array) -> tuple[float, float]:
    """When pendulums that begin to move were let go, both at once.

    From rest an angle grows with the square of the time at first: it takes as long again to four times an angle as it
    took to that angle. The orbit makes the torque vary, so half of that is how far the answer may be off.

    Args:
        time_s: of the samples, shape (n,).
        moved_rad: how far each has moved, shape (n, 2); at least one of them farther than four times `SEEN_RAD`.

    Returns:
        Time and its standard uncertainty, s.
    """
    farther = moved_rad.max(axis=1)
    seen, later = (float(time_s[int(np.argmax(farther > angle))]) for angle in (SEEN_RAD, 4 * SEEN_RAD))
    return 2 * seen - later, max(_LEAST_S, 0.5 * (later - seen))

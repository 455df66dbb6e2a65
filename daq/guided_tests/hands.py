"""Rotor and locks of a guided test: operated by a device, or by the operator's hand.

Tests use the same interface for both. A device gets a command. The operator gets a request, and the sensors show
whether it was carried out. Without such a sensor the operator has to confirm it.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq.acquisition.channel_watch import HOST
from daq.acquisition.lock_positions import lock_positions, misplaced
from daq.acquisition.session import Session
from daq.channels import LOCKS_CLOSED
from daq.errors import DeviceError
from daq.guided_tests.measures import ANGLE_FIELDS
from daq.items import DeviceEvent
from rig_configs.roles import PendulumAngles

Array = NDArray[np.floating[Any]]

HUMAN_S = 120.0
"""Timeout for a person, s."""
MAX_LOCK_S = 10.0
"""Timeout for a lock's mechanism, s."""
_STOP_RAMP_RPM_S = 400.0
_MAX_STOP_S = 30.0  # timeout for the rotor to come to rest, s
_MAX_SEEN_S = 1.0  # timeout for locked pendulums to be measured, s
_HELD_S = 0.4  # stretch over which pendulums are observed before they count as held, s
_MAX_HELD_MOTION_RAD = math.radians(0.3)  # peak to peak of a held pendulum
SEEN_RAD = math.radians(0.35)
"""Displacement above which a pendulum counts as moving: four steps of an ordinary encoder."""
_FREE_RAD = 5 * SEEN_RAD
_MIN_RELEASE_STD_S = 0.03  # standard uncertainty of a release by hand; identification takes no damping from it
HAND_RAMP_RPM_S = 20.0
"""Ramp that is requested from the operator if the test has no ramp of its own."""

Progress = Callable[[str, float | None], None]
"""Called with a description of the progress and the completed share, 0 … 1 (None if unknown)."""
Wait = Callable[[Callable[[], bool], float, str], None]
"""Waits for a condition: arguments are the condition, the timeout in s, and its description; see
`Session.wait_for`."""


class Operator(Protocol):
    """Operates by hand what the rig cannot: a person at the terminal, or the simulated operator."""

    def pluck(self, axis: str) -> None:
        """Displace the column by a few mm along an axis and release it."""
        ...

    def flick(self) -> None:
        """Set both pendulums spinning by hand, slower than two turns a second."""
        ...

    def scatter(self) -> None:
        """Bring both free pendulums (or balls) to arbitrary angles, different each time. The rotor is at rest."""
        ...

    def lock(self, seen: bool) -> None:
        """Lock both pendulums: A at 0°, B at 180°.

        Args:
            seen: whether sensors measure the result; otherwise return only when both are locked.
        """
        ...

    def release(self) -> None:
        """Release both pendulums at the same time."""
        ...

    def turn(self, rpm: float, ramp_rpm_per_s: float) -> None:
        """Bring the rotor to a speed with a steady ramp and hold it; 0: bring it to rest."""
        ...


class RotorHand(Protocol):
    """Turns the rotor for a test."""

    ramp_rpm_per_s: float
    """Ramp if the test has none of its own, rpm per s."""

    @property
    def speed_rpm(self) -> float:
        """Present measured speed, rpm; NaN if unknown."""
        ...

    @property
    def reported_rpm(self) -> float:
        """Speed that the drive reports, rpm; NaN without a drive or a report."""
        ...

    def begin(self) -> str:
        """Prepare the rotor at rest for turning. Return a message for the operator, empty if there is none."""
        ...

    def go(self, rpm: float, ramp_rpm_per_s: float) -> None:
        """Start a ramp to a speed and return immediately.

        Raises:
            DeviceError: a device that guards the rotor is missing or has failed.
            ProcedureError: the speed exceeds the limit.
        """
        ...

    def stop(self) -> None:
        """Bring the rotor to rest and release it.

        Raises:
            DeviceError: the rotor still turns, or its state is unknown.
        """
        ...

    def quick_stop(self) -> None:
        """Start to stop the rotor as fast as possible and return immediately."""
        ...


class Locks(Protocol):
    """Locks and releases the pendulums for a test."""

    def lock(self) -> None:
        """Lock both pendulums while the rotor is at rest.

        Raises:
            DeviceError: timeout.
        """
        ...

    def release(self, turning: bool) -> int:
        """Release both pendulums.

        Args:
            turning: whether the rotor turns, so that free pendulums move.

        Returns:
            Time of the release, ns since 1970.

        Raises:
            DeviceError: the command was refused, or no pendulum moved.
        """
        ...


class DrivenRotor(RotorHand):
    """Rotor that the rig's speed source turns."""

    def __init__(self, session: Session) -> None:
        role = session.rig.roles.speed
        assert role is not None, "the rig has no speed source"
        self.ramp_rpm_per_s: float = role.ramp_rpm_per_s
        self._s = session

    @property
    @override
    def speed_rpm(self) -> float:
        """The index marks decide, since a wrong setting of the drive scales command and report alike."""
        return self._s.rotor.rpm()

    @property
    @override
    def reported_rpm(self) -> float:
        return self._s.drive.actual_rpm

    @override
    def begin(self) -> str:
        drive = self._s.drive
        drive.enable()
        message, drive.was_reset = drive.was_reset, ""
        return message

    @override
    def go(self, rpm: float, ramp_rpm_per_s: float) -> None:
        self._s.drive.set_ramp(ramp_rpm_per_s)
        self._s.drive.set_speed(rpm)

    @override
    def stop(self) -> None:
        drive = self._s.drive
        if abs(drive.actual_rpm) <= self._s.rig.roles.rest_rpm and not drive.enabled:
            return
        drive.set_ramp(_STOP_RAMP_RPM_S)
        if not drive.enabled:  # the rotor coasts, for example after a host was killed
            self.begin()
        drive.set_speed(0)
        self._s.rotor.wait_for_rest(_MAX_STOP_S)
        self._s.clock.wait(0.5)
        self._s.rotor.wait_for_rest(_MAX_STOP_S)
        drive.disable()

    @override
    def quick_stop(self) -> None:
        self._s.drive.quick_stop()


class HandRotor(RotorHand):
    """Rotor that the operator turns, monitored by its index marks.

    Args:
        session: the open rig.
        operator: turns the rotor.
        progress: called with a description of each wait.
    """

    ramp_rpm_per_s = HAND_RAMP_RPM_S

    def __init__(self, session: Session, operator: Operator, progress: Progress) -> None:
        self._s, self._operator, self._progress = session, operator, progress

    @property
    @override
    def reported_rpm(self) -> float:
        return math.nan

    @property
    @override
    def speed_rpm(self) -> float:
        return self._s.rotor.rpm()

    @override
    def begin(self) -> str:
        self._s.rotor.permit(None)
        return ""

    @override
    def go(self, rpm: float, ramp_rpm_per_s: float) -> None:
        self._s.rotor.permit(rpm)
        self._operator.turn(rpm, ramp_rpm_per_s)

    @override
    def stop(self) -> None:
        """A rotor whose state is unknown counts as turning, so that the operator has to stop it."""
        if not self._s.rotor.turning():
            self._s.rotor.permit(0.0)
            return
        self._progress("stop the rotor", None)
        self._operator.turn(0.0, HAND_RAMP_RPM_S)
        self._s.rotor.permit(0.0)
        self._s.rotor.wait_for_rest(HUMAN_S)

    @override
    def quick_stop(self) -> None:
        self._operator.turn(0.0, _STOP_RAMP_RPM_S)


class CommandedLocks(Locks):
    """Locks of the rig, which report their state in the flags of the pendulum samples."""

    def __init__(self, session: Session, wait: Wait) -> None:
        self._s, self._wait_for = session, wait

    @override
    def lock(self) -> None:
        self._s.rotor.command_locks("lock both")
        self._wait(closed=True)

    @override
    def release(self, turning: bool) -> int:
        self._s.rotor.command_locks("release both")
        self._wait(closed=False)
        return self._opened_ns()

    def _wait(self, closed: bool) -> None:
        def reached() -> bool:
            _, (flags,) = self._newest(0.1)
            return len(flags) > 0 and flags[-1] & LOCKS_CLOSED == (LOCKS_CLOSED if closed else 0)

        self._wait_for(reached, MAX_LOCK_S, f"both locks to {'close' if closed else 'open'}")

    def _opened_ns(self) -> int:
        """Return the time of the first sample with both locks open after the last sample with a closed lock, ns."""
        time_ns, (flags,) = self._newest(19.0)
        closed = np.flatnonzero((flags & LOCKS_CLOSED) != 0)
        return int(time_ns[min(closed[-1] + 1, len(time_ns) - 1)]) if len(closed) else int(time_ns[0])

    def _newest(self, seconds: float) -> tuple[NDArray[np.int64], list[NDArray[Any]]]:
        return self._s.channels.newest("pendulums", ("flags",), seconds)


class HandLocks(Locks):
    """Locks that the operator closes and opens, monitored by the encoders if the rig has any."""

    def __init__(self, session: Session, operator: Operator, progress: Progress, wait: Wait) -> None:
        self._s, self._operator, self._progress, self._wait_for = session, operator, progress, wait
        self._angles: PendulumAngles | None = session.rig.roles.angles

    @override
    def lock(self) -> None:
        if self._angles is None:
            self._operator.lock(seen=False)
            return
        # no request if the pendulums are locked and the host was only late
        with contextlib.suppress(DeviceError):  # usual: not locked yet
            self._wait_for(lambda: self._wrong() == "", _MAX_SEEN_S, "both pendulums to be measured at their locks")
            return
        self._progress("lock both pendulums: A at 0°, B at 180°", None)
        self._operator.lock(seen=True)
        self._wait_for(lambda: self._wrong() == "", HUMAN_S, "both pendulums to be at rest at their locks")

    @override
    def release(self, turning: bool) -> int:
        """At rest the release is not measured."""
        if not turning or self._angles is None:
            self._operator.release()
            return self._s.clock.now_ns()
        topic = self._angles.topic
        _, columns = self._s.channels.newest(topic, ANGLE_FIELDS, _HELD_S)
        held_rad = np.array([np.median(column) for column in columns])
        requested_ns = self._s.clock.now_ns()
        self._operator.release()

        def moved() -> bool:
            _, columns = self._s.channels.recent.last(topic, ANGLE_FIELDS, requested_ns)
            return bool(np.any(np.abs(np.column_stack(columns) - held_rad) > _FREE_RAD))

        self._wait_for(moved, HUMAN_S, "the pendulums to be released")
        time_ns, columns = self._s.channels.recent.last(topic, ANGLE_FIELDS, requested_ns)
        since_s, std_s = release_time((time_ns - requested_ns) * 1e-9, np.abs(np.column_stack(columns) - held_rad))
        released_ns = requested_ns + int(since_s * 1e9)
        for pendulum in (0, 1):
            facts = {"pendulum": pendulum, "state": "released", "time_ns": released_ns, "time_std_s": std_s}
            text = f"pendulum {'AB'[pendulum]} released by hand, time estimated from its angle"
            self._s.note(DeviceEvent("lock", HOST, text, facts))
        return released_ns

    def _wrong(self) -> str:
        """Return the reason why the pendulums do not count as held; empty if they do."""
        assert self._angles is not None
        time_ns, columns = self._s.channels.newest(self._angles.topic, ANGLE_FIELDS, _HELD_S)
        if len(time_ns) < _HELD_S * self._angles.rate_Hz / 3:
            return "their angles are missing"
        theta = np.column_stack(columns)
        if np.any(np.ptp(theta, axis=0) > _MAX_HELD_MOTION_RAD):
            return "they move"
        held = np.full(len(theta), LOCKS_CLOSED)
        return misplaced(lock_positions(theta, held, self._angles.zero_std_deg))


def release_time(time_s: Array, moved_rad: Array) -> tuple[float, float]:
    """Estimate the time at which both pendulums were released, from the start of their motion.

    From rest an angle first grows with the square of the time. The time from an angle to its fourfold therefore equals
    the time from the release to that angle. The orbit makes the torque vary, so half of this time is taken as the
    standard uncertainty.

    Args:
        time_s: times of the samples, s, shape (n,).
        moved_rad: displacement of each pendulum, rad, shape (n, 2); at least one exceeds four times `SEEN_RAD`.

    Returns:
        Time of the release and its standard uncertainty, s.
    """
    farther = moved_rad.max(axis=1)
    seen, later = (float(time_s[int(np.argmax(farther > angle))]) for angle in (SEEN_RAD, 4 * SEEN_RAD))
    return 2 * seen - later, max(_MIN_RELEASE_STD_S, 0.5 * (later - seen))

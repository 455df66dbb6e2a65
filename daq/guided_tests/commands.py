"""Commands of the states of a guided test to log, rotor, pendulum locks and operator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from daq.acquisition.channel_watch import HOST
from daq.acquisition.lock_positions import battery_low, flagged, lock_positions, misplaced
from daq.acquisition.session import Session
from daq.errors import AcquisitionError, DeviceError, ProcedureError
from daq.guided_tests.hands import (
    CommandedLocks,
    DrivenRotor,
    HandLocks,
    HandRotor,
    Locks,
    Operator,
    Progress,
    RotorHand,
    Wait,
)
from daq.guided_tests.measures import ANGLE_FIELDS, Measures
from daq.items import DeviceEvent
from daq.log.numbering import next_number, one_at_a_time
from daq.log.outcome import ending
from daq.transports import HostClock
from rig_configs.roles import PendulumAngles

_PAST_S = 3.0  # pre-trigger of the log of a test that was stopped before its log, s; short, since it is decoded
# while no device is read and the rotor turns
_COUNTERS_S = 0.1  # stretch of the samples at the closed locks, s
_FLAGS_S = 0.5  # stretch of the flags that are checked while a test runs, s


@dataclass(frozen=True)
class Kept:
    """A finished log.

    Attributes:
        log: path of the file.
        summary: facts that were written to its summary.
    """

    log: Path
    summary: Mapping[str, Any]


@dataclass(frozen=True)
class TestDemands:
    """What a test demands of the rig.

    Attributes:
        test: name of the test in the log.
        required_at_rest: channels whose silence ends the test even at rest.
        trusts_angles: whether the test is refused if the counters are wrong at the closed locks.
    """

    __test__ = False  # not a pytest class

    test: str
    required_at_rest: tuple[str, ...] = ()
    trusts_angles: bool = False


class RigCommands:
    """Carries out the commands of the tests of one session. `prepare` begins each test.

    Args:
        session: the open rig.
        operator: operates by hand what no device operates.
        folder: folder of the logs, whose names are numbered.
        progress: called with a description of the progress and the completed share, 0 … 1 (None if unknown).
        note: the operator's note, written to every log.
        wait: waits for a condition, as `Session.wait_for`, which it replaces; a request of the operator may end it.
        rotor, locks: rotor and locks of the tests; those of the session, or the operator's hands, if None.

    Attributes:
        measures: measured values of the signals.
        rotor, locks: rotor and locks of the test.
        memory: values that states keep for later states.
        facts: facts for the summary of the log.
        missed: description of the conditions that were not reached; empty if there are none.
        aborted: whether the operator ended the test.
        warnings: warnings for the operator.
        kept: the finished log of the test; None before it is finished.
    """

    def __init__(
        self,
        session: Session,
        operator: Operator,
        folder: Path,
        progress: Progress,
        note: str = "",
        wait: Wait | None = None,
        rotor: RotorHand | None = None,
        locks: Locks | None = None,
    ) -> None:
        self.session: Session = session
        self.operator: Operator = operator
        self.clock: HostClock = session.clock
        self.measures: Measures = Measures(session)
        self.rotor: RotorHand = rotor or _rotor_of(session, operator, progress)
        self.locks: Locks = locks or _locks_of(session, operator, progress, wait or session.wait_for)
        self._folder, self._progress, self._note = folder, progress, note
        self._early_notes: list[DeviceEvent] = []  # notes made before the log begins
        self._recording = self._turned = self._held = self._trusts_angles = False

    def prepare(self, demands: TestDemands, facts: Mapping[str, str]) -> None:
        """Begin a test: reset the state of the previous one.

        Args:
            demands: what the test demands of the rig.
            facts: facts for the metadata of its log.
        """
        self._demands = demands
        self._facts = dict(facts)
        self.memory: dict[str, Any] = {}
        self.facts: dict[str, Any] = {}
        self.missed: str = ""
        self.aborted: bool = False
        self.warnings: list[str] = []
        self.kept: Kept | None = None
        self._recording = self._turned = self._held = self._trusts_angles = False

    # --- messages ----------------------------------------------------------------------------------------------

    def report(self, text: str, share: float | None = None) -> None:
        """Report the progress to the operator."""
        self._progress(f"{self._demands.test}: {text}", share)

    def warn(self, text: str) -> None:
        """Report a warning to the operator and keep it for the log. An empty text is ignored."""
        if text:
            self.warnings.append(text)
            self._progress(text, None)

    def miss(self, what: str) -> None:
        """Keep the description of the first condition that was not reached. An empty text is ignored."""
        self.missed = self.missed or what

    def abort(self, why: str) -> None:
        """Keep that the operator ended the test, unless its log is finished."""
        if not self.aborted and self.kept is None:
            self.aborted, self.missed = True, why

    def note(self, text: str) -> None:
        """Write a note of the operator to the log with its time. Notes before the log begins are its first events."""
        now_ns = self.clock.now_ns()
        event = DeviceEvent("note", HOST, text, {"time_ns": now_ns})
        if self._recording:
            self.session.note(event)
        elif self.kept is None:
            self._early_notes.append(event)
        else:
            self.warn(f"the log had ended, so it lacks the note: {text}")

    # --- the log -----------------------------------------------------------------------------------------------

    def begin(self, before_s: float = 0.0) -> Path:
        """Begin the test's log and return its path.

        Args:
            before_s: length of the pre-trigger, s.
        """
        test = self._demands.test
        self._folder.mkdir(parents=True, exist_ok=True)
        facts = {"test": test, "note": self._note, **self._facts}
        self.session.channels.need(*self._demands.required_at_rest)
        with one_at_a_time(self._folder):  # two tests of two rigs may log into one folder
            path = self._folder / f"{next_number(p.name for p in self._folder.iterdir()):02d}-{test}.mcap"
            self.session.start_recording(path, facts, before_s)
        self._recording = True
        for event in self._early_notes:
            self.session.note(event)
        self._early_notes.clear()
        return path

    def record_past(self) -> None:
        """Begin the log of a test that an error ended before its log, if the rotor turns or its state is unknown.

        The log contains the last seconds, the error, and the run-down of the rotor. The end of the session finishes it.
        """
        if self._recording or self.kept is not None or self.session.trouble is None or not self.session.rotor.turning():
            return
        try:
            path = self.begin(_PAST_S)
        except (AcquisitionError, OSError) as error:
            self.warn(f"no log had begun, and the last {_PAST_S:g} s cannot be recorded: {error}")
        else:
            self.warn(f"no log had begun: the last {_PAST_S:g} s and the run-down of the rotor are recorded in {path}")

    def finish(self) -> None:
        """Finish the log, if one has begun.

        Raises:
            AcquisitionError: a device or an interlock failed in the last stretch of the log.
        """
        if not self._recording:
            return
        if wrong_rates := self.session.channels.rates.summary():
            self.warn(f"wrong rates: {wrong_rates}")
        facts = {**self.facts, **ending(self.missed)}
        if self.warnings:
            facts["warnings"] = "; ".join(self.warnings)
        self._recording = False
        self.kept = Kept(self.session.stop_recording(facts), facts)
        self.session.check()  # a test with an error in its last stretch must not count as finished

    # --- checks ------------------------------------------------------------------------------------------------

    @property
    def angles(self) -> PendulumAngles:
        """Role of the device that measures the pendulum angles."""
        role = self.session.rig.roles.angles
        assert role is not None, "tests that need the angles are refused on this rig"
        return role

    def check(self) -> None:
        """Check the session, and the encoders if the test needs the angles.

        Raises:
            AcquisitionError: an interlock, a reader or an encoder reported an error.
        """
        self.session.check()
        if self._trusts_angles:
            _, (flags,) = self.session.channels.newest(self.angles.topic, ("flags",), _FLAGS_S)
            if faults := flagged(flags):
                error = ProcedureError(f"{self.angles.device}: {'. '.join(faults)}; the rotor was commanded to stop")
                self.session.fail(error)  # the reason of the end in the open log
                self.rotor.quick_stop()
                raise error

    def check_counters(self) -> None:
        """Check the counters at the closed locks, and the description of their device.

        Raises:
            DeviceError: the device deviates from the rig file.
            ProcedureError: the counters are wrong and the test needs the angles.
        """
        device = self.angles.device
        if complaint := self.session.devices.identification_of(device)[
            1
        ]:  # it stopped nothing while the session was being opened
            raise DeviceError(f"{device}: {complaint}")
        _, (a, b, flags) = self.session.channels.newest(self.angles.topic, (*ANGLE_FIELDS, "flags"), _COUNTERS_S)
        wrong = [*flagged(flags), misplaced(lock_positions(np.column_stack([a, b]), flags, self.angles.zero_std_deg))]
        trouble = ". ".join(text for text in wrong if text)
        if trouble and self._demands.trusts_angles:
            raise ProcedureError(f"{device}: {trouble}. Nothing was turned, nothing recorded")
        self.warn(f"{device}: {trouble}" if trouble else "")
        self._trusts_angles = self._demands.trusts_angles
        self.warn(f"{device}: its battery is low; change it before the next test" if battery_low(flags) else "")

    # --- rotor and pendulums -----------------------------------------------------------------------------------

    def hold(self) -> None:
        """Lock both pendulums while the rotor is at rest."""
        self.locks.lock()
        self._held = True

    def hold_again(self) -> None:
        """Lock the pendulums if this test has released them. After an abort a failure is only a warning."""
        if "released_ns" not in self.memory or self._held:
            return
        try:
            self.hold()
        except DeviceError as error:
            if not self.aborted:
                raise
            self.warn(f"the pendulums are not locked: {error}")

    def release(self, turning: bool) -> None:
        """Release both pendulums and store the time in `memory["released_ns"]`, ns since 1970.

        Args:
            turning: whether the rotor must turn.

        Raises:
            ProcedureError: `turning` is set and this test has not turned the rotor.
        """
        if turning and not self._turned:
            raise ProcedureError(f"{self._demands.test}: the rotor is at rest, so the pendulums are not released")
        self._held = False
        self.memory["released_ns"] = self.locks.release(turning)

    def make_ready(self) -> None:
        """Prepare the rotor at rest for turning."""
        self.warn(self.rotor.begin())

    def turn(self, rpm: float, ramp_rpm_per_s: float, free: bool = False) -> None:
        """Start a ramp of the rotor to a speed and return immediately.

        Args:
            rpm: the speed.
            ramp_rpm_per_s: slope of the ramp.
            free: whether the pendulums may be free at the start.

        Raises:
            ProcedureError: the rotor is at rest, and the pendulums are not locked although `free` is not set.
        """
        if not self._held and not self._turned and not free:
            raise ProcedureError(f"{self._demands.test}: the pendulums are not locked, so the rotor is not turned")
        self._turned = True
        self.rotor.go(rpm, ramp_rpm_per_s)

    def rest(self) -> None:
        """Bring the rotor to rest and wait for it."""
        self.rotor.stop()
        self._turned = False

    def quick_stop(self) -> None:
        """Stop a rotor that this test has turned as fast as possible, without waiting for rest."""
        if self._turned:
            self.rotor.quick_stop()


def _rotor_of(session: Session, operator: Operator, progress: Progress) -> RotorHand:
    return DrivenRotor(session) if session.rig.roles.speed else HandRotor(session, operator, progress)


def _locks_of(session: Session, operator: Operator, progress: Progress, wait: Wait) -> Locks:
    commanded = session.rig.roles.locks is not None
    return CommandedLocks(session, wait) if commanded else HandLocks(session, operator, progress, wait)

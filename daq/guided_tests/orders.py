# pyright: strict
"""What the states of a guided test may order: the log, the rotor, the pendulums' locks, the operator."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from daq.acquisition.channel_watch import HOST
from daq.acquisition.lock_positions import battery_low, flagged, lock_positions, misplaced
from daq.acquisition.session import Session
from daq.drivers.items import Event
from daq.errors import DeviceError, ProcedureError, RigError
from daq.guided_tests.hands import CommandedLocks, DrivenRotor, HandLocks, HandRotor, Locks, Operator, Rotor
from daq.guided_tests.kinds import Asked
from daq.guided_tests.measures import Measures
from daq.log.numbering import next_number, one_at_a_time
from daq.log.outcome import ending
from rig_configs.roles import PendulumAngles

_LAST_S = 3.0  # rig s; no device is read while they are decoded, and the rotor still turns
_LOOK_S = 0.5  # the stretch of flags that is looked at while a test runs, rig s

Progress = Callable[[str, float | None], None]


@dataclass(frozen=True)
class Kept:
    """A finished log.

    Attributes:
        log: the file.
        summary: the facts that went into it.
    """

    log: Path
    summary: Mapping[str, Any]


class Orders:
    """Of one open session; `prepare` begins each test.

    Args:
        session: open rig.
        operator: whose hands do what no device does.
        folder: where logs go; names are counted up.
        progress: called with what is going on and the share done where that is known.
        note: the operator's note, kept in every log.

    Attributes:
        parameters: which identified parameters the speeds follow from; "" for the rig file's own. Kept in every log.
        measures: of the signals.
        rotor, locks: who turns the rotor and holds the pendulums.
        wait: how orders wait for somebody: `Session.wait_for`, until the runner lets requests interrupt it.
        asked: the test.
        memory: what states remember; `facts`: what goes into the log's summary.
        missed: what was not reached so far; empty when nothing. `aborted`: whether the operator ended it.
        warnings: what the operator has to be told, sentences.
        kept: the test's log when it is finished.
    """

    def __init__(self, session: Session, operator: Operator, folder: Path, progress: Progress, note: str = "") -> None:
        self.session, self.operator, self.clock = session, operator, session.clock
        self.parameters = ""
        self.measures = Measures(session)
        self.wait: Callable[[Callable[[], bool], float, str], None] = session.wait_for
        roles = session.rig.roles

        def wait(condition: Callable[[], bool], wall_s: float, what: str) -> None:
            self.wait(condition, wall_s, what)

        self.rotor: Rotor = DrivenRotor(session) if roles.speed else HandRotor(session, operator, progress)
        commanded = roles.locks is not None
        self.locks: Locks = CommandedLocks(session, wait) if commanded else HandLocks(session, operator, progress, wait)
        self._folder, self._progress, self._note = folder, progress, note
        self._notes_to_come: list[Event] = []
        self._recording = self._turned = self._held = self._trusts_angles = False

    def prepare(self, asked: Asked, facts: Mapping[str, str]) -> None:
        """A test begins; nothing has been ordered for it.

        Args:
            asked: the test.
            facts: for its log's metadata, beside its numbers.
        """
        self.asked, self._facts = asked, dict(facts)
        self.memory: dict[str, Any] = {}
        self.facts: dict[str, Any] = {}
        self.missed, self.aborted, self.warnings = "", False, list[str]()
        self.kept: Kept | None = None
        self._recording = self._turned = self._held = self._trusts_angles = False

    # --- words -------------------------------------------------------------------------------------------------

    def tell(self, text: str, share: float | None = None) -> None:
        """What is going on."""
        self._progress(f"{self.asked.test}: {text}", share)

    def warn(self, text: str) -> None:
        """What the operator has to be told; it stays in the log."""
        if text:
            self.warnings.append(text)
            self._progress(text, None)

    def note(self, text: str) -> None:
        """The operator's word, into the log with its time; one made before the log begins is its first event."""
        now_ns = self.clock.now_ns()
        event = Event("note", HOST, text, {"time_ns": now_ns})
        if self._recording:
            self.session.note(event)
        elif self.kept is None:
            self._notes_to_come.append(event)
        else:
            self.warn(f"the log had ended, so it lacks the note: {text}")

    # --- the log -----------------------------------------------------------------------------------------------

    def begin(self, before_s: float = 0.0) -> None:
        """Begin the test's log.

        Args:
            before_s: how much of what came before it is to hold, rig s.
        """
        self._begin(before_s)

    def _begin(self, before_s: float) -> Path:
        asked = self.asked
        self._folder.mkdir(parents=True, exist_ok=True)
        known = {"parameters": self.parameters} if self.parameters else {}
        facts = {"test": asked.test, "note": self._note, **known, **self._facts}
        self.session.need(*asked.kind.lives_on(self.session.rig.roles))
        with one_at_a_time(self._folder):  # two tests of two rigs may log into one folder
            path = self._folder / f"{next_number(p.name for p in self._folder.iterdir()):02d}-{asked.test}.mcap"
            self.session.start_recording(path, facts, before_s)
        self._recording = True
        for event in self._notes_to_come:
            self.session.note(event)
        self._notes_to_come.clear()
        return path

    def keep_the_past(self) -> None:
        """Begin the log of a test that something ended before its own would, where the rotor turns or may.

        What came last is in it, what ended the test, and the rotor's way to rest: the session's end finishes it.
        """
        if self._recording or self.kept is not None or self.session.trouble is None or not self.session.turning():
            return
        try:
            path = self._begin(_LAST_S)
        except (RigError, OSError) as error:
            self.warn(f"no log had begun, and none of what stopped the rig can be kept: {error}")
        else:
            self.warn(f"no log had begun: the last {_LAST_S:g} s and the rotor's way to rest are kept in {path}")

    def finish(self) -> None:
        """Finish the log, if one has begun."""
        if not self._recording:
            return
        if wrong_rates := self.session.rates.summary():
            self.warn(f"wrong rates: {wrong_rates}")
        facts = {**self.facts, **ending(self.missed)}
        if self.warnings:
            facts["warnings"] = "; ".join(self.warnings)
        self._recording = False
        self.kept = Kept(self.session.stop_recording(facts), facts)
        self.session.check()  # what went wrong in the last stretch must not look like a finished test

    # --- looking -----------------------------------------------------------------------------------------------

    @property
    def angles(self) -> PendulumAngles:
        """Who measures the pendulums' angles."""
        role = self.session.rig.roles.angles
        assert role is not None, "a test that needs them was not refused"
        return role

    def check(self) -> None:
        """Whether the rig is fine.

        Raises:
            RigError: what an interlock, a reader or an encoder found.
        """
        self.session.check()
        if self._trusts_angles:
            _, (flags,) = self.session.newest(self.angles.topic, ("flags",), _LOOK_S)
            if faults := flagged(flags):
                error = ProcedureError(f"{self.angles.device}: {'. '.join(faults)}; the rotor was commanded to stop")
                self.session.trouble = self.session.trouble or error  # the log that is still open ends with it
                self.rotor.quick_stop()
                raise error

    def believe_locked(self, span_s: float) -> None:
        """Hold the counters against the closed locks, and heed what the device says of itself.

        Args:
            span_s: the newest stretch of samples that is looked at.

        Raises:
            DeviceError: the device is not what the rig file says.
            ProcedureError: the test trusts the angles, and they cannot be believed.
        """
        device = self.angles.device
        if complaint := self.session.told(device)[1]:  # made while the session still opened, when nobody was stopped
            raise DeviceError(f"{device}: {complaint}")
        columns = ("theta3_rad", "theta4_rad", "flags")
        _, (a, b, flags) = self.session.newest(self.angles.topic, columns, span_s)
        wrong = [*flagged(flags), misplaced(lock_positions(np.column_stack([a, b]), flags, self.angles.zero_std_deg))]
        trouble = ". ".join(text for text in wrong if text)
        if trouble and self.asked.kind.trusts_angles:
            raise ProcedureError(f"{device}: {trouble}. Nothing was turned, nothing recorded")
        self.warn(f"{device}: {trouble}" if trouble else "")
        self._trusts_angles = self.asked.kind.trusts_angles
        self.warn(f"{device}: its battery is low; change it before the next test" if battery_low(flags) else "")

    # --- rotor and pendulums -----------------------------------------------------------------------------------

    def hold(self) -> None:
        """Hold both pendulums at their places, rotor at rest."""
        self.locks.lock()
        self._held = True

    def hold_again(self) -> None:
        """Hold pendulums that this test has let go; after an abort, open locks are a warning."""
        if "released_ns" not in self.memory or self._held:
            return
        try:
            self.hold()
        except DeviceError as error:
            if not self.aborted:
                raise
            self.warn(f"the pendulums are not locked: {error}")

    def let_go(self, turning: bool) -> None:
        """Let both pendulums go; `released_ns` remembers when.

        Raises:
            ProcedureError: the rotor is to turn, and stands.
        """
        if turning and not self._turned:
            raise ProcedureError(f"{self.asked.test}: the rotor stands, so the pendulums are not released")
        self._held = False
        self.memory["released_ns"] = self.locks.release(turning)

    def make_ready(self) -> None:
        """Make ready to turn the rotor, at rest."""
        self.warn(self.rotor.begin())

    def turn(self, rpm: float, ramp_rpm_per_s: float, free: bool = False) -> None:
        """Ramp the rotor to a speed; returns at once.

        Args:
            free: whether the pendulums are meant to be free from the start.

        Raises:
            ProcedureError: the pendulums are not held although they should be, and it stands.
        """
        if not self._held and not self._turned and not free:
            raise ProcedureError(f"{self.asked.test}: the pendulums are not locked, so the rotor is not turned")
        self._turned = True
        self.rotor.go(rpm, ramp_rpm_per_s)

    def rest(self) -> None:
        """Bring the rotor to rest and wait for it."""
        self.rotor.stop()
        self._turned = False

    def quick_stop(self) -> None:
        """Stop a rotor that this test has turned, as fast as can be; nothing else waits for it any more."""
        if self._turned:
            self.rotor.quick_stop()

# pyright: strict
"""What guided tests share: the rotor at rest and the pendulums held before, the log, the waiting, the warnings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from daq.acquisition.lock_positions import battery_low, flagged, lock_positions, misplaced
from daq.acquisition.session import Session
from daq.errors import DeviceError, ProcedureError
from daq.guided_tests.hands import CommandedLocks, DrivenRotor, HandLocks, HandRotor, Locks, Operator, Rotor
from daq.guided_tests.kinds import CHANNELS, KINDS, kind_of, refusal
from daq.guided_tests.measures import Measures
from daq.log.numbering import next_number, one_at_a_time
from daq.log.outcome import ending
from rig_configs.roles import PendulumAngles

_STATUS_S = 2.5  # a node tells its state each second; one of them may be lost
_LOCKED_LOOK_S = 0.2  # how long closed locks are looked at before they are believed
_LOOK_S = 0.5  # rig time between two looks at the signals
_SPIN_UP_S = 60.0  # beside what the ramp takes
_BY_HAND_S = 240.0  # the same where a person turns the rotor, wall s

Progress = Callable[[str, float | None], None]


@dataclass(frozen=True)
class TestDone:
    """A finished test.

    Attributes:
        test: its name.
        log: its log, finished and whole.
        summary: the facts that went into the log's summary.
        missed: what was not reached; empty when the test came to its end.
        warnings: what its operator must know, sentences.
    """

    __test__ = False  # not a pytest class

    test: str
    log: Path
    summary: Mapping[str, Any]
    missed: str = ""
    warnings: tuple[str, ...] = ()


class Steps:
    """The steps of a test on one open session.

    Args:
        session: open rig.
        operator: whose hands do what no device does.
        folder: where logs go; names are counted up.
        progress: told what is going on, with the share done where that is known.
        note: the operator's note, kept in every log.

    Attributes:
        parameters: which identified parameters the speeds follow from; "" for the rig file's own. Kept in every log.
        look: at the signals.
        rotor, locks: who turns the rotor and holds the pendulums.
    """

    def __init__(self, session: Session, operator: Operator, folder: Path, progress: Progress, note: str = "") -> None:
        self.session, self.operator, self.clock = session, operator, session.clock
        self.parameters = ""
        self.look = Measures(session)
        roles = session.rig.roles
        self.rotor: Rotor = DrivenRotor(session) if roles.speed else HandRotor(session, operator, self.tell)
        self.locks: Locks = CommandedLocks(session) if roles.locks else HandLocks(session, operator, self.tell)
        self._folder, self._progress, self._note = folder, progress, note
        self._warnings: list[str] = []
        self._angles_needed = False

    @property
    def angles(self) -> PendulumAngles:
        """Who tells the pendulums' angles."""
        role = self.session.rig.roles.angles
        assert role is not None, "a test that needs them was not refused"
        return role

    def refuse(self, test: str, why: str = "") -> None:
        """Refuse a test before anything is turned or recorded.

        Args:
            test: its name; one that the rig has no signals for is refused.
            why: another reason; empty when there is none.
        """
        if why := refusal(test, self.session.rig.roles) or why:
            raise ProcedureError(why)

    def warn(self, text: str) -> None:
        """What the operator must know; it stays in the log."""
        if text:
            self._warnings.append(text)
            self.tell(text, None)

    def tell(self, text: str, share: float | None) -> None:
        """What is going on."""
        self._progress(text, share)

    def stopped(self, message: str) -> ProcedureError:
        """Stop the rotor; returns what to raise."""
        self.rotor.quick_stop()
        error = ProcedureError(message)
        self.session.trouble = self.session.trouble or error  # the log that is still open ends with it
        return error

    # --- the log -----------------------------------------------------------------------------------------------

    def begin(self, test: str, facts: Mapping[str, str]) -> None:
        """Begin the test's log."""
        self._folder.mkdir(parents=True, exist_ok=True)
        known = {"parameters": self.parameters} if self.parameters else {}
        self.session.need(*self._needed(test))
        with one_at_a_time(self._folder):  # two tests of two rigs may log into one folder
            path = self._folder / f"{next_number(p.name for p in self._folder.iterdir()):02d}-{test}.mcap"
            self.session.start_recording(path, {"test": test, "note": self._note, **known, **facts})

    def _needed(self, test: str) -> list[str]:
        """Channels that a test at rest lives on: every displacement where the column rings, else the angles."""
        kind, roles = kind_of(test), self.session.rig.roles
        if kind is not None and kind is not KINDS["spin-down"] and not kind.turns:
            return [sensor.topic for sensor in roles.displacements]
        return [CHANNELS["angles"]] if roles.angles else []

    def end(self, test: str, summary: Mapping[str, Any], missed: str) -> TestDone:
        """Finish the log.

        Args:
            summary: the test's own facts.
            missed: what was not reached; empty when the test came to its end.
        """
        if wrong_rates := self.session.rates.summary():
            self.warn(f"wrong rates: {wrong_rates}")
        facts = {**summary, **ending(missed)}
        if self._warnings:
            facts["warnings"] = "; ".join(self._warnings)
        log = self.session.stop_recording(facts)
        self.session.check()  # what went wrong in the last stretch must not look like a finished test
        return TestDone(test, log, facts, missed, tuple(self._warnings))

    # --- waiting -----------------------------------------------------------------------------------------------

    def until(self, condition: Callable[[], bool], wall_s: float, what: str) -> None:
        """See Session.wait_for."""
        self.session.wait_for(condition, wall_s, what)

    def look_until(self, condition: Callable[[], bool], limit_s: float) -> bool:
        """Look every half second of rig time; False when the limit (rig time) is reached first."""
        end = self.clock.now_ns() + int(limit_s * 1e9)
        while True:
            self.session.check()
            self._heed_encoder_faults()
            if condition():
                return True
            if self.clock.now_ns() > end:
                return False
            self.clock.sleep(_LOOK_S)

    def _heed_encoder_faults(self) -> None:
        if self._angles_needed:
            _, (flags,) = self.session.newest(self.angles.topic, ("flags",), _LOOK_S)
            if faults := flagged(flags):
                raise self.stopped(f"{self.angles.device}: {'. '.join(faults)}; the rotor was stopped")

    # --- rotor and pendulums -----------------------------------------------------------------------------------

    def at_rest_and_locked(self, angles_needed: bool = True) -> None:
        """Bring the rig to where every test begins."""
        self._warnings, self._angles_needed = [], False
        self.session.check()
        self.rotor.stop()
        self.locks.lock()
        if self.session.rig.roles.angles is not None:
            self._look_at_locked(angles_needed)

    def _look_at_locked(self, angles_needed: bool) -> None:
        """Hold the counters against the closed locks, and heed what the device says of itself.

        Raises:
            ProcedureError: angles are needed, or the rotor is to turn, and they cannot be believed.
        """
        device = self.angles.device
        self.clock.sleep(_LOCKED_LOOK_S)
        # one of other counts ends the test; patience, since without it the angles would be blamed
        self.look_until(lambda: self.session.told(device)[0], _STATUS_S + self.clock.patience(_STATUS_S))
        self.session.check()
        if complaint := self.session.told(device)[1]:  # made while the session still opened, when nobody was stopped
            raise DeviceError(f"{device}: {complaint}")
        columns = ("theta3_rad", "theta4_rad", "flags")
        _, (a, b, flags) = self.session.newest(self.angles.topic, columns, 0.5 * _LOCKED_LOOK_S)
        wrong = [*flagged(flags), misplaced(lock_positions(np.column_stack([a, b]), flags, self.angles.zero_std_deg))]
        trouble = ". ".join(text for text in wrong if text)
        if trouble and angles_needed:
            raise ProcedureError(f"{device}: {trouble}. Nothing was turned, nothing recorded")
        self.warn(f"{device}: {trouble}" if trouble else "")
        self._angles_needed = angles_needed
        self.warn(f"{device}: its battery is low; change it before the next test" if battery_low(flags) else "")

    def spin_up(self, test: str, rpm: float) -> None:
        """Bring the rotor to a speed."""
        self.warn(self.rotor.begin())
        ramp = self.rotor.ramp_rpm_per_s
        by_hand = self.session.rig.roles.speed is None
        limit_s = (self.clock.patience(_BY_HAND_S) if by_hand else _SPIN_UP_S) + 1.5 * rpm / ramp
        self.rotor.go(rpm, ramp)

        def at_speed() -> bool:
            now = self.rotor.speed_rpm
            self.tell(f"{test}: spinning up, {now:.0f} of {rpm:.0f} rpm", None)
            return abs(now - rpm) < 0.01 * rpm + 2

        if not self.look_until(at_speed, limit_s):
            seen = f"{self.rotor.speed_rpm:.0f} rpm after {limit_s:.0f} s, expected {rpm:.0f}"
            raise self.stopped(f"{test}: {seen}{'' if by_hand else '. Look at the drive'}")

"""The guided tests: what to do with drive, locks and operator, and when a test is over.

Every test ends with a finished log and the rotor at rest, or with the error that ended it and the rotor stopping.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.lock_positions import battery_low, flagged, lock_positions, misplaced
from daq.acquisition.session import Session
from daq.channels import LOCKS_CLOSED
from daq.errors import DeviceError, ProcedureError
from daq.guided_tests import test_inputs
from daq.log.numbering import next_number, one_at_a_time
from daq.log.outcome import ending
from daq.signals.settling import Settling, locked_settled, settled
from rig_configs.roles import PendulumAngles, SpeedSource

_RPM = math.pi / 30
_HUMAN_S = 120.0  # how long a person may take, wall seconds
_ANSWER_S = 5.0  # how long a device may take, wall seconds
_LOCKS = LOCKS_CLOSED
_STATUS_S = 2.5  # the node tells its state each second; one of them may be lost
_LOCKED_LOOK_S = 0.2  # how long closed locks are looked at before they are believed
_SEEN_S = 10.0  # how far back to look for what a person did; a person may take minutes, the signals must stay few
_LOOK_S = 0.5  # rig time between two looks at the signals
_STOP_RAMP_RPM_S = 400.0
_POINT_LIMIT_S = 90.0
_RING_DOWN_S, _SPIN_DOWN_S, _LOCKED_STEADY_S = 60.0, 120.0, 60.0  # rig time
_SPIN_UP_S = 60.0  # beside what the drive's own ramp takes
# Stricter than the analysis, which asks the same again of the whole log: what is called steady here is so there.
_STEADY = {"angle_tolerance_rad": math.radians(0.05), "amplitude_tolerance_m": 2e-6}
_FLICKED_RAD = 0.5
_PLUCKED_M = 3e-4  # a displacement that is no longer vibration of the building
_BEFORE_RELEASE_S = 4.0
_SLOW_SHARE = 0.03  # of the top speed: below it a run-down has too few index marks to go on
_AFTER_STEADY_S = 2.5  # of steady state in the log; asked again after it with the analysis's own tolerances

Progress = Callable[[str, float | None], None]


class Operator(Protocol):
    """Who does by hand what the rig cannot do: a person at the terminal, or the simulated operator of the demo."""

    def pluck(self, axis: str) -> None:
        """Displace the column by a few mm along an axis and let go."""
        ...

    def flick(self) -> None:
        """Set both pendulums spinning by hand, slower than two turns a second."""
        ...


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

    test: str
    log: Path
    summary: Mapping[str, Any]
    missed: str = ""
    warnings: tuple[str, ...] = ()


class Procedures:
    """The guided tests on one open session.

    Args:
        session: open rig.
        operator: who plucks and flicks.
        folder: where logs go; names are counted up.
        progress: told what is going on, with the share done where that is known.
        note: the operator's note, kept in every log.

    Attributes:
        parameters: which identified parameters the speeds follow from; "" for the rig file's own. Kept in every log.
    """

    def __init__(self, session: Session, operator: Operator, folder: Path, progress: Progress, note: str = "") -> None:
        self._s, self._operator, self._folder, self._progress, self._note = session, operator, folder, progress, note
        self._clock = session.clock
        self.parameters = ""
        self._warnings: list[str] = []
        self._angles_needed = False

    # --- the tests ---------------------------------------------------------------------------------------------

    def ring_down(self, axis: str) -> TestDone:
        """Pluck along an axis, record until it has rung down to a fiftieth."""
        test = f"ring-down-{axis}"
        self._at_rest_and_locked(angles_needed=False)
        self._begin(test, {})
        self._clock.sleep(0.7)
        self._tell(f"{test}: pluck the column along {axis} by 2 to 3 mm and let go", None)
        field = f"laser/{axis}"
        self._until(lambda: self._valid(field, 0.5) > 0.4, _ANSWER_S, f"half a second of valid samples of {field}")
        rest = float(np.nanmedian(self._newest(field, ("displacement_m",), 0.5)[1][0]))
        asked = self._clock.now_ns()
        self._operator.pluck(axis)
        plucked = f"the column to be plucked along {axis}"
        self._until(
            lambda: self._largest_since(field, max(asked, self._since(_SEEN_S)), rest) > _PLUCKED_M, _HUMAN_S, plucked
        )
        self._clock.sleep(0.8)
        peak = 0.0

        def rung_down() -> bool:
            nonlocal peak
            now = self._peak_to_peak(field, 0.6)
            if not math.isfinite(now):
                return False  # a blocked sensor says nothing about the column
            peak = max(peak, now)
            share = math.log(max(peak, 1e-9) / max(now, 1e-9)) / math.log(50)
            self._tell(f"{test}: {now * 1e3:.2f} mm peak to peak", min(1.0, share))
            return now < peak / 50 or now < 4e-5

        reached = self._look_until(rung_down, _RING_DOWN_S)
        left = self._peak_to_peak(field, 0.6)
        seen = "the sensor sees nothing" if math.isnan(left) else f"{left * 1e3:.2f} of {peak * 1e3:.2f} mm were left"
        missed = "" if reached else f"the column to ring down to a fiftieth within {_RING_DOWN_S:g} s: {seen}"
        return self._end(test, {"rung_down": reached}, missed)

    def spin_down(self) -> TestDone:
        """Release both pendulums at rest, flick them, record until they have slowed by e⁵."""
        test = "spin-down"
        self._at_rest_and_locked()
        self._s.command_node("release both")
        self._wait_locks(closed=False)
        self._begin(test, {})
        self._clock.sleep(0.7)
        self._tell(f"{test}: flick both pendulums, slower than two turns a second", None)
        asked = self._clock.now_ns()
        self._operator.flick()
        flicked = "both pendulums to be flicked"
        self._until(
            lambda: bool(np.all(self._turned_since(max(asked, self._since(_SEEN_S)))[0] > _FLICKED_RAD)),
            _HUMAN_S,
            flicked,
        )

        def slowed() -> bool:
            rates = np.abs(self._rates())
            _, peak = self._turned_since(asked)
            if not np.all(np.isfinite(rates)):
                return False  # radio silence says nothing about the pendulums
            share = float(np.min(np.log(peak / np.maximum(rates, 1e-3)))) / 5.0
            self._tell(f"{test}: {rates[0]:.2f} and {rates[1]:.2f} rad/s", min(1.0, max(0.0, share)))
            return share >= 1.0

        reached = self._look_until(slowed, _SPIN_DOWN_S)
        a, b = np.abs(self._rates())
        seen = "their angles are missing" if math.isnan(a + b) else f"{a:.2f} and {b:.2f} rad/s were left"
        missed = "" if reached else f"the pendulums to slow down by e⁵ within {_SPIN_DOWN_S:g} s: {seen}"
        done = self._end(test, {"slowed_down": reached}, missed)
        self._lock_both()
        return done

    def run_up(self, top_rpm: float, duration_s: float) -> TestDone:
        """Ramp from rest through both resonances with locked pendulums."""
        test = "run-up"
        self._refuse(test_inputs.ramp_refusal(self._s.rig, top_rpm, duration_s))
        self._at_rest_and_locked()
        self._warn(test_inputs.ramp_warning(self._s.rig, top_rpm))
        drive = self._s.drive
        self._enable()
        drive.set_ramp(top_rpm / duration_s)
        self._begin(test, {"top_rpm": f"{top_rpm:.0f}", "duration_s": f"{duration_s:g}"})
        self._clock.sleep(0.5)
        drive.set_speed(top_rpm)

        def there() -> bool:
            self._tell(f"{test}: {drive.actual_rpm:.0f} rpm", drive.actual_rpm / top_rpm)
            return drive.actual_rpm > 0.985 * top_rpm

        reached = self._look_until(there, 1.5 * duration_s)
        self._clock.sleep(1.0)
        seen = f"{drive.actual_rpm:.0f} of {top_rpm:.0f} rpm after {1.5 * duration_s:g} s"
        done = self._end(test, {"reached_top": reached}, "" if reached else f"the top speed: {seen}")
        self._stop_rotor()
        return done

    def run_down(self, top_rpm: float, duration_s: float) -> TestDone:
        """Ramp from above both resonances to rest with locked pendulums."""
        test = "run-down"
        self._refuse(test_inputs.ramp_refusal(self._s.rig, top_rpm, duration_s))
        self._at_rest_and_locked()
        self._warn(test_inputs.ramp_warning(self._s.rig, top_rpm))
        drive = self._s.drive
        self._spin_up(test, top_rpm)
        self._begin(test, {"top_rpm": f"{top_rpm:.0f}", "duration_s": f"{duration_s:g}"})
        self._clock.sleep(1.0)
        drive.set_ramp(top_rpm / duration_s)
        drive.set_speed(0.0)

        def slow() -> bool:
            self._tell(f"{test}: {drive.actual_rpm:.0f} rpm", 1 - drive.actual_rpm / top_rpm)
            return drive.actual_rpm < _SLOW_SHARE * top_rpm

        reached = self._look_until(slow, 1.5 * duration_s)
        seen = f"still {drive.actual_rpm:.0f} rpm after {1.5 * duration_s:g} s"
        done = self._end(test, {"reached_rest": reached}, "" if reached else f"the rotor to come to rest: {seen}")
        self._stop_rotor()
        return done

    def point(self, name: str, speed_rad_s: float) -> TestDone:
        """Spin up with locked pendulums, wait until the orbit is steady, release, record until all is steady."""
        test = f"point-{name}"
        rpm = speed_rad_s / _RPM
        self._refuse(test_inputs.speed_refusal(self._s.rig, rpm))
        self._at_rest_and_locked()
        self._spin_up(test, rpm)
        steady = self._look_until(lambda: self._locked_steady(test), _LOCKED_STEADY_S)
        if not steady:
            self._warn(f"the orbit was not steady {_LOCKED_STEADY_S:g} s after the spin-up, the release follows anyway")
        self._begin(test, {"point": name, "speed_rpm": f"{rpm:.3f}"})
        self._clock.sleep(_BEFORE_RELEASE_S)
        self._tell(f"{test}: releasing the pendulums", None)
        self._s.command_node("release both")
        self._wait_locks(closed=False)
        released_ns = self._opened_ns()
        last: Settling | None = None

        def all_steady() -> bool:
            nonlocal last
            since = (self._clock.now_ns() - released_ns) * 1e-9
            if since < 3.0:
                return False
            last = self._steady(released_ns, _STEADY)
            self._tell(f"{test}: {since:.0f} s after release, {last.why}", None)
            return last.settled

        limit_ns = released_ns + int(_POINT_LIMIT_S * 1e9)
        reached = False
        while not reached and self._look_until(all_steady, (limit_ns - self._clock.now_ns()) * 1e-9):
            self._clock.sleep(_AFTER_STEADY_S)
            last = self._steady(released_ns, {})
            reached = last.settled
        why = last.why if last else "no data"
        found = reached or (self._expects_slipping(name) and last is not None and last.slipping)
        missed = "" if found else f"the steady state within {_POINT_LIMIT_S:g} s of the release: {why}"
        done = self._end(test, {"steady_before_release": steady, "settled": reached, "why": why}, missed)
        self._stop_rotor()
        self._lock_both()
        return done

    # --- parts -------------------------------------------------------------------------------------------------

    def _enable(self) -> None:
        drive = self._s.drive
        drive.enable()
        self._warn(drive.was_reset)
        drive.was_reset = ""

    def _spin_up(self, test: str, rpm: float) -> None:
        drive = self._s.drive
        self._enable()
        ramp = self._speed().ramp_rpm_per_s
        limit_s = _SPIN_UP_S + 1.5 * rpm / ramp
        drive.set_ramp(ramp)
        drive.set_speed(rpm)

        def at_speed() -> bool:
            self._tell(f"{test}: spinning up, {drive.actual_rpm:.0f} of {rpm:.0f} rpm", None)
            return abs(drive.actual_rpm - rpm) < 0.01 * rpm + 2

        if not self._look_until(at_speed, limit_s):
            seen = f"{drive.actual_rpm:.0f} rpm after {limit_s:.0f} s, expected {rpm:.0f}"
            raise self._stopped(f"{test}: {seen}. Look at the drive")

    def _speed(self) -> SpeedSource:
        role = self._s.rig.roles.speed
        assert role is not None, "the test was refused without one"
        return role

    def _angles(self) -> PendulumAngles:
        role = self._s.rig.roles.angles
        assert role is not None, "the test was refused without one"
        return role

    def _expects_slipping(self, point: str) -> bool:
        known = self._s.rig.points.get(point)
        return known is not None and known.expected == "slipping"

    def _refuse(self, why: str) -> None:
        """Refuse a test before anything is enabled or recorded."""
        if why:
            raise ProcedureError(why)

    def _warn(self, text: str) -> None:
        if text:
            self._warnings.append(text)
            self._tell(text, None)

    def _stopped(self, message: str) -> ProcedureError:
        self._s.drive.quick_stop()
        error = ProcedureError(message)
        self._s.trouble = self._s.trouble or error  # the log that is still open ends with it
        return error

    def _tell(self, text: str, share: float | None) -> None:
        self._progress(text, share)

    def _begin(self, test: str, facts: Mapping[str, str]) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        known = {"parameters": self.parameters} if self.parameters else {}
        self._s.need(*(["laser/x", "laser/y"] if test.startswith("ring-down") else ["pendulums"]))
        with one_at_a_time(self._folder):  # two tests of two rigs may log into one folder
            path = self._folder / f"{next_number(p.name for p in self._folder.iterdir()):02d}-{test}.mcap"
            self._s.start_recording(path, {"test": test, "note": self._note, **known, **facts})

    def _end(self, test: str, summary: Mapping[str, Any], missed: str) -> TestDone:
        """Finish the log.

        Args:
            summary: the test's own facts.
            missed: what was not reached; empty when the test came to its end.
        """
        if wrong_rates := self._s.rates.summary():
            self._warn(f"wrong rates: {wrong_rates}")
        facts = {**summary, **ending(missed)}
        if self._warnings:
            facts["warnings"] = "; ".join(self._warnings)
        log = self._s.stop_recording(facts)
        self._s.check()  # what went wrong in the last stretch must not look like a finished test
        return TestDone(test, log, facts, missed, tuple(self._warnings))

    def _until(self, condition: Callable[[], bool], wall_s: float, what: str) -> None:
        self._s.wait_for(condition, wall_s, what)

    def _look_until(self, condition: Callable[[], bool], limit_s: float) -> bool:
        """Look every half second of rig time; False when the limit (rig time) is reached first."""
        end = self._clock.now_ns() + int(limit_s * 1e9)
        while True:
            self._s.check()
            self._heed_encoder_faults()
            if condition():
                return True
            if self._clock.now_ns() > end:
                return False
            self._clock.sleep(_LOOK_S)

    def _heed_encoder_faults(self) -> None:
        if self._angles_needed:
            _, (flags,) = self._newest("pendulums", ("flags",), _LOOK_S)
            if faults := flagged(flags):
                raise self._stopped(f"{self._angles().device}: {'. '.join(faults)}; the rotor was stopped")

    def _since(self, seconds: float) -> int:
        return self._clock.now_ns() - int(seconds * 1e9)

    def _newest(self, topic: str, fields: tuple[str, ...], seconds: float) -> tuple[NDArray[np.int64], list[Any]]:
        """The newest stretch of a channel, counted back from its newest sample: a late read is no silence."""
        time_ns, columns = self._s.recent.last(topic, fields, self._since(20.0))
        if len(time_ns) == 0:
            return time_ns, columns
        new = time_ns > time_ns[-1] - int(seconds * 1e9)
        return time_ns[new], [column[new] for column in columns]

    def _peak_to_peak(self, topic: str, seconds: float) -> float:
        """Of a laser over its newest stretch, m; NaN where much of it is missing or invalid."""
        if self._valid(topic, seconds) < 0.8 * seconds:
            return math.nan
        _, (x,) = self._newest(topic, ("displacement_m",), seconds)
        return float(np.ptp(x[np.isfinite(x)]))

    def _valid(self, topic: str, seconds: float) -> float:
        """How many seconds of valid samples a laser's newest stretch holds."""
        _, (x,) = self._newest(topic, ("displacement_m",), seconds)
        rates = {sensor.topic: sensor.rate_Hz for sensor in self._s.rig.roles.displacements}
        return float(np.count_nonzero(np.isfinite(x))) / rates[topic]

    def _largest_since(self, topic: str, since_ns: int, rest_m: float) -> float:
        """Largest distance of a laser from its reading at rest since an instant, m."""
        _, (x,) = self._s.recent.last(topic, ("displacement_m",), since_ns)
        return float(np.nanmax(np.abs(x - rest_m), initial=0.0))

    def _turned_since(self, since_ns: int) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """How far the pendulums have turned since an instant, rad, and their largest speeds, rad/s; shapes (2,)."""
        time_ns, columns = self._s.recent.last("pendulums", ("theta3_rad", "theta4_rad"), since_ns)
        step = 50
        if len(time_ns) <= step:
            return np.zeros(2), np.full(2, 1e-3)
        angles = np.column_stack(columns)
        rates = (angles[step:] - angles[:-step]) / ((time_ns[step:] - time_ns[:-step]) * 1e-9)[:, None]
        return np.ptp(angles, axis=0), np.max(np.abs(rates), axis=0)

    def _rates(self) -> NDArray[np.floating]:
        """Pendulum speeds over the newest fifth of a second of samples, rad/s, shape (2,); NaN without samples."""
        time_ns, (a, b) = self._newest("pendulums", ("theta3_rad", "theta4_rad"), 0.2)
        if len(time_ns) < 10:
            return np.full(2, np.nan)
        return np.array([a[-1] - a[0], b[-1] - b[0]]) / ((time_ns[-1] - time_ns[0]) * 1e-9)

    def _signals(self, since_ns: int, lasers_since_ns: int | None = None) -> tuple[NDArray[np.floating], ...]:
        """Angle times and angles, marks and (perhaps later) lasers since an instant, times in s from it."""
        recent = self._s.recent
        t, (a, b) = recent.last("pendulums", ("theta3_rad", "theta4_rad"), since_ns)
        m, (turns,) = recent.last("tacho", ("revolutions",), since_ns)
        tx, (x,) = recent.last("laser/x", ("displacement_m",), lasers_since_ns or since_ns)
        ty, (y,) = recent.last("laser/y", ("displacement_m",), lasers_since_ns or since_ns)

        def seconds(ns: NDArray[np.int64]) -> NDArray[np.floating]:
            return (ns - since_ns) * 1e-9

        return (
            seconds(t), np.column_stack([a, b]), seconds(m), 2 * np.pi * turns.astype(float),
            seconds(tx)[::4], x[::4], seconds(ty)[::4], y[::4],
        )  # fmt: skip

    def _locked_steady(self, test: str) -> bool:
        _, _, marks, phase, tx, x, ty, y = self._signals(self._since(15.0))
        found = locked_settled(marks, phase, tx, x, ty, y)
        self._tell(f"{test}: waiting for a steady orbit, {found.why}", None)
        return found.settled

    def _steady(self, released_ns: int, tolerances: Mapping[str, float]) -> Settling:
        since = released_ns - 1_500_000_000  # some of the time before, to know how the pendulums stood
        signals = self._signals(since, max(since, self._since(15.0)))
        step = self._angles().step_rad
        return settled(*signals, release_time_s=(released_ns - since) * 1e-9, angle_step_rad=step, **tolerances)

    def _at_rest_and_locked(self, angles_needed: bool = True) -> None:
        self._warnings, self._angles_needed = [], False
        self._s.check()
        self._stop_rotor()
        self._lock_both()
        self._look_at_locked(angles_needed)

    def _look_at_locked(self, angles_needed: bool) -> None:
        """Hold the counters against the closed locks, and heed what the node says of itself.

        Raises:
            ProcedureError: angles are needed, or the rotor is to turn, and they cannot be believed.
        """
        self._clock.sleep(_LOCKED_LOOK_S)
        # one of other counts ends the test; patience, since without it the angles would be blamed
        device = self._angles().device
        self._look_until(lambda: self._s.told(device)[0], _STATUS_S + self._clock.patience(_STATUS_S))
        self._s.check()
        if complaint := self._s.told(device)[1]:  # made while the session still opened, when nobody was to be stopped
            raise DeviceError(f"{device}: {complaint}")
        _, (a, b, flags) = self._newest("pendulums", ("theta3_rad", "theta4_rad", "flags"), 0.5 * _LOCKED_LOOK_S)
        zero_std = self._angles().zero_std_deg
        wrong = [*flagged(flags), misplaced(lock_positions(np.column_stack([a, b]), flags, zero_std))]
        trouble = ". ".join(text for text in wrong if text)
        if trouble and angles_needed:
            raise ProcedureError(f"{device}: {trouble}. Nothing was turned, nothing recorded")
        self._warn(f"{device}: {trouble}" if trouble else "")
        self._angles_needed = angles_needed
        self._warn(f"{device}: its battery is low; change it before the next test" if battery_low(flags) else "")

    def _stop_rotor(self) -> None:
        drive = self._s.drive
        if drive.actual_rpm != 0 or drive.enabled:
            drive.set_ramp(_STOP_RAMP_RPM_S)
            if not drive.enabled:  # it coasts, perhaps since a host was killed: brake it
                self._enable()
            drive.set_speed(0)
            self._s.wait_for_rest(30.0)
            self._clock.sleep(0.5)
            self._s.wait_for_rest(30.0)
            drive.disable()

    def _lock_both(self) -> None:
        self._s.command_node("lock both")
        self._wait_locks(closed=True)

    def _opened_ns(self) -> int:
        """Time of the first sample with both locks open, after the last one with a lock closed."""
        time_ns, (flags,) = self._newest("pendulums", ("flags",), 19.0)
        closed = np.flatnonzero((flags & _LOCKS) != 0)
        return int(time_ns[min(closed[-1] + 1, len(time_ns) - 1)]) if len(closed) else int(time_ns[0])

    def _wait_locks(self, closed: bool) -> None:
        def there() -> bool:
            _, (flags,) = self._newest("pendulums", ("flags",), 0.1)
            return len(flags) > 0 and flags[-1] & _LOCKS == (_LOCKS if closed else 0)

        self._until(there, 10.0, f"both locks to {'close' if closed else 'open'}")


def zero_counters(session: Session) -> None:
    """Close both locks and zero the node's counters there, where their zero belongs; the rotor must be at rest.

    Raises:
        DeviceError: the node refuses, or a lock does not close.
    """
    session.command_node("lock both")

    def closed() -> bool:
        _, (flags,) = session.recent.last("pendulums", ("flags",), session.clock.now_ns() - 2_000_000_000)
        return len(flags) > 0 and flags[-1] & _LOCKS == _LOCKS

    session.wait_for(closed, 10.0, "both locks to close")
    session.clock.sleep(_LOCKED_LOOK_S)
    session.command_node("zero")
    session.clock.sleep(_LOCKED_LOOK_S)

# pyright: strict
"""The host's side of a VESC: the ramp, the command that is repeated, the polls, and how the rotor is stopped.

The controller obeys the last command until its own time-out, and has no enabled state, nor a ramp of ours. So the host
repeats its command, a little further along the ramp each time, from one thread; what the host means to do is this
command's `mode`. A host that dies is silent, and the controller lets go or brakes by itself, as it is set up.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from enum import Enum

from daq.drivers.contract import Pipeline, RotorGuard
from daq.drivers.run_down import wait_for_rest
from daq.drivers.vesc import stream, wire
from daq.drivers.vesc.ramp import Ramp
from daq.drivers.vesc.settings import Vesc
from daq.drivers.vesc.stream import VescPipeline
from daq.errors import DeviceError
from daq.transports.host_clock import HostClock, Repeated

_WORD_S = 0.5  # wall seconds after which the controller's word is too old
_ANSWER_S = 0.1  # wall seconds after which a poll counts as unanswered and the next one goes out
_ENABLE_S = 3.0  # wall seconds for the controller to obey
_LEAVE_S = 0.5  # wall seconds for the controller to answer behind the command to let go
_UNCONFIRMED = (
    "it does not answer: nobody can tell whether it has. Without commands it does what is set for its own time-out. "
    "Look at its power and its line before anyone touches the rotor"
)
_BEAT_S = 0.002  # wall seconds, the shortest beat: where rig time runs fast
_STEP_S = 0.25  # wall seconds, the longest step of the ramp

_UNKNOWN, _RESTARTED = "UNKNOWN", "RESTARTED"


class Mode(Enum):
    """What the host repeats to the controller."""

    NOTHING = "nothing: it is only asked"
    SPEED = "the ramp's set-point"
    BRAKE = "brake"
    FREE = "let go"


class VescControl:
    """See SpeedSource.

    `beat` does all that is due; a thread calls it. Two locks: one around what is decided, held for no longer than
    that, and one around what is decided and then sent, so that an older command never follows a newer one.

    Args:
        settings: the controller's table of the rig file.
        send: writes bytes to its link (and to the log).
        clock: for the ramp, for time-outs, and for the age of the controller's word.
        guard: what is asked before the rotor is turned; without it the controller's own word counts.

    Attributes:
        mode: what is being repeated.
        faults: codes reported since the last `enable`.
    """

    def __init__(
        self, settings: Vesc, send: Callable[[bytes], None], clock: HostClock, guard: RotorGuard | None = None
    ) -> None:
        self._settings, self._send, self._clock = settings, send, clock
        self._guarded = guard or RotorGuard(
            permit=lambda rpm: None,
            at_rest=lambda: None if math.isnan(self.actual_rpm) else abs(self.actual_rpm) <= settings.rest_rpm,
            speed_rpm=lambda: abs(self.actual_rpm),
        )
        self._ramp = Ramp(settings.ramp_rpm_per_s, settings.min_rpm, clock.patience(_STEP_S))
        self._deciding, self._sending = threading.Lock(), threading.Lock()
        self._repeated: Repeated | None = None
        self.mode = Mode.NOTHING
        self._armed = self._ordered = False
        self._stops = 0  # how often it was told to stop: who began before the last one has to begin anew
        self._word: wire.Values | None = None
        self._word_ns = self._answers = 0
        self._ordered_ns = 0  # when the newest mode was first sent
        self._polled_ns: int | None = None  # of the poll under way
        self._poll_due_ns = self._command_due_ns = 0
        self.dropped_out: str | None = None
        self.was_reset = ""  # nothing here is reset: a fault of this controller passes by itself
        self.faults: list[int] = []

    # --- what it says ------------------------------------------------------------------------------------------

    def notice(self, pipeline: Pipeline) -> None:
        """See SpeedSource."""
        assert isinstance(pipeline, VescPipeline)
        for values in pipeline.answers:
            self._heed(values)

    def _heed(self, values: wire.Values) -> None:
        with self._deciding:
            before, self._word, self._word_ns = self._word, values, self._clock.now_ns()
            self._answers += 1
            self._polled_ns = None
            if values.fault and values.fault not in self.faults:
                self.faults.append(values.fault)
            if not self._armed:
                return
            now = stream.state(stream.statusword(values, stream.SPEED))
            fallen = now if now != "HOLDS SPEED" else None
            if before is not None and wire.restarted(before, values):
                fallen = _RESTARTED
            if fallen is not None:
                self.dropped_out = self.dropped_out or fallen
                self._armed, self.mode = False, Mode.BRAKE  # as soon as it obeys again, it is to stop, not to go on

    @property
    def actual_rpm(self) -> float:
        """See SpeedSource."""
        word = self._fresh()
        return math.nan if word is None else word.erpm / self._settings.pole_pairs

    def _fresh(self) -> wire.Values | None:
        young = self._clock.now_ns() - self._word_ns <= self._clock.patience(_WORD_S) * 1e9
        return self._word if young else None

    @property
    def state(self) -> str:
        """See SpeedSource: its fault and its status byte are its own, the rest is what it was last told."""
        word = self._fresh()
        if word is None:
            return _UNKNOWN
        told = {Mode.SPEED: stream.SPEED, Mode.BRAKE: stream.BRAKE, Mode.FREE: stream.FREE}.get(self.mode, 0)
        return stream.state(stream.statusword(word, told))

    @property
    def enabled(self) -> bool:
        """Whether it is being told a speed, and does not say that it cannot."""
        return self._armed and self._fresh() is not None

    def fault_code(self) -> int | None:
        """See SpeedSource; it is asked all the time, so the newest answer is one."""
        word = self._fresh()
        return None if word is None or not word.fault else word.fault

    def why(self) -> str:
        """See SpeedSource."""
        return "".join(f"; fault {wire.fault_words(code)}" for code in self.faults)

    # --- what it is told ---------------------------------------------------------------------------------------

    def start(self) -> None:
        """See SpeedSource: begin to ask; the motor is not commanded yet."""
        if self._repeated is not None:  # of a line that was lost, or of a second start
            self._repeated.stop()
        period_s = min(self._settings.command_ms * 1e-3, 1.0 / self._settings.report_Hz)
        self.beat()
        # a link that is gone is its reader's to report; a controller without commands stops by its own time-out
        self._repeated = self._clock.every(
            max(_BEAT_S, self._clock.wall(period_s)), self.beat, "vesc", lambda error: None
        )

    def beat(self) -> None:
        """Send what is due: the command, a poll.

        Raises:
            LinkLost: the device is gone.
        """
        with self._sending:
            now_ns = self._clock.now_ns()
            data = b""
            with self._deciding:
                if now_ns >= self._command_due_ns:
                    data += self._command(now_ns)
                waited = self._polled_ns is None or now_ns - self._polled_ns > self._clock.patience(_ANSWER_S) * 1e9
                if waited and now_ns >= self._poll_due_ns:
                    period_ns = round(1e9 / self._settings.report_Hz)
                    self._poll_due_ns = max(self._poll_due_ns + period_ns, now_ns)
                    self._polled_ns = now_ns
                    data += wire.get_values()
            if data:
                self._send(data)

    def _command(self, now_ns: int) -> bytes:
        """The mode's command now, and when the next one is due; call it under both locks."""
        self._command_due_ns = now_ns + self._settings.command_ms * 1_000_000
        if self.mode is Mode.NOTHING:
            return b""
        self._ordered = True
        self._ordered_ns = self._ordered_ns or now_ns
        if self.mode is Mode.FREE:
            return wire.let_go()
        rpm = self._ramp.at(now_ns * 1e-9) if self.mode is Mode.SPEED else 0.0
        # speed 0 is a brake: below its least speed a controller lets go, shorts the motor or brakes, by its firmware
        return wire.set_rpm(round(rpm * self._settings.pole_pairs)) if rpm else wire.set_brake(self._settings.brake_A)

    def _begin(self, mode: Mode) -> None:
        """A new mode, told at the next beat; call it under the lock around what is decided."""
        self.mode, self._command_due_ns, self._ordered_ns = mode, 0, 0

    def set_ramp(self, rpm_per_s: float) -> None:
        """See SpeedSource.

        Raises:
            DeviceError: no rate.
        """
        if not 0 < rpm_per_s < math.inf:
            raise DeviceError(f"drive: expected a ramp above 0 rpm/s, got {rpm_per_s:g}")
        with self._deciding:
            self._ramp.rpm_per_s = rpm_per_s

    def enable(self) -> None:
        """Hold speed 0: a rotor that turns is led down the ramp from where it is.

        The controller has no enabled state. It obeys when it reports neither fault nor time-out after a command has
        reached it; firmware without a status byte shows no more than that it has no fault.

        Raises:
            DeviceError: a fault stands, or it does not obey.
            RigError: whatever `permit` raises.
        """
        deadline = self._clock.wall_s() + _ENABLE_S
        with self._deciding:
            stops, self._armed, self.dropped_out, self.faults = self._stops, False, None, []
        begun = False
        try:
            while True:
                self._guarded.permit(None)
                if begun and self._arm(stops):
                    return
                if not begun and self._obedient() and not math.isnan(self.actual_rpm):
                    begun = self._hold(stops)
                self.beat()
                if self._clock.wall_s() > deadline:
                    raise DeviceError(self._disobeys())
                self._clock.wait(0.005)
        except BaseException:
            with self._deciding:
                if begun and not self._armed:
                    self._begin(Mode.BRAKE)
            raise

    def _obedient(self) -> bool:
        word = self._fresh()
        return word is not None and not word.fault and not (word.status or 0) & wire.KILL_SWITCH

    def _disobeys(self) -> str:
        if self._fresh() is None:
            return "drive: it does not answer. Look at its power and its line"
        why = self.why() or "; it reports no fault"
        return (
            f"drive: expected it to obey, its state is {self.state}{why}. Look at the fault with the maker's software, "
            "at the kill switch, at the wire to the controller, and whether another input commands the motor"
        )

    def _hold(self, stops: int) -> bool:
        with self._deciding:
            self._check_not_stopped(stops)
            assert self._word is not None
            self._ramp.begin(self._word.erpm / self._settings.pole_pairs, self._clock.now_s())
            self._begin(Mode.SPEED)
        return True

    def _arm(self, stops: int) -> bool:
        with self._deciding:
            self._check_not_stopped(stops)
            word = self._word
            heard = word is not None and 0 < self._ordered_ns < self._word_ns
            if not heard or word is None or word.fault or word.status:
                return False
            self._armed = True
        return True

    def _check_not_stopped(self, stops: int) -> None:
        if stops != self._stops:
            raise DeviceError("drive: it was told to stop while it was being enabled")

    def set_speed(self, rpm: float) -> None:
        """See SpeedSource.

        Raises:
            DeviceError: it cannot hold that speed, or is not enabled.
            RigError: whatever `permit` raises.
        """
        least = self._settings.min_rpm
        if rpm and not abs(rpm) >= least:
            raise DeviceError(
                f"drive: {rpm:g} rpm wanted, it cannot hold less than {least:.0f} rpm (min_erpm "
                f"{self._settings.min_erpm:g} over {self._settings.pole_pairs} pole pairs): it was not told"
            )
        if not abs(rpm) * self._settings.pole_pairs < 2**31:
            raise DeviceError(f"drive: {rpm:g} rpm wanted, which its wire cannot carry")
        self._guarded.permit(rpm)
        with self._deciding:
            if not self._armed:
                raise DeviceError(f"drive: {rpm:g} rpm wanted, it is not enabled ({self.state}{self.why()})")
            self._ramp.target_rpm = rpm
            self._command_due_ns = 0
        self.beat()

    def disable(self) -> None:
        """See SpeedSource.

        Raises:
            DeviceError: it does not answer, so that nobody can tell whether it has let go.
        """
        with self._deciding:
            self._armed = False
            self._begin(Mode.FREE)
        self.beat()
        if not self._lets_go():
            raise DeviceError(f"drive: told to let go of the rotor, {_UNCONFIRMED}")

    def _lets_go(self) -> bool:
        """Tell it to let go until it has answered behind that; whether it has.

        It has no word for having let go: its line keeps the order, so that an answer to a question behind the command
        shows that the command has arrived.
        """
        deadline = self._clock.wall_s() + _LEAVE_S
        while True:
            with self._sending:
                with self._deciding:
                    due = self._answers + (2 if self._polled_ns is not None else 1)  # one may be under way still
                    self._polled_ns = self._clock.now_ns()
                self._send(wire.let_go() + wire.get_values())
            again = self._clock.wall_s() + _ANSWER_S
            while self._answers < due and self._clock.wall_s() < again:
                self._clock.wait(0.002)
            if self._answers >= due:
                return True
            if self._clock.wall_s() > deadline:
                return False

    def quick_stop(self) -> None:
        """Brake at once, and go on braking."""
        with self._deciding:
            self._armed = False
            self._stops += 1
            self._begin(Mode.BRAKE)
        self.beat()

    def stop(self, told: Callable[[str], None] = lambda text: None) -> bool:
        """Brake until the rotor stands, then let go of it; whether both are known to have happened.

        A rotor that is not known to stand is not let go of: the commands end with a brake, and what the controller
        does at its own time-out is left to it.

        Args:
            told: called with what is being waited for.
        """
        rest = self._repeated is None and not self._ordered
        try:
            rest = rest or self._rest(told)
        finally:
            self._end()
        if rest and self._ordered and not self._lets_go():
            told(f"the drive was told to let go of the rotor, {_UNCONFIRMED}")
            return False
        return rest

    def _end(self) -> None:
        """No more commands and polls."""
        if self._repeated is not None:
            self._repeated.stop()
            self._repeated = None
        with self._deciding:
            self._armed, self.mode = False, Mode.NOTHING

    def _rest(self, told: Callable[[str], None]) -> bool:
        """Brake, and wait until the rotor stands: as long as it grows slower, or runs down by itself."""
        if not self._ordered and (self._word is None or self._guarded.at_rest()):
            return True  # it was told nothing, and nothing is known to turn
        self.quick_stop()
        return wait_for_rest(self._clock, self._guarded, self.beat, told)

"""The host's command of a VESC: the ramp, the repeated command, the polls, and the stop of the rotor.

The controller executes the last command until its own timeout. It has neither an enabled state nor a ramp of the rotor.
The host therefore repeats its command from one thread, each time further along the ramp; `VescControl.mode` is the kind
of command. If the host ends, the commands end, and the controller releases the motor or brakes by itself, according to
its set-up.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from enum import Enum

from daq.drivers.contract import Pipeline, RotorGuard
from daq.drivers.run_down import wait_for_rest
from daq.drivers.vesc import stream, wire
from daq.drivers.vesc.ramp import SetpointRamp
from daq.drivers.vesc.settings import Vesc
from daq.drivers.vesc.stream import VescPipeline
from daq.errors import DeviceError
from daq.transports.host_clock import HostClock, Repeated

_MAX_REPORT_AGE_S = 0.5  # wall s after which a report is too old
_ANSWER_S = 0.1  # wall s after which a poll counts as unanswered and the next one is sent
_ENABLE_S = 3.0  # wall s for the controller to obey
_RELEASE_S = 0.5  # wall s for the controller to answer after the command to release the rotor
_UNCONFIRMED = (
    "it does not answer: the release is not confirmed. Without commands it does what is set for its own timeout. "
    "Look at its power and its line before anyone touches the rotor"
)
_MIN_BEAT_S = 0.002  # wall s, shortest period of the thread, for fast rig time
_MAX_STEP_S = 0.25  # wall s, longest step of the ramp

_UNKNOWN, _RESTARTED = "UNKNOWN", "RESTARTED"


class Mode(Enum):
    """The command that the host repeats."""

    NOTHING = "none: the controller is only polled"
    SPEED = "the ramp's set-point"
    BRAKE = "brake"
    FREE = "release"


class VescControl:
    """See SpeedSource.

    `beat` sends everything that is due; a thread calls it. The lock `_deciding` protects the state and is held only
    while the state is read or changed. The lock `_sending` is held from the decision to the end of sending, so that an
    older command never follows a newer one.

    Args:
        settings: table of the controller in the rig file.
        send: writes bytes to the controller's link (and to the log).
        clock: clock for the ramp, the timeouts and the age of reports.
        guard: conditions for turning the rotor; without it only the controller's own reports are used.

    Attributes:
        mode: command that is being repeated.
        faults: fault codes reported since the last `enable`.
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
        self._ramp = SetpointRamp(settings.ramp_rpm_per_s, settings.min_rpm, clock.patience(_MAX_STEP_S))
        self._deciding, self._sending = threading.Lock(), threading.Lock()
        self._repeated: Repeated | None = None
        self.mode: Mode = Mode.NOTHING
        self._armed = self._ordered = False
        self._stops = 0  # number of stop commands: an `enable` that began before the last one fails
        self._report: wire.Values | None = None
        self._report_ns = self._answers = 0
        self._ordered_ns = 0  # time at which the newest mode was first sent
        self._polled_ns: int | None = None  # time of the poll that is not answered yet
        self._poll_due_ns = self._command_due_ns = 0
        self.dropped_out: str | None = None
        self.was_reset = ""  # never set: a fault of this controller ends by itself
        self.faults: list[int] = []

    # --- reports ----------------------------------------------------------------------------------------------

    def notice(self, pipeline: Pipeline) -> None:
        """See SpeedSource."""
        assert isinstance(pipeline, VescPipeline)
        for values in pipeline.answers:
            self._take(values)

    def _take(self, values: wire.Values) -> None:
        with self._deciding:
            before, self._report, self._report_ns = self._report, values, self._clock.now_ns()
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
                self._armed, self.mode = False, Mode.BRAKE  # as soon as it obeys again it must stop

    @property
    def actual_rpm(self) -> float:
        """See SpeedSource."""
        report = self._recent()
        return math.nan if report is None else report.erpm / self._settings.pole_pairs

    def _recent(self) -> wire.Values | None:
        """Return the newest report unless it is too old."""
        recent = self._clock.now_ns() - self._report_ns <= self._clock.patience(_MAX_REPORT_AGE_S) * 1e9
        return self._report if recent else None

    @property
    def state(self) -> str:
        """See SpeedSource. Fault and status byte are from the newest report, the rest is the last command."""
        report = self._recent()
        if report is None:
            return _UNKNOWN
        command = {Mode.SPEED: stream.SPEED, Mode.BRAKE: stream.BRAKE, Mode.FREE: stream.FREE}.get(self.mode, 0)
        return stream.state(stream.statusword(report, command))

    @property
    def enabled(self) -> bool:
        """Whether speeds are commanded and the controller reports no obstacle."""
        return self._armed and self._recent() is not None

    def fault_code(self) -> int | None:
        """See SpeedSource. The controller is polled continuously, so the newest report is used."""
        report = self._recent()
        return None if report is None or not report.fault else report.fault

    def why(self) -> str:
        """See SpeedSource."""
        return "".join(f"; fault {wire.fault_words(code)}" for code in self.faults)

    # --- commands ----------------------------------------------------------------------------------------------

    def start(self) -> None:
        """See SpeedSource: start polling; the motor receives no command yet."""
        if self._repeated is not None:  # from a line that was lost, or from an earlier start
            self._repeated.stop()
        period_s = min(self._settings.command_ms * 1e-3, 1.0 / self._settings.report_Hz)
        self.beat()
        # a lost link is reported by its reader; a controller without commands stops by its own timeout
        self._repeated = self._clock.every(
            max(_MIN_BEAT_S, self._clock.wall(period_s)), self.beat, "vesc", lambda error: None
        )

    def beat(self) -> None:
        """Send the command and the poll if they are due.

        Raises:
            LinkLost: the connection to the device is lost.
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
        """Return the mode's command and schedule the next one; the caller holds both locks."""
        self._command_due_ns = now_ns + self._settings.command_ms * 1_000_000
        if self.mode is Mode.NOTHING:
            return b""
        self._ordered = True
        self._ordered_ns = self._ordered_ns or now_ns
        if self.mode is Mode.FREE:
            return wire.release()
        rpm = self._ramp.at(now_ns * 1e-9) if self.mode is Mode.SPEED else 0.0
        # speed 0 is sent as a brake: below its least speed a controller releases, shorts or brakes the motor,
        # depending on its firmware
        return wire.set_rpm(round(rpm * self._settings.pole_pairs)) if rpm else wire.set_brake(self._settings.brake_A)

    def _begin(self, mode: Mode) -> None:
        """Set a new mode, which is sent at the next beat; the caller holds the lock `_deciding`."""
        self.mode, self._command_due_ns, self._ordered_ns = mode, 0, 0

    def set_ramp(self, rpm_per_s: float) -> None:
        """See SpeedSource.

        Raises:
            DeviceError: the rate is not a positive finite number.
        """
        if not 0 < rpm_per_s < math.inf:
            raise DeviceError(f"drive: expected a ramp above 0 rpm/s, got {rpm_per_s:g}")
        with self._deciding:
            self._ramp.rpm_per_s = rpm_per_s

    def enable(self) -> None:
        """Hold speed 0; a turning rotor is slowed down along the ramp.

        The controller has no enabled state. It obeys if it reports neither fault nor timeout after a command has
        reached it. Firmware without a status byte only shows the absence of a fault.

        Raises:
            DeviceError: the controller has a fault or does not obey.
            AcquisitionError: raised by `permit`.
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
        report = self._recent()
        return report is not None and not report.fault and not (report.status or 0) & wire.KILL_SWITCH

    def _disobeys(self) -> str:
        """Return the text of the error for a controller that does not obey."""
        if self._recent() is None:
            return "drive: it does not answer. Look at its power and its line"
        why = self.why() or "; it reports no fault"
        return (
            f"drive: expected it to obey, its state is {self.state}{why}. Look at the fault with the maker's software, "
            "at the kill switch, at the wire to the controller, and whether another input commands the motor"
        )

    def _hold(self, stops: int) -> bool:
        with self._deciding:
            self._check_not_stopped(stops)
            assert self._report is not None
            self._ramp.begin(self._report.erpm / self._settings.pole_pairs, self._clock.now_s())
            self._begin(Mode.SPEED)
        return True

    def _arm(self, stops: int) -> bool:
        with self._deciding:
            self._check_not_stopped(stops)
            report = self._report
            if report is None or not 0 < self._ordered_ns < self._report_ns or report.fault or report.status:
                return False
            self._armed = True
        return True

    def _check_not_stopped(self, stops: int) -> None:
        if stops != self._stops:
            raise DeviceError("drive: a stop was commanded while it was being enabled")

    def set_speed(self, rpm: float) -> None:
        """See SpeedSource.

        Raises:
            DeviceError: the controller cannot hold that speed, or is not enabled.
            AcquisitionError: raised by `permit`.
        """
        least = self._settings.min_rpm
        if rpm and not abs(rpm) >= least:
            raise DeviceError(
                f"drive: {rpm:g} rpm wanted, it cannot hold less than {least:.0f} rpm (min_erpm "
                f"{self._settings.min_erpm:g} over {self._settings.pole_pairs} pole pairs): nothing was sent"
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
            DeviceError: the controller does not answer, so the release is not confirmed.
        """
        with self._deciding:
            self._armed = False
            self._begin(Mode.FREE)
        self.beat()
        if not self._release():
            raise DeviceError(f"drive: commanded to release the rotor, {_UNCONFIRMED}")

    def _release(self) -> bool:
        """Send the command to release the rotor until a poll after it is answered; return whether it was.

        The controller does not report a release. Its line keeps the order, so the answer to a poll that was sent after
        the command shows that the command has arrived.
        """
        deadline = self._clock.wall_s() + _RELEASE_S
        while True:
            with self._sending:
                with self._deciding:
                    due = self._answers + (2 if self._polled_ns is not None else 1)  # an earlier poll may be unanswered
                    self._polled_ns = self._clock.now_ns()
                self._send(wire.release() + wire.get_values())
            again = self._clock.wall_s() + _ANSWER_S
            while self._answers < due and self._clock.wall_s() < again:
                self._clock.wait(0.002)
            if self._answers >= due:
                return True
            if self._clock.wall_s() > deadline:
                return False

    def quick_stop(self) -> None:
        """Brake immediately and continue to brake."""
        with self._deciding:
            self._armed = False
            self._stops += 1
            self._begin(Mode.BRAKE)
        self.beat()

    def stop(self, notify: Callable[[str], None] = lambda text: None) -> bool:
        """Brake until the rotor stands, then release it.

        The rotor is not released if it is not confirmed to stand: the commands end with a brake, and the controller's
        own timeout follows.

        Args:
            notify: called with a text about what is being waited for.

        Returns:
            Whether rest and release are confirmed.
        """
        rest = self._repeated is None and not self._ordered
        try:
            rest = rest or self._rest(notify)
        finally:
            self._end()
        if rest and self._ordered and not self._release():
            notify(f"the drive was commanded to release the rotor, {_UNCONFIRMED}")
            return False
        return rest

    def _end(self) -> None:
        """End commands and polls."""
        if self._repeated is not None:
            self._repeated.stop()
            self._repeated = None
        with self._deciding:
            self._armed, self.mode = False, Mode.NOTHING

    def _rest(self, notify: Callable[[str], None]) -> bool:
        """Brake and wait until the rotor stands; see `wait_for_rest`."""
        if not self._ordered and (self._report is None or self._guarded.at_rest()):
            return True  # no command was sent, and the rotor is not known to turn
        self.quick_stop()
        return wait_for_rest(self._clock, self._guarded, self.beat, notify)

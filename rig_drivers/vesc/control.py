"""The host's command of a VESC: its commands, its polls, and the confirmation of a release.

The controller has neither an enabled state nor a ramp of the rotor; see `RepeatedCommand`.
"""

from __future__ import annotations

from collections.abc import Callable

from typing_extensions import override

from daq.drivers.contract import Pipeline, RotorGuard, TimeOut
from daq.drivers.host_command import UNKNOWN
from daq.drivers.motors import MOST_REST_RPM
from daq.drivers.repeated_command import RESTARTED, Mode, RepeatedCommand
from daq.errors import DeviceError
from daq.transports.host_clock import HostClock
from rig_basics.texts import number_of
from rig_drivers.vesc import stream, wire
from rig_drivers.vesc.settings import VescMotor
from rig_drivers.vesc.stream import VescPipeline

__all__ = ["Mode", "VescControl"]

_ANSWER_S = 0.1  # s to wait for an answer before the poll is repeated
_MOST_UNANSWERED = 8  # polls in a row without an answer after which a driven rotor is stopped
_NO_ANSWER = f"{UNKNOWN} (no answer to {_MOST_UNANSWERED} polls)"
_STEP_S = 0.01  # period at which the controller examines its timeout [its firmware], s


class VescControl(RepeatedCommand):
    """See RepeatedCommand.

    Args:
        on_line: encodes a command, a packet of the serial port, for the controller's line.
    """

    def __init__(
        self,
        settings: VescMotor,
        send: Callable[[bytes], None],
        clock: HostClock,
        guard: RotorGuard | None = None,
        on_line: Callable[[bytes], bytes] = bytes,
    ) -> None:
        self._on_line = on_line
        super().__init__(settings, send, clock, guard, min_rpm=settings.min_rpm, beat_s=1.0 / settings.report_Hz)
        self._settings = settings
        self._report: wire.Values | None = None
        self._answers = 0
        self._polled_ns: int | None = None  # time of the poll that is not answered yet
        self._poll_due_ns = 0
        self._unanswered = 0  # polls since the newest answer
        self._expired = False  # whether it has reported an expired timeout since this command began

    # --- reports ----------------------------------------------------------------------------------------------

    @override
    def notice(self, pipeline: Pipeline) -> None:
        assert isinstance(pipeline, VescPipeline)
        for values in pipeline.answers:
            self._take(values)

    def _take(self, values: wire.Values) -> None:
        with self._deciding:
            before, self._report = self._report, values
            self._take_speed(values.erpm / self._settings.pole_pairs)
            self._answers += 1
            self._polled_ns, self._unanswered = None, 0
            self._expired |= bool((values.status or 0) & wire.TIMED_OUT)
            if values.fault and values.fault not in self.faults:
                self.faults.append(values.fault)
            if not self._armed:
                return
            now = stream.state(stream.statusword(values, stream.SPEED))
            fallen = now if now != "HOLDS SPEED" else None
            if before is not None and wire.restarted(before, values):
                fallen = RESTARTED
            if fallen is not None:
                self._fall(fallen)

    def _recent(self) -> wire.Values | None:
        """Return the newest report unless it is too old."""
        return self._report if self._is_recent(self._report_ns) else None

    @property
    @override
    def state(self) -> str:
        """Fault and status byte from the newest report, otherwise the last command."""
        report = self._recent()
        if report is None:
            return UNKNOWN
        command = {Mode.SPEED: stream.SPEED, Mode.BRAKE: stream.BRAKE, Mode.FREE: stream.FREE}.get(self.mode, 0)
        return stream.state(stream.statusword(report, command))

    @override
    def fault_code(self) -> int | None:
        """Return the fault in the newest report: the controller is polled continuously."""
        report = self._recent()
        return None if report is None or not report.fault else report.fault

    @override
    def _words(self, code: int) -> str:
        return wire.fault_words(code)

    # --- commands ----------------------------------------------------------------------------------------------

    @override
    def _question(self, now_ns: int) -> bytes:
        waited = self._polled_ns is None or now_ns - self._polled_ns > _ANSWER_S * 1e9
        if not waited or now_ns < self._poll_due_ns:
            return b""
        if self._polled_ns is not None:  # counted, not timed: a host that was asleep has sent no polls
            self._unanswered += 1
            if self._armed and self._unanswered >= _MOST_UNANSWERED:
                self._fall(_NO_ANSWER)
        self._poll_due_ns = max(self._poll_due_ns + round(1e9 / self._settings.report_Hz), now_ns)
        self._polled_ns = now_ns
        return self._on_line(wire.get_values())

    @override
    def _speed_command(self, rpm: float) -> bytes:
        if self.mode is Mode.FREE:
            return self._on_line(wire.release())
        # speed 0 is sent as a brake: below its least speed a controller releases, shorts or brakes the motor,
        # depending on its firmware
        if not rpm:
            return self._on_line(wire.set_brake(self._settings.brake_A))
        return self._on_line(wire.set_rpm(round(rpm * self._settings.pole_pairs)))

    @override
    def _is_ready(self) -> bool:
        report = self._recent()
        return report is not None and self._is_driveable(report) and self._is_proven(report)

    @staticmethod
    def _is_driveable(report: wire.Values) -> bool:
        return not report.fault and not (report.status or 0) & wire.KILL_SWITCH

    def _is_proven(self, report: wire.Values) -> bool:
        """Return whether the timeout is proven, or cannot be proven. Until then a standing rotor gets no command.

        It cannot be proven with firmware that does not report it, and while the rotor turns so fast that it must be
        slowed down first. A lower reading may be the noise of a standing rotor.
        """
        if self._expired or report.status is None:
            return True
        turns = abs(self.actual_rpm) >= max(self._settings.min_rpm, MOST_REST_RPM)
        if turns and not self._guarded.at_rest():
            return True
        with self._deciding:
            self._check_not_stopped()
            if self.mode is not Mode.NOTHING:
                self._begin(Mode.NOTHING)
        return False

    @override
    def _obeys(self) -> bool:
        """Return whether it reports neither fault nor timeout after a command has reached it.

        Firmware without a status byte only shows the absence of a fault.
        """
        report = self._report
        if report is None or not self._ordered_ns < self._report_ns or report.fault:
            return False
        return not (report.status or 0) & wire.OBSTACLES

    @override
    def _disobeys(self) -> str:
        report = self._recent()
        if self.mode is Mode.NOTHING and not self._expired and report is not None and self._is_driveable(report):
            return (
                "its timeout has not expired although it received no command: it is off or longer than "
                f"expected, or another input commands the motor. Expected {self._settings.timeout_s:g} s (timeout_s): "
                "without it the rotor goes on turning when the host is gone. Set it in the application settings"
            )
        why = self.why() or "; it reports no fault"
        return (
            f"expected it to obey, its state is {self.state}{why}. Look at the fault with the maker's software, "
            "at the kill switch, at the wire to the controller, and whether another input commands the motor"
        )

    @override
    def set_speed(self, rpm: float) -> None:
        least = self._settings.min_rpm
        if rpm and not abs(rpm) >= least:
            raise DeviceError(
                f"drive: {rpm:g} rpm wanted, it cannot hold less than {least:.0f} rpm (min_erpm "
                f"{self._settings.min_erpm:g} over {number_of(self._settings.pole_pairs, 'pole pair')}): nothing "
                f"was sent"
            )
        if not abs(rpm) * self._settings.pole_pairs < 2**31:
            raise DeviceError(f"drive: {rpm:g} rpm wanted, which its wire cannot carry")
        super().set_speed(rpm)

    @override
    def _send_release(self) -> Callable[[], bool]:
        """Send the command to release the rotor, and a poll.

        The controller does not report a release. Its line keeps the order, so the answer to a poll that was sent after
        the command shows that the command has arrived.
        """
        with self._sending:
            with self._deciding:
                due = self._answers + (2 if self._polled_ns is not None else 1)  # an earlier poll may be unanswered
                self._polled_ns = self._clock.now_ns()
            self._send(self._on_line(wire.release()) + self._on_line(wire.get_values()))
        return lambda: self._answers >= due

    def _speed_words(self) -> str:
        """Return the reported speed and what to do about it, if it is larger than that of a standing rotor."""
        rpm, most = self.actual_rpm, self._settings.rest_rpm
        if not abs(rpm) > most:  # also without a recent report
            return ""
        return (
            f" and reports {rpm:.1f} rpm, a standing rotor at most {most:g} rpm (rest_rpm). If it stands, the reading "
            "is noise: raise rest_rpm. If it turns without a command, another input commands the motor"
        )

    @override
    def measure_time_out(self) -> TimeOut:
        """Release once, and wait until the status byte shows the expired timeout."""
        report, s = self._recent(), self._settings
        if report is None or report.fault or self.mode is not Mode.NOTHING or not self._guarded.at_rest():
            raise DeviceError(
                f"the rotor must stand without a command and without a fault, it is in {self.state}"
                + self._speed_words()
            )
        if report.status is None:
            raise DeviceError("firmware before 5.3 does not report an expired timeout: measure it with a turning rotor")
        with self._sending:
            self._send(self._on_line(wire.release()))
            sent_ns, sent_s = self._clock.now_ns(), self._clock.now_s()
        obeyed = False

        def expired() -> bool:
            nonlocal obeyed
            with self._deciding:
                timed_out = bool((self._report.status or 0) & wire.TIMED_OUT) if self._report is not None else False
                obeyed |= self._is_late(self._report_ns, sent_ns) and not timed_out
            return obeyed and timed_out

        found = self._await_time_out(expired, sent_s, s.timeout_s, 1.0 / s.report_Hz + _STEP_S)
        if not obeyed:
            raise DeviceError("the command to release did not end its expired timeout: do commands reach it?")
        return found

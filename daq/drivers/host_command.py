"""The host's command of a device that turns the rotor: its life from the set-up to the confirmed stop.

A device defines its frames and its dialogue. Everything else is here: what a report is worth, permission, the way to
operation, a drop-out, the stop and its confirmation, repeated actions, and the measurement of the device's time-out.
"""

from __future__ import annotations

import math
import threading
from abc import abstractmethod
from collections.abc import Callable, Generator
from contextlib import closing
from typing import ClassVar

from typing_extensions import override

from daq.drivers.contract import RotorGuard, SpeedControl, TimeOut
from daq.drivers.motors import MotorSettings
from daq.drivers.ramp import REPEAT_S, wait_for_rest
from daq.errors import DeviceError
from daq.transports.host_clock import HostClock, Repeated

Steps = Generator[str, None, None]
"""Steps of a dialogue, which yield what they wait for, a clause for the operator."""
UNKNOWN = "UNKNOWN"
"""State of every device without a recent report."""
UNCONFIRMED = (
    "it does not answer: the release is not confirmed. Without its host it does what is set for its own time-out. Look "
    "at its power and its line before anyone touches the rotor"
)
_MAX_REPORT_AGE_S = 0.5  # s after which a report is too old
_LOOK_S = 0.005  # s between two looks at the reports
_CONFIRM_S = 4 * REPEAT_S  # s to wait for a confirmation, so that some lost frames do not matter
_MOST_TIME_OUTS = 4  # stated time-outs for which the measured one is awaited
_REPORT_DELAY_S = 0.05  # s, longest time of a report from the device to this process


class HostCommand(SpeedControl):
    """See SpeedControl. Subclasses bring the device's frames and dialogue.

    The lock `_deciding` protects the state. It is held only while the state is read or changed, never while sending.

    Args:
        settings: table of the device in the rig file.
        send: writes bytes to the device's link (and to the log).
        clock: clock for waits, repeated actions and the age of reports.
        guard: conditions for turning the rotor; without it only the device's own reports are used.

    Attributes:
        dropped_out, was_reset: see SpeedControl.
        enable_s: time that the device may need to be enabled, s.
    """

    enable_s: ClassVar[float] = 3.0

    def __init__(
        self, settings: MotorSettings, send: Callable[[bytes], None], clock: HostClock, guard: RotorGuard | None
    ) -> None:
        self._send, self._clock = send, clock
        self._guarded = guard or RotorGuard(
            permit=lambda rpm: None,
            at_rest=lambda: None if math.isnan(self.actual_rpm) else abs(self.actual_rpm) <= settings.rest_rpm,
            speed_rpm=lambda: abs(self.actual_rpm),
        )
        self._deciding = threading.Lock()
        self._repeated: dict[str, Repeated] = {}
        self._ramp_rpm_per_s = settings.ramp_rpm_per_s
        self._armed = False  # whether speeds may be commanded
        self._ordered = False  # whether the device may follow a command whose end is not confirmed
        self._stopped = False  # whether a stop was commanded since the newest `enable` began
        self._reported_rpm = math.nan
        self._report_ns = 0  # time of the newest report of the speed; 0 before the first
        self.dropped_out: str | None = None
        self.was_reset: str = ""

    # --- what a device defines ------------------------------------------------------------------------------------

    @abstractmethod
    def _enabling(self) -> Steps:
        """Bring the device to operation.

        Permission was given before each step. The steps are closed, with GeneratorExit, if it is refused, if the device
        is stopped, and after `enable_s`.
        """

    @abstractmethod
    def _set_ramp(self, rpm_per_s: float) -> None:
        """Set the rate of the ramp, rpm/s, which is positive and finite."""

    @abstractmethod
    def _switch_off(self) -> str:
        """Command the device to release the rotor; return why it is not confirmed that it did, empty if it is."""

    @abstractmethod
    def _finish(self) -> str:
        """Release the rotor, which stands, at the end of all commands; see `_switch_off`."""

    def _brake(self) -> None:
        """Decide to stop as fast as possible; sent by `beat`. The caller holds `_deciding`."""

    def beat(self) -> None:
        """Send everything that is due.

        Raises:
            LinkLost: the connection to the device is lost.
        """

    # --- reports --------------------------------------------------------------------------------------------------

    def _take_speed(self, rpm: float) -> None:
        """Take the speed of a new report, rpm."""
        self._reported_rpm, self._report_ns = rpm, self._clock.now_ns()

    def _is_recent(self, time_ns: int) -> bool:
        """Return whether a report of that time is recent enough to be used."""
        return bool(time_ns) and self._clock.now_ns() - time_ns <= _MAX_REPORT_AGE_S * 1e9

    @property
    @override
    def actual_rpm(self) -> float:
        return self._reported_rpm if self._is_recent(self._report_ns) else math.nan

    @property
    @override
    def enabled(self) -> bool:
        return self._armed and self._is_recent(self._report_ns)

    def _fall(self, state: str) -> None:
        """Take that the device left operation by itself; should it return, it must stop. The caller holds `_deciding`.

        The first state stands for what happened.
        """
        self.dropped_out = self.dropped_out or state
        self._armed = False
        self._brake()

    # --- commands -------------------------------------------------------------------------------------------------

    @override
    def set_ramp(self, rpm_per_s: float) -> None:
        if not 0 < rpm_per_s < math.inf:
            raise DeviceError(f"drive: expected a ramp above 0 rpm/s, got {rpm_per_s:g}")
        self._set_ramp(rpm_per_s)
        self._ramp_rpm_per_s = rpm_per_s

    @override
    def enable(self) -> None:
        with self._deciding:
            self._armed = self._stopped = False
            self.dropped_out, self.was_reset = None, ""
        self._carry_out(self._enabling(), self._check_permission, self.enable_s)
        with self._deciding:
            self._check_not_stopped()
            self._armed = True

    def _carry_out(self, steps: Steps, check: Callable[[], None], seconds: float) -> None:
        """Carry out the steps of a dialogue.

        Args:
            steps: the steps.
            check: called before each; it raises to end them.
            seconds: longest time, s.

        Raises:
            DeviceError: they are not done in time.
        """
        deadline = self._clock.now_s() + seconds
        with closing(steps):
            while True:
                check()
                awaited = next(steps, None)
                if awaited is None:
                    return
                if self._clock.now_s() > deadline:
                    raise DeviceError(f"drive: {awaited}")
                self._pass()

    def _pass(self) -> None:
        """Let a moment pass in a wait for reports."""
        self._clock.wait(_LOOK_S)

    def _check_permission(self) -> None:
        self._guarded.permit(None)
        self._check_not_stopped()

    def _check_not_stopped(self) -> None:
        if self._stopped:
            raise DeviceError("drive: a stop was commanded while it was being enabled")

    def _check_armed(self, rpm: float) -> None:
        if not self._armed:
            raise DeviceError(f"drive: {rpm:g} rpm wanted, it is not enabled ({self.state}{self.why()})")

    # --- stop -----------------------------------------------------------------------------------------------------

    @override
    def quick_stop(self) -> None:
        with self._deciding:
            self._armed, self._stopped = False, True
            self._brake()
        self.beat()

    @override
    def disable(self) -> None:
        with self._deciding:
            self._armed = False
        if trouble := self._switch_off():
            raise DeviceError(f"drive: commanded to release the rotor, {trouble}")

    @override
    def stop(self, notify: Callable[[str], None] = lambda text: None) -> bool:
        """Stop the rotor, then release it.

        It is released only at rest, because a rotor that runs down by itself passes its resonances slowly. Until rest
        is confirmed the device watches its host, and stops by itself when the commands end.

        Args:
            notify: called with a text about what is being waited for or could not be confirmed.

        Returns:
            Whether rest and release are confirmed.
        """
        try:
            if not (self._repeated or self._ordered):
                return True
            if not self._rest(notify):
                return False
            if trouble := self._finish():
                notify(f"the drive was commanded to release the rotor, {trouble}")
                return False
            self._ordered = False
            return True
        finally:
            self._end()

    def _rest(self, notify: Callable[[str], None]) -> bool:
        """Stop the rotor and wait until it stands; return whether it does."""
        return not self._may_turn() or wait_for_rest(self._clock, self._guarded, self.quick_stop, notify)

    def _may_turn(self) -> bool:
        """Return whether a stop must be commanded and awaited."""
        return self._ordered or bool(self._report_ns and not self._guarded.at_rest())

    def _confirm(self, command: Callable[[], Callable[[], bool]]) -> bool:
        """Repeat a command until it is confirmed; return whether it was.

        Args:
            command: sends the command, and returns a function that returns whether it was confirmed since.
        """
        deadline = self._clock.now_s() + _CONFIRM_S
        while self._clock.now_s() < deadline:
            confirmed, again = command(), self._clock.now_s() + REPEAT_S
            while self._clock.now_s() < again:
                if confirmed():
                    return True
                self._pass()
        return False

    # --- repeated actions -----------------------------------------------------------------------------------------

    def _repeat(self, seconds: float, do: Callable[[], object], name: str) -> None:
        """Repeat an action in the background, in place of an earlier one of that name, as for a line that was lost.

        A lost link is reported by its reader; a device that is not reached stops by its own time-out.
        """
        self._cease(name)
        self._repeated[name] = self._clock.every(seconds, do, name, lambda error: None)

    def _cease(self, name: str, seconds: float = 2.0) -> None:
        """End a repeated action, if there is one, and wait for its end for some s."""
        if (repeated := self._repeated.pop(name, None)) is not None:
            repeated.stop(seconds)

    def _end(self) -> None:
        """End all commands and repeated actions."""
        for name in list(self._repeated):
            self._cease(name)
        with self._deciding:
            self._armed, self._stopped = False, True

    # --- time-out -------------------------------------------------------------------------------------------------

    def _await_time_out(self, reported: Callable[[], bool], fed_s: float, stated_s: float, period_s: float) -> TimeOut:
        """Wait until the device reports that its host is missing.

        Args:
            reported: returns whether it does.
            fed_s: time of the last sign of life, s.
            stated_s: time-out that it states, s.
            period_s: period of its reports and of its watch, s.
        """
        looked_s, longest_s, heard = self._clock.now_s(), 0.0, False
        end_s = fed_s + _MOST_TIME_OUTS * stated_s + 1.0
        while not heard and looked_s < end_s:
            self._clock.wait(0.002)
            before_s, looked_s = looked_s, self._clock.now_s()
            heard, longest_s = reported(), max(longest_s, looked_s - before_s)
        resolution_s = period_s + _REPORT_DELAY_S + 2 * longest_s  # a busy host is late
        return TimeOut(looked_s - fed_s if heard else None, stated_s, resolution_s)

    def _is_late(self, time_ns: int, fed_ns: int) -> bool:
        """Return whether a report cannot have been sent before a command of that time, ns."""
        return time_ns - fed_ns > _REPORT_DELAY_S * 1e9

"""The host's command of a frequency converter: set-up, watchdog, ramps, speed and stop."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Sequence

from daq.drivers.contract import Pipeline, RotorGuard, TimeOut
from daq.drivers.run_down import wait_for_rest
from daq.errors import DeviceError
from daq.transports.host_clock import HostClock, Repeated
from rig_basics.ignoring import ignoring
from rig_drivers.modbus_converter import states, wire
from rig_drivers.modbus_converter.line import Order, RequestLine
from rig_drivers.modbus_converter.settings import ModbusConverter
from rig_drivers.modbus_converter.stream import ConverterPipeline, Report

_log = logging.getLogger(__name__)

_MAX_REPORT_AGE_S = 0.5  # s after which a report is too old
_ENABLE_S = 3.0  # s for the converter to run
_OFF_S = 1.0  # s for the converter to switch its output off at rest
_CONFIRM_S = 2.0  # s for the answers to some requests, with their repetitions
_MIN_BEAT_S, _BEAT_S = 0.002, 0.004  # s, period of the thread that sends requests
_SILENCES = (0.8, 1.25, 2.0, 4.0)  # silences after which the fault is looked for, in stated timeouts
_MAX_RAMP_DEVIATION = 0.05  # relative deviation of the converter's ramp from the requested one
_UNCONFIRMED = (
    "it does not answer: the stop is not confirmed. Its own communication timeout stops it, if it works. Look at its "
    "power and its line before anyone touches the rotor"
)
_DISOBEYS = (
    "its state is RUNNING: it answers, but does not obey. Look whether it is set to its keypad or its terminals "
    "instead of the serial line, and stop it there"
)
_REMEDY = "Look into its manual, mend the cause and reset it there"


class ConverterControl:
    """See SpeedSource.

    `RequestLine` sends everything, one request at a time; a thread calls its `beat`, and every wait here calls it too.

    Args:
        settings: table of the converter in the rig file.
        send: writes bytes to the converter's link (and to the log).
        clock: clock for timeouts and the age of reports.
        guard: conditions for turning the rotor; without it only the converter's own reports are used.

    Attributes:
        dropped_out: state that the converter entered by itself while it should have been running.
        was_reset: text for the operator about a fault that `enable` found and reset; empty without such a fault.
    """

    def __init__(
        self,
        settings: ModbusConverter,
        send: Callable[[bytes], None],
        clock: HostClock,
        guard: RotorGuard | None = None,
    ) -> None:
        self._settings, self._registers, self._clock = settings, settings.registers, clock
        self._guarded = guard or RotorGuard(
            permit=lambda rpm: None,
            at_rest=lambda: None if math.isnan(self.actual_rpm) else abs(self.actual_rpm) <= settings.rest_rpm,
            speed_rpm=lambda: abs(self.actual_rpm),
        )
        self._line = RequestLine(settings, send, clock)
        self._lock = threading.Lock()
        self._repeated: Repeated | None = None
        self._report: Report | None = None
        self._report_ns = self._reports = 0
        self._armed = self._ordered = False
        self._watch_set = False  # whether the converter may have a communication timeout from this host
        self._stops = 0  # number of stop commands: an `enable` that began before the last one fails
        self._ramp_rpm_per_s = settings.ramp_rpm_per_s
        self._watchdog = settings.watchdog_counts(settings.watchdog_s)
        self.dropped_out: str | None = None
        self.was_reset: str = ""

    # --- reports ----------------------------------------------------------------------------------------------

    def notice(self, pipeline: Pipeline) -> None:
        """See SpeedSource."""
        assert isinstance(pipeline, ConverterPipeline)
        for answer in pipeline.answers:
            self._line.heard(answer)
        for report in pipeline.reports:
            with self._lock:
                self._report, self._report_ns = report, self._clock.now_ns()
                self._reports += 1
                if self._armed and report.state != states.RUNNING:
                    self._armed, self.dropped_out = False, self.dropped_out or report.state
                    self._order_stop()  # it may run again by itself after a fault

    def _recent(self) -> Report | None:
        """Return the newest report unless it is too old."""
        recent = self._clock.now_ns() - self._report_ns <= _MAX_REPORT_AGE_S * 1e9
        return self._report if recent else None

    @property
    def actual_rpm(self) -> float:
        """See SpeedSource."""
        report = self._recent()
        return math.nan if report is None else report.rpm

    @property
    def state(self) -> str:
        """See SpeedSource."""
        report = self._recent()
        return states.UNKNOWN if report is None else report.state

    @property
    def enabled(self) -> bool:
        """See SpeedSource."""
        return self._armed and self.state == states.RUNNING

    def fault_code(self) -> int | None:
        """See SpeedSource. The converter is polled continuously, so the newest report is used."""
        report = self._recent()
        return None if report is None or not report.fault else report.fault

    def why(self) -> str:
        """See SpeedSource."""
        code = self.fault_code()
        return "" if code is None else f"; {states.fault_text(code)}"

    # --- requests ---------------------------------------------------------------------------------------------

    def _write(self, register: int, *values: int) -> wire.Request:
        return wire.Request(
            self._settings.address, self._registers.write_function, register, len(values), tuple(values)
        )

    def _set(self, register: int, value: int) -> wire.Request:
        """Return the request that sets a ramp or the watchdog, without a write to the converter's EEPROM."""
        return self._write(register + self._registers.write_offset, value)

    def _confirmed(self, requests: Sequence[wire.Request], check: Callable[[], None] = lambda: None) -> list[Order]:
        """Send requests and wait for their answers.

        Args:
            requests: the requests.
            check: called before they are queued, and while they wait; it raises to end the wait. It is called with the
                lock held, so that no command follows the stop that prevents it.

        Raises:
            DeviceError: the converter does not answer, or refuses one.
        """
        with self._lock:
            check()
            orders = self._line.put(requests)
        deadline = self._clock.wall_s() + _CONFIRM_S
        try:
            while waiting := [order for order in orders if order.answer is None]:
                with self._lock:
                    check()
                if self._clock.wall_s() > deadline:
                    raise DeviceError(f"drive: no answer to {waiting[0].request.words}. Look at its power and its line")
                self._line.beat()
                self._clock.wait(0.002)
        finally:
            self._line.drop(orders)
        for order in orders:
            assert order.answer is not None
            if order.answer.exception:
                raise DeviceError(f"drive: it refuses {order.request.words}: {order.answer.refusal}")
        return orders

    def _read(self, register: int) -> int:
        request = wire.Request(self._settings.address, self._registers.read_function, register, 1)
        (order,) = self._confirmed([request])
        assert order.answer is not None
        return order.answer.registers[0]

    # --- commands ---------------------------------------------------------------------------------------------

    def start(self) -> None:
        """See SpeedSource: set watchdog and ramps, and start polling; the motor receives no command yet.

        Raises:
            DeviceError: the converter does not answer, or refuses a setting.
        """
        if self._repeated is not None:  # from a line that was lost, or from an earlier start
            self._repeated.stop()
        period_s = max(_MIN_BEAT_S, _BEAT_S)
        # a lost link is reported by its reader; a converter without requests stops by its own timeout
        self._repeated = self._clock.every(period_s, self._line.beat, "requests", lambda error: None)
        self._line.polling = True
        r = self._registers
        if r.watchdog is not None:
            if self._watch_set:  # the pipeline derives from it whether the converter was switched off and on
                self._read(r.watchdog)
            self._watch_set = True
            self._confirmed([self._set(r.watchdog, self._watchdog)])
        if r.watchdog_action is not None:
            self._confirmed([self._set(r.watchdog_action, r.watchdog_action_value)])
        self.set_ramp(self._ramp_rpm_per_s)

    def pause(self) -> None:
        """See SendsByItself. A stop is sent all the same."""
        self._line.polling = False

    def set_ramp(self, rpm_per_s: float) -> None:
        """See SpeedSource.

        Raises:
            DeviceError: the rate is not possible with the resolution of the converter's ramp times, or it refuses it.
        """
        if not 0 < rpm_per_s < math.inf:
            raise DeviceError(f"drive: expected a ramp above 0 rpm/s, got {rpm_per_s:g}")
        s, r = self._settings, self._registers
        counts = s.ramp_counts(rpm_per_s)
        found = s.max_rpm / (counts * r.ramp_step_s)
        if abs(found - rpm_per_s) > _MAX_RAMP_DEVIATION * rpm_per_s or counts > 0xFFFF:
            raise DeviceError(
                f"drive: {rpm_per_s:g} rpm/s wanted; its ramp times are multiples of {r.ramp_step_s:g} s to "
                f"{s.max_rpm:.0f} rpm, the nearest ramp is {found:g} rpm/s"
            )
        self._ramp_rpm_per_s = rpm_per_s
        self._confirmed([self._set(r.acceleration, counts), self._set(r.deceleration, counts)])

    def enable(self) -> None:
        """Run with reference 0.

        A converter whose host was killed may have the fault of its communication timeout. This fault is reset once. Any
        other fault must be examined by the operator.

        Raises:
            DeviceError: the converter does not run, has a fault, or does not have the communication timeout.
            AcquisitionError: raised by `permit`.
        """
        r = self._registers
        self._guarded.permit(None)
        with self._lock:
            stops, self._armed, self.dropped_out, self.was_reset = self._stops, False, None, ""

        def check() -> None:
            if stops != self._stops:
                raise DeviceError("drive: a stop was commanded while it was being enabled")

        def permitted() -> None:
            self._guarded.permit(None)
            check()

        self._wait(lambda: self._recent() is not None, permitted, "it does not answer. Look at its power and its line")
        self._reset_if_only_watchdog(permitted)
        self._check_watchdog()
        self._wait(
            lambda: self.state == states.RUNNING or self._guarded.at_rest() is not False,
            permitted,
            "its output is off and the rotor turns. Wait until it stands",
        )
        self.set_ramp(self._ramp_rpm_per_s)
        self._guarded.permit(None)
        self._ordered = True
        try:
            commands = (*r.before_run, r.run)
            self._confirmed([self._write(r.reference, 0), *(self._write(r.control, word) for word in commands)], check)
            reports = self._reports + 1
            self._wait(
                lambda: self.state == states.RUNNING and self._reports > reports,
                permitted,
                "expected it to run. Look at its source of commands (the serial line), and at its terminals for enable",
            )
            with self._lock:
                check()
                self._armed = True
        except BaseException:
            self._order_stop()
            raise

    def _wait(self, ready: Callable[[], bool], check: Callable[[], None], words: str) -> None:
        """Wait until a condition holds.

        Raises:
            DeviceError: it does not hold in time.
        """
        deadline = self._clock.wall_s() + _ENABLE_S
        while not ready():
            check()
            self._line.beat()
            if self._clock.wall_s() > deadline:
                raise DeviceError(f"drive: {words} (its state is {self.state}{self.why()})")
            self._clock.wait(0.005)

    def _reset_if_only_watchdog(self, check: Callable[[], None]) -> None:
        if self.state != states.FAULT:
            return
        r, code = self._registers, self.fault_code()
        if code is None or code != r.watchdog_fault:
            raise DeviceError(f"drive: it has a fault{self.why() or '; its code is not readable'}. {_REMEDY}")
        self.was_reset = f"the drive had the fault of a missing host (code {code}); it was reset"
        self._confirmed(
            [self._write(r.control, r.stop), self._write(r.control, r.reset), self._write(r.control, r.stop)]
        )
        self._wait(lambda: self.state not in (states.FAULT, states.UNKNOWN), check, f"the fault stays. {_REMEDY}")

    def _check_watchdog(self) -> None:
        """Raise DeviceError unless the converter has the communication timeout, as far as it can be read."""
        r = self._registers
        if r.watchdog is None:
            return
        found = self._read(r.watchdog)
        if not 0 < found <= self._watchdog:
            raise DeviceError(
                f"drive: its communication timeout (register {r.watchdog}) is {found}, expected {self._watchdog}: it "
                "started again, or does not accept the timeout. A drive that does not stop when its host is gone must "
                "not turn the rotor. Look at its supply, then start again"
            )

    def measure_time_out(self) -> TimeOut:
        """See MeasuresTimeOut: stop polling for longer and longer, until the converter has the fault of its timeout."""
        r = self._registers
        if r.watchdog is None or r.watchdog_fault is None:
            raise DeviceError(
                "its register table has no communication timeout, or no code of its fault (watchdog_fault)"
            )
        if not self._guarded.at_rest() or self.state in (states.RUNNING, states.FAULT, states.UNKNOWN):
            raise DeviceError(f"the rotor must stand and the converter be off, it is in {self.state}{self.why()}")
        stated_s = self._read(r.watchdog) * r.watchdog_step_s
        longest_s = 0.0
        for share in _SILENCES:
            silent_s = self._stay_silent(share * stated_s)
            if self.state == states.FAULT:
                self._reset_if_only_watchdog(lambda: None)
                return TimeOut((longest_s + silent_s) / 2, stated_s, (silent_s - longest_s) / 2)
            longest_s = silent_s
        raise DeviceError(
            f"no fault within {longest_s:.1f} s without requests while its output is off: some converters watch only "
            "while they run. Pull the host's plug at a low speed and measure the time until it stops"
        )

    def _stay_silent(self, seconds: float) -> float:
        """Send no requests for some s, then read state and fault code; return how long it was."""
        self._line.polling = False
        try:
            self._wait(lambda: self._line.idle, lambda: None, "it does not answer. Look at its power and its line")
            begun_ns = self._line.sent_ns
            self._clock.wait(seconds)
            reports, end_ns = self._reports + 1, self._clock.now_ns()
        finally:
            self._line.polling = True
        self._wait(lambda: self._reports > reports, lambda: None, "it does not answer. Look at its power and its line")
        return (end_ns - begun_ns) * 1e-9

    def set_speed(self, rpm: float) -> None:
        """See SpeedSource.

        Raises:
            DeviceError: the converter cannot turn so fast or in this direction, is not enabled, or refuses the speed.
            AcquisitionError: raised by `permit`.
        """
        s, r = self._settings, self._registers
        if not abs(rpm) <= s.max_rpm:
            raise DeviceError(f"drive: {rpm:g} rpm wanted, its highest is {s.max_rpm:g} rpm (max_Hz): nothing was sent")
        word = r.run if rpm >= 0 or r.reference_signed else r.run_reverse
        if word is None:
            raise DeviceError(f"drive: {rpm:g} rpm wanted, it does not turn backwards: nothing was sent")
        self._guarded.permit(rpm)
        counts = round((rpm if r.reference_signed else abs(rpm)) / s.reference_rpm)
        if not (-0x8000 <= counts < 0x8000 if r.reference_signed else counts <= 0xFFFF):
            raise DeviceError(f"drive: {rpm:g} rpm wanted, which its register cannot carry: nothing was sent")

        def check() -> None:
            if not self._armed:
                raise DeviceError(f"drive: {rpm:g} rpm wanted, it is not enabled ({self.state}{self.why()})")

        self._confirmed([self._write(r.reference, counts & 0xFFFF), self._write(r.control, word)], check)

    def disable(self) -> None:
        """See SpeedSource.

        Raises:
            DeviceError: the converter does not answer, or goes on running.
        """
        with self._lock:
            self._armed = False
        if not self._off():
            raise DeviceError(f"drive: commanded to stop, {self._why_not_off()}")

    def _why_not_off(self) -> str:
        known = {states.UNKNOWN: _UNCONFIRMED, states.RUNNING: _DISOBEYS}
        return known.get(self.state, f"its state is {self.state}. {_REMEDY}")

    def _off(self) -> bool:
        """Send the stop until a later report shows that the output is off; return whether one did."""
        deadline, reports = self._clock.wall_s() + _OFF_S, self._reports + 1
        again = 0.0
        while self._clock.wall_s() < deadline:
            if self._reports > reports and self.state not in (states.RUNNING, states.UNKNOWN):
                return True
            if self._clock.wall_s() >= again:
                again = self._clock.wall_s() + 0.25
                self._line.put(
                    [
                        self._write(self._registers.control, self._registers.stop),
                        self._write(self._registers.reference, 0),
                    ],
                    urgent=True,
                )
            self._line.beat()
            self._clock.wait(0.005)
        return False

    def _order_stop(self) -> None:
        """Queue the fastest stop in place of every other command; it is sent at the next beat."""
        s, r = self._settings, self._registers
        stop = r.stop if r.quick_stop is None else r.quick_stop
        requests = [self._write(r.control, stop), self._write(r.reference, 0)]
        if r.quick_stop is None:
            steep = max(s.quick_rpm_per_s, self._ramp_rpm_per_s)
            requests.insert(1, self._set(r.deceleration, s.ramp_counts(steep)))
        self._line.put(requests, urgent=True)

    def quick_stop(self) -> None:
        """See SpeedSource."""
        with self._lock:
            self._armed = False
            self._stops += 1
            self._order_stop()
        self._line.beat()

    def stop(self, notify: Callable[[str], None] = lambda text: None) -> bool:
        """Stop the rotor, then switch the output off and end the communication timeout.

        Without confirmed rest the timeout stays on: the requests end, and it stops the converter again.

        Args:
            notify: called with a text about what is being waited for.

        Returns:
            Whether rest and the end of the output are confirmed.
        """
        confirmed = self._repeated is None and not self._ordered
        try:
            confirmed = confirmed or (self._rest(notify) and self._release(notify))
        finally:
            if self._repeated is not None:
                self._repeated.stop()
                self._repeated = None
            self._line.polling = self._armed = False
        return confirmed

    def _rest(self, notify: Callable[[str], None]) -> bool:
        """Command a quick stop and wait until the rotor stands; see `wait_for_rest`."""
        if not self._ordered and self.state != states.RUNNING and self._guarded.at_rest() is not False:
            return True  # no command was sent, and it is not known to turn
        self.quick_stop()
        rests = wait_for_rest(self._clock, self._guarded, self.quick_stop, notify)
        if not rests and self.state == states.RUNNING:
            notify(f"the drive was commanded to stop, {_DISOBEYS}")
        return rests

    def _release(self, notify: Callable[[str], None]) -> bool:
        """Switch the output off, if it was on, and end the watch."""
        if (self._ordered or self.state == states.RUNNING) and not self._off():
            notify(f"the drive was commanded to stop, {self._why_not_off()}")
            return False
        r = self._registers
        if self._watch_set and r.watchdog is not None and r.watchdog_off is not None:
            with ignoring(_log, "ending the converter's communication timeout", DeviceError):
                self._confirmed([self._set(r.watchdog, r.watchdog_off)])
                self._watch_set = False
        self._ordered = False
        return True

"""The host's command of a frequency converter: set-up, watchdog, ramps, speed and stop."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from typing_extensions import override

from daq.drivers.contract import Pipeline, RotorGuard, TimeOut
from daq.drivers.host_command import UNCONFIRMED, HostCommand, Steps
from daq.drivers.ramp import check_ramp
from daq.errors import DeviceError
from daq.transports.host_clock import HostClock
from rig_basics.ignoring import ignoring
from rig_drivers.modbus_converter import registers, wire
from rig_drivers.modbus_converter.line import QueuedRequest, RequestLine
from rig_drivers.modbus_converter.settings import ModbusConverter
from rig_drivers.modbus_converter.stream import ConverterPipeline, Report

_log = logging.getLogger(__name__)

_CONFIRM_S = 2.0  # s for the answers to some requests, with their repetitions
_BEAT_S = 0.004  # s, period of the thread that sends requests
_SILENCES = (0.8, 1.25, 2.0, 4.0)  # silences after which the fault is looked for, in stated timeouts
_DISOBEYS = (
    "its state is RUNNING: it answers, but does not obey. Look whether it is set to its keypad or its terminals "
    "instead of the serial line, and stop it there"
)
_SILENT = "it does not answer. Look at its power and its line"
_REMEDY = "Look into its manual, mend the cause and reset it there"


class ConverterControl(HostCommand):
    """See HostCommand.

    `RequestLine` sends everything, one request at a time; a thread calls its `beat`, and every wait here calls it too.
    """

    def __init__(
        self,
        settings: ModbusConverter,
        send: Callable[[bytes], None],
        clock: HostClock,
        guard: RotorGuard | None = None,
    ) -> None:
        super().__init__(settings, send, clock, guard)
        self._settings, self._registers = settings, settings.registers
        self._line = RequestLine(settings, send, clock)
        self._report: Report | None = None
        self._reports = 0
        self._watch_set = False  # whether the converter may have a communication timeout from this host
        self._watchdog = settings.watchdog_counts(settings.watchdog_s)

    # --- reports ----------------------------------------------------------------------------------------------

    @override
    def notice(self, pipeline: Pipeline) -> None:
        assert isinstance(pipeline, ConverterPipeline)
        for answer in pipeline.answers:
            self._line.heard(answer)
        for report in pipeline.reports:
            with self._deciding:
                self._take_speed(report.rpm)
                self._report = report
                self._reports += 1
                if self._armed and report.state != registers.RUNNING:
                    self._fall(report.state)

    def _recent(self) -> Report | None:
        """Return the newest report unless it is too old."""
        return self._report if self._is_recent(self._report_ns) else None

    @property
    @override
    def state(self) -> str:
        report = self._recent()
        return registers.UNKNOWN if report is None else report.state

    @property
    @override
    def enabled(self) -> bool:
        return self._armed and self.state == registers.RUNNING

    @override
    def fault_code(self) -> int | None:
        """Return the fault in the newest report: the converter is polled continuously."""
        report = self._recent()
        return None if report is None or not report.fault else report.fault

    @override
    def why(self) -> str:
        code = self.fault_code()
        return "" if code is None else f"; {registers.fault_text(code)}"

    # --- requests ---------------------------------------------------------------------------------------------

    def _write(self, register: int, *values: int) -> wire.Request:
        return wire.Request(
            self._settings.address, self._registers.write_function, register, len(values), tuple(values)
        )

    def _set(self, register: int, value: int) -> wire.Request:
        """Return the request that sets a ramp or the watchdog, without a write to the converter's EEPROM."""
        return self._write(register + self._registers.write_offset, value)

    def _confirmed(
        self, requests: Sequence[wire.Request], check: Callable[[], None] = lambda: None
    ) -> list[QueuedRequest]:
        """Send requests and wait for their answers.

        Args:
            requests: the requests.
            check: called before they are queued, and while they wait; it raises to end the wait. It is called with the
                lock held, so that no command follows the stop that prevents it.

        Raises:
            DeviceError: the converter does not answer, or refuses one.
        """
        with self._deciding:
            check()
            queued = self._line.put(requests)
        deadline = self._clock.now_s() + _CONFIRM_S
        try:
            while waiting := [one for one in queued if one.answer is None]:
                with self._deciding:
                    check()
                if self._clock.now_s() > deadline:
                    raise DeviceError(f"drive: no answer to {waiting[0].request.words}. Look at its power and its line")
                self._pass()
        finally:
            self._line.drop(queued)
        for one in queued:
            assert one.answer is not None
            if one.answer.exception:
                raise DeviceError(f"drive: it refuses {one.request.words}: {one.answer.refusal}")
        return queued

    def _read(self, register: int) -> int:
        request = wire.Request(self._settings.address, self._registers.read_function, register, 1)
        (one,) = self._confirmed([request])
        assert one.answer is not None
        return one.answer.registers[0]

    @override
    def beat(self) -> None:
        self._line.beat()

    @override
    def _pass(self) -> None:
        self.beat()
        super()._pass()

    # --- commands ---------------------------------------------------------------------------------------------

    @override
    def start(self) -> None:
        """Set watchdog and ramps, and start polling; the motor receives no command yet."""
        self._repeat(_BEAT_S, self.beat, "requests")
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

    @override
    def pause(self) -> None:
        """End the polling. A stop is sent all the same."""
        self._line.polling = False

    @override
    def _set_ramp(self, rpm_per_s: float) -> None:
        s, r = self._settings, self._registers
        counts = min(s.ramp_counts(rpm_per_s), 0xFFFF)
        why = f"its ramp times are multiples of {r.ramp_step_s:g} s to {s.max_rpm:.0f} rpm"
        check_ramp(rpm_per_s, s.max_rpm / (counts * r.ramp_step_s), why)
        self._confirmed([self._set(r.acceleration, counts), self._set(r.deceleration, counts)])

    @override
    def _enabling(self) -> Steps:
        """Run with reference 0.

        A converter whose host was killed may have the fault of its communication timeout. This fault is reset once. Any
        other fault must be examined by the operator.
        """
        r = self._registers
        while self._recent() is None:
            yield _SILENT
        yield from self._resetting()
        self._check_watchdog()
        while self.state != registers.RUNNING and self._guarded.at_rest() is False:
            yield self._but("its output is off and the rotor turns. Wait until it stands")
        self.set_ramp(self._ramp_rpm_per_s)
        self._check_permission()
        self._ordered = True
        try:
            words = (*r.before_run, r.run)
            requests = [self._write(r.reference, 0), *(self._write(r.control, word) for word in words)]
            self._confirmed(requests, self._check_not_stopped)
            reports = self._reports + 1
            while self.state != registers.RUNNING or self._reports <= reports:
                yield self._but(
                    "expected it to run. Look at its source of commands (the serial line), and at its terminals for "
                    "enable"
                )
        except BaseException:
            with self._deciding:
                self._brake()
            raise

    def _but(self, words: str) -> str:
        return f"{words} (its state is {self.state}{self.why()})"

    def _resetting(self) -> Steps:
        """Reset the fault of a missing host.

        Raises:
            DeviceError: it has another fault.
        """
        if self.state != registers.FAULT:
            return
        r, code = self._registers, self.fault_code()
        if code is None or code != r.watchdog_fault:
            raise DeviceError(f"drive: it has a fault{self.why() or '; its code is not readable'}. {_REMEDY}")
        self.was_reset: str = f"the drive had the fault of a missing host (code {code}); it was reset"
        self._confirmed([self._write(r.control, word) for word in (r.stop, r.reset, r.stop)])
        while self.state in (registers.FAULT, registers.UNKNOWN):
            yield self._but(f"the fault stays. {_REMEDY}")

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

    @override
    def measure_time_out(self) -> TimeOut:
        """Stop polling for longer and longer, until the converter has the fault of its timeout."""
        r = self._registers
        if r.watchdog is None or r.watchdog_fault is None:
            raise DeviceError(
                "its register table has no communication timeout, or no code of its fault (watchdog_fault)"
            )
        if not self._guarded.at_rest() or self.state in (registers.RUNNING, registers.FAULT, registers.UNKNOWN):
            raise DeviceError(f"the rotor must stand and the converter be off, it is in {self.state}{self.why()}")
        stated_s = self._read(r.watchdog) * r.watchdog_step_s
        longest_s = 0.0
        for share in _SILENCES:
            silent_s = self._stay_silent(share * stated_s)
            if self.state == registers.FAULT:
                self._carry_out(self._resetting(), lambda: None, self.enable_s)
                return TimeOut((longest_s + silent_s) / 2, stated_s, (silent_s - longest_s) / 2)
            longest_s = silent_s
        raise DeviceError(
            f"no fault within {longest_s:.1f} s without requests while its output is off: some converters watch only "
            "while they run. Pull the host's plug at a low speed and measure the time until it stops"
        )

    def _stay_silent(self, seconds: float) -> float:
        """Send no requests for some s, then read state and fault code; return how long it was."""
        self.pause()
        try:
            self._wait_until(lambda: self._line.idle)
            begun_ns = self._line.sent_ns
            self._clock.wait(seconds)
            reports, end_ns = self._reports + 1, self._clock.now_ns()
        finally:
            self._line.polling = True
        self._wait_until(lambda: self._reports > reports)
        return (end_ns - begun_ns) * 1e-9

    def _wait_until(self, ready: Callable[[], bool]) -> None:
        def steps() -> Steps:
            while not ready():
                yield _SILENT

        self._carry_out(steps(), lambda: None, self.enable_s)

    @override
    def set_speed(self, rpm: float) -> None:
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
        requests = [self._write(r.reference, counts & 0xFFFF), self._write(r.control, word)]
        self._confirmed(requests, lambda: self._check_armed(rpm))

    # --- stop -------------------------------------------------------------------------------------------------

    @override
    def _brake(self) -> None:
        """Queue the fastest stop in place of every other command."""
        s, r = self._settings, self._registers
        stop = r.stop if r.quick_stop is None else r.quick_stop
        requests = [self._write(r.control, stop), self._write(r.reference, 0)]
        if r.quick_stop is None:
            steep = max(s.quick_rpm_per_s, self._ramp_rpm_per_s)
            requests.insert(1, self._set(r.deceleration, s.ramp_counts(steep)))
        self._line.put(requests, urgent=True)

    @override
    def _switch_off(self) -> str:
        reports, r = self._reports + 1, self._registers

        def is_off() -> bool:
            return self._reports > reports and self.state not in (registers.RUNNING, registers.UNKNOWN)

        def command() -> Callable[[], bool]:
            self._line.put([self._write(r.control, r.stop), self._write(r.reference, 0)], urgent=True)
            return is_off

        if self._confirm(command):
            return ""
        known = {registers.UNKNOWN: UNCONFIRMED, registers.RUNNING: _DISOBEYS}
        return known.get(self.state, f"its state is {self.state}. {_REMEDY}")

    @override
    def _rest(self, notify: Callable[[str], None]) -> bool:
        rests = super()._rest(notify)
        if not rests and self.state == registers.RUNNING:
            notify(f"the drive was commanded to stop, {_DISOBEYS}")
        return rests

    @override
    def _may_turn(self) -> bool:
        return self._ordered or self.state == registers.RUNNING or self._guarded.at_rest() is False

    @override
    def _finish(self) -> str:
        """Switch the output off, if it was on, and end the communication timeout."""
        if (self._ordered or self.state == registers.RUNNING) and (trouble := self._switch_off()):
            return trouble
        r = self._registers
        if self._watch_set and r.watchdog is not None and r.watchdog_off is not None:
            with ignoring(_log, "ending the converter's communication timeout", DeviceError):
                self._confirmed([self._set(r.watchdog, r.watchdog_off)])
                self._watch_set = False
        return ""

    @override
    def _end(self) -> None:
        super()._end()
        self._line.polling = False

"""The host's command of an ODrive: enabling, set-points, stop, and the proof that its watchdog works.

The controller has no ramp that a command of the bus could set. The host therefore makes it; see `RepeatedCommand`. Each
command also feeds the controller's watchdog.
"""

from __future__ import annotations

from collections.abc import Callable

from typing_extensions import override

from daq.drivers.contract import Pipeline, RotorGuard, TimeOut
from daq.drivers.host_command import UNKNOWN
from daq.drivers.repeated_command import RESTARTED, Mode, RepeatedCommand
from daq.errors import DeviceError
from daq.transports.can_frames import CanFrame, encode
from daq.transports.host_clock import HostClock
from rig_basics.texts import number_of
from rig_drivers.odrive import stream, wire
from rig_drivers.odrive.settings import Odrive
from rig_drivers.odrive.stream import OdrivePipeline

_REQUEST_S = 0.3  # s between two requests of closed-loop control: a second one interrupts it for a moment
_BRAKE_S = 1.0  # s of braking without effect after which the torque is removed
_MOST_MISSING = 10  # heartbeats in a row, counted in estimates, after which a driven axis is stopped
_BRAKES = 0.9  # share of the first speed above which a rotor counts as not braked


class OdriveControl(RepeatedCommand):
    """See RepeatedCommand."""

    def __init__(
        self, settings: Odrive, send: Callable[[bytes], None], clock: HostClock, guard: RotorGuard | None = None
    ) -> None:
        super().__init__(settings, send, clock, guard)
        self._settings = settings
        self._beat: wire.Heartbeat | None = None
        self._beat_ns = 0  # time of the newest heartbeat
        self._estimates = 0  # estimates since then
        self._expired = False  # whether the watchdog has expired since the controller started
        self._requested_ns = 0  # time of the newest request of closed-loop control
        self._brake_rpm = 0.0  # speed at which braking began
        self._ask_errors = False
        self._errors: dict[str, int] = {}

    # --- reports ----------------------------------------------------------------------------------------------

    @override
    def notice(self, pipeline: Pipeline) -> None:
        assert isinstance(pipeline, OdrivePipeline)
        with self._deciding:
            self._errors = pipeline.errors
            if pipeline.speeds_rpm:
                self._take_speed(pipeline.speeds_rpm[-1])
            if pipeline.restarted:
                self._expired = False  # its set-up may be another one
                if self._armed:
                    self._fall(RESTARTED)
            for beat in pipeline.beats:
                self._take(beat)
            # counted, not timed: a host that was asleep receives heartbeats and estimates together
            self._estimates = 0 if pipeline.beats else self._estimates + len(pipeline.speeds_rpm)
            missing = self._estimates * self._settings.estimates_ms // self._settings.heartbeat_ms
            if self._armed and missing >= _MOST_MISSING:
                self._fall(f"{UNKNOWN} (no heartbeat for {number_of(self._estimates, 'estimate')})")

    def _take(self, beat: wire.Heartbeat) -> None:
        before, self._beat, self._beat_ns = self._beat, beat, self._clock.now_ns()
        watchdog = wire.WATCHDOG[self._settings.firmware]
        self._expired |= bool(beat.error & watchdog)
        if beat.error & ~watchdog and (before is None or before.error != beat.error):
            self._ask_errors = True
        if beat.error and beat.error not in self.faults and (self._armed or beat.error != watchdog):
            self.faults.append(beat.error)
        if self._armed and (beat.error or beat.state != wire.CLOSED_LOOP):
            self._fall(stream.state(beat, self._settings.firmware))

    def _recent(self) -> wire.Heartbeat | None:
        """Return the newest heartbeat unless it is too old."""
        return self._beat if self._is_recent(self._beat_ns) else None

    @property
    @override
    def state(self) -> str:
        beat = self._recent()
        return UNKNOWN if beat is None else stream.state(beat, self._settings.firmware)

    @property
    @override
    def enabled(self) -> bool:
        """Whether speeds are commanded, and heartbeat and speed are reported."""
        return super().enabled and self._recent() is not None

    @override
    def fault_code(self) -> int | None:
        beat = self._recent()
        idle = beat is None or (beat.error == wire.WATCHDOG[self._settings.firmware] and not self.faults)
        return None if idle or not self._beat or not self._beat.error else self._beat.error

    @override
    def why(self) -> str:
        """Return the errors of the axis, and the codes behind them if they were answered."""
        more = "".join(f"; {name} 0x{code:X}" for name, code in self._errors.items() if code) if self.faults else ""
        return super().why() + more

    @override
    def _words(self, code: int) -> str:
        return wire.error_words(self._settings.firmware, code)

    # --- commands ----------------------------------------------------------------------------------------------

    @override
    def _question(self, now_ns: int) -> bytes:
        """Request the error codes once after each new error."""
        if not self._ask_errors:
            return b""
        self._ask_errors = False
        return encode(*wire.error_requests(self._settings.node_id, self._settings.firmware))

    @override
    def _speed_command(self, rpm: float) -> bytes:
        node = self._settings.node_id
        if self.mode is Mode.FREE:
            return encode(wire.set_state(node, wire.IDLE))
        velocity = wire.set_velocity(node, self._settings.turns_per_s(rpm))
        if self.mode is Mode.BRAKE:
            frames = [velocity, wire.set_velocity_mode(node)]  # another host may have used another mode
            return encode(*frames, *([wire.estop(node)] if self._brakes_in_vain() else []))
        return encode(velocity) if self._armed else encode(velocity, *self._closed_loop())

    def _closed_loop(self) -> list[CanFrame]:
        """Return the frames that request closed-loop control, unless it is reported or was just requested."""
        now_ns, beat, node = self._clock.now_ns(), self._beat, self._settings.node_id
        reached = beat is not None and beat.state == wire.CLOSED_LOOP and not beat.error
        if reached or now_ns - self._requested_ns < _REQUEST_S * 1e9:
            return []
        self._requested_ns = now_ns
        cleared = [wire.clear_errors(node)] if beat is not None and beat.error else []
        return [*cleared, wire.set_velocity_mode(node), wire.set_state(node, wire.CLOSED_LOOP)]

    def _brakes_in_vain(self) -> bool:
        """Return whether the rotor has not become slower: then it is better without torque."""
        now_ns = self._clock.now_ns()
        if now_ns - self._ordered_ns < _BRAKE_S * 1e9 or not self._is_recent(self._report_ns):
            return False
        return abs(self._reported_rpm) > max(_BRAKES * self._brake_rpm, self._settings.rest_rpm)

    @override
    def _begin(self, mode: Mode) -> None:
        super()._begin(mode)
        self._requested_ns, self._brake_rpm = 0, abs(self._reported_rpm)

    @override
    def _is_ready(self) -> bool:
        """Return whether it has no error except an expired watchdog, which is cleared, and its watchdog was seen."""
        beat = self._recent()
        other = beat is None or beat.error & ~wire.WATCHDOG[self._settings.firmware]
        return not other and (self._expired or not self._settings.needs_proof)

    @override
    def _obeys(self) -> bool:
        beat = self._beat
        reached = beat is not None and beat.state == wire.CLOSED_LOOP and not beat.error
        return reached and self._ordered_ns < min(self._beat_ns, self._report_ns)

    @override
    def _disobeys(self) -> str:
        beat = self._recent()
        if beat is None:
            return "it sends no heartbeat. Set its period (heartbeat_ms), look at its power and at the bus"
        if beat.error & ~wire.WATCHDOG[self._settings.firmware]:
            return f"it has a fault: {self._words(beat.error)}{self.why()}. Mend the cause and clear the error"
        if not self._expired and self._settings.needs_proof:
            return (
                "its watchdog has not expired although it received no command: it is off, or longer than "
                "expected. A controller that does not stop when its host is gone must not turn the rotor. Set "
                f"enable_watchdog and watchdog_timeout = {self._settings.watchdog_s:g}, save and restart it"
            )
        return (
            f"expected closed-loop control, its state is {self.state}{self.why()}. Are motor and encoder "
            "calibrated? Look at its errors with the maker's software"
        )

    @override
    def measure_time_out(self) -> TimeOut:
        """Clear the watchdog's error, which also feeds it, and wait for the error to return."""
        beat, watchdog, s = self._recent(), wire.WATCHDOG[self._settings.firmware], self._settings
        if not s.needs_proof:
            raise DeviceError(
                f"not verified for an idle axis of firmware {s.firmware} (proves_watchdog = true if it is)"
            )
        if beat is None or beat.state != wire.IDLE or beat.error & ~watchdog or not self._guarded.at_rest():
            raise DeviceError(f"the rotor must stand and the axis be idle without a fault, it is in {self.state}")
        with self._sending:
            self._send(encode(wire.clear_errors(s.node_id)))
            fed_ns, fed_s = self._clock.now_ns(), self._clock.now_s()

        def expired() -> bool:  # an earlier heartbeat may have been sent before the error was cleared
            late = self._is_late(self._beat_ns, fed_ns)
            return late and self._beat is not None and bool(self._beat.error & watchdog)

        return self._await_time_out(expired, fed_s, s.watchdog_s, s.heartbeat_ms * 1e-3)

    @override
    def _send_release(self) -> Callable[[], bool]:
        """Send the command to release the rotor; a later heartbeat in the state IDLE confirms it."""
        with self._sending:
            sent_ns = self._clock.now_ns()
            self._send(encode(wire.set_state(self._settings.node_id, wire.IDLE)))

        def confirmed() -> bool:
            beat = self._beat
            return beat is not None and self._beat_ns > sent_ns and beat.state == wire.IDLE

        return confirmed

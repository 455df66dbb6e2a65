"""The host's command of a CiA 402 drive: set-up, states, speed and stop, and the host's heartbeat."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable

from daq.drivers.can_lines import FirstContact
from daq.drivers.canopen import cia301
from daq.drivers.canopen.node import NMT_PRE_OPERATIONAL, NMT_START
from daq.drivers.canopen.objects import NodeObjects
from daq.drivers.cia402 import demands, faults, statements, wire as cia402
from daq.drivers.cia402.faults import REMEDY
from daq.drivers.cia402.process_data import map_process_data
from daq.drivers.cia402.profile import profile_of
from daq.drivers.cia402.ramps import set_ramps
from daq.drivers.cia402.settings import MotorDrive
from daq.drivers.cia402.stream import DrivePipeline
from daq.drivers.contract import Pipeline, RotorGuard, TimeOut
from daq.drivers.run_down import wait_for_rest
from daq.errors import DeviceError, LinkLost
from daq.transports.can_frames import CLOSE_BUS, CanFrame, open_bus
from daq.transports.host_clock import HostClock, Repeated
from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)

_ENABLE_S = 10.0  # s to reach operation: a drive may charge its link and look for its motor's position
_REQUEST_S = 0.04  # s between requests to a drive that may report changes only
_RESET_S = 0.05  # s for which each controlword is held while a fault is reset
_MAX_BEAT_AGE_S = 0.3  # s by which a heartbeat may be late on a busy host
_OFF_S, _OFF_REPEAT_S = 0.5, 0.1  # s to wait for the end of the torque, and between two commands
_MOST_TIME_OUTS = 4  # stated time-outs for which the measured one is awaited
_REPORT_DELAY_S = 0.03  # s, from the drive's time-out to its emergency in the host
_MAX_WATCH_RATIO = 2  # of the drive's heartbeat timeout to the requested one; a drive may round it
_TORQUE = (cia402.OPERATION_ENABLED, cia402.QUICK_STOP_ACTIVE, cia402.FAULT_REACTION)
_MAX_EMERGENCIES = 30  # emergencies that are kept for a message
_UNCONFIRMED = (
    "it does not answer: the end of the torque is not confirmed. It still watches the host's heartbeat. Look at its "
    "power and its line before anyone touches the rotor"
)
_QUICK_STOP_S = 0.3  # s within which a drive must follow a quick stop
_MAX_REPORT_AGE_S = 0.5  # s after which a report of the drive is too old


class DriveControl:
    """See SpeedSource: set-up, speed and stop of the drive. It also sends the host's heartbeat.

    Args:
        config: table of the drive in the rig file.
        send: writes bytes to the drive's link (and to the log).
        clock: clock for timeouts and the age of reports.
        guard: conditions for turning the rotor; without it only the drive's own reports are used.

    Attributes:
        dropped_out: state that the drive entered by itself while it should have been running; None if it did not.
        was_reset: text for the operator about a fault that `enable` found and reset; empty without such a fault.
        emergencies: error codes since the set-up, without those that were reset.
    """

    def __init__(
        self,
        config: MotorDrive,
        send: Callable[[bytes], None],
        clock: HostClock,
        guard: RotorGuard | None = None,
    ) -> None:
        self._config, self._send, self._clock = config, send, clock
        self._guarded = guard or RotorGuard(
            permit=lambda rpm: None,
            at_rest=lambda: None if math.isnan(self.actual_rpm) else abs(self.actual_rpm) <= config.rest_rpm,
            speed_rpm=lambda: abs(self.actual_rpm),
        )
        self._report, self._profile = cia301.cob_tpdo(1, config.node_id), profile_of(config)
        self._objects = NodeObjects("drive", config.node_id, send, clock)
        self._beat: Repeated | None = None
        self._requests: Repeated | None = None  # of reports, if the drive may send changes only
        self._bus_open = self._watched = self._ordered = False
        self._run_word = cia402.ENABLE_OPERATION | (cia402.RAMP_BITS if config.ramp_bits else 0)
        self._statusword: int | None = None
        self._reported_rpm = 0.0
        self._reported_ns = 0
        self.dropped_out: str | None = None
        self.was_reset: str = ""
        self.emergencies: list[int] = []
        self._armed = False
        self._network_state: cia301.Heartbeat | None = None
        self._awaits_report = False  # whether the network operation was started and no report has arrived since
        self._fault_without_host: bool | None = None  # whether a missing heartbeat led to FAULT; None: not measured
        self._beats, self._beats_unwatched = 0, 0  # heartbeats sent, and those before the drive's watch was set
        self._beat_s = -math.inf  # time of the last one, s
        self._started_again, self._contact = False, FirstContact()
        self._stopping_s: float | None = None  # time of the first of the present stop commands, s
        self._beat_ended = False  # whether the heartbeat was ended to make the drive stop by itself
        self._watch_ms = min(65535, round(config.heartbeat_timeout_ms))
        self._found: tuple[int, float] | None = None  # statusword and speed, rpm, when it was opened, from its objects

    def notice(self, pipeline: Pipeline) -> None:
        """See SpeedSource."""
        assert isinstance(pipeline, DrivePipeline)
        self.take_frames(pipeline.frames)

    def take_frames(self, frames: list[CanFrame]) -> None:
        """Take frames from the drive."""
        node, report = self._config.node_id, self._report
        for frame in cia301.own_frames(frames):
            identifier, data = frame.arbitration_id, frame.data
            if identifier == report and len(data) >= self._profile.size:  # the most frequent case
                if self._started_again:  # the mapping may be the manufacturer's again, without a speed
                    continue
                self._contact.heard()
                self._statusword, self._reported_rpm = self._profile.unpack(data)
                self._reported_ns, self._awaits_report = self._clock.now_ns(), False
                if self._armed and self.state != cia402.OPERATION_ENABLED and self.dropped_out is None:
                    self.dropped_out = self.state
            elif identifier == cia301.cob_sdo_answer(node) and len(data) == 8:
                self._contact.heard()
                self._objects.take_answer(data)
            elif identifier == cia301.cob_emergency(node) and len(data) == 8:
                code = cia301.unpack_emergency(data).error_code
                self.emergencies = [*self.emergencies[-_MAX_EMERGENCIES:], code] if code else []
            elif identifier == cia301.cob_heartbeat(node) and (state := cia301.heartbeat(data)) is not None:
                self._network_state = state
                if state != cia301.Heartbeat.BOOT_UP:
                    self._contact.heard()
                elif not self._contact.pending:
                    self._statusword, self._started_again = None, True

    @property
    def actual_rpm(self) -> float:
        """Speed as the drive reports it, rpm; NaN if the newest report is too old."""
        recent = self._clock.now_ns() - self._reported_ns <= _MAX_REPORT_AGE_S * 1e9
        return self._reported_rpm if recent and self._statusword is not None else math.nan

    @property
    def state(self) -> str:
        """CiA 402 state in the drive's newest report."""
        return cia402.UNKNOWN if self._statusword is None else cia402.state(self._statusword)

    @property
    def enabled(self) -> bool:
        """See SpeedSource."""
        return self.state == cia402.OPERATION_ENABLED

    def start(self) -> None:
        """Open the bus, set up the drive, start the heartbeat and the network operation.

        Raises:
            DeviceError: the drive does not answer or refuses a setting.
        """
        c = self._config
        self._started_again, self._stopping_s, self._found, self.emergencies = False, None, None, []
        self._awaits_report = False
        self._end_requests()
        self._bus_open = True
        self._contact.sent(opening := open_bus(c.bitrate))
        self._send(opening)
        self._start_heartbeat()  # before the watch is set: a drive may require the heartbeat immediately
        demands.set_heartbeat(self._objects, c.heartbeat_ms)
        word, rpm = self._objects.read(cia402.STATUSWORD, 0), self._objects.read(self._profile.actual, 0)
        self._found = None if word is None or rpm is None else (word & 0xFFFF, self._profile.rpm(rpm))
        demands.set_mode(self._objects, self._profile)
        self._watched = True
        demands.set_watch(self._objects, c.host_node_id, self._watch_ms)
        self._beats_unwatched = self._beats
        self.set_ramp(c.ramp_rpm_per_s)
        on_request = map_process_data(self._objects, c.node_id, self._profile, in_torque=self._found_in_torque)
        self._network_state, self._awaits_report = None, True
        self._objects.send(0, bytes([NMT_START, c.node_id]))
        if on_request:
            self._requests = self._clock.every(_REQUEST_S, self._request_report, "requests", lambda error: None)

    def _request_report(self) -> None:
        """Request a report by a remote frame if the newest one is old: the drive may send changes only."""
        if self._clock.now_ns() - self._reported_ns > _REQUEST_S * 1e9:
            with ignoring(_log, "requesting a report", DeviceError, LinkLost):  # the link's reader reports the loss
                self._objects.request(self._report, self._profile.size)

    def set_ramp(self, rpm_per_s: float) -> None:
        """Set the ramp for speeding up and slowing down, rpm/s.

        Raises:
            DeviceError: the time of the drive's ramp is fixed and does not allow a ramp near this one.
        """
        set_ramps(self._objects, rpm_per_s, self._config.ramp_units)

    def enable(self) -> None:
        """Bring the drive to OPERATION ENABLED with target speed 0.

        A drive whose host was killed may be in FAULT because of the missing heartbeat. This fault is reset once. Any
        other fault, also one that occurs in between, must be examined by the operator.

        Raises:
            DeviceError: the drive does not reach the state, has another fault, or does not watch the host's heartbeat.
            AcquisitionError: raised by `permit`.
        """
        deadline = self._clock.wall_s() + _ENABLE_S
        self._armed, self.dropped_out, was_reset, watched = False, None, False, False
        self._stopping_s = None
        while not watched or self._recent_state != cia402.OPERATION_ENABLED:
            self._guarded.permit(None)
            state = self._recent_state
            if state == cia402.FAULT and not was_reset:
                self._reset_if_only_heartbeat(deadline)
                was_reset = True
            elif state == cia402.FAULT:
                raise DeviceError(f"drive: it entered FAULT again{self.why()}. {REMEDY}")
            elif not watched:
                self._check_watch()
                watched = True
                if state == cia402.OPERATION_ENABLED:  # found in operation: override an earlier target speed
                    self._pdo(self._run_word, 0)
            elif state == cia402.QUICK_STOP_ACTIVE and not self._guarded.at_rest():
                pass  # the drive brakes: without torque the rotor would run down through its resonances
            elif (word := cia402.towards_operation(state)) is not None:
                self._pdo(self._run_word if word == cia402.ENABLE_OPERATION else word, 0)
            if self._clock.wall_s() > deadline:
                raise DeviceError(
                    f"drive: expected OPERATION ENABLED, it stays in {self.state}{self.why()}. "
                    "Look at its display for a fault, at its supply, and at its inputs for safe torque off and enable"
                )
            self._clock.wait(0.005)
        self._armed = True

    def _check_watch(self) -> None:
        """Raise DeviceError unless the drive watches the host's heartbeat and the heartbeat is sent.

        A drive that has restarted does not watch it. The watch begins with the first heartbeat after its set-up
        (CiA 301).
        """
        if self._started_again:
            raise DeviceError(
                "drive: it started again since it was set up, so it does not watch the host any more. Look at its "
                "supply, then start again"
            )
        if self._beat is None or self._beat_ended:
            self._start_heartbeat()
        watched = self._objects.read(cia301.CONSUMER_HEARTBEAT, 1)
        right = watched is not None and watched >> 16 & 0xFF == self._config.host_node_id
        if watched is None or not right or not 0 < watched & 0xFFFF <= _MAX_WATCH_RATIO * self._watch_ms:
            found = "cannot be read" if watched is None else f"is 0x{watched:08X}"
            raise DeviceError(
                f"drive: it does not watch the heartbeat of node {self._config.host_node_id} for {self._watch_ms} ms: "
                f"1016h sub 1 {found}. A drive that does not stop when its host is gone must not turn the rotor"
            )
        end = self._clock.wall_s() + 3e-3 * self._config.heartbeat_ms + _MAX_BEAT_AGE_S
        while self._beats <= self._beats_unwatched and self._clock.wall_s() < end:
            self._clock.wait(0.005)
        self._check_heartbeat()

    def _check_heartbeat(self) -> None:
        """Raise DeviceError if the host's heartbeat is not sent: the drive ignores it, or will stop by itself."""
        patience_s = max(_MAX_BEAT_AGE_S, 1e-3 * self._config.heartbeat_timeout_ms)
        if self._beats <= self._beats_unwatched or self._clock.wall_s() - self._beat_s > patience_s:
            raise DeviceError("drive: the host's heartbeat does not go out. Look at adapter, bus and cable")

    def fault_code(self) -> int | None:
        """Return the cause of FAULT as the drive reports it; None if it reports none."""
        return faults.fault_code(self._objects)

    def _reset_if_only_heartbeat(self, deadline_s: float) -> None:
        faults.check_only_heartbeat(self._objects, lambda: self.emergencies)
        self.was_reset = "the drive stood in FAULT because a host's heartbeat had stayed away (0x8130); it was reset"
        while self.state == cia402.FAULT and self._clock.wall_s() < deadline_s:
            self._pdo(cia402.DISABLE_VOLTAGE, 0)  # the rising edge of the bit resets; one may be refused
            self._clock.wait(_RESET_S)  # a drive reads the word in its own cycles
            self._pdo(cia402.FAULT_RESET, 0)
            self._clock.wait(_RESET_S)
            if self.state == cia402.FAULT:
                faults.check_only_heartbeat(self._objects, lambda: self.emergencies, reset=True)

    def set_speed(self, rpm: float) -> None:
        """Ramp to a speed, rpm; in velocity mode it is sent as a whole number.

        Raises:
            DeviceError: the host's heartbeat is not sent.
            AcquisitionError: raised by `permit`.
        """
        self._guarded.permit(rpm)
        if rpm:
            self._check_heartbeat()
            self._stopping_s = None
        self._pdo(self._run_word, rpm)
        demands.confirm_target(self._objects, self._profile, rpm, self._order_again)

    def _order_again(self, rpm: float) -> bool:
        """Send a target speed again, and return True; send nothing and return False if a stop has been commanded."""
        if self._armed:
            self._pdo(self._run_word, rpm)
        return self._armed

    def disable(self) -> None:
        """Remove the torque; the rotor must be at rest.

        Raises:
            DeviceError: the drive stays in operation, or does not confirm the end of the torque.
        """
        self._armed = False
        if not self._leave_operation(cia402.SHUTDOWN):
            raise DeviceError(f"drive: commanded to remove the torque, it stays in {self.state}. {REMEDY}")
        if self._recent_state == cia402.UNKNOWN and not self._off_by_its_objects:
            raise DeviceError(f"drive: commanded to remove the torque, {_UNCONFIRMED}")

    def _leave_operation(self, word: int) -> bool:
        """Send a controlword until the drive does not report torque; return whether it stopped reporting torque.

        The host does not wait for a drive without recent reports.
        """
        deadline = self._clock.wall_s() + _OFF_S
        while True:
            self._pdo(word, 0)
            again = self._clock.wall_s() + _OFF_REPEAT_S
            while self._in_torque and self._clock.wall_s() < again:
                self._clock.wait(0.005)
            if not self._in_torque:
                return True
            if self._clock.wall_s() > deadline:
                return False

    @property
    def _recent_state(self) -> str:
        """State of the drive; `UNKNOWN` if its newest report is too old."""
        return cia402.UNKNOWN if math.isnan(self.actual_rpm) else self.state

    @property
    def _found_in_torque(self) -> bool:
        """Whether the drive turned or held the rotor when it was opened."""
        return self._found is not None and cia402.state(self._found[0]) in _TORQUE

    @property
    def _found_turning(self) -> bool:
        return self._found is not None and (self._found_in_torque or abs(self._found[1]) > self._config.rest_rpm)

    @property
    def _off_by_its_objects(self) -> bool:
        """Whether the drive reports by 6041h that it has no torque."""
        try:
            word = self._objects.read(cia402.STATUSWORD, 0)
        except DeviceError as error:
            _log.info("statusword of the drive not read, so its torque is not confirmed as removed: %s", error)
            return False
        return word is not None and cia402.state(word & 0xFFFF) not in _TORQUE

    @property
    def _in_torque(self) -> bool:
        """Whether the drive's recent report shows that it turns or holds the rotor."""
        return self._recent_state in _TORQUE

    def quick_stop(self) -> None:
        """Stop the rotor as fast as the drive can, in any network state.

        A drive that does not follow its process data, or sends no reports, is commanded through its objects and put
        into network operation. If it follows neither, the host's heartbeat is ended, so that the drive's watch stops
        it.
        """
        self._armed = False
        now_s = self._clock.wall_s()
        self._stopping_s = now_s if self._stopping_s is None else self._stopping_s
        self._pdo(cia402.QUICK_STOP, 0)
        in_network = self._network_state in (None, cia301.Heartbeat.OPERATIONAL)
        late_s = now_s - self._stopping_s
        if in_network and (late_s <= _QUICK_STOP_S or self._follows_stop):
            return
        order = cia402.write_word(cia402.CONTROLWORD, cia402.QUICK_STOP)
        self._objects.send(cia301.cob_sdo_request(self._config.node_id), order)  # without waiting for an answer
        self._objects.send(0, bytes([NMT_START, self._config.node_id]))
        self._pdo(cia402.QUICK_STOP, 0)
        if late_s > (2 if in_network else 1) * _QUICK_STOP_S and self._beat is not None:
            self._beat.stop(0.0)
            self._beat_ended = True

    @property
    def _follows_stop(self) -> bool:
        """Whether the drive has left operation, or its newest report is from within `_QUICK_STOP_S` of the command."""
        if self._recent_state == cia402.UNKNOWN:
            return False
        reported_s = self._clock.wall_s() - (self._clock.now_ns() - self._reported_ns) * 1e-9
        return self.state != cia402.OPERATION_ENABLED or reported_s - (self._stopping_s or 0.0) <= _QUICK_STOP_S

    def why(self) -> str:
        """Return the present emergencies for a message, with code and meaning; empty without one."""
        return faults.emergency_text(self.emergencies)

    def _pdo(self, control: int, rpm: float) -> None:
        self._ordered = True
        self._objects.send(cia301.cob_rpdo(1, self._config.node_id), self._profile.pack(control, rpm))

    def measure_time_out(self) -> TimeOut:
        """See MeasuresTimeOut: withhold the heartbeat until the drive's emergency 0x8130, or its fault, arrives."""
        if not self._guarded.at_rest() or self._recent_state in (*_TORQUE, cia402.UNKNOWN):
            raise DeviceError(f"the rotor must stand and the drive be off, it is in {self._recent_state}")
        stated_ms = (self._objects.read(cia301.CONSUMER_HEARTBEAT, 1) or 0) & 0xFFFF
        assert self._beat is not None
        self.emergencies = [code for code in self.emergencies if code != cia301.HEARTBEAT_ERROR]
        self._beat.stop()
        try:
            return self._time_out(stated_ms)
        finally:
            self._start_heartbeat()
            self._objects.send(0, bytes([NMT_START, self._config.node_id]))  # a drive without its host may leave it
            begun_ns, end_s = self._clock.now_ns(), self._clock.wall_s() + _MAX_REPORT_AGE_S
            while self._reported_ns <= begun_ns and self._clock.wall_s() < end_s:
                self._clock.wait(0.005)
            self._fault_without_host = self._recent_state == cia402.FAULT
            if self._fault_without_host:
                self._reset_if_only_heartbeat(self._clock.wall_s() + 3.0)

    def _time_out(self, stated_ms: int) -> TimeOut:
        """Wait for the report of the missing heartbeat, which has just been ended."""
        end_s = self._beat_s + _MOST_TIME_OUTS * stated_ms * 1e-3 + 1.0
        looked_s, longest_s, heard = self._clock.wall_s(), 0.0, False
        while not heard and looked_s < end_s:
            self._clock.wait(0.002)
            before_s, looked_s = looked_s, self._clock.wall_s()
            heard, longest_s = cia301.HEARTBEAT_ERROR in self.emergencies, max(longest_s, looked_s - before_s)
        silent_s = looked_s - self._beat_s
        resolution_s = _REPORT_DELAY_S + 2 * longest_s  # a busy host is late
        return TimeOut(silent_s if heard else None, stated_ms * 1e-3, resolution_s)

    def ignores_missing_host(self) -> bool:
        """Return whether the drive goes on turning without its host: it states no reaction, and no FAULT followed."""
        return self._fault_without_host is False and statements.reaction(self._objects) == statements.NO_REACTION

    def units_per_rpm(self) -> tuple[float, float] | None:
        """Return the units of speed for 1 rpm of the rig file and of the drive; None in rpm, or if it states none."""
        stated = None if self._config.mode == "velocity" else statements.units_per_rpm(self._objects)
        return None if stated is None else (self._profile.units_per_rpm, stated)

    def _start_heartbeat(self) -> None:
        identifier, operational = cia301.cob_heartbeat(self._config.host_node_id), bytes([cia301.Heartbeat.OPERATIONAL])

        def beat() -> None:
            try:
                self._objects.send(identifier, operational)
            except (DeviceError, LinkLost):  # usual: the link's reader reports the loss
                return  # the next beat may use a new link
            self._beats, self._beat_s = self._beats + 1, self._clock.wall_s()
            if self._awaits_report and self._network_state == cia301.Heartbeat.PRE_OPERATIONAL:
                with ignoring(_log, "starting the network operation again", DeviceError, LinkLost):
                    self._objects.send(0, bytes([NMT_START, self._config.node_id]))  # the first one was lost

        beat()
        if self._beat is not None:  # from a line that was lost
            self._beat.stop()
        self._beat_ended = False
        self._beat = self._clock.every(self._config.heartbeat_ms * 1e-3, beat, "heartbeat", lambda error: None)

    def stop(self, notify: Callable[[str], None] = lambda text: None) -> bool:
        """Stop the rotor, then release the drive.

        Torque is removed only at rest, because a rotor that runs down by itself passes its resonances slowly. The
        drive's watch of the host's heartbeat is also ended only at rest. Until rest is confirmed the watch remains, and
        the drive stops the rotor by itself when the heartbeat ends, even if this process is killed.

        Args:
            notify: called with a text about what is being waited for or could not be confirmed.

        Returns:
            Whether it is confirmed that the rotor stands and the drive is off.
        """
        rest, confirmed = self._beat is None, True
        try:
            rest = rest or self._rest(notify)
            if rest and self._watched:
                disarmed = self._disarm(notify)
                rest, confirmed = disarmed is not False, disarmed is True
        finally:
            self._release(rest)
        return rest and confirmed

    def _disarm(self, notify: Callable[[str], None]) -> bool | None:
        """Remove the torque, then the watch. A drive that keeps its torque keeps its watch, and stops by itself.

        Returns:
            Whether torque and watch are removed; None if the end of the torque is not confirmed.
        """
        confirmed = False
        with ignoring(_log, "removing the torque through 6040h", DeviceError):  # also out of network operation
            self._objects.write(cia402.CONTROLWORD, 0, cia402.DISABLE_VOLTAGE, 2)
            confirmed = True
        if not self._leave_operation(cia402.DISABLE_VOLTAGE):
            notify(f"the drive was commanded to remove the torque and stays in {self.state}. {REMEDY}")
            return False
        if self._recent_state == cia402.UNKNOWN and not confirmed and not self._off_by_its_objects:
            notify(f"the drive was commanded to remove the torque, {_UNCONFIRMED}")
            return None  # the watch remains
        # the watch of a drive that is off has no effect
        with ignoring(_log, "ending the drive's watch of the heartbeat", DeviceError):
            self._objects.write(cia301.CONSUMER_HEARTBEAT, 1, 0, 4)
        self._watched = False
        return True

    def _release(self, rest: bool) -> None:
        """End the heartbeat, at rest also torque and network operation of the drive, and close the adapter's bus."""
        self._end_requests()
        if self._beat is not None:
            self._beat.stop()
            self._beat = None
            if rest and (self._ordered or self._watched or self._found is not None):
                self._pdo(cia402.DISABLE_VOLTAGE, 0)
                self._objects.send(0, bytes([NMT_PRE_OPERATIONAL, self._config.node_id]))
        if self._bus_open:
            self._bus_open = False
            self._send(CLOSE_BUS)

    def _end_requests(self) -> None:
        if self._requests is not None:
            self._requests.stop()
            self._requests = None

    def _rest(self, notify: Callable[[str], None]) -> bool:
        """Command a quick stop and wait until the rotor stands; see `wait_for_rest`."""
        if not self._reported_ns and not self._ordered and not self._found_turning:  # the drive was not commanded
            if self._guarded.at_rest() is not False:
                return True
        elif self._guarded.at_rest() and self.state != cia402.OPERATION_ENABLED:
            return True
        if self.state == cia402.OPERATION_ENABLED:  # also at rest: it may have a target speed
            with ignoring(_log, "commanding a quick stop", LinkLost):  # the command is repeated
                self.quick_stop()
        return wait_for_rest(self._clock, self._guarded, self.quick_stop, notify)

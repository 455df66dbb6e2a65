"""The host's command of a CiA 402 drive: set-up, states, speed and stop, and the host's heartbeat."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from typing import ClassVar

from typing_extensions import override

from daq.drivers.can_lines import FirstContact
from daq.drivers.canopen import cia301
from daq.drivers.canopen.node import NMT_PRE_OPERATIONAL, NMT_START
from daq.drivers.canopen.objects import NodeObjects
from daq.drivers.cia402 import demands, faults, wire as cia402
from daq.drivers.cia402.demands import set_ramps
from daq.drivers.cia402.faults import REMEDY
from daq.drivers.cia402.process_data import map_process_data
from daq.drivers.cia402.settings import MotorDrive
from daq.drivers.cia402.stream import DrivePipeline
from daq.drivers.cia402.wire import profile_of
from daq.drivers.contract import Pipeline, RotorGuard, TimeOut
from daq.drivers.host_command import UNCONFIRMED, HostCommand, Steps
from daq.errors import DeviceError, LinkLost
from daq.transports.can_frames import CLOSE_BUS, CanFrame, open_bus
from daq.transports.host_clock import HostClock
from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)

_REQUEST_S = 0.04  # s between requests to a drive that may report changes only
_RESET_S = 0.05  # s for which each controlword is held while a fault is reset
_RESET_WITHIN_S = 3.0  # s to reset a fault
_MAX_BEAT_AGE_S = 0.3  # s by which a heartbeat may be late on a busy host
_MAX_WATCH_RATIO = 2  # of the drive's heartbeat timeout to the requested one; a drive may round it
_TORQUE = (cia402.OPERATION_ENABLED, cia402.QUICK_STOP_ACTIVE, cia402.FAULT_REACTION)
_MAX_EMERGENCIES = 30  # emergencies that are kept for a message
_QUICK_STOP_S = 0.3  # s within which a drive must follow a quick stop
_NEXT_REPORT_S = 0.5  # s to wait for a report after the heartbeat has returned
_HEARTBEAT, _REQUESTS = "heartbeat", "requests"  # repeated actions; reports are requested if it sends changes only


class DriveControl(HostCommand):
    """See HostCommand: set-up, speed and stop of the drive. It also sends the host's heartbeat.

    Attributes:
        emergencies: error codes since the set-up, without those that were reset.
    """

    enable_s: ClassVar[float] = 10.0  # a drive may charge its link and look for its motor's position

    def __init__(
        self,
        config: MotorDrive,
        send: Callable[[bytes], None],
        clock: HostClock,
        guard: RotorGuard | None = None,
    ) -> None:
        super().__init__(config, send, clock, guard)
        self._config = config
        self._report, self._profile = cia301.cob_tpdo(1, config.node_id), profile_of(config)
        self._objects = NodeObjects("drive", config.node_id, send, clock)
        self._bus_open = self._watched = False
        self._run_word = cia402.ENABLE_OPERATION | (cia402.RAMP_BITS if config.ramp_bits else 0)
        self._statusword: int | None = None
        self.emergencies: list[int] = []
        self._network_state: cia301.Heartbeat | None = None
        self._awaits_report = False  # whether the network operation was started and no report has arrived since
        self._fault_without_host: bool | None = None  # whether a missing heartbeat led to FAULT; None: not measured
        self._beats, self._beats_unwatched = 0, 0  # heartbeats sent, and those before the drive's watch was set
        self._beat_s = -math.inf  # time of the last one, s
        self._started_again, self._contact = False, FirstContact()
        self._stopping_s: float | None = None  # time of the first of the present stop commands, s
        self._watch_ms = min(65535, round(config.heartbeat_timeout_ms))
        self._found: tuple[int, float] | None = None  # statusword and speed, rpm, when it was opened, from its objects

    @override
    def notice(self, pipeline: Pipeline) -> None:
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
                self._awaits_report = False
                with self._deciding:
                    self._statusword, rpm = self._profile.unpack(data)
                    self._take_speed(rpm)
                    if self._armed and self.state != cia402.OPERATION_ENABLED:
                        self._fall(self.state)
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
                    self._statusword, self._reported_rpm, self._started_again = None, math.nan, True

    @property
    @override
    def state(self) -> str:
        """CiA 402 state in the drive's newest report."""
        return cia402.UNKNOWN if self._statusword is None else cia402.state(self._statusword)

    @property
    @override
    def enabled(self) -> bool:
        return self.state == cia402.OPERATION_ENABLED

    @override
    def start(self) -> None:
        """Open the bus, set up the drive, start the heartbeat and the network operation."""
        c = self._config
        self._started_again, self._stopping_s, self._found, self.emergencies = False, None, None, []
        self._awaits_report = False
        self._cease(_REQUESTS)
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
            self._repeat(_REQUEST_S, self._request_report, _REQUESTS)

    def _request_report(self) -> None:
        """Request a report by a remote frame if the newest one is old: the drive may send changes only."""
        if self._clock.now_ns() - self._report_ns > _REQUEST_S * 1e9:
            with ignoring(_log, "requesting a report", DeviceError, LinkLost):  # the link's reader reports the loss
                self._objects.request(self._report, self._profile.size)

    @override
    def _set_ramp(self, rpm_per_s: float) -> None:
        set_ramps(self._objects, rpm_per_s, self._config.ramp_units)

    @override
    def _enabling(self) -> Steps:
        """Bring the drive to OPERATION ENABLED with target speed 0.

        A drive whose host was killed may be in FAULT because of the missing heartbeat. This fault is reset once. Any
        other fault, also one that occurs in between, must be examined by the operator.
        """
        was_reset = watched = False
        self._stopping_s = None
        while not watched or self._recent_state != cia402.OPERATION_ENABLED:
            state = self._recent_state
            if state == cia402.FAULT and not was_reset:
                self._reset_if_only_heartbeat()
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
            yield (
                f"expected OPERATION ENABLED, it stays in {self.state}{self.why()}. Look at its display for a fault, "
                "at its supply, and at its inputs for safe torque off and enable"
            )

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
        if _HEARTBEAT not in self._repeated:
            self._start_heartbeat()
        watched = self._objects.read(cia301.CONSUMER_HEARTBEAT, 1)
        right = watched is not None and watched >> 16 & 0xFF == self._config.host_node_id
        if watched is None or not right or not 0 < watched & 0xFFFF <= _MAX_WATCH_RATIO * self._watch_ms:
            found = "cannot be read" if watched is None else f"is 0x{watched:08X}"
            raise DeviceError(
                f"drive: it does not watch the heartbeat of node {self._config.host_node_id} for {self._watch_ms} ms: "
                f"1016h sub 1 {found}. A drive that does not stop when its host is gone must not turn the rotor"
            )
        end = self._clock.now_s() + 3e-3 * self._config.heartbeat_ms + _MAX_BEAT_AGE_S
        while self._beats <= self._beats_unwatched and self._clock.now_s() < end:
            self._clock.wait(0.005)
        self._check_heartbeat()

    def _check_heartbeat(self) -> None:
        """Raise DeviceError if the host's heartbeat is not sent: the drive ignores it, or will stop by itself."""
        patience_s = max(_MAX_BEAT_AGE_S, 1e-3 * self._config.heartbeat_timeout_ms)
        if self._beats <= self._beats_unwatched or self._clock.now_s() - self._beat_s > patience_s:
            raise DeviceError("drive: the host's heartbeat does not go out. Look at adapter, bus and cable")

    @override
    def fault_code(self) -> int | None:
        """Return the cause of FAULT as the drive reports it; None if it reports none."""
        return faults.fault_code(self._objects)

    def _reset_if_only_heartbeat(self) -> None:
        faults.check_only_heartbeat(self._objects, lambda: self.emergencies)
        self.was_reset = "the drive stood in FAULT because a host's heartbeat had stayed away (0x8130); it was reset"
        deadline = self._clock.now_s() + _RESET_WITHIN_S
        while self.state == cia402.FAULT and self._clock.now_s() < deadline:
            self._pdo(cia402.DISABLE_VOLTAGE, 0)  # the rising edge of the bit resets; one may be refused
            self._clock.wait(_RESET_S)  # a drive reads the word in its own cycles
            self._pdo(cia402.FAULT_RESET, 0)
            self._clock.wait(_RESET_S)
            if self.state == cia402.FAULT:
                faults.check_only_heartbeat(self._objects, lambda: self.emergencies, reset=True)

    @override
    def set_speed(self, rpm: float) -> None:
        """Ramp to a speed, rpm; in velocity mode it is sent as a whole number."""
        self._guarded.permit(rpm)
        self._check_armed(rpm)
        if rpm:
            self._check_heartbeat()
            self._stopping_s = None
        self._pdo(self._run_word, rpm)
        demands.confirm_target(self._objects, self._profile, rpm, self._command_again)

    def _command_again(self, rpm: float) -> bool:
        """Send a target speed again, and return True; send nothing and return False if a stop has been commanded."""
        if self._armed:
            self._pdo(self._run_word, rpm)
        return self._armed

    # --- stop -----------------------------------------------------------------------------------------------------

    @override
    def _switch_off(self) -> str:
        return self._remove_torque(cia402.SHUTDOWN)

    def _remove_torque(self, word: int, *, confirmed: bool = False) -> str:
        """Send a controlword until the drive does not report torque; see `_switch_off`.

        The host does not wait for a drive without recent reports. The drive's objects then show whether it is off.

        Args:
            word: the controlword.
            confirmed: whether the drive has accepted the command through its objects.
        """

        def command() -> Callable[[], bool]:
            self._pdo(word, 0)
            return lambda: not self._in_torque

        if not self._confirm(command):
            return f"it stays in {self.state}. {REMEDY}"
        off = confirmed or self._recent_state != cia402.UNKNOWN or self._off_by_its_objects
        return "" if off else UNCONFIRMED

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

    @override
    def quick_stop(self) -> None:
        """Stop the rotor as fast as the drive can, in any network state.

        A drive that does not follow its process data, or sends no reports, is commanded through its objects and put
        into network operation. If it follows neither, the host's heartbeat is ended, so that the drive's watch stops
        it.
        """
        super().quick_stop()
        now_s = self._clock.now_s()
        self._stopping_s = now_s if self._stopping_s is None else self._stopping_s
        self._pdo(cia402.QUICK_STOP, 0)
        in_network = self._network_state in (None, cia301.Heartbeat.OPERATIONAL)
        late_s = now_s - self._stopping_s
        if in_network and (late_s <= _QUICK_STOP_S or self._follows_stop):
            return
        command = cia402.write_word(cia402.CONTROLWORD, cia402.QUICK_STOP)
        self._objects.send(cia301.cob_sdo_request(self._config.node_id), command)  # without waiting for an answer
        self._objects.send(0, bytes([NMT_START, self._config.node_id]))
        self._pdo(cia402.QUICK_STOP, 0)
        if late_s > (2 if in_network else 1) * _QUICK_STOP_S:
            self._cease(_HEARTBEAT, 0.0)

    @property
    def _follows_stop(self) -> bool:
        """Whether the drive has left operation, or its newest report is from within `_QUICK_STOP_S` of the command."""
        if self._recent_state == cia402.UNKNOWN:
            return False
        reported_s = self._clock.now_s() - (self._clock.now_ns() - self._report_ns) * 1e-9
        return self.state != cia402.OPERATION_ENABLED or reported_s - (self._stopping_s or 0.0) <= _QUICK_STOP_S

    @override
    def why(self) -> str:
        """Return the present emergencies for a message, with code and meaning; empty without one."""
        return faults.emergency_text(self.emergencies)

    def _pdo(self, control: int, rpm: float) -> None:
        self._ordered = True
        self._objects.send(cia301.cob_rpdo(1, self._config.node_id), self._profile.pack(control, rpm))

    @override
    def measure_time_out(self) -> TimeOut:
        """Withhold the heartbeat until the drive's emergency 0x8130, or its fault, arrives."""
        if not self._guarded.at_rest() or self._recent_state in (*_TORQUE, cia402.UNKNOWN):
            raise DeviceError(f"the rotor must stand and the drive be off, it is in {self._recent_state}")
        stated_ms = (self._objects.read(cia301.CONSUMER_HEARTBEAT, 1) or 0) & 0xFFFF
        self.emergencies = [code for code in self.emergencies if code != cia301.HEARTBEAT_ERROR]
        self._cease(_HEARTBEAT)
        try:
            return self._await_time_out(
                lambda: cia301.HEARTBEAT_ERROR in self.emergencies, self._beat_s, stated_ms * 1e-3, 0.0
            )
        finally:
            self._start_heartbeat()
            self._objects.send(0, bytes([NMT_START, self._config.node_id]))  # a drive without its host may leave it
            begun_ns, end_s = self._clock.now_ns(), self._clock.now_s() + _NEXT_REPORT_S
            while self._report_ns <= begun_ns and self._clock.now_s() < end_s:
                self._pass()
            self._fault_without_host = self._recent_state == cia402.FAULT
            if self._fault_without_host:
                self._reset_if_only_heartbeat()

    def ignores_missing_host(self) -> bool:
        """Return whether the drive goes on turning without its host: it states no reaction, and no FAULT followed."""
        return self._fault_without_host is False and faults.reaction(self._objects) == faults.NO_REACTION

    def units_per_rpm(self) -> tuple[float, float] | None:
        """Return the units of speed for 1 rpm of the rig file and of the drive; None in rpm, or if it states none."""
        stated = None if self._config.mode == "velocity" else faults.units_per_rpm(self._objects)
        return None if stated is None else (self._profile.units_per_rpm, stated)

    def _start_heartbeat(self) -> None:
        identifier, operational = cia301.cob_heartbeat(self._config.host_node_id), bytes([cia301.Heartbeat.OPERATIONAL])

        def beat() -> None:
            try:
                self._objects.send(identifier, operational)
            except (DeviceError, LinkLost):  # usual: the link's reader reports the loss
                return  # the next beat may use a new link
            self._beats, self._beat_s = self._beats + 1, self._clock.now_s()
            if self._awaits_report and self._network_state == cia301.Heartbeat.PRE_OPERATIONAL:
                with ignoring(_log, "starting the network operation again", DeviceError, LinkLost):
                    self._objects.send(0, bytes([NMT_START, self._config.node_id]))  # the first one was lost

        beat()
        self._repeat(self._config.heartbeat_ms * 1e-3, beat, _HEARTBEAT)

    @override
    def _may_turn(self) -> bool:
        if not self._report_ns and not self._ordered and not self._found_turning:  # the drive was not commanded
            return self._guarded.at_rest() is False
        return not self._guarded.at_rest() or self.state == cia402.OPERATION_ENABLED  # it may have a target speed

    @override
    def _finish(self) -> str:
        """Remove the torque, then the watch, and end heartbeat and network operation.

        A drive that keeps its torque keeps its watch, and stops by itself when the heartbeat ends.
        """
        trouble = self._disarm() if self._watched else ""
        if trouble and self._in_torque:
            return trouble
        signs_off = self._ordered or self._found is not None
        super()._end()
        if signs_off:
            self._pdo(cia402.DISABLE_VOLTAGE, 0)
            self._objects.send(0, bytes([NMT_PRE_OPERATIONAL, self._config.node_id]))
        return trouble

    def _disarm(self) -> str:
        """Remove the torque, then the watch; see `_switch_off`."""
        confirmed = False
        with ignoring(_log, "removing the torque through 6040h", DeviceError):  # also out of network operation
            self._objects.write(cia402.CONTROLWORD, 0, cia402.DISABLE_VOLTAGE, 2)
            confirmed = True
        if trouble := self._remove_torque(cia402.DISABLE_VOLTAGE, confirmed=confirmed):
            return trouble
        # the watch of a drive that is off has no effect
        with ignoring(_log, "ending the drive's watch of the heartbeat", DeviceError):
            self._objects.write(cia301.CONSUMER_HEARTBEAT, 1, 0, 4)
        self._watched = False
        return ""

    @override
    def _end(self) -> None:
        super()._end()
        if self._bus_open:
            self._bus_open = False
            self._send(CLOSE_BUS)

"""The host's side of the motor drive: its set-up, its states, its speed and its stop, and the host's heartbeat."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable

from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.canopen_node import NMT_PRE_OPERATIONAL, NMT_START
from daq.drivers.cia402.objects import NodeObjects
from daq.drivers.cia402.process_data import map_process_data
from daq.drivers.cia402.settings import Drive
from daq.drivers.cia402.stream import DrivePipeline
from daq.drivers.contract import Pipeline, RotorGuard
from daq.drivers.run_down import wait_for_rest
from daq.errors import DeviceError, LinkLost
from daq.transports import slcan
from daq.transports.host_clock import HostClock, Repeated

_RAMP_S = 10
_RAMP_SHARE = 0.05  # by which a ramp may differ from what is wanted
_RESET_S = 0.05  # wall seconds that a controlword stands while a fault is reset
_ALIVE_S = 0.3  # wall seconds that a heartbeat may be late on a busy host
_LEAVE_S, _LEAVE_AGAIN_S = 0.5, 0.1  # wall seconds to wait for a drive without torque, and until it is told again
_WATCH_MORE = 2  # times the time of its watch, as a drive may round it
_OTHER_FAULTS = 0x6E  # bits of 1001h: current, voltage, temperature, profile, reserved; not generic, line, maker's
_TORQUE = (cia402.OPERATION_ENABLED, cia402.QUICK_STOP_ACTIVE, cia402.FAULT_REACTION)
_EMERGENCIES = 30  # that are kept for a message
_LOOK = "Look into its manual, mend the cause and reset it there"
_UNCONFIRMED = (
    "it does not answer: nobody can tell whether it has. It still watches our heartbeat. Look at its power and its "
    "line before anyone touches the rotor"
)
_HEED_S = 0.3  # wall seconds that a drive has to heed a quick stop
_WORD_S = 0.5  # wall seconds after which the drive's word is too old


class DriveControl:
    """Commands the drive: set-up, speed, quick stop; keeps the host's heartbeat going.

    Args:
        config: the drive's table of the rig file.
        send: writes bytes to the drive's link (and to the log).
        clock: for time-outs, and for the age of the drive's word.
        guard: what is asked before the rotor is turned; without it the drive's own word counts.

    Attributes:
        dropped_out: state it fell into by itself while it should have been running.
        emergencies: error codes it has sent since it was set up, without those it has reset.
    """

    def __init__(
        self,
        config: Drive,
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
        self._report = cia402.cob_tpdo(1, config.node_id)
        self._objects = NodeObjects(config.node_id, send, clock)
        self._beat: Repeated | None = None
        self._bus_open = self._watched = self._ordered = False
        self._run_word = cia402.ENABLE_OPERATION | (cia402.RAMP_BITS if config.ramp_bits else 0)
        self._statusword: int | None = None
        self._word_rpm = 0.0
        self._word_ns = 0
        self.dropped_out: str | None = None
        self.was_reset = ""  # what enable found and reset, for whoever runs the rig
        self.emergencies: list[int] = []
        self._armed = False
        self._network_state: cia402.Heartbeat | None = None
        self._beats, self._beats_unwatched = 0, 0  # that went out, and those of them before the drive was told to watch
        self._beat_s = -math.inf  # when the last one went out, wall s
        self._started_again = False
        self._stopping_s: float | None = None  # since when the drive is told to stop, wall s
        self._beat_ended = False  # so that the drive stops by itself
        self._watch_ms = min(65535, round(clock.patience(config.heartbeat_timeout_ms)))
        self._found: tuple[int, int] | None = None  # statusword and rpm when it was opened, by its objects

    def notice(self, pipeline: Pipeline) -> None:
        """See SpeedSource."""
        assert isinstance(pipeline, DrivePipeline)
        self.heed(pipeline.frames)

    def heed(self, frames: list[slcan.CanFrame]) -> None:
        """Frames from the drive."""
        node, report = self._config.node_id, self._report
        for frame in cia402.own_frames(frames):
            identifier, data = frame.arbitration_id, frame.data
            if identifier == report and len(data) >= cia402.TPDO1_BYTES:  # nearly all of them
                if self._started_again:  # its mapping may be its maker's again: what looks like a speed may be none
                    continue
                self._statusword, rpm = cia402.unpack_tpdo1(data)
                self._word_rpm, self._word_ns = float(rpm), self._clock.now_ns()
                if self._armed and self.state != cia402.OPERATION_ENABLED and self.dropped_out is None:
                    self.dropped_out = self.state
            elif identifier == cia402.cob_sdo_answer(node) and len(data) == 8:
                self._objects.heed(data)
            elif identifier == cia402.cob_emergency(node) and len(data) == 8:
                code = cia402.unpack_emergency(data).error_code
                self.emergencies = [*self.emergencies[-_EMERGENCIES:], code] if code else []
            elif identifier == cia402.cob_heartbeat(node) and (state := cia402.heartbeat(data)) is not None:
                self._network_state = state
                if state == cia402.Heartbeat.BOOT_UP:
                    self._statusword, self._started_again = None, True

    @property
    def actual_rpm(self) -> float:
        """The drive's word on its speed, rpm; NaN when it has said nothing for so long that nobody knows."""
        fresh = self._clock.now_ns() - self._word_ns <= self._clock.patience(_WORD_S) * 1e9
        return self._word_rpm if fresh and self._statusword is not None else math.nan

    @property
    def state(self) -> str:
        """The drive's CiA 402 state as last reported."""
        return cia402.UNKNOWN if self._statusword is None else cia402.state(self._statusword)

    @property
    def enabled(self) -> bool:
        """See SpeedSource."""
        return self.state == cia402.OPERATION_ENABLED

    def start(self) -> None:
        """Open the bus, set the drive up, start the heartbeat, go operational.

        Raises:
            DeviceError: the drive does not answer or refuses a setting.
        """
        c = self._config
        self._started_again, self._stopping_s, self._found, self.emergencies = False, None, None, []
        rate = {125_000: b"S4", 250_000: b"S5", 500_000: b"S6", 1_000_000: b"S8"}[c.bitrate]
        self._bus_open = True
        self._send(b"\rC\r" + rate + b"\rO\r")
        self._start_heartbeat()  # before it is watched: a drive may miss it from the moment it is told to
        self._objects.write(cia402.PRODUCER_HEARTBEAT, 0, c.heartbeat_ms, 2)
        word, rpm = self._objects.read(cia402.STATUSWORD, 0), self._objects.read(cia402.ACTUAL_VELOCITY, 0)
        self._found = None if word is None or rpm is None else (word & 0xFFFF, cia402.signed(rpm))
        self._objects.write(cia402.MODE_OF_OPERATION, 0, cia402.MODE_VELOCITY, 1)
        self._watched = True
        self._objects.write(cia402.CONSUMER_HEARTBEAT, 1, cia402.consumer_heartbeat(c.host_node_id, self._watch_ms), 4)
        self._beats_unwatched = self._beats
        self.set_ramp(c.ramp_rpm_per_s)
        map_process_data(self._objects, c.node_id, in_torque=self._found_in_torque)
        self._objects.send(0, bytes([NMT_START, c.node_id]))

    def set_ramp(self, rpm_per_s: float) -> None:
        """Ramp for speeding up and slowing down, rpm/s.

        Raises:
            DeviceError: the time of the drive's ramp is fixed, and it can do no ramp near this one.
        """
        for index in (cia402.VELOCITY_ACCELERATION, cia402.VELOCITY_DECELERATION):
            seconds = self._ramp_seconds(index)
            change = max(1, round(rpm_per_s * seconds))
            if abs(change / seconds - rpm_per_s) > _RAMP_SHARE * rpm_per_s:
                raise DeviceError(
                    f"drive: {rpm_per_s:g} rpm/s wanted; the time of its ramp ({index:04X}h sub 2) is fixed at "
                    f"{seconds} s, which allows whole rpm in {seconds} s only, as {change / seconds:g} rpm/s"
                )
            self._objects.write(index, 1, change, 4)

    def _ramp_seconds(self, index: int) -> int:
        """The time of a ramp: 10 s, for a resolution of 0.1 rpm/s, or the drive's own where it cannot be changed."""
        try:
            self._objects.write(index, 2, _RAMP_S, 2)
        except DeviceError:
            if own := self._objects.read(index, 2):
                return own
            raise
        return _RAMP_S

    def enable(self) -> None:
        """Walk the state machine to OPERATION ENABLED with target speed 0.

        A drive whose host was killed may stand in FAULT because the heartbeat stayed away: that one is reset, once. Any
        other fault is its operator's to look into, also one that comes on the way.

        Raises:
            DeviceError: it does not get there, stands in a fault of its own, or does not watch the host's heartbeat.
            RigError: whatever `permit` raises.
        """
        deadline = self._clock.wall_s() + 3.0
        self._armed, self.dropped_out, was_reset, watched = False, None, False, False
        self._stopping_s = None
        while not watched or self._fresh_state != cia402.OPERATION_ENABLED:
            self._guarded.permit(None)
            state = self._fresh_state
            if state == cia402.FAULT and not was_reset:
                self._reset_if_only_heartbeat(deadline)
                was_reset = True
            elif state == cia402.FAULT:
                raise DeviceError(f"drive: it fell into FAULT again{self.why()}. {_LOOK}")
            elif not watched:
                self._check_watch()
                watched = True
                if state == cia402.OPERATION_ENABLED:  # found so: whatever it was told to do, it is told to stand
                    self._pdo(self._run_word, 0)
            elif state == cia402.QUICK_STOP_ACTIVE and not self._guarded.at_rest():
                pass  # it brakes: without torque it would run down through its resonances
            elif (word := cia402.towards_operation(state)) is not None:
                self._pdo(self._run_word if word == cia402.ENABLE_OPERATION else word, 0)
            if self._clock.wall_s() > deadline:
                raise DeviceError(
                    f"drive: expected OPERATION ENABLED, it stays in {self.state}{self.why()}. "
                    "Look at its display for a fault"
                )
            self._clock.wait(0.005)
        self._armed = True

    def _check_watch(self) -> None:
        """Nothing turns without the drive's own watch over our heartbeat, or without the heartbeat.

        A drive that has started again has none. One that has been told to watches from the next heartbeat on (CiA 301).
        """
        if self._started_again:
            raise DeviceError(
                "drive: it started again since it was set up, so it does not watch the host any more. Look at its "
                "supply, then begin anew"
            )
        if self._beat is None or self._beat_ended:
            self._start_heartbeat()
        watched = self._objects.read(cia402.CONSUMER_HEARTBEAT, 1)
        right = watched is not None and watched >> 16 & 0xFF == self._config.host_node_id
        if watched is None or not right or not 0 < watched & 0xFFFF <= _WATCH_MORE * self._watch_ms:
            said = "cannot be read" if watched is None else f"is 0x{watched:08X}"
            raise DeviceError(
                f"drive: it does not watch the heartbeat of node {self._config.host_node_id} for {self._watch_ms} ms: "
                f"1016h sub 1 {said}. Nothing is turned by a drive that does not stop when its host is gone"
            )
        end = self._clock.wall_s() + 3e-3 * self._config.heartbeat_ms + _ALIVE_S
        while self._beats <= self._beats_unwatched and self._clock.wall_s() < end:
            self._clock.wait(0.005)
        self._check_heartbeat()

    def _check_heartbeat(self) -> None:
        """Raise when the host's heartbeat does not go out: the drive does not watch it, or stops by itself soon."""
        patience_s = max(_ALIVE_S, 1e-3 * self._config.heartbeat_timeout_ms)
        if self._beats <= self._beats_unwatched or self._clock.wall_s() - self._beat_s > patience_s:
            raise DeviceError("drive: the host's heartbeat does not go out. Look at adapter, bus and cable")

    def fault_code(self) -> int | None:
        """Why the drive stands in FAULT, by its own word; None when it tells nothing.

        603Fh, where it has none 1003h, and where it has neither the register 1001h, when only the line is at fault.
        """
        for index, sub in ((cia402.ERROR_CODE, 0), (cia402.PREDEFINED_ERROR_FIELD, 1)):
            with contextlib.suppress(DeviceError):
                if code := (self._objects.read(index, sub) or 0) & 0xFFFF:
                    return code
        with contextlib.suppress(DeviceError):
            register = self._objects.read(cia402.ERROR_REGISTER, 0)
            if register is not None and register & 0xFE == cia402.REGISTER_COMMUNICATION:
                return cia402.HEARTBEAT_ERROR
        return None

    def _check_only_heartbeat(self, *, reset: bool = False) -> None:
        """Raise when anything else than the host's absence is at fault: the newest error hides those before it.

        Args:
            reset: it has been told to reset, and may tell of no fault any more.
        """
        code = self.fault_code()
        register = None
        with contextlib.suppress(DeviceError):
            register = self._objects.read(cia402.ERROR_REGISTER, 0)
        others = (register or 0) & _OTHER_FAULTS or set(self.emergencies) - {cia402.HEARTBEAT_ERROR}
        if others or (code != cia402.HEARTBEAT_ERROR and not (reset and code is None)):
            said = "it does not tell why" if code is None else f"its error code is 0x{code:04X}"
            said += f", its error register 0x{register:02X}" if register else ""
            raise DeviceError(f"drive: it stands in FAULT, {said}{self.why()}. {_LOOK}")

    def _reset_if_only_heartbeat(self, deadline_s: float) -> None:
        self._check_only_heartbeat()
        self.was_reset = "the drive stood in FAULT because a host's heartbeat had stayed away (0x8130); it was reset"
        while self.state == cia402.FAULT and self._clock.wall_s() < deadline_s:
            self._pdo(cia402.DISABLE_VOLTAGE, 0)  # a reset is the bit's rising edge; one may be refused
            self._clock.wait(_RESET_S)  # a drive looks at the word in cycles of its own
            self._pdo(cia402.FAULT_RESET, 0)
            self._clock.wait(_RESET_S)
            if self.state == cia402.FAULT:
                self._check_only_heartbeat(reset=True)

    def set_speed(self, rpm: float) -> None:
        """Ramp to a speed (whole rpm on this drive's wire).

        Raises:
            RigError: whatever `permit` raises.
        """
        self._guarded.permit(rpm)
        if rpm:
            self._check_heartbeat()
            self._stopping_s = None
        self._pdo(self._run_word, round(rpm))

    def disable(self) -> None:
        """Take the torque away; the rotor must be at rest.

        Raises:
            DeviceError: the drive stays in operation, or does not answer whether it does.
        """
        self._armed = False
        if not self._leaves_operation(cia402.SHUTDOWN):
            raise DeviceError(f"drive: told to take the torque away, it stays in {self.state}. {_LOOK}")
        if self._fresh_state == cia402.UNKNOWN and not self._off_by_its_objects:
            raise DeviceError(f"drive: told to take the torque away, {_UNCONFIRMED}")

    def _leaves_operation(self, word: int) -> bool:
        """Send a controlword until the drive's own reports show that it has no torque; whether they do.

        A drive that has fallen silent is not waited for.
        """
        deadline = self._clock.wall_s() + _LEAVE_S
        while True:
            self._pdo(word, 0)
            again = self._clock.wall_s() + _LEAVE_AGAIN_S
            while self._in_torque and self._clock.wall_s() < again:
                self._clock.wait(0.005)
            if not self._in_torque:
                return True
            if self._clock.wall_s() > deadline:
                return False

    @property
    def _fresh_state(self) -> str:
        """The drive's state, unless its word is too old."""
        return cia402.UNKNOWN if math.isnan(self.actual_rpm) else self.state

    @property
    def _found_in_torque(self) -> bool:
        """Whether it turned the rotor, or held it, when it was opened."""
        return self._found is not None and cia402.state(self._found[0]) in _TORQUE

    @property
    def _found_turning(self) -> bool:
        return self._found is not None and (self._found_in_torque or abs(self._found[1]) > self._config.rest_rpm)

    @property
    def _off_by_its_objects(self) -> bool:
        """Whether it says by 6041h that it has no torque."""
        try:
            word = self._objects.read(cia402.STATUSWORD, 0)
        except DeviceError:
            return False
        return word is not None and cia402.state(word & 0xFFFF) not in _TORQUE

    @property
    def _in_torque(self) -> bool:
        """Whether the drive's fresh word is that it turns the rotor, or holds it."""
        return self._fresh_state in _TORQUE

    def quick_stop(self) -> None:
        """Stop as fast as the drive can, in whatever network state it is.

        A drive that does not heed its process data, or says nothing, is ordered through its objects and into operation;
        one that heeds neither is left to its own watch: the host's heartbeat ends.
        """
        self._armed = False
        now_s = self._clock.wall_s()
        self._stopping_s = now_s if self._stopping_s is None else self._stopping_s
        self._pdo(cia402.QUICK_STOP, 0)
        in_network = self._network_state in (None, cia402.Heartbeat.OPERATIONAL)
        late_s = now_s - self._stopping_s
        if in_network and (late_s <= _HEED_S or self._heeds_the_stop):
            return
        order = cia402.write_word(cia402.CONTROLWORD, cia402.QUICK_STOP)
        self._objects.send(cia402.cob_sdo_request(self._config.node_id), order)  # no time for an answer
        self._objects.send(0, bytes([NMT_START, self._config.node_id]))
        self._pdo(cia402.QUICK_STOP, 0)
        if late_s > (2 if in_network else 1) * _HEED_S and self._beat is not None:
            self._beat.stop(0.0)
            self._beat_ended = True

    @property
    def _heeds_the_stop(self) -> bool:
        """Whether the drive reports that it is not in operation any more, or none of its reports is new enough."""
        if self._fresh_state == cia402.UNKNOWN:
            return False
        reported_s = self._clock.wall_s() - self._clock.wall((self._clock.now_ns() - self._word_ns) * 1e-9)
        return self.state != cia402.OPERATION_ENABLED or reported_s - (self._stopping_s or 0.0) <= _HEED_S

    def why(self) -> str:
        """The emergencies that stand, in words for a message: code and meaning; empty without one."""
        return "".join(f"; emergency {cia402.emergency_words(code)}" for code in dict.fromkeys(self.emergencies))

    def _pdo(self, control: int, rpm: int) -> None:
        self._ordered = True
        self._objects.send(cia402.cob_rpdo(1, self._config.node_id), cia402.pack_rpdo1(control, rpm))

    def _start_heartbeat(self) -> None:
        identifier, operational = cia402.cob_heartbeat(self._config.host_node_id), bytes([cia402.Heartbeat.OPERATIONAL])

        def beat() -> None:
            try:
                self._objects.send(identifier, operational)
            except (DeviceError, LinkLost):  # a link that is gone is its reader's to report; another takes the next one
                return
            self._beats, self._beat_s = self._beats + 1, self._clock.wall_s()

        beat()
        if self._beat is not None:  # of a line that was lost
            self._beat.stop()
        self._beat_ended = False
        self._beat = self._clock.every(self._config.heartbeat_ms * 1e-3, beat, "heartbeat", lambda error: None)

    def stop(self, told: Callable[[str], None] = lambda text: None) -> bool:
        """Stop the rotor, then let go of the drive; whether the rotor is known to stand and it to be off.

        Torque is taken away only at rest: a rotor left to run down would pass its resonances slowly. The drive's
        watch over our heartbeat is ended only then too: as long as rest is not confirmed it stays, and stops the
        rotor by itself when the heartbeat ends, however this process ends.

        Args:
            told: called with what is being waited for.
        """
        rest, confirmed = self._beat is None, True
        try:
            rest = rest or self._rest(told)
            if rest and self._watched:
                disarmed = self._disarms(told)
                rest, confirmed = disarmed is not False, disarmed is True
        finally:
            self._let_go(rest)
        return rest and confirmed

    def _disarms(self, told: Callable[[str], None]) -> bool | None:
        """Take torque and watch away, in this order; whether nothing is left armed, None when nobody can tell.

        A drive that keeps its torque keeps its watch too, and stops by itself when the heartbeat ends.
        """
        confirmed = False
        with contextlib.suppress(DeviceError):  # also out of network operation
            self._objects.write(cia402.CONTROLWORD, 0, cia402.DISABLE_VOLTAGE, 2)
            confirmed = True
        if not self._leaves_operation(cia402.DISABLE_VOLTAGE):
            told(f"the drive was told to take the torque away and stays in {self.state}. {_LOOK}")
            return False
        if self._fresh_state == cia402.UNKNOWN and not confirmed and not self._off_by_its_objects:
            told(f"the drive was told to take the torque away, {_UNCONFIRMED}")
            return None  # its watch stays
        with contextlib.suppress(DeviceError):  # a drive that is off needs no watch ended
            self._objects.write(cia402.CONSUMER_HEARTBEAT, 1, 0, 4)
        self._watched = False
        return True

    def _let_go(self, rest: bool) -> None:
        """End the heartbeat, the node's operation and the adapter's; of a rotor that may turn nothing is taken away."""
        if self._beat is not None:
            self._beat.stop()
            self._beat = None
            if rest and (self._ordered or self._watched or self._found is not None):
                self._pdo(cia402.DISABLE_VOLTAGE, 0)
                self._objects.send(0, bytes([NMT_PRE_OPERATIONAL, self._config.node_id]))
        if self._bus_open:
            self._bus_open = False
            self._send(b"C\r")

    def _rest(self, told: Callable[[str], None]) -> bool:
        """Quick stop, and wait until the rotor stands: as long as it grows slower, or runs down by itself."""
        if not self._word_ns and not self._ordered and not self._found_turning:  # it is as it was found
            if self._guarded.at_rest() is not False:
                return True
        elif self._guarded.at_rest() and self.state != cia402.OPERATION_ENABLED:
            return True
        if self.state == cia402.OPERATION_ENABLED:  # also at rest: it may have an order to turn
            with contextlib.suppress(LinkLost):  # one frame; it is repeated
                self.quick_stop()
        return wait_for_rest(self._clock, self._guarded, self.quick_stop, told)

"""A simulated CiA 402 drive behind an slcan adapter: SDO server, PDOs, heartbeats both ways, quick stop.

Stand-in for a CiA 402 drive of a log while the log is played.

The objects of a simulated drive, and of the stand-in for a drive of a log.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

from typing_extensions import override

from daq.drivers.can_lines import Adapter, PlayedOnBus
from daq.drivers.canopen import cia301
from daq.drivers.canopen.node import NMT_STOP, RESETS, Node, Objects
from daq.drivers.cia402 import wire as cia402
from daq.drivers.cia402.settings import MotorDrive
from daq.drivers.cia402.wire import (
    PROFILE_ACCELERATION,
    PROFILE_DECELERATION,
    SPEED_ZERO,
    TARGET_REACHED,
    VELOCITY,
    SpeedProfile,
    profile_of,
)
from daq.drivers.simulated import FaultKind
from daq.drivers.simulated_motor import COAST_RPM_S, QUICK_RPM_S, Periodic, SimulatedMotor
from daq.transports.can_frames import CanFrame, decode
from daq.virtual_rig.motion import SimulatedMotion
from daq.virtual_rig.world import World
from rig_basics.units import RPM


def drive_objects(node: int, profile: SpeedProfile = VELOCITY) -> Objects:
    """Return the minimum objects of a drive with initial values: ramps 100 rpm/s, no reports at rest."""
    ordered = profile.mapping(cia402.CONTROLWORD, profile.target)
    reported = profile.mapping(cia402.STATUSWORD, profile.actual)
    ramp = round(100 * profile.units_per_rpm)
    return {
        (cia301.RPDO1, 1): (cia301.cob_rpdo(1, node), "<I"),
        (cia301.RPDO1, 2): (255, "<B"),
        (cia301.RPDO1_MAPPING, 0): (2, "<B"),
        (cia301.RPDO1_MAPPING, 1): (ordered[0], "<I"),
        (cia301.RPDO1_MAPPING, 2): (ordered[1], "<I"),
        (cia301.TPDO1, 1): (cia301.cob_tpdo(1, node), "<I"),
        (cia301.TPDO1, 2): (255, "<B"),
        (cia301.TPDO1, 5): (0, "<H"),
        (cia301.TPDO1_MAPPING, 0): (2, "<B"),
        (cia301.TPDO1_MAPPING, 1): (reported[0], "<I"),
        (cia301.TPDO1_MAPPING, 2): (reported[1], "<I"),
        (0x1000, 0): (0x00020192, "<I"),
        (0x1001, 0): (0, "<B"),
        (cia301.CONSUMER_HEARTBEAT, 1): (0, "<I"),
        (cia301.PRODUCER_HEARTBEAT, 0): (0, "<H"),
        (cia402.CONTROLWORD, 0): (0, "<H"),
        (profile.target, 0): (0, "<h" if profile.bits == 16 else "<i"),
        (PROFILE_ACCELERATION, 0): (ramp, "<I"),
        (PROFILE_DECELERATION, 0): (ramp, "<I"),
        (cia402.VELOCITY_ACCELERATION, 1): (100, "<I"),
        (cia402.VELOCITY_ACCELERATION, 2): (1, "<H"),
        (cia402.VELOCITY_DECELERATION, 1): (100, "<I"),
        (cia402.VELOCITY_DECELERATION, 2): (1, "<H"),
        (cia402.MODE_OF_OPERATION, 0): (0, "<b"),
    }


_STATUS = {name: value for name, (_, value) in cia402.STATES.items()}
_MAKERS = {(0x1018, 1): (0x0000_0A11, "<I"), (0x1018, 4): (24601, "<I"), (0x6085, 0): (int(QUICK_RPM_S), "<I")}


class SimulatedDrive(SimulatedMotor):
    """Drive that turns the rotor as commanded, and stops it by itself if the host's heartbeat is missing.

    Args:
        config: table of the drive in the rig file.
        motion: motion of the rotor.
        report_s: period of the speed report, s.

    Attributes:
        state: CiA 402 state.
    """

    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        **SimulatedMotor.fault_kinds,
        "emergency": FaultKind(
            "it sends an emergency and goes on", 0x4210, end=None, meaning="the error code", limits=(0, 0xFFFF)
        ),
        "fault": FaultKind(
            "it enters FAULT: no torque", 0x4210, end=None, meaning="the error code", limits=(0, 0xFFFF)
        ),
        "network": FaultKind(
            "it is in another network state", 4, end=5, meaning="4 stopped, 5 operational", limits=(4, 5)
        ),
        "silent reports": FaultKind("it reports neither state nor speed; its heartbeat continues"),
        "time-out": FaultKind(
            "its time-out is not the one it states", 3.0, end=1, meaning="ratio to it", limits=(0.01, 1e3)
        ),
        "second host": FaultKind("another node on the bus sends the host's heartbeat"),
    }

    def __init__(self, config: MotorDrive, motion: SimulatedMotion, report_s: float) -> None:
        super().__init__(motion)
        self._config, self._report_s = config, report_s
        self._profile, self._halted = profile_of(config), False
        self._second_due_s = 0.0
        self._adapter, self._reports = Adapter(), Periodic()
        self.state: str = cia402.SWITCH_ON_DISABLED
        self._target_rpm = 0.0
        self._heard_s: float | None = None  # last host heartbeat; None until the first
        self._without_supply = False
        self._objects = self._initial_objects()
        measured = {
            (cia402.STATUSWORD, 0): lambda: struct.pack("<H", self._statusword),
            (self._profile.actual, 0): lambda: self._profile.pack(0, self._reported_rpm)[2:],
            (cia402.MODE_DISPLAY, 0): lambda: struct.pack("<b", self._objects[cia402.MODE_OF_OPERATION, 0][0]),
        }
        self._node = Node(config.node_id, self._objects, measured, self._written)
        self._restart()

    def _initial_objects(self) -> Objects:
        timer_ms = max(1, round(self._report_s * 1e3))
        return drive_objects(self._config.node_id, self._profile) | _MAKERS | {(cia301.TPDO1, 5): (timer_ms, "<H")}

    @classmethod
    def of(cls, device: str, config: MotorDrive, world: World) -> SimulatedDrive:
        """Make the drive of a simulated rig."""
        return cls(config, world.motion, world.virtual.drive.report_s)

    @override
    def facts(self) -> dict[str, Any]:
        return {**super().facts(), "drive": self.state}

    @override
    def fail(self, what: str, value: Any) -> None:
        match what:
            case "emergency":
                self._emergency(int(value))
            case "fault":  # no torque: the rotor runs down by itself
                self.state = cia402.FAULT
                self._emergency(int(value))
            case "restart":
                self._objects[cia301.CONSUMER_HEARTBEAT, 1] = (0, "<I")
                self._restart()
            case "network":
                self._node.state = cia301.Heartbeat(int(value))
            case "speed":  # until the next command
                self._target_rpm = float(value)
            case _:
                super().fail(what, value)

    @override
    def _restart(self) -> None:
        self.state, self._target_rpm, self._heard_s = cia402.SWITCH_ON_DISABLED, 0.0, None
        self._node.state = cia301.Heartbeat.PRE_OPERATIONAL
        self._adapter.out.append(self._node.boot_up())

    def power(self, on: bool, now_s: float) -> None:
        """See FarEnd. The supply is that of the drive; the adapter is supplied by the host and continues.

        Without supply the torque is 0. After power-up the objects have their initial values.
        """
        self._without_supply = not on
        self._adapter.repeated.clear()
        if on:
            self._objects.update(self._initial_objects())
            self._restart()

    def _emergency(self, code: int) -> None:
        self.emergencies.append(code)
        self._adapter.out.append(self._node.emergency(code, 0x11 if code else 0))

    @property
    @override
    def watchdog_ms(self) -> int:
        """Longest accepted interval of the host's heartbeat (1016h), ms; 0 if it is not watched."""
        return self._objects[cia301.CONSUMER_HEARTBEAT, 1][0] & 0xFFFF

    @property
    def _statusword(self) -> int:
        """State, and in profile velocity mode whether target and rest are reached."""
        word, rpm = _STATUS[self.state], self._reported_rpm
        if self._profile is VELOCITY:
            return word
        reached = abs(rpm - self._target_rpm) < 1 + 0.01 * abs(self._target_rpm)
        return word | TARGET_REACHED * reached | SPEED_ZERO * (abs(rpm) < 1)

    @override
    def receive(self, data: bytes, now_s: float) -> bytes:
        frames = self._adapter.receive(data)
        for frame in [] if self._without_supply else frames:
            self._frame(frame, now_s)
        return self._adapter.pass_on()

    def _frame(self, frame: CanFrame, now_s: float) -> None:
        identifier, data = frame.arbitration_id, frame.data
        self._react(self._node.command(frame))
        self._adapter.out += self._node.answers(frame)
        if identifier == cia301.cob_rpdo(1, self._config.node_id) and len(data) == self._profile.size:
            if self._node.operational:
                control, self._target_rpm = self._profile.unpack(data)
                form = self._objects[self._profile.target, 0][1]
                self._objects[self._profile.target, 0] = (struct.unpack(form, data[2:])[0], form)
                self._control(control)
        elif identifier == cia301.cob_heartbeat(self._objects[0x1016, 1][0] >> 16 & 0x7F):
            self._heard_s = now_s

    def _react(self, command: int | None) -> None:
        if command in (NMT_STOP, *RESETS) and self.state == cia402.OPERATION_ENABLED:
            self._quick_stop()
        if command in RESETS:
            self._heard_s = None

    def _written(self, index: int, sub: int, value: int) -> None:
        if (index, sub) == (cia402.CONTROLWORD, 0):
            self._control(value)
        if (index, sub) == (self._profile.target, 0):
            self._target_rpm = value / self._profile.units_per_rpm
        if (index, sub) == (cia301.CONSUMER_HEARTBEAT, 1):
            self._heard_s = None  # the watch begins with the next heartbeat (CiA 301)

    def _control(self, word: int) -> None:
        s = self.state
        self._halted = bool(word & cia402.HALT) and self._profile is not VELOCITY
        if word & 0x82 == 0x00:
            self.state = cia402.SWITCH_ON_DISABLED if s != cia402.FAULT else s
        elif word & 0x86 == 0x02:
            if s == cia402.OPERATION_ENABLED:
                self._quick_stop()
        elif word & 0x80:
            self.state = cia402.SWITCH_ON_DISABLED if s == cia402.FAULT else s
        elif s == cia402.SWITCH_ON_DISABLED and word & 0x87 == 0x06:
            self.state = cia402.READY
        elif s == cia402.READY and word & 0x87 == 0x07:
            self.state = cia402.SWITCHED_ON
        elif s in (cia402.READY, cia402.SWITCHED_ON) and word & 0x8F == 0x0F:
            self.state = cia402.OPERATION_ENABLED
        elif s in (cia402.OPERATION_ENABLED, cia402.SWITCHED_ON) and word & 0x87 == 0x06:
            self.state = cia402.READY

    def _quick_stop(self) -> None:
        self.state = cia402.QUICK_STOP_ACTIVE

    def step(self, now_s: float) -> bytes:
        """Update watchdog, ramps and state up to `now_s`; return the frames that are due."""
        if self._without_supply:
            self._drive(0.0, COAST_RPM_S)
            return b""
        self._send_as_second_host(now_s)
        self._watch(now_s)
        enabled = self.state == cia402.OPERATION_ENABLED
        in_mode = self._objects[0x6060, 0][0] == self._profile.mode
        target = self._target_rpm if enabled and in_mode and not self._halted else 0
        stopping = self.state == cia402.QUICK_STOP_ACTIVE
        ramp = self._ramp_rpm_s(target) if enabled else QUICK_RPM_S if stopping else COAST_RPM_S
        self._drive(target, ramp, braking=stopping)
        if self.state == cia402.QUICK_STOP_ACTIVE and abs(self._motion.speed_rad_s) < 0.01:
            self.state = cia402.SWITCH_ON_DISABLED
        self._cyclic(now_s)
        return self._adapter.pass_on()

    def _ramp_rpm_s(self, target_rpm: float) -> float:
        """Ramp towards a target speed, rpm/s."""
        faster = abs(target_rpm) * RPM >= abs(self._motion.speed_rad_s)
        if units := self._config.ramp_units:
            return self._objects[PROFILE_ACCELERATION if faster else PROFILE_DECELERATION, 0][0] / units
        index = cia402.VELOCITY_ACCELERATION if faster else cia402.VELOCITY_DECELERATION
        return self._objects[index, 1][0] / max(1, self._objects[index, 2][0])

    def _send_as_second_host(self, now_s: float) -> None:
        """Send the heartbeat of another node with the host's number; the drive cannot distinguish the two."""
        if not self._faults["second host"] or now_s < self._second_due_s:
            return
        self._second_due_s = now_s + 0.97e-3 * self._config.heartbeat_ms  # the other node has its own clock
        beat = CanFrame(cia301.cob_heartbeat(self._config.host_node_id), bytes([cia301.Heartbeat.OPERATIONAL]))
        self._adapter.out.append(beat)
        self._frame(beat, now_s)

    def _watch(self, now_s: float) -> None:
        limit_ms = self.watchdog_ms
        if not limit_ms or self._heard_s is None or now_s - self._heard_s <= limit_ms * 1e-3 * self._faults["time-out"]:
            return
        self._heard_s = None
        if self.state == cia402.OPERATION_ENABLED:
            self._quick_stop()
        self._emergency(cia301.HEARTBEAT_ERROR)

    def _cyclic(self, now_s: float) -> None:
        self._adapter.out += self._node.heartbeat(now_s)
        if not self._node.operational or self._faults["silent reports"]:
            self._reports.begin(now_s)
            return
        for rpm in self._reported_speeds(self._reports.due(now_s, self._report_s)):
            data = self._profile.pack(self._statusword, rpm)
            self._adapter.out.append(CanFrame(cia301.cob_tpdo(1, self._config.node_id), data))


class PlayedDrive(PlayedOnBus):
    """A drive behind its adapter. It accepts settings and follows network commands; its speed is that of the log.

    Args:
        config: table of the drive in the rig file.
        identity: of the drive; it is not needed.
    """

    expects = "the network's start"

    def __init__(self, config: MotorDrive, identity: Mapping[str, Any]) -> None:
        super().__init__({cia301.cob_heartbeat(config.host_node_id)})
        self._host_beat = cia301.cob_heartbeat(config.host_node_id)
        self._profile = profile_of(config)
        self._reported = bytes(self._profile.size)
        objects = self._objects = drive_objects(config.node_id, self._profile)
        measured = {
            (cia402.STATUSWORD, 0): lambda: self._reported[:2],
            (self._profile.actual, 0): lambda: self._reported[2:],
            (cia402.MODE_DISPLAY, 0): lambda: struct.pack("<b", objects[cia402.MODE_OF_OPERATION, 0][0]),
        }
        self._node = Node(config.node_id, objects, measured, self._written)

    @property
    @override
    def sending(self) -> bool:
        return super().sending and self._node.operational

    @override
    def begin(self) -> None:
        super().begin()
        self._node.state = cia301.Heartbeat.OPERATIONAL

    @override
    def is_host(self, frame: CanFrame) -> bool:
        return frame.arbitration_id == self._host_beat

    def _pass(self, data: bytes) -> bytes:
        for frame in decode(data).frames:
            if frame.arbitration_id == cia301.cob_tpdo(1, self._node.number) and len(frame.data) >= self._profile.size:
                self._reported = frame.data[: self._profile.size]
        return super()._pass(data)

    @override
    def answers(self, frame: CanFrame) -> Iterable[CanFrame]:
        data = frame.data
        yield from self._node.answers(frame)
        if frame.arbitration_id == cia301.cob_rpdo(1, self._node.number) and len(data) == self._profile.size:
            form = self._objects[self._profile.target, 0][1]
            self._objects[self._profile.target, 0] = (struct.unpack(form, data[2:])[0], form)
            self._turn(self._profile.unpack(data)[0])

    def _written(self, index: int, sub: int, value: int) -> None:
        if (index, sub) == (cia402.CONTROLWORD, 0):
            self._turn(value)

    def _turn(self, controlword: int) -> None:
        """Count a command to operate, which a log cannot follow. Commands that end operation are not counted."""
        self.unfollowed += controlword & 0x0F == cia402.ENABLE_OPERATION

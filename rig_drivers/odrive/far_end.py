"""A simulated ODrive axis behind an slcan adapter: closed-loop control, watchdog, errors, heartbeat and estimates.

It encodes and decodes frames by its own path, not by the host's codec.

Stand-in for an ODrive of a log while the log is played.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

from typing_extensions import override

from daq.drivers.can_lines import Adapter, PlayedOnBus
from daq.drivers.simulated import FaultKind
from daq.drivers.simulated_motor import COAST_RPM_S, LOOP_RPM_S, Periodic, SimulatedMotor
from daq.transports.can_frames import CanFrame, decode
from daq.virtual_rig.motion import SimulatedMotion
from daq.virtual_rig.world import World
from rig_drivers.odrive import wire
from rig_drivers.odrive.settings import Odrive

_BOOT_S = 0.3  # time from power-up to the first state of the axis
_SERIAL = bytes.fromhex("3D1E4C6A2B39")
_UNDEFINED, _IDLE, _CLOSED_LOOP = 0, 1, 8
_ERROR_BITS = {"0.5": {"watchdog": 1 << 11, "estop": 1 << 14}, "0.6": {"watchdog": 1 << 24, "estop": 1 << 25}}


class SimulatedOdrive(SimulatedMotor):
    """Axis that turns the rotor as commanded, and removes the torque by itself without messages of the host.

    Args:
        settings: table of the controller in the rig file; the simulated controller has these values.
        motion: motion of the rotor.
        watchdog_s: timeout of the watchdog, s; None: that of the settings; 0: the watchdog is off.

    Attributes:
        error: error code of the axis.
    """

    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        **SimulatedMotor.fault_kinds,
        "fault": FaultKind(
            "it has an error: no torque until the error is cleared",
            0x40,
            end=None,
            meaning="the error bits of the axis",
            limits=(1, 0x7FFF_FFFF),
        ),
        "silent reports": FaultKind("it sends no encoder estimates; its heartbeat continues"),
        "silent heartbeat": FaultKind("it sends no heartbeat; its encoder estimates continue"),
        "time-out": FaultKind(
            "its watchdog is not set as in the rig file", 3.0, end=1, meaning="ratio to it", limits=(0.01, 1e3)
        ),
        "deaf": FaultKind("no message reaches it; it still reports"),
        "second host": FaultKind("another node on the bus commands the axis"),
    }

    def __init__(self, settings: Odrive, motion: SimulatedMotion, *, watchdog_s: float | None = None) -> None:
        super().__init__(motion)
        self._settings = settings
        self._watchdog_s = settings.watchdog_s if watchdog_s is None else watchdog_s
        self._bits = _ERROR_BITS[settings.firmware]
        self.error: int = 0
        self._adapter = Adapter()
        self._without_supply = False
        self._beats, self._estimates = Periodic(), Periodic()
        self._start(0.0, booted_s=0.0)

    @classmethod
    def of(cls, device: str, settings: Odrive, world: World) -> SimulatedOdrive:
        """Make the controller of a simulated rig."""
        return cls(settings, world.motion, watchdog_s=settings.watchdog_s)

    def _start(self, now_s: float, booted_s: float = _BOOT_S) -> None:
        """Set the state after power-up."""
        self.state, self.error = (_IDLE if booted_s == 0.0 else _UNDEFINED), 0
        self._ready_s, self._heard_s = now_s + booted_s, now_s
        self._turns = 0.0
        self._input, self._modes = 0.0, (3, 1)  # position control: the stored default
        self._runaway_rpm = None
        self._detail = 0

    @override
    def facts(self) -> dict[str, Any]:
        name = "FAULT" if self.error else {0: "UNDEFINED", 1: "IDLE", 8: "CLOSED LOOP"}[self.state]
        return {**super().facts(), "drive": name}

    @property
    @override
    def watchdog_ms(self) -> int:
        return round(self._watchdog_s * 1e3)

    @override
    def fail(self, what: str, value: Any) -> None:
        if what == "fault":
            self._detail = 0x0010_0000
            self._trip(int(value))
        else:
            super().fail(what, value)

    @override
    def _restart(self) -> None:
        self._start(self._now_s)

    def power(self, on: bool, now_s: float) -> None:
        """See FarEnd. The supply is that of the controller; the adapter is supplied by the host and continues."""
        self._without_supply = not on
        self._start(now_s)

    def _trip(self, bits: int) -> None:
        """Set error bits; an axis with an error has no torque."""
        self.error |= bits
        self.emergencies.append(self.error)
        if self.state != _UNDEFINED:
            self.state = _IDLE

    # --- the line ---------------------------------------------------------------------------------------------

    @override
    def receive(self, data: bytes, now_s: float) -> bytes:
        self._passed_s(now_s)
        frames = self._adapter.receive(data)
        if not (self._without_supply or self._faults["deaf"]):
            for frame in frames:
                self._hear(frame)
        return self._adapter.pass_on()

    def _emit(self, command: int, data: bytes) -> None:
        self._adapter.out.append(CanFrame(self._settings.node_id * 32 + command, data))

    def _hear(self, frame: CanFrame) -> None:
        if frame.extended or frame.arbitration_id // 32 != self._settings.node_id:
            return
        self._heard_s = self._now_s  # any message feeds the watchdog
        command, data = frame.arbitration_id % 32, frame.data
        if frame.remote:
            self._answer(command)
        elif command == 2:
            self._trip(self._bits["estop"])
        elif command == 7 and len(data) >= 4:
            self._request(int.from_bytes(data[:4], "little"))
        elif command == 11 and len(data) == 8:
            self._modes = struct.unpack("<ii", data)
        elif command == 13 and len(data) == 8:
            self._input = struct.unpack("<f", data[:4])[0]
        elif command == 24:
            self.error = self._detail = 0

    def _answer(self, command: int) -> None:
        """Answer a request as far as the firmware has it."""
        if self._settings.firmware == "0.5":
            if command == 3:
                self._emit(3, self._detail.to_bytes(8, "little"))
            elif command in (4, 29):
                self._emit(command, bytes(8))
        elif command == 0:
            self._emit(0, bytes([2, 4, 4, 58, 0, 6, 10, 0]))
        elif command == 3:
            self._emit(3, self.error.to_bytes(4, "little") * 2)
        elif command == 6:
            self._emit(6, bytes([self._settings.node_id]) + _SERIAL[::-1] + b"\0")

    def _request(self, state: int) -> None:
        if self.state == _UNDEFINED:
            return
        if state == _CLOSED_LOOP and not self.error:
            self.state = _CLOSED_LOOP
        elif state == _IDLE:
            self.state = _IDLE

    # --- time -------------------------------------------------------------------------------------------------

    def step(self, now_s: float) -> bytes:
        """Update watchdog and motor up to `now_s`; return the frames that are due."""
        passed = self._passed_s(now_s)
        self._turns += self.speed_rpm / 60 * self._settings.gear_ratio * passed
        if not self._without_supply:
            self._watch()
            self._report()
        self._turn()
        return self._adapter.pass_on()

    def _watch(self) -> None:
        if self.state == _UNDEFINED and self._now_s >= self._ready_s:
            self.state = _IDLE
        late = self._now_s - self._heard_s > self._watchdog_s * self._faults["time-out"]
        if self._watchdog_s and late and not self.error & self._bits["watchdog"]:
            self._trip(self._bits["watchdog"])

    def _turn(self) -> None:
        driven = self.state == _CLOSED_LOOP and not self._without_supply
        if not driven:
            self._runaway_rpm = None
        in_mode = self._modes == (2, 1)  # in another mode the rotor is held
        rpm = self._input * 60 / self._settings.gear_ratio if in_mode else 0.0
        rpm = rpm if self._runaway_rpm is None else self._runaway_rpm
        self._drive(rpm if driven else 0.0, LOOP_RPM_S if driven else COAST_RPM_S)

    def _report(self) -> None:
        for _ in range(self._beats.due(self._now_s, self._settings.heartbeat_ms * 1e-3)):
            if self._faults["second host"]:  # once in each heartbeat
                self._emit(13, struct.pack("<ff", 1.5, 0.0))
            if not self._faults["silent heartbeat"]:
                error = self.error | (self.state == _UNDEFINED and self._settings.firmware == "0.6")
                flags = bytes([self._detail != 0 and self._settings.firmware == "0.5", 0, 0])
                self._emit(1, error.to_bytes(4, "little") + bytes([self.state]) + flags)
        for rpm in self._reported_speeds(self._estimates.due(self._now_s, self._settings.estimates_ms * 1e-3)):
            if not self._faults["silent reports"]:
                self._emit(9, struct.pack("<ff", self._turns, rpm / 60 * self._settings.gear_ratio))


_UNKNOWN = wire.Version((0, 0, 0), (0, 6, 0))


class PlayedOdrive(PlayedOnBus):
    """An ODrive behind its adapter. It reports its version and serial number; its speed and state are those of the log.

    When the bus is opened it sends the newest heartbeat and estimates of the log, for which the opening waits.

    Args:
        settings: table of the controller in the rig file.
        identity: identity of the controller from its opening.
    """

    expects = "the opening of the bus"

    def __init__(self, settings: Odrive, identity: Mapping[str, Any]) -> None:
        super().__init__({wire.identifier(settings.node_id, command) for command in range(32)})
        self._node = settings.node_id
        self._answers = _answers(settings, identity)
        self._reports = {
            wire.HEARTBEAT: self._frame(wire.HEARTBEAT, wire.pack_idle()),
            wire.ESTIMATES: self._frame(wire.ESTIMATES, bytes(8)),
        }

    def first_frames(self) -> Iterable[CanFrame]:
        """See PlayedOnBus: the opening waits for them."""
        return self._reports.values()

    @override
    def answers(self, frame: CanFrame) -> Iterable[CanFrame]:
        node, command = wire.split(frame.arbitration_id)
        if node != self._node:
            return
        self.unfollowed += command == wire.AXIS_STATE and wire.parse_state(frame) == wire.CLOSED_LOOP
        if frame.remote and command in self._answers:
            yield self._frame(command, self._answers[command])

    def _frame(self, command: int, data: bytes) -> CanFrame:
        return CanFrame(wire.identifier(self._node, command), data)

    def _pass(self, data: bytes) -> bytes:
        for frame in decode(data).frames:
            node, command = wire.split(frame.arbitration_id)
            if node == self._node and command in self._reports and not frame.remote:
                self._reports[command] = frame
        return super()._pass(data)


def _answers(settings: Odrive, identity: Mapping[str, Any]) -> dict[int, bytes]:
    """Return the answers to requests by command; known ones if the identity is incomplete or invalid."""
    if settings.firmware == "0.5":
        return {}
    serial = str(identity.get("serial", ""))
    if len(serial) != 12 or not all(digit in "0123456789ABCDEF" for digit in serial):
        serial = settings.serial or "0" * 12
    try:
        hardware = _three(identity["hardware"])
        version = wire.Version(hardware, _three(identity["firmware"]))
        answer = wire.pack_version(version)
    except (KeyError, ValueError):  # usual: the identity in the log is incomplete
        answer = wire.pack_version(_UNKNOWN)
    return {wire.VERSION: answer, wire.ADDRESS: wire.pack_address(settings.node_id, serial)}


def _three(text: Any) -> tuple[int, int, int]:
    first, second, third = (int(part) for part in str(text).split("."))
    return first, second, third

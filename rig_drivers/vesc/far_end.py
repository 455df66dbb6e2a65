"""A simulated VESC: it turns the rotor as commanded, answers polls, and has a timeout of its own.

Stand-in for a VESC of a log while the log is played.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Self

from typing_extensions import override

from daq.drivers.played import PlayedDevice
from daq.drivers.simulated import FaultKind
from daq.drivers.simulated_motor import COAST_RPM_S, LOOP_RPM_S, SimulatedMotor
from daq.virtual_rig.motion import SimulatedMotion
from daq.virtual_rig.world import World
from rig_drivers.vesc import packets, wire
from rig_drivers.vesc.settings import Vesc, VescMotor

_BRAKE_RPM_S_PER_A = 200.0
_STEPS_PER_ERPM_S = 6 / 60  # a motor makes six steps per electrical revolution
_FAULT_STOP_S = 0.5  # duration of a fault; then it ends by itself
_SUPPLY_V, _RUNNING_A, _RATED_ERPM = 24.0, 2.0, 20_000.0
_FIRMWARE = wire.Firmware(6, 5, "60_MK5", "2a0041000a51353338363731")


class SimulatedVesc(SimulatedMotor):
    """Controller that turns the rotor as commanded, and stops it by itself without commands.

    Args:
        settings: table of the controller in the rig file; the simulated controller has these values.
        motion: motion of the rotor.
        timeout_s: timeout of the controller, s; None: that of the settings.
        timeout_brake_A: brake current after the timeout, A; None: that of the host's own stop. The manufacturer's
            default is 0; then the rotor runs down.
        has_status: whether the firmware sends the status byte.
    """

    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        **SimulatedMotor.fault_kinds,
        "fault": FaultKind(
            "it has a fault, which passes by itself: no torque", 4, meaning="the fault code", limits=(0, 255)
        ),
        "silent reports": FaultKind("it does not answer requests for its values"),
        "deaf": FaultKind("no command reaches it; it still answers polls"),
    }

    def __init__(
        self,
        settings: VescMotor,
        motion: SimulatedMotion,
        *,
        timeout_s: float | None = None,
        timeout_brake_A: float | None = None,
        has_status: bool = True,
    ) -> None:
        super().__init__(motion)
        self._settings, self._has_status = settings, has_status
        self._timeout_s = settings.timeout_s if timeout_s is None else timeout_s
        self._timeout_brake_A = settings.brake_A if timeout_brake_A is None else timeout_brake_A
        self._fault_until_s = 0.0
        self._restart()

    @classmethod
    def of(cls, device: str, settings: VescMotor, world: World) -> Self:
        """Make the controller of a simulated rig."""
        return cls(settings, world.motion, timeout_s=settings.timeout_s)

    @override
    def facts(self) -> dict[str, Any]:
        return {**super().facts(), "drive": self.state}

    @override
    def _restart(self) -> None:
        self._command: wire.MotorCommand | None = None
        self._heard_s: float | None = None
        self._fault = 0
        self._runaway_rpm = None
        self._decoder = packets.PacketDecoder()
        self._steps = self._drawn_Ah = self._drawn_Wh = 0.0

    @override
    def fail(self, what: str, value: Any) -> None:
        if what != "fault":
            super().fail(what, value)
            return
        self._fault, self._fault_until_s = int(value), self._now_s + _FAULT_STOP_S
        if self._fault:
            self.emergencies.append(self._fault)

    def power(self, on: bool, now_s: float) -> None:
        """See FarEnd. Without supply the torque is 0; after power-up the controller has received no command."""
        super().power(on, now_s)
        self._restart()

    # --- state --------------------------------------------------------------------------------------------------

    @property
    def timed_out(self) -> bool:
        """Whether the last command is older than the timeout."""
        return self._heard_s is None or self._now_s - self._heard_s > self._timeout_s

    @property
    @override
    def watchdog_ms(self) -> int:
        return round(self._timeout_s * 1e3)

    @property
    def state(self) -> str:
        """State of the controller."""
        if self._fault:
            return "FAULT"
        if self.timed_out:
            return "TIMED OUT"
        command = self._command
        names = {wire.SET_RPM: "SPEED", wire.SET_BRAKE: "BRAKE", wire.SET_CURRENT: "FREE"}
        return "FREE" if command is None else names[command.what]

    @property
    def values(self) -> wire.Values:
        """Values that the controller reports now."""
        erpm = self._reported_rpm * self._settings.pole_pairs
        status = wire.TIMED_OUT if self.timed_out else 0
        return wire.Values(
            erpm=round(erpm),
            motor_A=self._motor_A(),
            input_V=_SUPPLY_V,
            duty=max(-1.0, min(1.0, erpm / _RATED_ERPM)),
            charges=(round(self._drawn_Ah * 1e4), 0, round(self._drawn_Wh * 1e4), 0),
            turned=round(self._steps) % 2**32,
            fault=self._fault,
            status=status if self._has_status else None,
        )

    def _motor_A(self) -> float:
        return _RUNNING_A if self.state == "SPEED" else 0.0

    # --- the line ----------------------------------------------------------------------------------------------

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the host; return the answers."""
        self._passed_s(now_s)
        out = b""
        for payload in self._decoder.feed(data).payloads:
            answer = self._answer(payload)
            if answer:
                out += packets.packet(answer)
        return out

    def _answer(self, payload: bytes) -> bytes:
        if payload == bytes([wire.GET_VALUES]):
            return b"" if self._faults["silent reports"] else wire.pack_values(self.values)
        if payload == bytes([wire.FIRMWARE_VERSION]):
            return wire.pack_firmware(_FIRMWARE)
        command = wire.parse_command(payload)
        if self._faults["deaf"] or (command is None and payload != bytes([wire.ALIVE])):
            return b""
        self._heard_s = self._now_s
        if command is not None:
            self._command = command
            if command.what == wire.SET_BRAKE:
                self._runaway_rpm = None
        return b""

    def step(self, now_s: float) -> bytes:
        """Update timeout, fault and motor up to `now_s`. The controller sends nothing without a request."""
        passed = self._passed_s(now_s)
        if self._fault and self._now_s >= self._fault_until_s:
            self._fault = 0
        erpm = abs(self.speed_rpm) * self._settings.pole_pairs
        self._steps += erpm * _STEPS_PER_ERPM_S * passed
        input_A = self._motor_A() * min(1.0, erpm / _RATED_ERPM)
        self._drawn_Ah += input_A * passed / 3600
        self._drawn_Wh += input_A * _SUPPLY_V * passed / 3600
        rpm, brake_A = self._set_point()
        ramp = LOOP_RPM_S if rpm is not None else max(COAST_RPM_S, brake_A * _BRAKE_RPM_S_PER_A)
        self._drive(rpm or 0.0, ramp, braking=rpm is None and brake_A > 0)
        return b""

    def _set_point(self) -> tuple[float | None, float]:
        """Return the speed, rpm, or None with a brake current, A. With None and 0 the rotor runs down."""
        if self._fault or not self.line_alive:
            return None, 0.0
        if self._runaway_rpm is not None:
            return self._runaway_rpm, 0.0
        command = self._command
        if self.timed_out or command is None:
            # a controller that has received no command is in its timeout too
            return None, self._timeout_brake_A
        if command.what == wire.SET_BRAKE:
            return None, command.number / 1000
        if command.what == wire.SET_RPM and abs(command.number) >= self._settings.min_erpm:
            return command.number / self._settings.pole_pairs, 0.0
        return None, 0.0


class PlayedVesc(PlayedDevice):
    """A VESC that reports its identity; its answers to polls, and thus the speed, are those of the log.

    Args:
        settings: table of the controller in the rig file.
        identity: identity of the controller from its opening.
    """

    def __init__(self, settings: Vesc, identity: Mapping[str, Any]) -> None:
        super().__init__()
        self._decoder = packets.PacketDecoder()
        self._firmware = firmware_of(identity)

    @override
    def hear(self, data: bytes) -> bytes:
        answers = b""
        for payload in self._decoder.feed(data).payloads:
            self.commands += 1
            command = wire.parse_command(payload)
            self.unfollowed += command is not None and command.what == wire.SET_RPM
            if payload[:1] == bytes([wire.FIRMWARE_VERSION]):
                answers += packets.packet(wire.pack_firmware(self._firmware))
        return answers


def firmware_of(identity: Mapping[str, Any]) -> wire.Firmware:
    """Return the firmware of an identity; a known firmware if the identity is incomplete or invalid."""
    try:
        major, minor = (int(part) for part in str(identity["firmware"]).split("."))
        found = wire.Firmware(major, minor, str(identity["hardware"]), str(identity["serial"]))
        wire.pack_firmware(found)
    except (KeyError, ValueError):  # usual: the identity in the log is incomplete
        return wire.Firmware(6, 5, "played", "00" * 12)
    return found

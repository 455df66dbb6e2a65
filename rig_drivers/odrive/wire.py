"""Frames of an ODrive's CANSimple protocol: a pure codec without bus and clock.

The identifier has 11 bits: node << 5 | command. Numbers are little-endian, real numbers have 32 bits. A request is a
remote frame with the identifier of its answer [S]. "25 turns/s" to node 1 is 02Dh with ``00 00 C8 41 00 00 00 00`` [S],
on the line ``t02D80000C84100000000`` [M]. From the controller:

- 00h, on request: version: protocol, hardware (3), firmware (3), unreleased; firmware 0.6, and answered by some 0.5
- 01h: heartbeat: error bits u32, state u8, three bytes that depend on the firmware
- 03h, on request: 0.5: motor error u64; 0.6: active errors u32, reason of the last disarming u32
- 04h, 1Dh, on request: 0.5: encoder error u32, controller error u32. 0.6: 04h and 05h carry parameters, not used
- 06h, on request: 0.6: node u8, serial number 48 bits. 0.5: a 06h of the host changes the node's number, so it is not
  sent
- 09h: estimates: position f32 turns, speed f32 turns/s

From the host:

- 02h: emergency stop: error bit, no torque
- 07h: state of the axis u32: 1 idle, 8 closed-loop control
- 0Bh: control mode u32 (2 velocity), input mode u32 (1 passthrough: no ramp of the controller)
- 0Dh: speed f32 turns/s, torque feed-forward f32 (always 0)
- 18h: clears the errors

Position of the serial number's bytes: message file [S]; spelling as 12 digits, highest byte first [U]. Further facts:
docs/protocols/odrive.md.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from daq.transports.can_frames import CanFrame

VERSION, HEARTBEAT, ESTOP = 0x00, 0x01, 0x02
ERRORS, ENCODER_ERROR, CONTROLLER_ERROR = 0x03, 0x04, 0x1D
"""Commands of error codes. Firmware 0.5: motor, encoder and controller errors. Firmware 0.6: 03h contains all."""
ADDRESS = 0x06
"""Firmware 0.6: node and serial number. With firmware 0.5 it *changes the node's number* and must not be sent."""
AXIS_STATE, ESTIMATES, CONTROLLER_MODE, INPUT_VELOCITY, CLEAR_ERRORS = 0x07, 0x09, 0x0B, 0x0D, 0x18
COMMANDS = (ESTOP, AXIS_STATE, CONTROLLER_MODE, INPUT_VELOCITY, CLEAR_ERRORS)
"""Commands that only a host sends."""

IDLE, CLOSED_LOOP = 1, 8
VELOCITY_CONTROL, PASSTHROUGH = 2, 1
"""Control mode and input mode: the set-point is used without a ramp or filter of the controller."""

WATCHDOG = {"0.5": 0x800, "0.6": 0x0100_0000}
"""Bit of the expired watchdog in an axis' error code, by firmware."""
INITIALIZING = 0x1
"""Bit of firmware 0.6: the controller is starting."""

STATES = {
    0: "UNDEFINED",
    1: "IDLE",
    2: "STARTUP SEQUENCE",
    3: "FULL CALIBRATION",
    4: "MOTOR CALIBRATION",
    5: "SENSORLESS CONTROL",
    6: "ENCODER INDEX SEARCH",
    7: "ENCODER OFFSET CALIBRATION",
    8: "CLOSED LOOP CONTROL",
    9: "LOCK-IN SPIN",
    10: "ENCODER DIRECTION SEARCH",
    11: "HOMING",
    12: "HALL POLARITY CALIBRATION",
    13: "HALL PHASE CALIBRATION",
    14: "ANTICOGGING CALIBRATION",
}
"""States of an axis."""

_HEARTBEAT = struct.Struct("<IB3s")
_TWO_REALS = struct.Struct("<ff")
_TWO_WORDS = struct.Struct("<II")
_MAX_REAL = 3.4028234663852886e38  # largest number of 32 bits


def identifier(node: int, command: int) -> int:
    """Return the identifier of a command's frame."""
    return node << 5 | command


def split(arbitration_id: int) -> tuple[int, int]:
    """Return node and command of an identifier."""
    return arbitration_id >> 5, arbitration_id & 0x1F


# --- from the host --------------------------------------------------------------------------------------------


def request(node: int, command: int) -> CanFrame:
    """Return the request of a report of 8 bytes."""
    return CanFrame(identifier(node, command), bytes(8), remote=True)


def set_velocity(node: int, turns_per_s: float) -> CanFrame:
    """Return the command of a speed, turns/s of the motor, without torque feed-forward.

    Raises:
        ValueError: the speed is not a finite number of 32 bits.
    """
    if not abs(turns_per_s) <= _MAX_REAL:
        raise ValueError(f"expected a finite speed of 32 bits, got {turns_per_s:g} turns/s")
    return CanFrame(identifier(node, INPUT_VELOCITY), _TWO_REALS.pack(turns_per_s, 0.0))


def set_velocity_mode(node: int) -> CanFrame:
    """Return the command of velocity control with the set-point as it is sent."""
    return CanFrame(identifier(node, CONTROLLER_MODE), _TWO_WORDS.pack(VELOCITY_CONTROL, PASSTHROUGH))


def set_state(node: int, state: int) -> CanFrame:
    """Return the command of an axis' state; it has 8 bytes, of which the first four are used."""
    return CanFrame(identifier(node, AXIS_STATE), _TWO_WORDS.pack(state, 0))


def clear_errors(node: int) -> CanFrame:
    """Return the command that clears the errors; the byte is the request of firmware 0.6 to blink, here off."""
    return CanFrame(identifier(node, CLEAR_ERRORS), bytes(1))


def estop(node: int) -> CanFrame:
    """Return the command that removes the torque at once: the rotor runs down by itself."""
    return CanFrame(identifier(node, ESTOP))


def parse_velocity(frame: CanFrame) -> float | None:
    """Return the speed, turns/s, in a command of a speed; None if the frame is too short or not a finite number."""
    if len(frame.data) < 4:
        return None
    (turns_per_s,) = struct.unpack_from("<f", frame.data)
    return float(turns_per_s) if math.isfinite(turns_per_s) else None


def parse_state(frame: CanFrame) -> int | None:
    """Return the state in a command of a state; None if the frame is too short."""
    return int.from_bytes(frame.data[:4], "little") if len(frame.data) >= 4 else None


# --- from the controller --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Heartbeat:
    """A heartbeat.

    Attributes:
        error: error bits of the axis; of firmware 0.6 the active errors and the reason of the last disarming.
        state: state of the axis, a key of STATES.
        flags: the three other bytes. Firmware 0.5: error flags of motor, encoder and controller. Firmware 0.6: result
            of the last procedure, flag of a finished trajectory, reserved.
    """

    error: int
    state: int
    flags: bytes = bytes(3)


def parse_heartbeat(data: bytes) -> Heartbeat | None:
    """Parse a heartbeat; None if it does not have 8 bytes."""
    return Heartbeat(*_HEARTBEAT.unpack(data)) if len(data) == _HEARTBEAT.size else None


def pack_idle() -> bytes:
    """Return the 8 bytes of the heartbeat of an idle axis without an error."""
    return _HEARTBEAT.pack(0, IDLE, bytes(3))


def parse_estimates(data: bytes) -> tuple[float, float] | None:
    """Return position, turns, and speed, turns/s; None if there are not 8 bytes or not two finite numbers."""
    if len(data) != _TWO_REALS.size:
        return None
    position, speed = _TWO_REALS.unpack(data)
    return (position, speed) if math.isfinite(position) and math.isfinite(speed) else None


def parse_errors(firmware: str, command: int, data: bytes) -> dict[str, int]:
    """Return the error codes in an answer, by name; empty if the frame is not an answer about errors."""
    if firmware == "0.6":
        if command != ERRORS or len(data) != _TWO_WORDS.size:
            return {}
        active, reason = _TWO_WORDS.unpack(data)
        return {"active_errors": active, "disarm_reason": reason}
    name = {ERRORS: "motor_error", ENCODER_ERROR: "encoder_error", CONTROLLER_ERROR: "controller_error"}.get(command)
    return {name: int.from_bytes(data, "little")} if name is not None and len(data) in (4, 8) else {}


def error_requests(node: int, firmware: str) -> list[CanFrame]:
    """Return the requests of the error codes."""
    commands = (ERRORS,) if firmware == "0.6" else (ERRORS, ENCODER_ERROR, CONTROLLER_ERROR)
    return [request(node, command) for command in commands]


@dataclass(frozen=True)
class Version:
    """Version of a controller.

    Attributes:
        hardware: major, minor and variant of the hardware.
        firmware: major, minor and revision of the firmware.
    """

    hardware: tuple[int, int, int]
    firmware: tuple[int, int, int]

    @property
    def series(self) -> str:
        """Major and minor version of the firmware, as in the rig file."""
        return f"{self.firmware[0]}.{self.firmware[1]}"


def parse_version(data: bytes) -> Version | None:
    """Parse the answer to a request of the version; None if it does not have 8 bytes."""
    if len(data) != 8:
        return None
    return Version((data[1], data[2], data[3]), (data[4], data[5], data[6]))


def pack_version(version: Version) -> bytes:
    """Return the 8 bytes of an answer with a version, protocol version 2."""
    return bytes([2, *version.hardware, *version.firmware, 0])


def parse_address(data: bytes) -> tuple[int, str] | None:
    """Return node and serial number (12 hexadecimal digits) of an address message of firmware 0.6; None if invalid."""
    if len(data) not in (7, 8):  # the connection number of newer firmware follows
        return None
    return data[0], data[1:7][::-1].hex().upper()


def pack_address(node: int, serial: str) -> bytes:
    """Return the 8 bytes of an address message."""
    return bytes([node]) + bytes.fromhex(serial)[::-1] + bytes(1)


# --- errors ---------------------------------------------------------------------------------------------------

# bits 2h to 20h: firmware before 0.5.2
_ERRORS = {
    "0.5": {
        0x1: "invalid state requested",
        0x2: "supply under-voltage",
        0x4: "supply over-voltage",
        0x8: "current measurement",
        0x10: "brake resistor disarmed",
        0x20: "motor disarmed",
        0x40: "motor failed",
        0x80: "sensorless estimator failed",
        0x100: "encoder failed",
        0x200: "controller failed",
        0x800: "watchdog expired: no command of the host came in time",
        0x1000: "lower end switch",
        0x2000: "upper end switch",
        0x4000: "emergency stop requested",
        0x20000: "homing without end switch",
        0x40000: "over-temperature",
        0x80000: "unknown position",
    },
    "0.6": {
        0x1: "initializing",
        0x2: "system level",
        0x4: "timing",
        0x8: "missing estimate",
        0x10: "bad configuration",
        0x20: "gate driver",
        0x40: "missing input",
        0x100: "supply over-voltage",
        0x200: "supply under-voltage",
        0x400: "supply over-current",
        0x800: "supply over-current while braking",
        0x1000: "current limit",
        0x2000: "over-temperature of the motor",
        0x4000: "over-temperature of the inverter",
        0x8000: "velocity limit",
        0x10000: "position limit",
        0x1000000: "watchdog expired: no command of the host came in time",
        0x2000000: "emergency stop requested",
        0x4000000: "spin-out: the encoder slips or is badly calibrated",
        0x8000000: "brake resistor disarmed",
        0x10000000: "thermistor disconnected",
        0x40000000: "calibration",
    },
}


def error_words(firmware: str, code: int) -> str:
    """Return an axis' error code with the meaning of its bits."""
    names = _ERRORS[firmware]
    bits = [1 << n for n in range(32) if code >> n & 1]
    return f"0x{code:08X}, " + "; ".join(names.get(bit, f"unknown bit 0x{bit:X}") for bit in bits)

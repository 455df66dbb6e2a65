"""Commands to a VESC and its answers: a pure codec without line and clock.

A payload consists of a command byte and big-endian numbers. An answer begins with the command that it answers. Both
directions are encoded and decoded here, because simulated and played controllers use the codec too.

- ``00``: firmware; answer ``00``, major u8, minor u8, hardware's name ended by ``00``, processor's number 12 bytes;
  newer firmware appends more, old (2.x) ends after minor [U]
- ``04``: query of the values; does not reset the timeout [S]
- ``06`` i32: motor current, mA; only 0: release the motor
- ``07`` i32: brake current, mA
- ``08`` i32: hold an electrical speed, rpm
- ``1E``: alive: continue with the last command; not used

Answer to ``04``, offsets in the payload [S, one real answer]: 1 temperatures i16 i16; 5 motor current i32 × 100; 9
input current; 13 and 17 currents d and q; 21 duty i16 × 1000; 23 electrical rpm i32; 27 supply voltage i16 × 10; 29 Ah
drawn, 33 Ah charged, 37 Wh drawn, 41 Wh charged, each i32 × 10⁴; 45 steps i32; 49 steps in both directions together
i32; 53 fault u8; 54 position i32; 58 controller's number u8; 59 three temperatures i16; 65 voltages d and q i32; 73
status u8 (bit 0: timed out, bit 1: kill switch open), from firmware 5.3 on. Fault codes to 18: several sources agree
[S]; 19 to 25 are from one [U].
Facts and their sources: docs/protocols/vesc.md.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from rig_drivers.vesc.packets import packet

FIRMWARE_VERSION, GET_VALUES = 0, 4
SET_CURRENT, SET_BRAKE, SET_RPM, ALIVE = 6, 7, 8, 30

TIMED_OUT, KILL_SWITCH = 0x01, 0x02
"""Bits of a controller's status byte: the timeout has released the motor; the kill switch is open."""
OBSTACLES = TIMED_OUT | KILL_SWITCH
"""Bits that show that a command is not carried out. The meaning of the others is unknown: they are no obstacle."""

_NUMBER = struct.Struct(">Bi")
_VALUES = struct.Struct(">hhiiiihihiiiiiiB")  # after the command byte, up to the fault code
_TAIL = struct.Struct(">iB3hii")  # position, number of the controller, three temperatures, voltages d and q
VALUES_BYTES = 1 + _VALUES.size
_STATUS_AT = VALUES_BYTES + _TAIL.size
_MA = 1000.0  # currents on the wire are in mA
_I32 = 2**31


# --- commands --------------------------------------------------------------------------------------------------


def firmware_version() -> bytes:
    """Encode a query of firmware and hardware; it does not reset the timeout."""
    return packet(bytes([FIRMWARE_VERSION]))


def get_values() -> bytes:
    """Encode a query of speed, fault and the other values; it does not reset the timeout."""
    return packet(bytes([GET_VALUES]))


def set_rpm(erpm: int) -> bytes:
    """Encode the command to hold an electrical speed, rpm; the controller approaches it without a ramp.

    Raises:
        ValueError: the speed does not fit 32 bits.
    """
    return _command(SET_RPM, erpm)


def set_brake(amperes: float) -> bytes:
    """Encode the command to brake with a motor current, A.

    Raises:
        ValueError: the current is below 0, or does not fit 32 bits in mA.
    """
    if not amperes >= 0:
        raise ValueError(f"expected a brake current of at least 0 A, got {amperes:g}")
    return _command(SET_BRAKE, round(amperes * _MA))


def release() -> bytes:
    """Encode the command for no current: the rotor turns freely."""
    return _command(SET_CURRENT, 0)


def alive() -> bytes:
    """Encode the command to continue with the last command; it resets the timeout."""
    return packet(bytes([ALIVE]))


def _command(command: int, number: int) -> bytes:
    if not -_I32 <= number < _I32:
        raise ValueError(f"expected a number of 32 bits for command {command}, got {number}")
    return packet(_NUMBER.pack(command, number))


@dataclass(frozen=True)
class MotorCommand:
    """A command of the host to the motor.

    Attributes:
        what: SET_RPM, SET_BRAKE or SET_CURRENT.
        number: electrical speed, rpm, or current, mA.
    """

    what: int
    number: int


def parse_command(payload: bytes) -> MotorCommand | None:
    """Parse a command to the motor; None if the payload is not such a command."""
    if len(payload) != _NUMBER.size or payload[0] not in (SET_RPM, SET_BRAKE, SET_CURRENT):
        return None
    return MotorCommand(*_NUMBER.unpack(payload))


# --- answers ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Values:
    """The values of a controller's answer to GET_VALUES that the rig uses.

    Attributes:
        erpm: electrical speed, rpm.
        motor_A: motor current, A.
        input_V: supply voltage, V.
        duty: duty cycle, dimensionless.
        charges: Ah drawn and charged, Wh drawn and charged since the controller started, in units of 1e-4; they never
            decrease.
        turned: number of steps of the motor in both directions since the controller started; it never decreases, and
            wraps at 2³².
        fault: fault code; 0 without a fault.
        status: bits TIMED_OUT, KILL_SWITCH; None for firmware that does not send them (before 5.3).
    """

    erpm: int = 0
    motor_A: float = 0.0
    input_V: float = 0.0
    duty: float = 0.0
    charges: tuple[int, int, int, int] = (0, 0, 0, 0)
    turned: int = 0
    fault: int = 0
    status: int | None = None


def parse_values(payload: bytes) -> Values | None:
    """Parse the answer to GET_VALUES; None if it is too short, as from firmware before 3."""
    if len(payload) < VALUES_BYTES or payload[0] != GET_VALUES:
        return None
    _, _, motor, _, _, _, duty, erpm, volts, *charges, _, turned, fault = _VALUES.unpack_from(payload, 1)
    drawn_Ah, charged_Ah, drawn_Wh, charged_Wh = charges
    return Values(
        erpm=erpm,
        motor_A=motor / 100.0,
        input_V=volts / 10.0,
        duty=duty / 1000.0,
        charges=(drawn_Ah, charged_Ah, drawn_Wh, charged_Wh),
        turned=turned % 2**32,
        fault=fault,
        status=payload[_STATUS_AT] if len(payload) > _STATUS_AT else None,
    )


def pack_values(values: Values) -> bytes:
    """Return the payload of a controller's answer to GET_VALUES; without status byte if `status` is None."""
    turned = (values.turned + _I32) % 2**32 - _I32
    motor = round(values.motor_A * 100)
    head = _VALUES.pack(
        250,
        250,
        motor,
        round(motor * abs(values.duty)),
        0,
        motor,
        round(values.duty * 1000),
        values.erpm,
        round(values.input_V * 10),
        *values.charges,
        0,
        turned,
        values.fault,
    )
    tail = _TAIL.pack(0, 0, 250, 250, 250, 0, 0)
    status = b"" if values.status is None else bytes([values.status])
    return bytes([GET_VALUES]) + head + tail + status


def restarted(before: Values, after: Values) -> bool:
    """Whether a controller restarted between two answers: a counter that never decreases has decreased.

    The restart of a controller that had not turned or drawn anything since its last start is not detected.
    """
    back = (after.turned - before.turned) % 2**32 >= _I32
    return back or any(new < old for old, new in zip(before.charges, after.charges, strict=True))


@dataclass(frozen=True)
class Firmware:
    """Identification of a controller.

    Attributes:
        major, minor: version of the firmware.
        hardware: name of the hardware.
        serial: number of the processor as hexadecimal digits.
    """

    major: int
    minor: int
    hardware: str
    serial: str

    @property
    def facts(self) -> dict[str, str]:
        """The identification as an identity has it."""
        version = f"{self.major}.{self.minor:02d}"
        return {"firmware": version, "hardware": self.hardware, "serial": self.serial}


def parse_firmware(payload: bytes) -> Firmware | None:
    """Parse the answer to FIRMWARE_VERSION; None if it has no hardware name, as from very old firmware."""
    if len(payload) < 4 or payload[0] != FIRMWARE_VERSION or 0 not in payload[3:]:
        return None
    end = payload.index(0, 3)
    name = "".join(chr(byte) if 0x20 <= byte < 0x7F else "?" for byte in payload[3:end])
    return Firmware(payload[1], payload[2], name, payload[end + 1 : end + 13].hex())


def parse_identity(payload: bytes) -> Firmware | None:
    """Parse the answer to FIRMWARE_VERSION, also from old firmware that states only its version.

    Logs are decoded with `parse_firmware`, so that the facts of their replies stay the same.
    """
    if len(payload) < 3 or payload[0] != FIRMWARE_VERSION:
        return None
    return parse_firmware(payload) or Firmware(payload[1], payload[2], "not stated", "")


def pack_firmware(firmware: Firmware) -> bytes:
    """Return the payload of a controller's answer to FIRMWARE_VERSION."""
    name = firmware.hardware.encode("ascii") + b"\0"
    return bytes([FIRMWARE_VERSION, firmware.major, firmware.minor]) + name + bytes.fromhex(firmware.serial)


# --- faults ----------------------------------------------------------------------------------------------------

_FAULTS = {
    0: "none",
    1: "supply over-voltage: braking feeds the supply; it must take the energy, or the brake current be less",
    2: "supply under-voltage",
    3: "gate driver",
    4: "over-current",
    5: "over-temperature of the transistors",
    6: "over-temperature of the motor",
    7: "gate driver over-voltage",
    8: "gate driver under-voltage",
    9: "under-voltage of the processor",
    10: "it started again after a reset by its own watchdog",
    11: "rotor position sensor: its line",
    12: "rotor position sensor: sine and cosine too weak",
    13: "rotor position sensor: sine and cosine too strong",
    14: "its memory is damaged",
    15: "offset of current sensor 1",
    16: "offset of current sensor 2",
    17: "offset of current sensor 3",
    18: "unbalanced phase currents",
    19: "brake input",
    20: "resolver: loss of tracking",
    21: "resolver: degradation of signal",
    22: "resolver: loss of signal",
    23: "its stored application settings are damaged",
    24: "its stored motor settings are damaged",
    25: "rotor position sensor: no magnet",
}
"""Codes up to 18 agree among several sources; those above are from one source only."""


def fault_words(code: int) -> str:
    """Return a fault code with its meaning."""
    return f"{code}, {_FAULTS.get(code, 'not in the list of this software; see the firmware')}"

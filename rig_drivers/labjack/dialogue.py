"""Opening of a LabJack: identity, end of a stream that still runs, calibration constants, set-up and start.

- identity: product 60000, firmware 60004, serial 60028
- end of a running stream, else set-up is refused: 4990 = 0
- earlier programs are undone; refusals are accepted: trigger 4024 = 0, external clock 4014 = 0, power of inputs
  48005 = 1; a tachometer's line that is an output or, of a T4, analogue: one read of 2000 + line (FIO0 is 0, EIO0 is 8)
  makes it a digital input
- calibration from the flash: 61810 = 3C4000h, then 41 numbers (T7) or 19 (T4) at 61812
- inputs: single-ended 41000 + n = 199, range 40000 + 2n
- stream: scan rate 4002 (the rate kept is read back), inputs 4004, settling 4008 = 0, resolution 4010 = 0, buffer
  4012 = 32768 bytes, target 4016 = 16, 4018 = 0, endless 4020 = 0, scan list 4100 + 2i, start 4990 = 1

Identification of a LabJack on the network by the search request of its maker. It only reads registers.
"""

from __future__ import annotations

import logging
import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any

from daq.drivers.contract import Talk
from daq.drivers.identification import Announcement, FoundDevice, NetworkDevice
from daq.drivers.questions import TRIES, ask
from daq.errors import DeviceError
from daq.transports.port_names import network_port
from rig_basics.ignoring import ignoring
from rig_drivers.labjack import wire
from rig_drivers.labjack.scans import CONSTANTS_BYTES, T4_INPUTS, T4_MISSING_LINES, VoltScale, nominal, read_constants
from rig_drivers.labjack.settings import LabJack
from rig_drivers.labjack.wire import Register

_log = logging.getLogger(__name__)

ANSWER_S = 1.0
"""Wall time within which the device answers a command, s."""
_SINGLE_ENDED = 199


class RequestRefused(DeviceError):
    """The device refused a request; `code` is the value of its register LAST_ERROR, 0 if it did not state it."""

    def __init__(self, place: str, code: int) -> None:
        super().__init__(f"{place}: it refuses a command: {wire.explain(code)}")
        self.code = code


class Commands:
    """Commands of one dialogue, each with its own transaction number."""

    def __init__(self, talk: Talk, place: str) -> None:
        self._talk, self._place, self._number = talk, place, 0

    def ask(self, parts: Sequence[bytes]) -> bytes:
        """Send the parts of a request, again if no answer comes, and return the registers read.

        Raises:
            RequestRefused: the device refuses it.
            DeviceError: the device does not answer.
        """
        answer = self._answer(parts)
        if answer.function == wire.FEEDBACK:
            return answer.body
        detail = self._answer([wire.read(Register.LAST_ERROR, 1)])
        stated = detail.function == wire.FEEDBACK and len(detail.body) == 2
        raise RequestRefused(self._place, int.from_bytes(detail.body, "big") if stated else 0)

    def _answer(self, parts: Sequence[bytes]) -> wire.Message:
        self._number = (self._number + 1) % wire.FIRST_STREAM_ID

        def found_in(reply: str) -> wire.Message | None:
            (message,) = wire.MessageDecoder().feed(bytes.fromhex(reply)).messages
            return message if message.number == self._number else None

        message = ask(self._talk, wire.request(self._number, parts), found_in, ANSWER_S)
        if message is not None:
            return message
        raise DeviceError(
            f"{self._place}: no answer in {TRIES} tries. Is it a LabJack T4 or T7, and is the port that of its "
            "commands (502)?"
        )


def _u32(register: int, value: int) -> bytes:
    return wire.write(register, struct.pack(">I", value))


def _f32(register: int, value: float) -> bytes:
    return wire.write(register, struct.pack(">f", value))


def identify(device: str, settings: LabJack, commands: Commands) -> dict[str, Any]:
    """Query model, firmware and serial number, and compare them with the settings.

    Raises:
        DeviceError: another device than the rig file states, or one whose inputs are not those of the rig file.
        RequestRefused: the device refuses.
    """
    place = f"{device} on {settings.port}"
    answer = commands.ask(IDENTITY_READS)
    values = parse_identity(answer)
    if values is None:
        raise DeviceError(f"{place}: expected product, firmware and serial number, got {answer.hex()!r}")
    product, firmware, serial = values
    model = MODELS.get(product)
    if model is None:
        raise DeviceError(f"{place}: expected a LabJack T4 or T7, got product {product:g}")
    if settings.serial and serial != settings.serial_number:
        raise DeviceError(
            f"{place}: expected serial number {settings.serial} (devices.{device}.serial), got {serial}: another "
            "device is at this address"
        )
    if model == "T4":
        if settings.tacho is not None and settings.tacho.input in T4_MISSING_LINES:
            raise DeviceError(
                f"{place}: it is a T4, whose terminals have no {settings.tacho.input} (they are AIN0 … AIN3), expected "
                "a tachometer at FIO4 … FIO7 or EIO0 … EIO7"
            )
        wrong = [name for name, range_V in settings.ranges_V.items() if name not in T4_INPUTS or range_V != 10.0]
        if wrong:
            raise DeviceError(
                f"{place}: it is a T4, whose inputs for ±10 V are {', '.join(T4_INPUTS)} (range_V = 10.0), got "
                f"{', '.join(wrong)}"
            )
    return {"model": model, "device_serial": serial, "firmware": round(firmware, 4)}


def end_stream(commands: Commands) -> None:
    """End a stream that runs, such as that of a host that was killed. The device must not be set up while it runs.

    Raises:
        RequestRefused: the device refuses for another reason than that no stream runs.
        DeviceError: the device does not answer.
    """
    try:
        commands.ask([_u32(Register.STREAM_ENABLE, 0)])
    except RequestRefused as refusal:
        if refusal.code not in (wire.Status.STREAM_NOT_RUNNING, 0):
            raise


def constants(settings: LabJack, model: str, commands: Commands) -> dict[str, Any]:
    """Return the conversion of every analogue input as entries of the identity, with the origin of the numbers."""
    size = CONSTANTS_BYTES[model]
    parts = [_u32(Register.FLASH_POINTER, wire.FLASH_CONSTANTS), wire.read(Register.FLASH, size // 2)]
    found: dict[str, VoltScale | None] = dict.fromkeys(settings.ranges_V)
    reason = "the constants in the flash are impossible"
    try:
        data = commands.ask(parts)
        if len(data) == size:
            found = {name: read_constants(model, name, r, data) for name, r in settings.ranges_V.items()}
    except RequestRefused as refusal:
        reason = f"the flash cannot be read ({wire.explain(refusal.code)})"
    facts: dict[str, Any] = {}
    for name, scale in found.items():
        facts |= (scale or nominal(model, settings.ranges_V[name])).facts(name)
    lacking = sorted(name for name, scale in found.items() if scale is None)
    facts["constants"] = f"nominal for {', '.join(lacking)}: {reason}" if lacking else "from its flash"
    if lacking:
        facts["warning"] = (
            f"the scales of {', '.join(lacking)} are nominal ({reason}): voltages can be wrong by 1 %. Have the "
            "device's own calibration restored, or calibrate the sensors at these inputs"
        )
    return facts


def undo(settings: LabJack, commands: Commands) -> None:
    """Undo what an earlier program may have left: trigger, external clock, inputs without power, a line as output.

    Such a stream has no scans, other times, or an input without a signal. A device that does not know one of these
    registers cannot have been left so; models and firmwares differ. A line that is read alone becomes a digital input.

    Raises:
        DeviceError: the device does not answer.
    """
    parts = [
        _u32(Register.STREAM_TRIGGER, 0),
        _u32(Register.STREAM_CLOCK_SOURCE, 0),
        wire.write(Register.AIN_POWER, struct.pack(">H", 1)),
    ]
    if settings.tacho is not None and settings.tacho.is_digital:
        parts.append(wire.read(Register.DIGITAL_LINE + settings.tacho.line, 1))
    for part in parts:
        with ignoring(_log, "undoing what an earlier program left in a device", RequestRefused):
            commands.ask([part])


def start_stream(settings: LabJack, model: str, commands: Commands) -> float:
    """Set up the inputs and the stream, and start it.

    Returns:
        Scan rate that the device keeps, Hz.

    Raises:
        RequestRefused: the device refuses a setting.
        DeviceError: it answers with an impossible rate.
    """
    if model == "T7":
        for name, range_V in settings.ranges_V.items():
            place = int(name[3:])
            single = wire.write(Register.AIN_NEGATIVE + place, struct.pack(">H", _SINGLE_ENDED))
            commands.ask([_f32(Register.AIN_RANGE + 2 * place, range_V), single])
    inputs = settings.scan_list
    commands.ask(
        [
            _f32(Register.STREAM_SCAN_RATE_HZ, settings.scan_rate_Hz),
            _u32(Register.STREAM_ADDRESSES, len(inputs)),
            _u32(Register.STREAM_SAMPLES_PER_PACKET, wire.samples_per_read(len(inputs))),
            _f32(Register.STREAM_SETTLING_US, 0.0),
            _u32(Register.STREAM_RESOLUTION, 0),
            _u32(Register.STREAM_BUFFER_BYTES, wire.BUFFER_BYTES),
            _u32(Register.STREAM_TARGET, wire.TARGET_COMMAND),
            _u32(Register.STREAM_DATA_TYPE, 0),
            _u32(Register.STREAM_SCANS, 0),
        ]
    )
    commands.ask([wire.write(Register.STREAM_SCAN_LIST, struct.pack(f">{len(inputs)}I", *inputs))])
    answer = commands.ask([_u32(Register.STREAM_ENABLE, 1), wire.read(Register.STREAM_SCAN_RATE_HZ, 2)])
    (rate,) = struct.unpack(">f", answer) if len(answer) == 4 else (math.nan,)
    if not abs(rate / settings.scan_rate_Hz - 1) < 0.01:
        raise DeviceError(f"scan rate: expected {settings.scan_rate_Hz:g} Hz, the device states {rate:g}")
    return float(rate)


def open_device(device: str, settings: LabJack, talk: Talk) -> dict[str, Any]:
    """Query the identity, end an old stream, read the calibration constants, and start the stream.

    Returns:
        Identity: model, serial number of the device (its sensors have their own), firmware, the scale of every
        analogue input, and the scan rate.

    Raises:
        DeviceError: the device does not answer, refuses, or differs from the rig file.
    """
    commands = Commands(talk, f"{device} on {settings.port} (devices.{device})")
    identity = identify(device, settings, commands)
    end_stream(commands)
    identity |= constants(settings, identity["model"], commands)
    undo(settings, commands)
    return identity | {"scan_rate_Hz": start_stream(settings, identity["model"], commands)}


def stop_device(settings: LabJack, talk: Talk) -> None:
    """End the stream.

    Raises:
        DeviceError: the device does not answer, or refuses.
    """
    end_stream(Commands(talk, "LabJack"))


MODELS: Mapping[float, str] = {4.0: "T4", 7.0: "T7"}
"""Value of the register PRODUCT to model."""
IDENTITY_READS = tuple(wire.read(register, 2) for register in (Register.PRODUCT, Register.FIRMWARE, Register.SERIAL))
_IDENTITY = struct.Struct(">ffI")
_SEARCH_PORT = 52_362
"""UDP port on which the devices answer requests. Source: the maker's data sheet of the T series, Ethernet."""
_COMMAND_PORT = 502
_SEARCH_NUMBER = 0x5052
"""Transaction number of the search: an answer has it too."""


def parse_identity(registers: bytes) -> tuple[float, float, int] | None:
    """Return product, firmware and serial number from the answer to IDENTITY_READS; None if it is not one."""
    return _IDENTITY.unpack(registers) if len(registers) == _IDENTITY.size else None


def found(data: bytes, sender: str) -> NetworkDevice | None:
    """Parse a datagram that answers the search.

    Args:
        data: the datagram.
        sender: address from which it came.
    """
    messages = wire.MessageDecoder().feed(data).messages
    if len(messages) != 1 or (messages[0].number, messages[0].function) != (_SEARCH_NUMBER, wire.FEEDBACK):
        return None
    values = parse_identity(messages[0].body)
    if values is None or values[0] not in MODELS:
        return None
    product, firmware, serial = values
    identity = {"model": MODELS[product], "firmware": round(firmware, 4), "serial": serial}
    return NetworkDevice(network_port(sender, _COMMAND_PORT), FoundDevice({"serial": serial}, identity))


def announcement() -> Announcement:
    """Return how a device answers the search request of its maker."""
    return Announcement(0, found, wire.request(_SEARCH_NUMBER, IDENTITY_READS), _SEARCH_PORT)

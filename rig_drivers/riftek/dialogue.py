"""Set-up of an RF60x sensor: stop the stream, identify the sensor, write and verify its parameters, start the stream.

The line has no checksum. The identification is therefore requested until two consecutive answers are equal, and every
parameter is read back after writing. Parameters are written to the sensor's working memory only; its stored settings
are not changed. In this order: laser on (00h), control (02h) to sampling by time and averaging by number, averages
(06h), zero point 0 (17h, 18h), longest integration (0Ah, 0Bh) within the period, sampling period in µs (08h, 09h). The
bytes of a word are written in the order whose intermediate value is allowed.

Identification of an RF60x sensor on an unknown port. Reads only: a stream continues, no parameter is written.
"""

from __future__ import annotations

import re
from typing import Any

from daq.drivers.contract import Talk
from daq.drivers.displacement import compare_range
from daq.drivers.identification import FoundDevice, IdentityRequest, IdentityTurns
from daq.drivers.questions import ANSWER_S, TRIES, ask, stop_stream
from daq.errors import DeviceError
from rig_drivers.riftek import wire
from rig_drivers.riftek.settings import RiftekLaser


def configure(device: str, settings: RiftekLaser, talk: Talk) -> dict[str, Any]:
    """Stop the stream, identify the sensor, set its parameters and start the stream.

    Returns:
        Identity: type, firmware, serial, base_m, range_m, period_us, control.

    Raises:
        DeviceError: the sensor does not answer, a parameter cannot be written, or the sensor differs from the rig file.
    """
    if not stop_stream(talk, wire.request(settings.address, wire.STOP) + wire.request(wire.EVERYONE, wire.STOP)):
        raise DeviceError(
            f"{device} on {settings.port}: ordered several times to stop its stream, it goes on sending. Does its line "
            "carry commands too (both wire pairs of RS422), and does another program command it? Switch it "
            "off and on"
        )
    talk.restart_decoding()
    dialogue = _Dialogue(device, settings, talk)
    info = dialogue.identify()
    compare_range(device, settings, info.range_m, info.serial)
    dialogue.write(wire.POWER, 1, "laser on")
    control = dialogue.read(wire.CONTROL) & wire.CONTROL_KEPT
    dialogue.write(wire.CONTROL, control, "sampling by time, averaging by number")
    dialogue.write(wire.AVERAGES, settings.averages, "number of averaged results")
    dialogue.write_word(wire.ZERO, 0, wire.ZEROS, "zero point")
    integration = min(settings.period_us, wire.INTEGRATIONS_US[1])
    dialogue.write_word(wire.INTEGRATION, integration, wire.INTEGRATIONS_US, "longest integration time")
    dialogue.write_word(wire.PERIOD, settings.period_us, wire.PERIODS_US, "sampling period")
    talk.send(wire.request(settings.address, wire.START))
    return {
        "type": info.kind,
        "firmware": info.firmware,
        "serial": str(info.serial),
        "base_m": info.base_m,
        "range_m": info.range_m,
        "period_us": settings.period_us,
        "control": control,
    }


def stop(settings: RiftekLaser, talk: Talk) -> None:
    """Command every sensor on the line to stop streaming; sent twice because the command is not acknowledged."""
    talk.send(2 * wire.request(wire.EVERYONE, wire.STOP))


class _Dialogue:
    """Requests and their answers on a line without a stream."""

    def __init__(self, device: str, settings: RiftekLaser, talk: Talk) -> None:
        self._device, self._settings, self._talk = device, settings, talk

    def identify(self) -> wire.SensorIdentity:
        """Return the sensor's identification after two equal answers."""
        answers = [self._request(wire.IDENTIFY)]
        while len(answers) <= TRIES:
            answers.append(self._request(wire.IDENTIFY))
            if answers[-1] == answers[-2]:
                return wire.parse_info(answers[-1])
        raise DeviceError(
            f"{self._device} on {self._settings.port}: expected two equal answers to the request for identification, "
            f"got {', '.join(answer.hex() for answer in answers)}: look at cable, shield and termination"
        )

    def read(self, parameter: int) -> int:
        """Return the value of a parameter of one byte."""
        return self._request(wire.READ, bytes([parameter]))[0]

    def write(self, parameter: int, value: int, what: str) -> None:
        """Write a parameter of one byte and read it back."""
        found: list[int] = []
        for _ in range(TRIES):
            self._talk.send(wire.request(self._settings.address, wire.WRITE, bytes([parameter, value])))
            found.append(self.read(parameter))
            if found[-1] == value:
                return
        raise DeviceError(
            f"{self._device}: wrote {what} {value} (parameter {parameter:02X}h), read back "
            f"{', '.join(map(str, found))}: can this sensor do that?"
        )

    def write_word(self, parameter: int, value: int, bounds: tuple[int, int], what: str) -> None:
        """Write a parameter of two bytes, in the order for which the value between the two writes is within bounds."""
        high, low = (
            (parameter + 1, value >> 8, f"high byte of {what}"),
            (parameter, value & 0xFF, f"low byte of {what}"),
        )
        between = value & 0xFF00 | self.read(parameter)
        for each in (high, low) if bounds[0] <= between <= bounds[1] else (low, high):
            self.write(*each)

    def _request(self, code: int, message: bytes = b"") -> bytes:
        """Repeat a request until it is answered; return the answer."""
        settings = self._settings
        request = wire.request(settings.address, code, message)
        answer = ask(self._talk, request, bytes.fromhex)
        if answer is not None:
            return answer
        raise DeviceError(
            f"{self._device} on {settings.port}: no answer to request {code} of address {settings.address} within "
            f"{TRIES * ANSWER_S:g} s. "
            f"Is the sensor powered, is its baud rate {settings.baud}, its parity {settings.parity}, "
            "its address the rig file's, and its protocol RIFTEK's binary one?"
        )


_RUNS = re.compile(rb"[\x80-\x8F]+|[\x90-\x9F]+|[\xA0-\xAF]+|[\xB0-\xBF]+")
"""Bytes of packets that are not new results, by the packets' numbers."""


def identity_turns(settings: RiftekLaser) -> IdentityTurns:
    """Request the identification until two answers are equal, then read the sampling period.

    The line has no checksum, so two equal answers are required. Answers have another high half than the results of a
    stream, by which they are separated from it.
    """
    size = wire.ANSWER_BYTES[wire.IDENTIFY]
    request = IdentityRequest(
        wire.request(settings.address, wire.IDENTIFY), lambda data: answer_in(data, size) is not None
    )
    first = answer_in((yield request), size)
    if first is None:
        return None
    if answer_in((yield request), size) != first and answer_in((yield request), size) != first:
        return None
    try:
        info = wire.parse_info(first)
    except DeviceError:  # usual: another device
        return None
    known = {"range_m": info.range_m, "baud": settings.baud, "parity": settings.parity, "address": settings.address}
    period_us = 0
    for parameter in (wire.PERIOD + 1, wire.PERIOD):  # high byte first
        byte = answer_in((yield _reading(settings.address, parameter)), wire.ANSWER_BYTES[wire.READ])
        period_us = -1 if byte is None or period_us < 0 else period_us << 8 | byte[0]
    if wire.PERIODS_US[0] <= period_us <= wire.PERIODS_US[1]:
        known["rate_Hz"] = 1e6 / period_us
    return FoundDevice(known, {"type": info.kind, "firmware": info.firmware, "serial": info.serial})


def _reading(address: int, parameter: int) -> IdentityRequest:
    size = wire.ANSWER_BYTES[wire.READ]
    message = wire.request(address, wire.READ, bytes([parameter]))
    return IdentityRequest(message, lambda data: answer_in(data, size) is not None)


def answer_in(data: bytes, size: int) -> bytes | None:
    """Return the data of the first answer of a length among received bytes; None without such an answer.

    Args:
        data: received bytes; results of a stream may be among them.
        size: length of the answer on the line, bytes.
    """
    run = next((found[0] for found in _RUNS.finditer(data) if len(found[0]) == size), None)
    if run is None:
        return None
    return bytes(low & 0x0F | (high & 0x0F) << 4 for low, high in zip(run[::2], run[1::2], strict=True))

"""Identification of a VESC, before any command to its motor."""

from __future__ import annotations

from typing import Any

from daq.drivers.contract import Talk
from daq.drivers.questions import TRIES, ask
from daq.errors import DeviceError
from rig_basics.texts import number_of
from rig_drivers.vesc import wire
from rig_drivers.vesc.settings import VescMotor

_MIN_MAJOR = 3  # first major version of the firmware whose answers have the layout in `wire`


def identify(device: str, settings: VescMotor, talk: Talk, query: bytes, advice: str) -> dict[str, Any]:
    """Query firmware and hardware. The controller's set-up is not changed; it cannot be queried.

    Args:
        query: encoded query of the firmware.
        advice: what to look at if the controller does not answer.

    Returns:
        Identity: firmware, hardware, serial, and the values of the controller in the rig file.

    Raises:
        DeviceError: the controller does not answer, or its firmware's answers have another layout.
    """
    heard: list[str] = []

    def found_in(reply: str) -> wire.Firmware | None:
        try:
            return wire.parse_identity(bytes.fromhex(reply))
        except ValueError:  # usual: words, no payload: what else is on the line
            heard.append(reply)
            return None

    firmware = ask(talk, query, found_in)
    if firmware is not None:
        if firmware.major < _MIN_MAJOR:
            raise DeviceError(
                f"{device}: firmware {firmware.major}.{firmware.minor:02d} answers in an unknown layout, "
                f"expected {_MIN_MAJOR}.00 or later. Update the controller's firmware"
            )
        return {
            "firmware": f"{firmware.major}.{firmware.minor:02d}",
            "hardware": firmware.hardware,
            "serial": firmware.serial,
            "pole_pairs": settings.pole_pairs,
            "timeout_s": settings.timeout_s,
        }
    came = f"{number_of(talk.bytes_in, 'byte')} came, none of them an answer" if talk.bytes_in else "nothing came"
    also = f", but {', '.join(heard)}" if heard else ""
    raise DeviceError(
        f"{device} on {settings.port}: expected its firmware's version, {came} in {TRIES} tries{also}. {advice}"
    )

# pyright: strict
"""Asking a VESC who it is, before anything is asked of its motor."""

from __future__ import annotations

import queue
from typing import Any

from daq.drivers.contract import Talk
from daq.drivers.vesc import wire
from daq.drivers.vesc.settings import Vesc
from daq.errors import DeviceError

_ANSWER_S = 0.5  # wall seconds
_TRIES = 3
_OLDEST = 3  # major number of the firmware whose answers have the layout in `wire`


def identify(device: str, settings: Vesc, talk: Talk) -> dict[str, Any]:
    """Ask for firmware and hardware. Nothing of the controller's set-up is changed, nor can it be asked for.

    Returns:
        Identity: firmware, hardware, serial, and what the rig file states of the controller.

    Raises:
        DeviceError: no answer, or firmware whose answers are laid out in another way.
    """
    while not talk.replies.empty():
        talk.replies.get_nowait()
    for _ in range(_TRIES):
        talk.send(wire.firmware_version())
        firmware = _answer(talk)
        if firmware is None:
            continue
        if firmware.major < _OLDEST:
            raise DeviceError(
                f"{device}: firmware {firmware.major}.{firmware.minor:02d} answers in a layout that is not known here, "
                f"expected {_OLDEST}.00 or later. Update the controller's firmware"
            )
        return {
            "firmware": f"{firmware.major}.{firmware.minor:02d}",
            "hardware": firmware.hardware,
            "serial": firmware.serial,
            "pole_pairs": settings.pole_pairs,
            "timeout_s": settings.timeout_s,
        }
    came = f"{talk.bytes_in} bytes came, none of them an answer" if talk.bytes_in else "nothing came"
    raise DeviceError(
        f"{device} on {settings.port}: expected its firmware's version, {came} in {_TRIES} tries. Is the controller "
        f"powered, its serial port enabled at {settings.baud} baud, are both wires right?"
    )


def _answer(talk: Talk) -> wire.Firmware | None:
    """The next answer that is one, if it comes in time."""
    deadline = talk.clock.wall_s() + _ANSWER_S
    while (left := deadline - talk.clock.wall_s()) > 0:
        try:
            firmware = wire.parse_firmware(bytes.fromhex(talk.replies.get(timeout=left)))
        except queue.Empty:
            return None
        if firmware is not None:
            return firmware
    return None

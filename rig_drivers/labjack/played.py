"""Stand-in for a LabJack of a log while the log is played."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

from daq.drivers.played import PlayedDevice
from daq.errors import DeviceError, LogError
from rig_drivers.labjack import wire
from rig_drivers.labjack.settings import LabJack
from rig_drivers.labjack.volts import BLANK_FLASH, VoltScale, encode_constants, nominal
from rig_drivers.labjack.wire import Register


class PlayedLabJack(PlayedDevice):
    """A device that answers the opening dialogue as that of the log did, and then plays its answers at their times.

    Args:
        settings: table of the device in the rig file.
        identity: of the device of the log.

    Raises:
        LogError: the identity is impossible.
    """

    expects = "the command that starts the stream"

    def __init__(self, settings: LabJack, identity: Mapping[str, Any]) -> None:
        super().__init__(sends=False)
        model = identity.get("model", "T7")
        if model not in ("T4", "T7"):
            raise LogError(f"identities.json: expected the model T4 or T7, got {model!r:.40}")
        try:
            scales = {
                name: VoltScale.of(identity, name) or nominal(model, range_V)
                for name, range_V in settings.ranges_V.items()
            }
            answers = {
                Register.PRODUCT: struct.pack(">f", float(model[1:])),
                Register.FIRMWARE: struct.pack(">f", float(identity.get("firmware", 0.0))),
                Register.SERIAL: struct.pack(">I", int(identity.get("device_serial", settings.serial_number))),
                Register.STREAM_SCAN_RATE_HZ: struct.pack(">f", identity.get("scan_rate_Hz", settings.scan_rate_Hz)),
            }
        except (struct.error, TypeError, ValueError, OverflowError, DeviceError) as fault:
            raise LogError(f"identities.json: expected the identity of a LabJack: {fault}") from fault
        of_place = {name if model == "T4" else settings.ranges_V[name]: scale for name, scale in scales.items()}
        blank = str(identity.get("constants", "")).startswith("nominal")
        flash = BLANK_FLASH if blank else encode_constants(model, of_place)
        self._registers: dict[int, bytes] = {**answers, Register.FLASH: flash}

    def hear(self, data: bytes) -> bytes:
        """See PlayedDevice. Stream reads, and reads of their errors, are not answered: the log has their answers."""
        out = b""
        for message in wire.MessageDecoder().feed(data).messages:
            if message.number >= wire.ERROR_NUMBER:
                continue
            self.commands += 1
            out += wire.encode(wire.Message(message.number, wire.FEEDBACK, self._carry_out(message.body)))
        return out

    def _carry_out(self, body: bytes) -> bytes:
        out = b""
        for register, count, value in wire.parts_of(body):
            if value is None:
                out += self._registers.get(register, b"").ljust(2 * count, b"\0")[: 2 * count]
            elif register == Register.STREAM_ENABLE:
                self._sends = any(value)
        return out

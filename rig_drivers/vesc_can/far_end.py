"""A simulated VESC on a CAN bus behind an slcan adapter: the simulated controller with the frames of the bus.

Stand-in for a VESC on a CAN bus of a log while the log is played.
"""

from __future__ import annotations

import binascii
from collections.abc import Container, Iterable, Mapping
from typing import Any, ClassVar

from typing_extensions import override

from daq.drivers.can_lines import Adapter, PlayedOnBus
from daq.drivers.simulated import FaultKind
from daq.drivers.simulated_motor import Periodic
from daq.transports.can_frames import CanFrame, encode
from daq.virtual_rig.motion import SimulatedMotion
from rig_drivers.vesc import wire as vesc
from rig_drivers.vesc.far_end import SimulatedVesc, firmware_of
from rig_drivers.vesc_can import wire
from rig_drivers.vesc_can.settings import VescCan

_SERIAL_COMMAND = {1: 6, 2: 7, 3: 8}  # current, brake, speed: command on the bus and on the serial port


class SimulatedVescCan(SimulatedVesc):
    """See SimulatedVesc. It encodes frames by its own path, not by the host's codec."""

    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        **SimulatedVesc.fault_kinds,
        "silent status": FaultKind("it sends no status by itself; it still answers"),
        "second host": FaultKind("another node on the bus commands the controller"),
    }

    def __init__(self, settings: VescCan, motion: SimulatedMotion, **far: Any) -> None:
        self._bus, self._adapter = settings, Adapter()
        self._statuses = Periodic()
        super().__init__(settings, motion, **far)

    @override
    def receive(self, data: bytes, now_s: float) -> bytes:
        self._passed_s(now_s)
        frames, out = self._adapter.receive(data), b""
        for frame in frames:
            command, number = divmod(frame.arbitration_id, 256)
            if not frame.extended or number != self._bus.controller_id or not self.line_alive:
                continue
            if command in _SERIAL_COMMAND and len(frame.data) == 4:
                self._answer(bytes([_SERIAL_COMMAND[command]]) + frame.data)
            elif command == 8 and len(frame.data) > 2 and frame.data[1] == 0:
                out += self._send(self._answer(frame.data[2:]), frame.data[0])
        return out

    def _send(self, payload: bytes, host: int) -> bytes:
        """Return the frames of an answer, as text."""
        if not payload or not self._adapter.open:
            return b""
        frames = [(5, bytes([at]) + payload[at : at + 7]) for at in range(0, len(payload), 7)]
        check = binascii.crc_hqx(payload, 0)
        frames.append((7, bytes([self._bus.controller_id, 1, 0, len(payload), check >> 8, check & 0xFF])))
        return encode(*(CanFrame(command * 256 + host, data, extended=True) for command, data in frames))

    def step(self, now_s: float) -> bytes:
        """Update the controller up to `now_s`; return the status messages that are due."""
        super().step(now_s)
        out = b""
        due = self._statuses.due(self._now_s, 1 / self._bus.status_Hz) if self._bus.status_Hz else 0
        for _ in range(due if self._adapter.open else 0):
            if self.line_alive and not self._faults["silent status"]:
                values = self.values
                data = values.erpm.to_bytes(4, "big", signed=True)
                data += round(values.motor_A * 10).to_bytes(2, "big", signed=True)
                data += round(values.duty * 1000).to_bytes(2, "big", signed=True)
                out += encode(CanFrame(0x900 + self._bus.controller_id, data, extended=True))
            if self._faults["second host"]:
                data = (7000).to_bytes(4, "big")
                out += encode(CanFrame(0x300 + self._bus.controller_id, data, extended=True))
        return out


class _CommandsTo(Container[int]):
    """The identifiers of all commands to a controller."""

    def __init__(self, controller_id: int) -> None:
        self._number = controller_id

    def __contains__(self, arbitration_id: object) -> bool:
        return isinstance(arbitration_id, int) and wire.split(arbitration_id)[1] == self._number


class PlayedVescCan(PlayedOnBus):
    """A VESC that reports its identity; its other messages, and so its speed, are those of the log.

    Args:
        settings: table of the controller in the rig file.
        identity: identity of the controller from its opening.
    """

    expects = "the opening of the bus"

    def __init__(self, settings: VescCan, identity: Mapping[str, Any]) -> None:
        super().__init__(_CommandsTo(settings.controller_id))
        self._settings, self._firmware = settings, vesc.pack_firmware(firmware_of(identity))

    @override
    def answers(self, frame: CanFrame) -> Iterable[CanFrame]:
        command, number = wire.split(frame.arbitration_id)
        if number != self._settings.controller_id:
            return ()
        self.unfollowed += command == wire.SET_RPM
        asks = wire.payload_of(frame) == bytes([vesc.FIRMWARE_VERSION])
        return wire.pieces(self._firmware, number, self._settings.host_id) if asks else ()

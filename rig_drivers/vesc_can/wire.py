"""Frames between a host and a VESC on a CAN bus: a pure codec without bus and clock.

The identifier has 29 bits: command << 8 | number of the receiver, or of the sender of a status. Numbers are big-endian
[S]. "51 A to controller 23" is 0117h with ``00 00 C7 38`` [S]; "3000 electrical rpm" is 0317h with ``00 00 0B B8``, on
the line ``T00000317400000BB8`` [M]. From the host:

- 1: motor current i32, mA; only 0: release the motor
- 2: brake current i32, mA
- 3: hold an electrical speed i32, rpm. The document's table has a scale of 1000; its example and the firmware have
  1 [S]
- 8, from both: payload of up to 6 bytes: number of the sender, 0 (answer to the sender) or 1 (an answer), payload

From the controller:

- 5, 6: piece of an answer: offset u8 (6: u16), up to 7 (6) bytes. It does not contain its sender.
- 7: end of an answer: number of the sender, 1, length u16, CRC-16/XMODEM u16 of the payload
- 9: status, by itself: electrical speed i32 in rpm, current i16 × 10, duty cycle i16 × 1000
- 57: its start, once, from firmware 6 on: name of the hardware, up to 8 bytes [S, its firmware]

Payloads of 5 to 8 are those of the serial port: queries of firmware and values (11 pieces and an end). Other status
messages (14, 15, 16, 27, and 58, in the document 28) are ignored. Further facts: docs/protocols/vesc_can.md.
"""

from __future__ import annotations

import binascii
import struct

from daq.transports.can_frames import CanFrame, encode
from rig_drivers.vesc import wire as vesc
from rig_drivers.vesc.packets import MAX_PAYLOAD

SET_CURRENT, SET_BRAKE, SET_RPM = 1, 2, 3
FILL, FILL_LONG, PROCESS, SHORT = 5, 6, 7, 8
"""Pieces of a payload: with an offset of 8 and of 16 bits; its end with length and CRC; a payload of up to 6 bytes."""
STATUS = 9
BOOT = 57
"""Message of a controller that has started, from firmware 6 on; its data are the name of the hardware."""
EVERY = 255
"""Number of a receiver that stands for every controller."""

_MOVES = frozenset({0, SET_CURRENT, SET_BRAKE, SET_RPM, 4, 10, 11, 12, 13})
"""Commands to the motor: duty cycle, currents, speed, position, hand brakes. They reset the timeout."""
_CHANGES = frozenset({19, 21, 22, 23, 24, 25, 26, 29, 30, 31})
"""Measurement of the motor, new limits of currents and speeds, new limits of the supply's voltage, shutdown."""
_QUERIES = frozenset({0, 4, 14, 15, 17, 18, 31, 32, 33, 47, 50, 51, 62, 65})
"""Payloads that only query: firmware, values, settings, inputs, other nodes, sensor of motion."""
_ANSWERED = 1  # second byte of the end of an answer
_ANSWER = 0  # second byte of a query: answer to the sender on the bus
_SIMPLE = {SET_CURRENT: vesc.SET_CURRENT, SET_BRAKE: vesc.SET_BRAKE, SET_RPM: vesc.SET_RPM}


def split(arbitration_id: int) -> tuple[int, int]:
    """Return command and number of an identifier."""
    return arbitration_id >> 8, arbitration_id & 0xFF


def frame(command: int, number: int, data: bytes) -> CanFrame:
    """Return the frame of a command to a receiver."""
    return CanFrame(command << 8 | number, data, extended=True)


def on_bus(command: bytes, controller_id: int, host_id: int) -> bytes:
    """Return the frame of a command to a controller or a query of it, given as a packet of the serial port."""
    payload = command[2:-3]
    commands = {serial: bus for bus, serial in _SIMPLE.items()}
    if payload[0] in commands:
        return encode(frame(commands[payload[0]], controller_id, payload[1:]))
    return encode(frame(SHORT, controller_id, bytes([host_id, _ANSWER]) + payload))


def payload_of(sent: CanFrame) -> bytes | None:
    """Return a frame of a host as the payload that it would have on the serial port; None for other frames."""
    command, _ = split(sent.arbitration_id)
    if command in _SIMPLE and len(sent.data) == 4:
        return bytes([_SIMPLE[command]]) + sent.data
    return sent.data[2:] if command == SHORT and len(sent.data) > 2 else None


def is_command(sent: CanFrame) -> bool:
    """Return whether a frame of a host acts on its receiver: on the motor, on its timeout or on its settings.

    A payload in pieces is longer than any query, so its end counts as a command unless it is an answer.
    """
    command, _ = split(sent.arbitration_id)
    if command in (PROCESS, SHORT) and len(sent.data) > 2:
        queries = command == SHORT and sent.data[2] in _QUERIES
        return sent.data[1] != _ANSWERED and not queries
    return command in _MOVES | _CHANGES


def parse_status(data: bytes) -> int | None:
    """Return the electrical speed, rpm, of a status that a controller sends by itself; None without its 8 bytes."""
    return int.from_bytes(data[:4], "big", signed=True) if len(data) == 8 else None


def pieces(payload: bytes, sender: int, receiver: int) -> list[CanFrame]:
    """Return the frames of a payload from a controller."""
    if len(payload) <= 6:
        return [frame(SHORT, receiver, bytes([sender, 1]) + payload)]
    out = [
        frame(FILL, receiver, bytes([at]) + payload[at : at + 7])
        if at <= 255
        else frame(FILL_LONG, receiver, at.to_bytes(2, "big") + payload[at : at + 6])
        for at in _offsets(len(payload))
    ]
    end = struct.pack(">BBHH", sender, 1, len(payload), binascii.crc_hqx(payload, 0))
    return [*out, frame(PROCESS, receiver, end)]


def _offsets(length: int) -> list[int]:
    short = list(range(0, min(length, 256), 7))
    return short + list(range(short[-1] + 7, length, 6))


class Pieces:
    """Assembly of payloads from their pieces. Memory is bounded by the longest payload.

    A piece does not contain its sender; only the end does. Pieces of two senders at a time fail the CRC.

    Args:
        sender: number of the controller.
    """

    def __init__(self, sender: int) -> None:
        self._sender, self._have = sender, bytearray()
        self._begun = False  # whether a first piece has arrived: a payload cut at the beginning of a log is not damaged

    def take(self, command: int, data: bytes) -> tuple[bytes | None, bool]:
        """Take a frame to this host.

        Returns:
            The payload if the frame completes one, and whether a payload was damaged.
        """
        if command == SHORT:
            own = len(data) > 2 and data[0] == self._sender
            return (data[2:] if own else None), False
        if command in (FILL, FILL_LONG):
            size = 1 if command == FILL else 2
            return None, self._fill(int.from_bytes(data[:size], "big"), data[size:])
        return self._end(data)

    def _fill(self, offset: int, piece: bytes) -> bool:
        lost = offset == 0 and bool(self._have)  # the end of the payload before is missing
        if offset == 0:
            self._have.clear()
            self._begun = True
        if offset == len(self._have) and offset + len(piece) <= MAX_PAYLOAD:
            self._have += piece
        return lost

    def _end(self, data: bytes) -> tuple[bytes | None, bool]:
        payload, begun = bytes(self._have), self._begun
        self._have.clear()
        if len(data) != 6:
            return None, begun
        sender, _, length, crc = struct.unpack(">BBHH", data)
        if sender == self._sender and payload and length == len(payload) and crc == binascii.crc_hqx(payload, 0):
            return payload, False
        return None, begun and sender == self._sender

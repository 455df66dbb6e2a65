"""The text between a host and its CAN adapter: frames of both directions, damaged lines, and frames that were not sent.

Used by the pipelines of CANopen devices.
"""

from __future__ import annotations

from daq.drivers.canopen import cia301
from daq.items import DeviceEvent
from daq.transports import slcan

KINDS = ("damaged_lines", "refused_lines")
"""Kinds of losses that are counted here."""


CLOSING = b"C\r"
"""Text that closes the bus at the adapter, which is silent then."""
_RATES = {125_000: b"S4", 250_000: b"S5", 500_000: b"S6", 1_000_000: b"S8"}


def opening(bitrate: int) -> bytes:
    """Return the text that opens the bus at the adapter with a bit rate, bit/s."""
    return b"\rC\r" + _RATES[bitrate] + b"\rO\r"


class BusLines:
    """Decoder of slcan text of both directions.

    Args:
        device: name of the device in the rig file.
        losses: losses of the pipeline; those of `KINDS` are counted in place.
    """

    def __init__(self, device: str, losses: dict[str, int]) -> None:
        self._device, self._losses = device, losses
        self._rx, self._tx = slcan.LineDecoder(), slcan.LineDecoder(of_host=True)
        self._joined = False
        self._may_refuse = 0  # pending commands to the adapter itself; a refusal of these is not a lost frame

    def sent(self, data: bytes) -> list[slcan.CanFrame]:
        """Return the CANopen frames that the host has sent."""
        found = self._tx.feed(data)
        self._may_refuse += len(found.other_lines)
        return cia301.own_frames(found.frames)

    def received(self, data: bytes) -> tuple[list[slcan.CanFrame], list[DeviceEvent]]:
        """Return the CANopen frames from the bus, and the events about refused frames and damaged lines."""
        found = self._rx.feed(data) if self._joined else self._join(data)
        out: list[DeviceEvent] = []
        if found.other_lines or self._may_refuse:
            out += self._answered(found)
        if damaged := found.damaged:
            self._losses["damaged_lines"] += damaged
            out.append(DeviceEvent("damage", self._device, f"{damaged} damaged lines dropped", {"lines": damaged}))
        return cia301.own_frames(found.frames), out

    def _join(self, data: bytes) -> slcan.DecodedLines:
        """Decode the first line of a log, which may be cut at its beginning, without counting damage."""
        end = slcan.first_line_end(data)
        if not end:
            return self._rx.feed(data)
        self._joined = True
        first, found = self._rx.feed(data[:end]), self._rx.feed(data[end:])
        return slcan.DecodedLines(first.frames + found.frames, first.other_lines + found.other_lines, found.damaged)

    def _answered(self, found: slcan.DecodedLines) -> list[DeviceEvent]:
        """Return the event about refused frames in the adapter's answers, which are in the order of the commands."""
        refused = 0
        for line in found.other_lines:
            if line in ("", slcan.BEL):
                refused += line == slcan.BEL and not self._may_refuse
                self._may_refuse = max(0, self._may_refuse - 1)
            elif line in ("z", "Z"):  # a frame was sent: earlier commands to the adapter are not pending any more
                self._may_refuse = 0
        if found.frames:
            self._may_refuse = 0  # the bus is open
        if not refused:
            return []
        self._losses["refused_lines"] += refused
        text = f"the adapter refused {refused} lines: these frames did not go out. Look at the bus and its termination"
        return [DeviceEvent("refused", self._device, text, {"lines": refused})]

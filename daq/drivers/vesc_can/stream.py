"""The CAN line of a VESC's pipeline: adapter text to payloads of answers, and the speeds of the status messages."""

from __future__ import annotations

from daq.drivers.can_lines import CanLines, OtherHost
from daq.drivers.vesc.stream import VescPipeline
from daq.drivers.vesc_can import wire
from daq.drivers.vesc_can.settings import VescCan
from daq.items import DeviceEvent
from daq.transports.slcan import CanFrame

_TO_HOST = (wire.FILL, wire.FILL_LONG, wire.PROCESS, wire.SHORT)


class CanLine:
    """See VescLine. Damaged answers are counted as `damaged_answers`, status messages of a wrong length too.

    Args:
        device: name of the device in the rig file.
        losses: losses of the pipeline.
        settings: table of the controller in the rig file.
    """

    def __init__(self, device: str, losses: dict[str, int], settings: VescCan) -> None:
        self.speeds_erpm: list[int] = []
        self.others: list[bytes] = []
        self._device, self._losses, self._settings = device, losses, settings
        self._lines, self._other_host = CanLines(device, losses), OtherHost(device)
        self._pieces = wire.Pieces(settings.controller_id)
        losses["damaged_answers"] = 0

    def sent(self, data: bytes) -> list[bytes]:
        """See VescLine."""
        out: list[bytes] = []
        for frame in self._lines.sent(data):
            if frame.extended and wire.split(frame.arbitration_id)[1] == self._settings.controller_id:
                self._other_host.sent(frame)
                out += [] if (payload := wire.payload_of(frame)) is None else [payload]
        return out

    def received(self, data: bytes, host_ns: int) -> tuple[list[bytes], list[DeviceEvent]]:
        """See VescLine."""
        self.speeds_erpm, self.others = [], []
        frames, events = self._lines.received(data)
        payloads: list[bytes] = []
        for frame in frames:
            if frame.extended and not frame.remote:
                events += self._frame(frame, host_ns, payloads)
        return payloads, events

    def _frame(self, frame: CanFrame, host_ns: int, payloads: list[bytes]) -> list[DeviceEvent]:
        command, number = wire.split(frame.arbitration_id)
        if command == wire.STATUS and number == self._settings.controller_id:
            status = wire.parse_status(frame.data)
            if status is None:
                return self._damage()
            self.speeds_erpm.append(status.erpm)
        elif command in _TO_HOST and number == self._settings.host_id:
            payload, damaged = self._pieces.take(command, frame.data)
            payloads += [] if payload is None else [payload]
            return self._damage() if damaged else []
        elif number == self._settings.controller_id and (payload := wire.payload_of(frame)) is not None:
            if not self._other_host.replaced:
                self.others.append(payload)
            return self._other_host.received(frame, host_ns)
        return []

    def _damage(self) -> list[DeviceEvent]:
        self._losses["damaged_answers"] += 1
        return [DeviceEvent("damage", self._device, "a damaged answer dropped", {"answers": 1})]


def can_pipeline(device: str, settings: VescCan) -> VescPipeline:
    """Make the pipeline of a controller on the bus."""
    return VescPipeline(device, settings, lambda name, losses: CanLine(name, losses, settings))

"""The CAN line of a VESC's pipeline: frames to payloads of answers, and the speeds of the status messages.

Status messages of a VESC on a CAN bus: their rate, and their absence while the controller answers.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from typing_extensions import override

from daq.drivers.can_lines import CanLines, FirstContact, OtherHost
from daq.drivers.checks import DeviceCheck
from daq.items import DeviceEvent
from daq.transports.can_frames import CanFrame
from rig_basics.texts import number_of
from rig_drivers.vesc import wire as vesc
from rig_drivers.vesc.stream import VescLine, VescPipeline
from rig_drivers.vesc_can import wire
from rig_drivers.vesc_can.settings import VescCan

_MISSING_PERIODS, _MISSING_S = 5, 0.5  # time without a status message after which they are missing: the longer one
_RATE_SHARE = 0.3  # permitted deviation of the rate of the status messages


class StatusWatch:
    """Rate of the status messages, and their absence while the controller answers.

    The absence is counted in answers, so that a stall of the host causes none. Its messages are counted as
    `missing_status` from the rate in the rig file, because they are not numbered.

    Args:
        device: name of the device in the rig file.
        losses: losses of the pipeline.
        settings: table of the controller in the rig file.

    Attributes:
        count: number of status messages so far.
    """

    def __init__(self, device: str, losses: dict[str, int], settings: VescCan) -> None:
        self.count: int = 0
        self._device, self._losses, self._rate_Hz = device, losses, settings.status_Hz
        longest_s = max(_MISSING_PERIODS / self._rate_Hz, _MISSING_S) if self._rate_Hz else 0.0
        self._max_answers = round(longest_s * settings.report_Hz)
        self._answers = self._counted = 0  # since the last status message: answers, missing messages
        self._first_ns = self._last_ns = 0
        self._missing = False
        losses["missing_status"] = 0

    @property
    def rate_Hz(self) -> float:
        """Mean rate of the status messages so far, Hz; 0 before the second one."""
        return (self.count - 1) / (self._last_ns - self._first_ns) * 1e9 if self._last_ns > self._first_ns else 0.0

    def message(self, host_ns: int) -> list[DeviceEvent]:
        """Take a status message; return the event that ends their absence."""
        self._first_ns = self._first_ns if self.count else host_ns
        self.count, self._last_ns = self.count + 1, host_ns
        missing, lost = self._missing, self._counted
        self._answers, self._counted, self._missing = 0, 0, False
        if not missing:
            return []
        return [DeviceEvent("gap", self._device, f"status messages again, about {lost} are missing", {"samples": lost})]

    def answer(self, host_ns: int) -> list[DeviceEvent]:
        """Take an answer; return the event about an absence of the status messages that has begun."""
        self._answers += 1
        if not self._rate_Hz or self._answers < self._max_answers:
            return []
        began, self._missing = not self._missing, True
        if self.count:
            lost = int((host_ns - self._last_ns) * 1e-9 * self._rate_Hz)
            self._losses["missing_status"] += max(0, lost - self._counted)
            self._counted = max(lost, self._counted)
        if not began:
            return []
        text = "no status message for" if self.count else "no status message yet in"
        text += (
            f" {number_of(self._answers, 'answer')}, expected {self._rate_Hz:g} a second (status_Hz). Look "
            f"at its setting "
            "CAN Status Messages Rate 1, or set status_Hz = 0 in the rig file"
        )
        return [DeviceEvent("status", self._device, text, {"status_messages": self.count})]


def status_check(settings: VescCan, watch: StatusWatch) -> DeviceCheck:
    """Compare the rate of the status messages with that of the rig file; their absence is accepted if it states none.

    The controller waits for a whole period after the transmission, so its rate is lower than its setting.
    """
    expected_Hz, found_Hz = settings.status_Hz, watch.rate_Hz
    fine = abs(found_Hz - expected_Hz) <= _RATE_SHARE * expected_Hz
    passed = fine or not (watch.count or "status_Hz" in settings.model_fields_set)
    advice = "set CAN Status Messages Rate 1 with status message 1 in the controller, or status_Hz in the rig file"
    return DeviceCheck(round(found_Hz, 1), f"{expected_Hz:g} ± {_RATE_SHARE:.0%}", passed, "" if fine else advice)


_TO_HOST = (wire.FILL, wire.FILL_LONG, wire.PROCESS, wire.SHORT)
_FIRMWARE = bytes([vesc.FIRMWARE_VERSION])


class CanLine(VescLine):
    """Frames on a bus. Damaged answers are counted as `damaged_answers`, status messages of a wrong length too.

    Args:
        device: name of the device in the rig file.
        losses: losses of the pipeline.
        settings: table of the controller in the rig file.

    Attributes:
        status_watch: rate and absence of the status messages.
    """

    def __init__(self, device: str, losses: dict[str, int], settings: VescCan) -> None:
        super().__init__(device, losses)
        self._settings = settings
        self._number = settings.controller_id
        self._lines, self._other_host = CanLines(device, losses), OtherHost(device)
        self._contact = FirstContact()
        self._pieces = wire.Pieces(settings.controller_id)
        self._asks_firmware = False  # whether the query of the firmware is not answered yet
        self._others_heard = set[int]()  # other controllers whose status was reported
        self._open_refused = False  # whether it was reported
        losses["damaged_answers"] = 0
        self.status_watch: StatusWatch = StatusWatch(device, losses, settings)

    @override
    def sent(self, data: bytes) -> list[bytes]:
        out: list[bytes] = []
        self._contact.sent(data)
        for frame in self._lines.sent(data):
            if frame.extended and wire.split(frame.arbitration_id)[1] == self._settings.controller_id:
                self._other_host.sent(frame)
                out += [] if (payload := wire.payload_of(frame)) is None else [payload]
        self._asks_firmware |= _FIRMWARE in out
        return out

    @override
    def received(self, data: bytes, host_ns: int) -> tuple[list[bytes], list[DeviceEvent]]:
        self.speeds_erpm.clear()
        self.others.clear()
        frames, events = self._lines.received(data)
        payloads: list[bytes] = []
        for frame in frames:
            if frame.extended and not frame.remote:
                events += self._frame(frame, host_ns, payloads)
        if payloads:
            self._asks_firmware &= all(payload[:1] != _FIRMWARE for payload in payloads)
        return payloads, [*self._refusal(), *events]

    def _refusal(self) -> list[DeviceEvent]:
        """Return a reply about an adapter that does not open the bus, once, while the query is not answered."""
        if self._open_refused or not (self._asks_firmware and self._lines.open_refused):
            return []
        self._open_refused = True
        return [DeviceEvent("reply", self._device, "the adapter refused to open the bus", {})]

    def _frame(self, frame: CanFrame, host_ns: int, payloads: list[bytes]) -> list[DeviceEvent]:
        command, number = wire.split(frame.arbitration_id)
        if number == self._number and command == wire.STATUS:
            self._contact.heard()
        if command == wire.STATUS:
            own = number == self._number
            return self._status(frame.data, host_ns, len(payloads)) if own else self._other_status(number)
        if command == wire.BOOT:
            return [self._started()] if number == self._number else []
        if command in _TO_HOST and number == self._settings.host_id:
            self._contact.heard()
            payload, damaged = self._pieces.take(command, frame.data)
            if payload is not None:
                payloads.append(payload)
                return self.status_watch.answer(host_ns)
            return self._damage() if damaged else []
        return self._foreign(frame, number, host_ns) if number in (self._number, wire.EVERY) else []

    def _started(self) -> DeviceEvent:
        if self._contact.pending:
            text = "the controller had started before the bus was opened: the message of its start is its first"
            return DeviceEvent("network", self._device, text, {})
        text = "the controller started again: it has sent the message of its start"
        return DeviceEvent("restart", self._device, text, {})

    def _status(self, data: bytes, host_ns: int, place: int) -> list[DeviceEvent]:
        erpm = wire.parse_status(data)
        if erpm is None:
            return self._damage()
        self.speeds_erpm.append((place, erpm))
        return self.status_watch.message(host_ns)

    def _other_status(self, number: int) -> list[DeviceEvent]:
        """Return a reply about another controller's status, once, while the query of the firmware is not answered."""
        if not self._asks_firmware or number in self._others_heard:
            return []
        self._others_heard.add(number)
        text = f"status messages of controller {number}"
        return [DeviceEvent("reply", self._device, text, {"controller_id": number})]

    def _foreign(self, frame: CanFrame, number: int, host_ns: int) -> list[DeviceEvent]:
        """Take a frame to the controller from the bus. A session that only receives uses those of the rig's host."""
        payload = wire.payload_of(frame)
        acts = wire.is_command(frame)
        of_rig = acts or frame.data[:1] == bytes([self._settings.host_id])
        if payload is not None and of_rig and not self._other_host.replaced:
            self.others.append(payload)
        return self._other_host.received(frame, host_ns) if acts else []

    def _damage(self) -> list[DeviceEvent]:
        self._losses["damaged_answers"] += 1
        return [DeviceEvent("damage", self._device, "a damaged answer dropped", {"answers": 1})]


class VescCanPipeline(VescPipeline):
    """See VescPipeline.

    Attributes:
        status_watch: rate and absence of the status messages.
    """

    def __init__(self, device: str, settings: VescCan, identity: Mapping[str, Any]) -> None:
        super().__init__(device, settings, identity, partial(CanLine, settings=settings))
        assert isinstance(self._line, CanLine)
        self.status_watch: StatusWatch = self._line.status_watch

"""Pipeline of a VESC: bytes in both directions to speed, fault and the last command."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

from typing_extensions import override

from daq.drivers.following import Following, SlowingDown
from daq.drivers.motors import MotorPipeline
from daq.items import TX, Batch, DeviceEvent
from rig_basics.texts import number_of
from rig_drivers.vesc import packets, wire
from rig_drivers.vesc.settings import VescMotor

NOTHING, SPEED, BRAKE, FREE = 0, 1, 2, 3
"""The last command to the controller, as in the statusword."""
STATUS_KNOWN = 1 << 24

_COMMANDS = {wire.SET_RPM: SPEED, wire.SET_BRAKE: BRAKE, wire.SET_CURRENT: FREE}
_JOINED_BYTES = 84  # longest rest of an answer that began before the reception; it does not count as a loss


def statusword(values: wire.Values, command: int) -> int:
    """Return the state of a report as it is stored in the log.

    Bits 0–7: fault code. Bits 8–9: last command of the host (NOTHING, SPEED, BRAKE, FREE). Bits 16–23: status byte,
    valid if bit 24 is set.
    """
    status = 0 if values.status is None else values.status << 16 | STATUS_KNOWN
    return values.fault | command << 8 | status


def state(word: int) -> str:
    """Return the state of a statusword as text."""
    status = word >> 16 & 0xFF
    if word & 0xFF:
        return "FAULT"
    if status & wire.KILL_SWITCH:
        return "KILL SWITCH OPEN"
    if status & wire.TIMED_OUT:
        return "TIMED OUT"
    return {NOTHING: "NOT COMMANDED", SPEED: "HOLDS SPEED", BRAKE: "BRAKES", FREE: "RELEASED"}[word >> 8 & 3]


class VescLine(ABC):
    """The line of a controller: framing of the payloads in both directions.

    Args:
        device: name of the device in the rig file.
        losses: losses of the pipeline.

    Attributes:
        speeds_erpm: electrical speeds, rpm, that the last `received` contained in addition to answers, each after the
            number of payloads that came before it.
        others: payloads of another host in the last `received`, in a session that only receives.
    """

    def __init__(self, device: str, losses: dict[str, int]) -> None:
        self.speeds_erpm: list[tuple[int, int]] = []
        self.others: list[bytes] = []
        self._device, self._losses = device, losses

    @abstractmethod
    def received(self, data: bytes, host_ns: int) -> tuple[list[bytes], list[DeviceEvent]]:
        """Return the payloads in the bytes of one read, and events of the line."""

    @abstractmethod
    def sent(self, data: bytes) -> list[bytes]:
        """Return the payloads in the bytes of one write."""


class SerialLine(VescLine):
    """Packets on a serial port. Bytes outside intact packets are counted as `damaged_bytes`."""

    def __init__(self, device: str, losses: dict[str, int]) -> None:
        super().__init__(device, losses)
        losses["damaged_bytes"] = 0
        self._rx, self._tx = packets.PacketDecoder(_JOINED_BYTES), packets.PacketDecoder()

    @override
    def received(self, data: bytes, host_ns: int) -> tuple[list[bytes], list[DeviceEvent]]:
        found = self._rx.feed(data)
        if not found.skipped:
            return found.payloads, []
        self._losses["damaged_bytes"] += found.skipped
        text = f"{number_of(found.skipped, 'damaged byte')} dropped"
        return found.payloads, [DeviceEvent("damage", self._device, text, {"bytes": found.skipped})]

    @override
    def sent(self, data: bytes) -> list[bytes]:
        return self._tx.feed(data).payloads


class VescPipeline(MotorPipeline):
    """Decoder of bytes to reports.

    A controller has no clock and does not number its answers. Samples get the host's time. A poll that was not answered
    before the next poll counts as a loss until its answer arrives late: each poll has one answer, and their order is
    kept.

    Attributes:
        losses: see Pipeline.
        answers: reports of the last `feed`, for the host's command.
    """

    def __init__(
        self,
        device: str,
        settings: VescMotor,
        identity: Mapping[str, Any],
        line: Callable[[str, dict[str, int]], VescLine] = SerialLine,
    ) -> None:
        super().__init__(device)
        self._line = line(device, self.losses)
        self.losses.update(unanswered=0, unreadable_answers=0)
        self.answers: list[wire.Values] = []
        self._pole_pairs = settings.pole_pairs
        self._target_rpm, self._command = 0.0, NOTHING
        self._polled = False
        self._unanswered = 0  # since the last answer
        self._late = 0  # polls counted as a loss whose answers may still arrive
        self._early = 0  # answers that may still arrive to a poll before a release
        self._last: wire.Values | None = None
        self._word = 0  # statusword of the newest answer
        max_reports = round(settings.follow_s * settings.report_Hz)
        self._following = Following(device, max_reports)
        self._slowing = SlowingDown(device, max_reports)

    @override
    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | DeviceEvent]:
        self.answers = []
        if direction == TX:
            for payload in self._line.sent(data):
                self._sent(payload)
            return []
        payloads, events = self._line.received(data, host_ns)
        out: list[Batch | DeviceEvent] = [*events]
        if any(event.kind == "restart" for event in events):
            self._last = None  # its smaller counters are the same restart
        rows: list[tuple[int, int]] = []  # electrical speed and statusword, in the order of the bytes
        for place, payload in enumerate((*payloads, b"")):
            rows += [(erpm, self._word) for before, erpm in self._line.speeds_erpm if before == place]
            if payload[:1] == bytes([wire.GET_VALUES]):
                out += self._report(payload, rows)
            elif payload[:1] == bytes([wire.FIRMWARE_VERSION]):
                out.append(self._identity(payload))
        for payload in self._line.others:
            self._sent(payload)
        return out + self.samples([(erpm / self._pole_pairs, self._target_rpm, word) for erpm, word in rows], host_ns)

    def _sent(self, payload: bytes) -> None:
        """Take a payload of the host: only it contains the set-point. A second poll in a row shows a missing answer."""
        if payload[0] == wire.GET_VALUES:
            if self._polled:
                self.losses["unanswered"] += 1
                self._unanswered += 1
            self._polled = True
        elif (command := wire.parse_command(payload)) is not None:
            before, self._command = self._command, _COMMANDS[command.what]
            if self._command == FREE != before:  # the poll that follows a release does not wait for an earlier answer
                self._early += self._polled
                self._polled = False
            self._target_rpm = command.number / self._pole_pairs if self._command == SPEED else 0.0

    def _identity(self, payload: bytes) -> DeviceEvent:
        firmware = wire.parse_firmware(payload)
        facts = {} if firmware is None else firmware.facts
        return DeviceEvent("reply", self._device, payload.hex(), facts)

    def _report(self, payload: bytes, rows: list[tuple[int, int]]) -> list[DeviceEvent]:
        values = wire.parse_values(payload)
        if values is None:
            text = (
                f"an answer of {number_of(len(payload), 'byte')}, expected at least {wire.VALUES_BYTES}: is its "
                f"firmware too old?"
            )
            return [self.damage("unreadable_answers", text, bytes=len(payload))]
        out = self._gap() + self._restart(values)
        word = statusword(values, self._command)
        actual_rpm = values.erpm / self._pole_pairs
        out += self.state_events(state(word), statusword=word)
        text = f"fault {wire.fault_words(values.fault)}" if values.fault else "no fault any more"
        out += self.fault_events(values.fault, text)
        out += self._following.check(self._command == SPEED, self._target_rpm, actual_rpm)
        out += self._slowing.check(self._command == BRAKE, actual_rpm)
        self._last, self._word = values, word
        self.answers.append(values)
        rows.append((values.erpm, word))
        return out

    def _gap(self) -> list[DeviceEvent]:
        if not self._polled:
            return self._surplus()
        lost, self._unanswered, self._polled = self._unanswered, 0, False
        self._late += lost
        return (
            [DeviceEvent("gap", self._device, f"{number_of(lost, 'poll')} not answered", {"samples": lost})]
            if lost
            else []
        )

    def _surplus(self) -> list[DeviceEvent]:
        """Take an answer for which no poll is open. Return the event that takes a loss back, if it was late."""
        if self._early or not self._late:
            self._early = max(0, self._early - 1)
            return []
        self._late -= 1
        self.losses["unanswered"] -= 1
        text = "an answer was late: its poll was counted as not answered"
        return [DeviceEvent("gap", self._device, text, {"samples": -1})]

    def _restart(self, values: wire.Values) -> list[DeviceEvent]:
        if self._last is None or not wire.restarted(self._last, values):
            return []
        text = "the controller started again: its counters are smaller than before"
        return [DeviceEvent("restart", self._device, text, {"turned": values.turned})]

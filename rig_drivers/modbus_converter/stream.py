"""Pipeline of a frequency converter: requests and answers to speed, state and fault.

An answer belongs to the last request, and only until the next one is sent. The host's order of requests prevents that a
late answer fits the next request (`line.RequestLine`). A converter has no clock: samples get the host's time.

Checks of a converter that do not use its speed: its state, its faults, and the requests that it refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from typing_extensions import override

from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import Pipeline, SpeedControl
from daq.drivers.fault_checks import controller_checks
from daq.drivers.motors import MotorPipeline
from daq.drivers.polling import LATEST_S
from daq.items import TX, Batch, DeviceEvent
from rig_basics.texts import number_of
from rig_drivers.modbus_converter import registers, wire
from rig_drivers.modbus_converter.rotor_speed import RotorSpeed
from rig_drivers.modbus_converter.settings import ModbusConverter

Items = list[Batch | DeviceEvent]


@dataclass(frozen=True)
class Report:
    """State and speed of the converter.

    Attributes:
        status: status word.
        state: state that it contains.
        fault: code of the present fault, 0 without one or if it is not readable.
        rpm: speed of the rotor for the reported frequency, rpm; NaN without torque at the rotor.
    """

    status: int
    state: str
    fault: int
    rpm: float


class ConverterPipeline(MotorPipeline):
    """Decoder of one converter's line.

    Attributes:
        losses: see Pipeline. "unanswered": requests after which no byte came; "damaged_answers": requests after which
            bytes without an intact answer came; "damaged_bytes": bytes outside of answers; "late": answers to a read
            after `LATEST_S`; "refused": requests that the converter refused.
        answers, reports: those of the last `feed`, for the host's command.
        echoes: whether the adapter returns the host's own bytes.
    """

    def __init__(self, device: str, settings: ModbusConverter, identity: Mapping[str, Any]) -> None:
        super().__init__(device, "unanswered", "damaged_answers", "damaged_bytes", "late", "refused")
        self.answers: list[wire.Answer] = []
        self.reports: list[Report] = []
        self._settings, self._registers = settings, settings.registers
        self._blocks = settings.blocks
        self.echoes: bool = False
        self._request: wire.Request | None = None
        self._returned = b""  # bytes of the request that the adapter may return
        self._asked_ns = 0
        self._asked_once = False  # whether a request was seen: an answer before it began before the log
        self._received = bytearray()
        self._missing = 0  # requests without an intact answer since the last one
        self._words: dict[int, int] = {}  # registers of the present report
        self._control, self._reference = settings.registers.stop, 0
        self._rotor = RotorSpeed(settings)
        self._watchdog: int | None = None  # communication timeout that the host has set; None if it was before the log
        self._stopping = False  # whether the last command in the log is a stop
        self._refusals: dict[tuple[int, int], str] = {}  # reasons by function and register, until an answer

    @override
    def feed(self, direction: int, data: bytes, host_ns: int) -> Items:
        self.answers, self.reports = [], []
        if direction == TX:
            request = wire.parse_request(data)
            return [] if request is None else self._sent(request, data, host_ns)
        if self._request is None:
            return self._unexpected(len(data))
        self._received += data
        if self.echoes and self._returned and len(self._received) >= len(self._returned):
            self.echoes = self._received.startswith(self._returned)
            if self.echoes:
                del self._received[: len(self._returned)]
            self._returned = b""
        found = self._found()
        if found is None:
            surplus = len(self._received) - 2 * wire.LONGEST_FRAME_BYTES
            if surplus <= 0:
                return []
            del self._received[:surplus]
            return self._unexpected(surplus)
        before, end, answer = found
        after = len(self._received) - end
        if answer.request.function in wire.READS and self._returned:
            self.echoes = bytes(self._received[:before]) == self._returned
            before = 0 if self.echoes else before
        self._request = None
        self._received.clear()
        out = self._unexpected(before + after) + self._gap()
        self.answers.append(answer)
        return out + self._answered(answer, host_ns)

    def _found(self) -> tuple[int, int, wire.Answer] | None:
        """Return the answer to the present request, with where it begins and ends in the received bytes."""
        request = self._request
        if request is None or (self.echoes and self._returned):  # a write and its answer are the same bytes
            return None
        return wire.find_answer(bytes(self._received), request)

    def _unexpected(self, count: int) -> Items:
        if not count or not self._asked_once:
            return []
        return [self.damage("damaged_bytes", f"{number_of(count, 'byte')} outside of answers", count, bytes=count)]

    def _sent(self, request: wire.Request, data: bytes, host_ns: int) -> Items:
        out: Items = []
        if self._request is not None:
            self._missing += 1
            if self._received:
                self.losses["damaged_answers"] += 1
                out = self._unexpected(len(self._received))
            else:
                self.losses["unanswered"] += 1
        self._request, self._asked_ns, self._asked_once = request, host_ns, True
        self._returned = data
        self._received.clear()
        r = self._registers
        for register, value in enumerate(request.values, request.register):
            if register == r.control:
                self._control, self._stopping = value, value not in (r.run, r.run_reverse)
            elif register == r.reference:
                self._reference = value
            elif r.watchdog is not None and register == r.watchdog + r.write_offset:
                self._watchdog = value
        return out

    def _gap(self) -> Items:
        missing, self._missing = self._missing, 0
        if not missing:
            return []
        return [
            DeviceEvent("gap", self._device, f"{number_of(missing, 'request')} without an answer", {"samples": missing})
        ]

    def _answered(self, answer: wire.Answer, host_ns: int) -> Items:
        if answer.exception:
            return self._refused(answer)
        self._refusals.pop((answer.request.function, answer.request.register), None)
        if answer.request.function not in wire.READS:
            return []
        reply = DeviceEvent("reply", self._device, " ".join(map(str, answer.registers)), {})
        block = answer.request.register, answer.request.count
        if block not in self._blocks:
            return [reply, *self._restart(answer)]
        if host_ns - self._asked_ns > LATEST_S * 1e9:
            self._words.clear()
            return [reply, self.damage("late", "an answer too late for a sample", samples=1)]
        if block == self._blocks[0]:
            self._words.clear()
        self._words.update(enumerate(answer.registers, answer.request.register))
        return [reply, *(self._report(host_ns) if block == self._blocks[-1] else [])]

    def _refused(self, answer: wire.Answer) -> Items:
        self.losses["refused"] += 1
        request = answer.request
        text = f"it refuses {request.words}: {answer.refusal}"
        of = request.function, request.register
        before, self._refusals[of] = self._refusals.get(of), text
        reply = DeviceEvent("reply", self._device, text, {})
        new = text != before
        return [reply, *([DeviceEvent("refused", self._device, text, {"exception": answer.exception})] if new else [])]

    def _restart(self, answer: wire.Answer) -> Items:
        """Return the event of a converter that has lost the communication timeout that the host had set.

        A restart that begins while the rotor turns stops the rig. At rest the operator gets a warning.
        """
        r = self._registers
        if (answer.request.register, answer.request.count) != (r.watchdog, 1):
            return []
        found, wanted = answer.registers[0], self._watchdog
        if wanted == 0 or 0 < found <= (0xFFFF if wanted is None else wanted):
            return []
        turns = self._rotor.restarted()
        self._watchdog = 0  # until the host sets it again
        text = (
            f"it was switched off and on: its communication timeout (register {r.watchdog}) is {found}, not what the "
            "host had set. Look at its supply, then start again"
        )
        if turns:
            return [DeviceEvent("restart", self._device, text)]
        return [DeviceEvent("emergency", self._device, text, {"error_code": 0, "restart": True})]

    # --- reports -----------------------------------------------------------------------------------------------

    def _report(self, host_ns: int) -> Items:
        """Return the sample of a whole report, and the events of what has changed."""
        r, words = self._registers, self._words
        if r.status not in words or (r.fault_code is not None and r.fault_code not in words):
            return []  # a part of the report was lost
        status = words[r.status]
        now = r.state(status)
        fault = 0 if r.fault_code is None or now != registers.FAULT else words[r.fault_code]
        rpm = self._settings.speed_rpm * r.reported_counts(status, words[r.speed])
        rpm = self._rotor.reported(now, rpm, host_ns, stopping=self._stopping)
        report = Report(status, now, fault, rpm)
        words.clear()
        self.reports.append(report)
        changes = self.state_events(now, statusword=status) + self.fault_events(fault, registers.fault_text(fault))
        word = status | fault << 16  # in the log: bits 0–15 status word, bits 16–31 code of the present fault
        return [*changes, *self.samples([(rpm, self._target_rpm, word)], host_ns)]

    @property
    def _target_rpm(self) -> float:
        """Speed that the host commands, rpm; 0 unless it commands to run."""
        r = self._registers
        if self._control == r.run:
            signed = (self._reference ^ 0x8000) - 0x8000 if r.reference_signed else self._reference
            return self._settings.reference_rpm * signed
        return -self._settings.reference_rpm * self._reference if self._control == r.run_reverse else 0.0


def converter_checks(
    settings: ModbusConverter, pipeline: Pipeline, control: SpeedControl | None, events: Sequence[DeviceEvent]
) -> Checks:
    """Return the checks of an open converter.

    Args:
        settings: table of the converter in the rig file.
        pipeline: pipeline of the converter.
        control: command of the converter; None if its bytes are only received.
        events: events of the converter during the check.
    """
    out = controller_checks(control, events, registers.fault_text, (registers.FAULT, registers.UNKNOWN))
    refused = [event.text for event in events if event.kind == "refused"]
    note = "compare the register table with its manual" if refused else ""
    out["refused_requests"] = DeviceCheck(len(refused), 0, not refused, note)
    if isinstance(pipeline, ConverterPipeline) and pipeline.echoes:
        note = "the adapter returns the host's own bytes; they are dropped. Switch the echo off if the adapter can"
        out["echo"] = DeviceCheck("yes", "no or yes", True, note)
    return out

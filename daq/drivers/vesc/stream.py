# pyright: strict
"""Bytes of a VESC, and to it, to speed, fault and what it was told."""

from __future__ import annotations

import numpy as np

from daq import channels
from daq.drivers.items import TX, Batch, Event
from daq.drivers.vesc import packets, wire
from daq.drivers.vesc.settings import Vesc

NOTHING, SPEED, BRAKE, FREE = 0, 1, 2, 3
"""What the controller was last told, in the statusword."""
STATUS_KNOWN = 1 << 24

_TOLD = {wire.SET_RPM: SPEED, wire.SET_BRAKE: BRAKE, wire.SET_CURRENT: FREE}
_JOINED_BYTES = 84  # of an answer that began before the first byte heard: it is nobody's loss
_APART = (0.2, 30.0)  # share and rpm by which a rotor that follows may differ from the set-point


def statusword(values: wire.Values, told: int) -> int:
    """A report's state as the log keeps it.

    Bits 0–7 the fault code; 8–9 what the host last told it (NOTHING, SPEED, BRAKE, FREE); 16–23 its status byte, when
    bit 24 is set.
    """
    status = 0 if values.status is None else values.status << 16 | STATUS_KNOWN
    return values.fault | told << 8 | status


def state(word: int) -> str:
    """A statusword in words."""
    status = word >> 16 & 0xFF
    if word & 0xFF:
        return "FAULT"
    if status & wire.KILL_SWITCH:
        return "KILL SWITCH OPEN"
    if status & wire.TIMED_OUT:
        return "TIMED OUT"
    return {NOTHING: "NOT COMMANDED", SPEED: "HOLDS SPEED", BRAKE: "BRAKES", FREE: "LET GO"}[word >> 8 & 3]


class VescPipeline:
    """Bytes to reports. A controller has no clock and counts nothing it sends: host time counts, and as loss a poll
    that was not answered before the next one.

    Attributes:
        answers: reports of the last feed, for the host's command.
    """

    def __init__(self, device: str, settings: Vesc) -> None:
        self.losses = {"damaged_bytes": 0, "unanswered": 0, "unreadable_answers": 0}
        self.answers: list[wire.Values] = []
        self._device, self._pole_pairs = device, settings.pole_pairs
        self._rx, self._tx = packets.PacketDecoder(_JOINED_BYTES), packets.PacketDecoder()
        self._target_rpm, self._told = 0.0, NOTHING
        self._polled = False
        self._unanswered = 0  # since the last answer
        self._last: wire.Values | None = None
        self._word: int | None = None
        self._apart, self._apart_limit = 0, max(3, round(settings.follow_s * settings.report_Hz))

    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | Event]:
        """See Pipeline."""
        self.answers = []
        if direction == TX:
            for payload in self._tx.feed(data).payloads:
                self._went(payload)
            return []
        found = self._rx.feed(data)
        out: list[Batch | Event] = [*self._damage(found)]
        words: list[int] = []
        for payload in found.payloads:
            if payload[0] == wire.GET_VALUES:
                out += self._report(payload, words)
            elif payload[0] == wire.FIRMWARE_VERSION:
                out.append(self._identity(payload))
        if self.answers:
            n = len(self.answers)
            columns = {
                "speed_rpm": np.array([values.erpm for values in self.answers], float) / self._pole_pairs,
                "target_rpm": np.full(n, self._target_rpm),
                "statusword": np.array(words, np.uint32),
            }
            out.append(Batch(channels.MOTOR, np.full(n, host_ns, np.int64), np.zeros(n, np.uint32), columns))
        return out

    def _went(self, payload: bytes) -> None:
        """What the host sent: its set-point is nowhere else, and a poll that follows a poll leaves one unanswered."""
        if payload[0] == wire.GET_VALUES:
            if self._polled:
                self.losses["unanswered"] += 1
                self._unanswered += 1
            self._polled = True
        elif (command := wire.parse_command(payload)) is not None:
            self._told = _TOLD[command.what]
            self._target_rpm = command.number / self._pole_pairs if self._told == SPEED else 0.0

    def _damage(self, found: packets.Found) -> list[Event]:
        if not found.skipped:
            return []
        self.losses["damaged_bytes"] += found.skipped
        return [Event("damage", self._device, f"{found.skipped} damaged bytes dropped", {"bytes": found.skipped})]

    def _identity(self, payload: bytes) -> Event:
        firmware = wire.parse_firmware(payload)
        facts = (
            {}
            if firmware is None
            else {
                "firmware": f"{firmware.major}.{firmware.minor:02d}",
                "hardware": firmware.hardware,
                "serial": firmware.serial,
            }
        )
        return Event("reply", self._device, payload.hex(), facts)

    def _report(self, payload: bytes, words: list[int]) -> list[Event]:
        values = wire.parse_values(payload)
        if values is None:
            self.losses["unreadable_answers"] += 1
            text = f"an answer of {len(payload)} bytes, expected at least {wire.VALUES_BYTES}: is its firmware too old?"
            return [Event("damage", self._device, text, {"bytes": len(payload)})]
        out = self._gap() + self._restart(values)
        word = statusword(values, self._told)
        out += self._changes(word) + self._follows(values)
        self._last, self._word = values, word
        self.answers.append(values)
        words.append(word)
        return out

    def _gap(self) -> list[Event]:
        lost, self._unanswered, self._polled = self._unanswered, 0, False
        return [Event("gap", self._device, f"{lost} polls not answered", {"samples": lost})] if lost else []

    def _restart(self, values: wire.Values) -> list[Event]:
        if self._last is None or not wire.restarted(self._last, values):
            return []
        text = "the controller started again: its counters are less than they were"
        return [Event("restart", self._device, text, {"turned": values.turned})]

    def _changes(self, word: int) -> list[Event]:
        """A new state, a new fault, a fault that has passed."""
        before, out = self._word, list[Event]()
        if before is None or state(word) != state(before):
            out.append(Event("drive", self._device, state(word), {"statusword": word}))
        fault = word & 0xFF
        if fault != (0 if before is None else before & 0xFF):
            text = f"fault {wire.fault_words(fault)}" if fault else "no fault any more"
            out.append(Event("emergency", self._device, text, {"error_code": fault}))
        return out

    def _follows(self, values: wire.Values) -> list[Event]:
        """Whether the rotor turns as told; counted in reports, so that a host that was asleep accuses nobody."""
        actual, (share, more) = values.erpm / self._pole_pairs, _APART
        apart = abs(actual - self._target_rpm) > share * abs(self._target_rpm) + more
        self._apart = self._apart + 1 if self._told == SPEED and apart else 0
        if self._apart != self._apart_limit:
            return []
        text = (
            f"the rotor does not follow: told {self._target_rpm:.0f} rpm, it turns at {actual:.0f} rpm. Look at the "
            "controller's limits of current and speed, at its own time-out, at whether it may brake"
        )
        return [Event("fault", self._device, text, {"target_rpm": self._target_rpm, "speed_rpm": actual})]

"""Network state, heartbeats, emergencies, and the faults that an encoder had at its opening."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from daq.drivers.can_lines import FirstContact
from daq.drivers.canopen import cia301
from daq.items import DeviceEvent
from daq.transports.can_frames import CanFrame
from rig_drivers.cia406 import wire
from rig_drivers.cia406.settings import FAULT_KEYS, Encoder

_GENERIC_ERROR = 0x1000  # of an encoder that does not report which error it has
_PATIENCE = 3.5  # periods without a heartbeat after which it is lost


@dataclass(frozen=True)
class FoundFaults:
    """Faults that an encoder had at its opening; all 0 if it was not queried.

    Attributes:
        error_register: 1001h.
        error_code: error code of the newest entry of 1003h.
        alarms, warnings: 6503h and 6505h; 0 for an encoder without them.
    """

    error_register: int = 0
    error_code: int = 0
    alarms: int = 0
    warnings: int = 0

    @classmethod
    def of(cls, encoder: Encoder, identity: Mapping[str, Any]) -> FoundFaults:
        """Take them from the identity; that of an encoder that was not queried has none."""
        values = (identity.get(f"{encoder.name}_{key}", 0) for key in FAULT_KEYS)
        return cls(*(value if type(value) is int else 0 for value in values))

    @property
    def faulty(self) -> bool:
        """Whether there is a fault. A warning does not count."""
        return bool(self.error_register or self.alarms)

    @property
    def text(self) -> str:
        """The fault for the operator."""
        alarms = f", alarms {wire.alarm_words(self.alarms)}" if self.alarms else ""
        return f"error register {self.error_register:02X}h{alarms}"


_NO_FAULTS = FoundFaults()


class NodeWatch:
    """State of an encoder on the bus.

    Args:
        device: name of the device in the rig file.
        encoder: the encoder.
        heartbeat_ms: period of its heartbeat, ms.
        found: faults that it had at its opening.
        contact: first contact with the encoder; without it every boot-up message is a restart.

    Attributes:
        faulty: whether it has an error: by its newest emergency, before the first one as it was found at its opening.
        fault: this error for the operator; empty without one.
        restarted: whether it has started again since the opening of the device: its settings are gone.
    """

    def __init__(
        self,
        device: str,
        encoder: Encoder,
        heartbeat_ms: int,
        found: FoundFaults = _NO_FAULTS,
        contact: FirstContact | None = None,
    ) -> None:
        self.faulty: bool = found.faulty
        self.fault: str = f"of encoder {encoder.name}: since the opening, {found.text}" if found.faulty else ""
        self._found, self._contact = found, contact or FirstContact()
        self.restarted: bool = False
        self._device, self._encoder = device, encoder
        self._patience_ns = round(_PATIENCE * heartbeat_ms * 1e6)
        self._state: cia301.Heartbeat | None = None
        self._beat_ns: int | None = None  # of the newest heartbeat; None while it is lost, and before the first

    @property
    def name(self) -> str:
        """The encoder's name for the operator."""
        return f"encoder {self._encoder.name} (node {self._encoder.node})"

    def opened(self) -> Iterator[DeviceEvent]:
        """Report the faults that it had at its opening."""
        found = self._found
        if found.faulty:
            code = found.error_code or _GENERIC_ERROR
            facts = {"error_code": code, "register": found.error_register, "alarms": found.alarms}
            yield self._event("emergency", f"{self.name}: since the opening, {found.text}", **facts)
        if found.warnings:
            text = f"{self.name}: warnings {wire.warning_words(found.warnings)}. Its positions are used"
            yield self._event("status", text, warnings=found.warnings)

    def heartbeat(self, frame: CanFrame, host_ns: int) -> Iterator[DeviceEvent]:
        """Take a heartbeat or boot-up message."""
        state = cia301.heartbeat(frame.data)
        if state is None:
            return
        before, self._state, self._beat_ns = self._state, state, host_ns
        if state == cia301.Heartbeat.BOOT_UP and self._contact.pending:
            text = f"{self.name} had started before the bus was opened (boot-up message); its set-up follows"
            yield self._event("network", text, network_state=int(state))
            return
        if state != cia301.Heartbeat.BOOT_UP:
            self._contact.heard()
        if state == cia301.Heartbeat.BOOT_UP:
            self.restarted = True
            text = f"{self.name} started again (boot-up message): its set-up is gone. Open the rig again"
            yield self._event("restart", text)
        elif state != before and not (before is None and state == cia301.Heartbeat.OPERATIONAL):
            operational = state == cia301.Heartbeat.OPERATIONAL
            text = f"{self.name}: network state {state.name.replace('_', '-')}"
            text += "" if operational else ": it reports no position"
            yield self._event("network", text, network_state=int(state), operational=operational)

    def passed(self, host_ns: int) -> Iterator[DeviceEvent]:
        """Look for the heartbeat at a time at which other bytes came from the bus."""
        if self._beat_ns is None or host_ns - self._beat_ns <= self._patience_ns:
            return
        silent_s = (host_ns - self._beat_ns) * 1e-9
        self._beat_ns = None
        text = f"{self.name}: no heartbeat for {silent_s:.1f} s. Look at its supply and its line"
        yield self._event("network", text, operational=False)

    def emergency(self, frame: CanFrame) -> Iterator[DeviceEvent]:
        """Take an emergency."""
        if len(frame.data) != 8:
            return
        found = cia301.unpack_emergency(frame.data)
        self.faulty = bool(
            found.error_code or found.error_register
        )  # code 0: an error has ended, maybe not the last one
        self.fault = f"of encoder {self._encoder.name}: {_emergency_words(found)}" if self.faulty else ""
        facts: dict[str, Any] = {"error_code": found.error_code, "register": found.error_register}
        if any(found.maker_bytes):
            facts["maker_bytes"] = found.maker_bytes.hex(" ")
        text = f"error 0x{found.error_code:04X}"
        if not found.error_code:
            remaining = f"others remain (error register {found.error_register:02X}h)" if self.faulty else "none remains"
            text = f"an error has ended, {remaining}"
        yield self._event("emergency", f"{self.name}: {text}", **facts)

    def _event(self, kind: str, text: str, **facts: Any) -> DeviceEvent:
        return DeviceEvent(kind, self._device, text, {"encoder": self._encoder.name, **facts})


def _emergency_words(found: cia301.Emergency) -> str:
    if found.error_code:
        return cia301.emergency_words(found.error_code)
    return f"one error has ended, others remain (error register {found.error_register:02X}h)"

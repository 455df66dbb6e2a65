"""Network state, heartbeats and emergencies of one encoder."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from daq.drivers.canopen import cia301
from daq.drivers.cia406.settings import Encoder
from daq.items import DeviceEvent
from daq.transports.slcan import CanFrame

_PATIENCE = 3.5  # periods without a heartbeat after which it is lost


class NodeWatch:
    """State of an encoder on the bus.

    Args:
        device: name of the device in the rig file.
        encoder: the encoder.
        heartbeat_ms: period of its heartbeat, ms.

    Attributes:
        faulty: whether its newest emergency reports an error.
        restarted: whether it has started again since the opening of the device: its settings are gone.
        lost_heartbeats: number of times that its heartbeat was lost.
    """

    def __init__(self, device: str, encoder: Encoder, heartbeat_ms: int) -> None:
        self.faulty: bool = False
        self.restarted: bool = False
        self.lost_heartbeats: int = 0
        self._device, self._encoder = device, encoder
        self._patience_ns = round(_PATIENCE * heartbeat_ms * 1e6)
        self._state: cia301.Heartbeat | None = None
        self._beat_ns: int | None = None  # of the newest heartbeat; None while it is lost, and before the first

    @property
    def name(self) -> str:
        """The encoder's name for the operator."""
        return f"encoder {self._encoder.name} (node {self._encoder.node})"

    def heartbeat(self, frame: CanFrame, host_ns: int) -> Iterator[DeviceEvent]:
        """Take a heartbeat or boot-up message."""
        state = cia301.heartbeat(frame.data)
        if state is None:
            return
        before, self._state, self._beat_ns = self._state, state, host_ns
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
        self.lost_heartbeats += 1
        text = f"{self.name}: no heartbeat for {silent_s:.1f} s. Look at its supply and its line"
        yield self._event("network", text, operational=False)

    def emergency(self, frame: CanFrame) -> Iterator[DeviceEvent]:
        """Take an emergency."""
        if len(frame.data) != 8:
            return
        found = cia301.unpack_emergency(frame.data)
        self.faulty = found.error_code != 0
        facts: dict[str, Any] = {"error_code": found.error_code, "register": found.error_register}
        if any(found.maker_bytes):
            facts["maker_bytes"] = found.maker_bytes.hex(" ")
        yield self._event("emergency", f"{self.name}: error 0x{found.error_code:04X}", **facts)

    def _event(self, kind: str, text: str, **facts: Any) -> DeviceEvent:
        return DeviceEvent(kind, self._device, text, {"encoder": self._encoder.name, **facts})

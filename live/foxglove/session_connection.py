"""Foxglove connection of a session in a process of its own. It returns only the origins of refused pages."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Mapping
from typing import Any

from daq import channels
from daq.acquisition.session import Session
from daq.drivers.devices import channels_of
from daq.items import DeviceEvent
from live.fed_process import FedProcess, drained
from live.foxglove.served import NoteRow, run_foxglove
from live.newest import Newest
from rig_configs.schema import Rig

HOLD_S = 0.25
"""Wall time for which samples are held back, s, so that those of a slow radio are sent in order with the others.

Samples arrive by the hundred at one host time, and Lichtblick, which uses the server's clock (capability `time`),
starts its plots again if that goes back. Samples that are still later keep their time, and the clock waits."""
_MAX_NOTES = 2000


class FoxgloveConnection(FedProcess):
    """Foxglove connection of one session; see FedProcess.

    Args:
        rig: rig of the session.
        port, origins: as for FoxgloveServer.
        refused: called with the origin of a page that was refused; see Refusals.

    Attributes:
        left_out: number of messages that slow clients were not sent; known after the context is left.
    Raises:
        LiveError: on entering, if the connection cannot be offered.
    """

    def __init__(self, rig: Rig, port: int, origins: Collection[str], refused: Callable[[str], None]) -> None:
        super().__init__("foxglove", "connection for Foxglove", run_foxglove, (rig, port, tuple(origins)))
        self.left_out: int = 0
        self._refused, self._hold_ns = refused, int(HOLD_S * 1e9)
        self._notes: deque[NoteRow] = deque(maxlen=_MAX_NOTES)
        self._newest = Newest({topic: channel.names for topic, channel in channels_of(rig.devices).items()})

    @property
    def url(self) -> str:
        """Address of the connection."""
        return str(self.offered["url"])

    def follow(self, session: Session) -> None:
        """Forward an open session from now on."""
        self._feed_from(session)

    def _on_note(self, event: DeviceEvent, host_ns: int) -> None:
        note = {"kind": event.kind, "device": event.device, "text": event.text, **event.facts}
        self._notes.append((channels.EVENTS_TOPIC, int(event.facts.get("time_ns", host_ns)), note))

    def _on_health(self, facts: Mapping[str, Any], host_ns: int) -> None:
        self._notes.append((channels.HEALTH_TOPIC, host_ns, dict(facts)))

    def _update(self, session: Session, last: bool) -> Mapping[str, Any]:
        heard_ns = session.clock.now_ns()
        until_ns = heard_ns if last else heard_ns - self._hold_ns
        rows = self._newest.take(session.channels.recent, heard_ns, None if last else until_ns)
        return {"until_ns": until_ns, "rows": rows, "notes": drained(self._notes)}

    def _on_message(self, message: Mapping[str, Any]) -> None:
        if "left_out" in message:
            self.left_out = int(message["left_out"])
        else:
            self._refused(str(message["refused"]))

# pyright: strict
"""The Foxglove connection beside a session, in a process of its own. Nothing comes back but words for the operator."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Mapping
from typing import Any

from daq import channels
from daq.acquisition.session import Session
from daq.drivers.devices import channels_of
from daq.drivers.items import Event
from live.fed_process import FedProcess, emptied
from live.foxglove.served import NoteRow, run_foxglove
from live.newest import Newest
from rig_configs.schema import Rig

HOLD_S = 0.25
"""Seconds of the wall that samples are kept back, so that those of a slow radio are sent in order with the others."""
_MOST_NOTES = 2000


class FoxgloveBeside(FedProcess):
    """A connection for one session; see FedProcess.

    Args:
        rig: the session's.
        rate: seconds of the rig per second of the wall.
        port, origins: as FoxgloveServer takes them.
        told: takes a sentence for the operator.

    Attributes:
        left_out: messages that slow clients were not sent; known once it is left.
    Raises:
        RigError: on entering; the connection cannot be offered.
    """

    def __init__(self, rig: Rig, rate: float, port: int, origins: Collection[str], told: Callable[[str], None]) -> None:
        super().__init__("foxglove", "--foxglove", run_foxglove, (rig, port, tuple(origins)))
        self.left_out = 0
        self._told, self._hold_ns = told, int(HOLD_S * 1e9 * (rate if math.isfinite(rate) else 1.0))
        self._notes: deque[NoteRow] = deque(maxlen=_MOST_NOTES)
        self._newest = Newest({topic: channel.names for topic, channel in channels_of(rig.devices).items()})

    @property
    def url(self) -> str:
        """The connection's address."""
        return str(self.offered["url"])

    def follow(self, session: Session) -> None:
        """Show an open session from now on."""
        self._feed_from(session)

    def _noted(self, event: Event, host_ns: int) -> None:
        note = {"kind": event.kind, "device": event.device, "text": event.text, **event.facts}
        self._notes.append((channels.EVENTS_TOPIC, int(event.facts.get("time_ns", host_ns)), note))

    def _reported(self, facts: Mapping[str, Any], host_ns: int) -> None:
        self._notes.append((channels.HEALTH_TOPIC, host_ns, dict(facts)))

    def _copied(self, session: Session, last: bool) -> Mapping[str, Any]:
        heard_ns = session.clock.now_ns()
        until_ns = heard_ns if last else heard_ns - self._hold_ns
        rows = self._newest.take(session.recent, heard_ns, None if last else until_ns)
        return {"until_ns": until_ns, "rows": rows, "notes": emptied(self._notes)}

    def _heard(self, said: Mapping[str, Any]) -> None:
        if "left_out" in said:
            self.left_out = int(said["left_out"])
        else:
            self._told(str(said["say"]))

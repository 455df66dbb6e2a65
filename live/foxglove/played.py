"""A log for the Foxglove connection: its own messages, sent as the page's replay advances."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.channels import EVENTS_TOPIC, HEALTH_TOPIC, pack_note
from daq.log import Log
from live.foxglove.client import Turn
from live.foxglove.protocol import ChannelMessages, Offered, offered
from live.foxglove.server import FoxgloveServer
from live.transport import Transport

_INTERVAL_S = 1 / 30
_END_S = 5.0


class LogMessages:
    """Messages of a log by time.

    Args:
        log: open log; it is read here and not needed afterwards.

    Attributes:
        offered: advertised channels.
    """

    def __init__(self, log: Log) -> None:
        sample_channels = [log.channel(topic) for topic in log]
        self.offered: list[Offered] = offered(sample_channels)
        self._numbers = {each.topic: each.number for each in self.offered}
        self._samples: list[tuple[int, NDArray[np.int64], NDArray[Any]]] = []
        for channel in sample_channels:
            samples = log[channel.topic]
            order = np.argsort(samples.time_ns, kind="stable")
            messages = channel.pack(samples.columns)[order]
            self._samples.append((self._numbers[channel.topic], samples.time_ns[order], messages))
        notes = [
            (int(note["time_ns"]), self._numbers[topic], pack_note(note))
            for topic, found in ((EVENTS_TOPIC, log.events), (HEALTH_TOPIC, log.health))
            for note in found
        ]
        self._notes = sorted(notes, key=lambda note: note[0])
        self._note_ns = np.array([time_ns for time_ns, _, _ in self._notes], np.int64)

    def turn(self, after_ns: int, until_ns: int, restarted: bool = False) -> Turn:
        """Return the messages after one instant and up to another, ns since 1970."""
        blocks: list[ChannelMessages] = []
        for number, time_ns, messages in self._samples:
            first, end = np.searchsorted(time_ns, [after_ns, until_ns], "right")
            if end > first:
                blocks.append(ChannelMessages(number, time_ns[first:end], messages[first:end].tobytes()))
        first, end = np.searchsorted(self._note_ns, [after_ns, until_ns], "right")
        for time_ns, number, note in self._notes[first:end]:
            blocks.append(ChannelMessages(number, np.array([time_ns], np.int64), note))
        return Turn(blocks, until_ns, restarted)


class LogSender:
    """Sends a log's messages to a server as its replay advances; a context.

    Args:
        played: log.
        transport: position in the log, s since `origin_ns`.
        origin_ns: origin of the position, ns since 1970.
        server: server of the connection.
    """

    def __init__(self, played: LogMessages, transport: Transport, origin_ns: int, server: FoxgloveServer) -> None:
        self._played, self._transport, self._origin_ns, self._server = played, transport, origin_ns, server
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._send, name="foxglove log", daemon=True)

    def __enter__(self) -> LogSender:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join(_END_S)

    def _send(self) -> None:
        jumps, at_ns = self._transport.jumps, self._now_ns() - 1
        while not self._ending.wait(_INTERVAL_S):
            if self._server.wanted:  # a subscription starts the replay, as a viewer of the page does
                self._transport.looked_at()
            jumped, now_ns = self._transport.jumps != jumps, self._now_ns()
            jumps = self._transport.jumps
            self._server.show(self._played.turn(now_ns - 1 if jumped else at_ns, now_ns, jumped))
            at_ns = now_ns

    def _now_ns(self) -> int:
        return self._origin_ns + round(self._transport.at() * 1e9)

"""Process of a session's Foxglove connection: rows are converted to messages here, not in the recorder's process."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Collection, Mapping
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from daq.channels import Channel, pack_note
from daq.drivers.devices import channels_of
from daq.version import software_version
from live.errors import LiveError
from live.foxglove.client import Turn
from live.foxglove.protocol import ChannelMessages, Offered, offered
from live.foxglove.server import FoxgloveServer
from live.newest import Rows
from rig_basics.ignoring import ignoring
from rig_configs.schema import Rig

NoteRow = tuple[str, int, Mapping[str, Any]]
"""Topic, time (ns since 1970), event or health report."""
_NICE = 10
_MAX_ORIGINS, _MAX_ORIGIN_LETTERS = 5, 80
_log = logging.getLogger(__name__)


class Packing:
    """Converts rows of a session to messages of a log.

    Args:
        sample_channels: channels by topic.

    Attributes:
        offered: advertised channels.
    """

    def __init__(self, sample_channels: Mapping[str, Channel]) -> None:
        self._channels = dict(sample_channels)
        self.offered: list[Offered] = offered(self._channels.values())
        self._numbers = {each.topic: each.number for each in self.offered}
        self._held: list[NoteRow] = []

    def samples(self, row: Rows) -> ChannelMessages:
        """Return the samples of one channel."""
        topic, time_ns, columns = row
        return ChannelMessages(self._numbers[topic], time_ns, self._channels[topic].pack(columns).tobytes())

    def note(self, row: NoteRow) -> ChannelMessages:
        """Return one event or health report."""
        topic, time_ns, note = row
        return ChannelMessages(self._numbers[topic], np.array([time_ns], np.int64), pack_note(note))

    def turn(self, handed: Mapping[str, Any], wanted: Collection[int]) -> Turn:
        """Convert an update; notes that are newer than the samples are held until these arrive.

        Args:
            handed: update of the session's process.
            wanted: numbers of the subscribed channels; others are not converted.
        """
        until_ns = int(handed["until_ns"])
        self._held += handed["notes"]
        due = [note for note in self._held if note[1] <= until_ns]
        self._held = [note for note in self._held if note[1] > until_ns]
        rows = [row for row in handed["rows"] if self._numbers[row[0]] in wanted]
        notes = [note for note in due if self._numbers[note[0]] in wanted]
        return Turn([*map(self.samples, rows), *map(self.note, notes)], until_ns)


class Refusals:
    """Origins of refused pages for the operator: each once, and a limited number.

    Args:
        refused: called with an origin; its text is escaped, because the page chose it.
    """

    def __init__(self, refused: Callable[[str], None]) -> None:
        self._refused, self._origins = refused, set[str]()

    def __call__(self, origin: str) -> None:
        """Report that a page of this origin was refused."""
        shown = ascii(origin[:_MAX_ORIGIN_LETTERS])[1:-1]
        if shown in self._origins or len(self._origins) >= _MAX_ORIGINS:
            return
        self._origins.add(shown)
        self._refused(shown)


def facts_of(rig: Rig) -> dict[str, str]:
    """Return the metadata of a connection for its clients."""
    return {"rig": rig.name, "software": software_version(), "access": "read-only"}


def run_foxglove(pipe: Connection, rig: Rig, port: int, origins: tuple[str, ...]) -> None:
    """Serve until the other side closes the pipe."""
    if hasattr(os, "nice"):  # no part of the rig depends on this process
        os.nice(_NICE)
    packing = Packing(channels_of(rig.devices))

    def refused(origin: str) -> None:
        with ignoring(_log, f"reporting that a page of {origin} was refused", OSError, ValueError):
            pipe.send({"refused": origin})

    try:
        server = FoxgloveServer(rig.name, packing.offered, facts_of(rig), origins, port, Refusals(refused))
    except LiveError as fault:
        pipe.send({"failed": str(fault)})
        return
    with server:
        pipe.send({"url": server.url})
        with ignoring(_log, "receiving the session's messages", EOFError, OSError):
            while "end" not in (handed := pipe.recv()):
                server.show(packing.turn(handed, server.wanted))
    with ignoring(_log, "reporting the omitted messages", OSError, ValueError):
        pipe.send({"left_out": server.left_out})

# pyright: strict
"""The Foxglove connection's own process beside a session: rows become messages here, not in the recorder's process."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable, Collection, Mapping
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from daq.channels import Channel, pack_note
from daq.drivers.devices import channels_of
from daq.errors import RigError
from daq.version import software_version
from live.foxglove.client import Turn
from live.foxglove.protocol import Block, Offered, offered
from live.foxglove.server import FoxgloveServer
from live.newest import Rows
from rig_configs.schema import Rig

NoteRow = tuple[str, int, Mapping[str, Any]]
"""Topic, time (ns since 1970), an event or a health report."""
_NICE = 10
_MOST_ORIGINS, _LONGEST_ORIGIN = 5, 80


class Packing:
    """Rows of a session as messages of a log.

    Args:
        sample_channels: by topic.

    Attributes:
        offered: the channels, as they are advertised.
    """

    def __init__(self, sample_channels: Mapping[str, Channel]) -> None:
        self._channels = dict(sample_channels)
        self.offered: list[Offered] = offered(self._channels.values())
        self._numbers = {each.topic: each.number for each in self.offered}
        self._held: list[NoteRow] = []

    def samples(self, row: Rows) -> Block:
        """Samples of one channel."""
        topic, time_ns, columns = row
        return Block(self._numbers[topic], time_ns, self._channels[topic].pack(columns).tobytes())

    def note(self, row: NoteRow) -> Block:
        """One event or health report."""
        topic, time_ns, note = row
        return Block(self._numbers[topic], np.array([time_ns], np.int64), pack_note(note))

    def turn(self, handed: Mapping[str, Any], wanted: Collection[int]) -> Turn:
        """What was handed over; notes that are newer than the samples wait for these.

        Args:
            wanted: numbers of the channels that somebody subscribed to; of others nothing is packed.
        """
        until_ns = int(handed["until_ns"])
        self._held += handed["notes"]
        due = [note for note in self._held if note[1] <= until_ns]
        self._held = [note for note in self._held if note[1] > until_ns]
        rows = [row for row in handed["rows"] if self._numbers[row[0]] in wanted]
        notes = [note for note in due if self._numbers[note[0]] in wanted]
        return Turn([*map(self.samples, rows), *map(self.note, notes)], until_ns)


class Refusals:
    """Words for the operator about pages that were refused: once each, and not many.

    Args:
        say: takes a sentence.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say, self._said = say, set[str]()

    def __call__(self, origin: str) -> None:
        """A page of this origin was refused; the text is the page's own, so it is shown as no terminal obeys it."""
        shown = ascii(origin[:_LONGEST_ORIGIN])[1:-1]
        if shown in self._said or len(self._said) >= _MOST_ORIGINS:
            return
        self._said.add(shown)
        self._say(
            f"warning: --foxglove: a page of {shown} asked for the rig's data and was refused; if it is one that "
            f"you use, begin with --foxglove-origin {shown}"
        )


def facts_of(rig: Rig) -> dict[str, str]:
    """What clients are told of a connection."""
    return {"rig": rig.name, "software": software_version(), "access": "read-only"}


def run_foxglove(pipe: Connection, rig: Rig, port: int, origins: tuple[str, ...]) -> None:
    """Serve until the other side of the pipe is gone."""
    for name in ("SIGINT", "SIGHUP"):  # the terminal sends them to both; the session decides when it is over
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    if hasattr(os, "nice"):  # nothing of the rig waits for it
        os.nice(_NICE)
    packing = Packing(channels_of(rig.devices))

    def say(text: str) -> None:
        with contextlib.suppress(OSError, ValueError):
            pipe.send({"say": text})

    try:
        server = FoxgloveServer(rig.name, packing.offered, facts_of(rig), origins, port, Refusals(say))
    except RigError as fault:
        pipe.send({"failed": str(fault)})
        return
    with server:
        pipe.send({"url": server.url})
        with contextlib.suppress(EOFError, OSError):
            while "end" not in (handed := pipe.recv()):
                server.show(packing.turn(handed, server.wanted))
    with contextlib.suppress(OSError, ValueError):
        pipe.send({"left_out": server.left_out})

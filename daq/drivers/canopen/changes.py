"""Objects of a node that are changed together: all of them, or none. Also the mapping of its process data (CiA 301)."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Generator, Sequence

from daq.drivers.canopen.objects import NodeObjects
from daq.errors import DeviceError, LinkLost
from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)

PDO_OFF, PDO_NO_REMOTE = 1 << 31, 1 << 30
"""Bits of a PDO's identifier: it is not used; it cannot be requested."""
MAX_ENTRIES = 64
"""Most entries in a PDO's mapping: one for each bit."""


class Changes:
    """Objects of a node, whose written values are kept to be restored.

    Args:
        objects: the objects.
    """

    def __init__(self, objects: NodeObjects) -> None:
        self._objects = objects
        self._before: list[tuple[int, int, int, int]] = []  # index, sub-index, value, size, in the order of the writes

    def read(self, index: int, sub: int) -> int | None:
        """See NodeObjects."""
        return self._objects.read(index, sub)

    def write(self, index: int, sub: int, value: int, size: int) -> None:
        """See NodeObjects. An object that has the value already is not written."""
        before = self._objects.read(index, sub)
        if before == value:
            return
        self._objects.write(index, sub, value, size)
        if before is not None:
            self._before.append((index, sub, before, size))

    def undo(self) -> None:
        """Restore the objects, the newest write first, as far as the node accepts it."""
        for index, sub, value, size in reversed(self._before):
            with ignoring(_log, f"restoring {index:04X}h sub {sub}", DeviceError, LinkLost):
                self._objects.write(index, sub, value, size)

    def mapped(self, index: int, most: int = MAX_ENTRIES) -> list[int | None] | None:
        """Return the entries of a PDO's mapping; None if the node does not provide it.

        Entries that are not provided, or beyond the most, are None: counts of 254 and 255 mark other kinds of PDO.
        """
        count = self.read(index, 0)
        if count is None:
            return None
        entries = [self.read(index, sub) for sub in range(1, min(count, most) + 1)]
        return entries + [None] * (count - len(entries))

    def map_entries(self, index: int, entries: Sequence[int]) -> None:
        """Write a PDO's mapping. The PDO must be off."""
        self.write(index, 0, 0, 1)
        for sub, entry in enumerate(entries, 1):
            self.write(index, sub, entry, 4)
        self.write(index, 0, len(entries), 1)


@contextlib.contextmanager
def restoring(objects: NodeObjects) -> Generator[Changes]:
    """Context in which a node is changed; after an error it is restored."""
    changes = Changes(objects)
    try:
        yield changes
    except BaseException:
        changes.undo()
        raise

"""Events that would fill a log if each of them were recorded: at most one each second, or one for each subject."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq.items import DeviceEvent

_MOST_FOREIGN = 16


class EachSecond:
    """Lets an event pass if the one before it was at least a second ago."""

    def __init__(self) -> None:
        self._passed_ns: int | None = None

    def passes(self, time_ns: int) -> bool:
        """Return whether an event of a time, ns, passes."""
        if self._passed_ns is not None and time_ns - self._passed_ns < 1_000_000_000:
            return False
        self._passed_ns = time_ns
        return True


class Foreign:
    """Reports each other sender once, up to a number that neither fills a log nor memory; further ones are counted.

    Args:
        device: name of the device in the rig file.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._known: set[str] = set()

    def event(self, text: str, facts: Mapping[str, Any]) -> list[DeviceEvent]:
        """Return the event about a message of another sender, which its text names."""
        if text in self._known or len(self._known) >= _MOST_FOREIGN:
            return []
        self._known.add(text)
        return [DeviceEvent("foreign", self._device, text, facts)]

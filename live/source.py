# pyright: strict
"""What the page shows, wherever it comes from: a rig's session or a log."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future
from typing import Any, Protocol

from live.signals import Signals

Facts = dict[str, Any]


class Refused(Exception):
    """What was asked cannot be done here; the text says why."""


class Source(Protocol):
    """See the module.

    Attributes:
        signals: all that is known of the signals.
    """

    signals: Signals

    def now_s(self) -> float:
        """The instant that is shown, s since the signals' origin."""
        ...

    def heard_s(self) -> float:
        """The instant up to which samples could be there."""
        ...

    @property
    def rate(self) -> float:
        """Seconds of the signals per second of the wall."""
        ...

    def looked_at(self) -> None:
        """A viewer has seen a picture."""
        ...

    def facts(self) -> Facts:
        """What else the page shows; see `live.picture`."""
        ...

    def events(self) -> list[Mapping[str, Any]]:
        """What happened up to now, in order: kind, device, text, at_s, a rising number and more."""
        ...

    def act(self, verb: str, given: Mapping[str, Any]) -> Future[Facts]:
        """Have done what somebody at the page asks for: passed on at once, by the caller's thread.

        Returns:
            The answer, when there is one; Refused where it cannot be done here.
        Raises:
            Refused: the same, where it is plain at once.
        """
        ...

"""Interface of the page's sources: a session of a rig, or a log."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future
from typing import Any, Protocol

from live.messages import Facts
from live.signals import Signals


class PageSource(Protocol):
    """Source of the page.

    Attributes:
        signals: all signals of the source.
    """

    signals: Signals

    def now_s(self) -> float:
        """Return the displayed instant, s since the signals' origin."""
        ...

    def heard_s(self) -> float:
        """Return the instant up to which samples can have arrived, s since the signals' origin."""
        ...

    def looked_at(self) -> None:
        """Report that a viewer has displayed a picture."""
        ...

    def facts(self) -> Facts:
        """Return further facts for the page; see `live.picture`."""
        ...

    def events(self) -> list[Mapping[str, Any]]:
        """Return the events up to now in order: kind, device, text, at_s, a rising number and more."""
        ...

    def act(self, verb: str, given: Mapping[str, Any]) -> Future[Facts]:
        """Forward a viewer's command immediately, in the caller's thread.

        Returns:
            The answer once it exists; CommandRefused if the command cannot be carried out here.
        Raises:
            CommandRefused: the same, if this is known at once.
        """
        ...

"""The newest samples and the rates of an open session's channels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.core import Core
from daq.acquisition.rate_watch import RateWatches
from daq.acquisition.recent import Recent
from daq.transports import HostClock

_MAX_NEWEST_AGE_S = 20.0  # of samples that `newest` returns, s


class Channels:
    """Channels of an open session.

    Args:
        core: core of the acquisition.
        clock: the host clock.
        topics: channels to which the devices send continuously.

    Attributes:
        topics: see above.
        recent: the newest samples of every channel.
        rates: rates of the device clocks.
    """

    def __init__(self, core: Core, clock: HostClock, topics: tuple[str, ...]) -> None:
        self._core, self._clock = core, clock
        self.topics: tuple[str, ...] = topics
        self.recent: Recent = core.recent
        self.rates: RateWatches = core.rates

    def newest(self, topic: str, fields: tuple[str, ...], seconds: float) -> tuple[NDArray[np.int64], list[Any]]:
        """Return the newest samples of a channel.

        Args:
            topic: of the channel.
            fields: names of the columns.
            seconds: length of the stretch, counted back from the newest sample, so that a late read is not a gap.

        Returns:
            Times, ns, and the columns; empty if the newest sample is older than 20 s.
        """
        time_ns, columns = self.recent.last(topic, fields, self._clock.now_ns() - int(_MAX_NEWEST_AGE_S * 1e9))
        if len(time_ns) == 0:
            return time_ns, columns
        new = time_ns > time_ns[-1] - int(seconds * 1e9)
        return time_ns[new], [column[new] for column in columns]

    def need(self, *topics: str) -> None:
        """Set the channels that the running test needs even at rest. Silence of one of them ends the test."""
        self._core.interlocks.need(topics)

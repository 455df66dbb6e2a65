"""The host's SYNC: sent periodically, and never before all encoders have answered the one before."""

from __future__ import annotations

from collections.abc import Callable

from daq.drivers.canopen import cia301
from daq.drivers.cia406 import wire
from daq.drivers.cia406.settings import LATEST_S, EncoderBus
from daq.drivers.polling import Request, RequestLoop
from daq.transports import slcan
from daq.transports.host_clock import HostClock

_ANSWERED = b"\r"
_MISSES = 3


class SyncSender(RequestLoop):
    """See Poller. A SYNC that not all encoders answer delays the next one to twice `LATEST_S`.

    An encoder that has not answered `_MISSES` times is not waited for until it answers again, so that a dead encoder
    does not slow down the others.

    Args:
        settings: table of the encoders in the rig file.
        send: writes bytes to the adapter.
        clock: clock for the periods.
    """

    def __init__(self, settings: EncoderBus, send: Callable[[bytes], None], clock: HostClock) -> None:
        self._expected = frozenset(cia301.cob_tpdo(1, encoder.node) for encoder in settings.encoders)
        self._missing: set[int] = set()
        self._misses = dict.fromkeys(self._expected, 0)
        self._lines = slcan.LineDecoder()
        self._write = send
        request = Request(lambda number: wire.SYNC, _ANSWERED, 1.0 / settings.rate_Hz, 2 * LATEST_S)
        super().__init__(request, self._sync, clock)

    def heard(self, data: bytes) -> None:
        """See Poller."""
        before = bool(self._missing)
        for frame in self._lines.feed(data).frames:
            if frame.arbitration_id in self._expected:
                self._missing.discard(frame.arbitration_id)
                self._misses[frame.arbitration_id] = 0
        if before and not self._missing:
            super().heard(_ANSWERED)

    def _sync(self, data: bytes) -> None:
        for identifier in self._missing:
            self._misses[identifier] += 1
        self._missing = {identifier for identifier in self._expected if self._misses[identifier] < _MISSES}
        self._write(data)


class NoRequests:
    """See Poller: encoders that send by their own timer get no request."""

    def start(self) -> None:
        """See Poller."""

    def heard(self, data: bytes) -> None:
        """See Poller."""

    def stop(self) -> None:
        """See Poller."""

"""Poller of a LabJack: stream reads, and a read of the error of each read that the device refuses.

While more samples wait than a read returns, one read follows the other at once: a full buffer skips scans until all
that wait have been read.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from daq.drivers.polling import RequestLoop
from daq.errors import LinkLost
from rig_basics.ignoring import ignoring
from rig_drivers.labjack import wire
from rig_drivers.labjack.wire import Register

_log = logging.getLogger(__name__)


class StreamReads:
    """Sends stream reads; see Poller. The pipeline explains a refused read by the answer to the read of its error.

    Args:
        loop: sends the stream reads.
        send: writes bytes to the device's link, and to the log.
    """

    def __init__(self, loop: RequestLoop, send: Callable[[bytes], None]) -> None:
        self._loop, self._send = loop, send
        self._decoder = wire.MessageDecoder()

    def start(self) -> None:
        """See Poller."""
        self._decoder = wire.MessageDecoder()
        self._loop.start()

    def heard(self, data: bytes) -> None:
        """See Poller."""
        for message in self._decoder.feed(data).messages:
            if message.number < wire.FIRST_STREAM_ID:
                continue
            if message.function == wire.FEEDBACK:
                read = wire.parse_stream(message.body)
                if read is not None and read.backlog_bytes >= 2 * max(1, len(read.samples)):
                    self._loop.hurry()
            else:
                with ignoring(_log, "reading the error of a device without a link", LinkLost):
                    self._send(wire.request(wire.ERROR_NUMBER, [wire.read(Register.LAST_ERROR, 1)]))
        self._loop.heard(data)

    def stop(self) -> None:
        """See Poller."""
        self._loop.stop()

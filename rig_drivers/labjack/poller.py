"""Poller of a LabJack: stream reads, and a read of the error of each read that the device refuses.

While more samples wait than a read returns, one read follows the other at once: a full buffer skips scans until all
that wait have been read.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial

from typing_extensions import override

from daq.drivers.contract import Poller
from daq.drivers.polling import Request, RequestLoop
from daq.errors import LinkLost
from daq.transports.host_clock import HostClock
from rig_basics.ignoring import ignoring
from rig_drivers.labjack import wire
from rig_drivers.labjack.dialogue import ANSWER_S
from rig_drivers.labjack.settings import LabJack
from rig_drivers.labjack.wire import Register

_log = logging.getLogger(__name__)


class StreamReads(Poller):
    """Sends stream reads; see Poller. The pipeline explains a refused read by the answer to the read of its error.

    Args:
        settings: table of the device in the rig file.
        send: writes bytes to the device's link, and to the log.
        clock: clock for the periods and the time-out.
    """

    def __init__(self, settings: LabJack, send: Callable[[bytes], None], clock: HostClock) -> None:
        read = partial(wire.stream_request, inputs=len(settings.scan_list))
        self._loop, self._send = RequestLoop(Request(read, b"", settings.read_period_s, ANSWER_S), send, clock), send
        self._decoder = wire.MessageDecoder()

    @override
    def start(self) -> None:
        self._decoder = wire.MessageDecoder()
        self._loop.start()

    @override
    def heard(self, data: bytes) -> None:
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

    @override
    def stop(self) -> None:
        self._loop.stop()

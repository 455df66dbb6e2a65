"""Player of a log's bytes at their times, with answers in between; one thread serves all ports.

Bytes leave in the recorded order and none is dropped: the player waits for a slow reader. A slow reader of one port
does not delay the others until `BACKLOG_BYTES` are waiting.

A command to a device within `_SETTLE_S` after the opening of all ports means a host that configures (opening a CAN
adapter is not a command): playing then begins for all devices together, when each has received the command that it
expects. A device whose transmission is stopped and started again continues at the present position of the log.
"""

from __future__ import annotations

import logging
import select
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from daq.drivers.played import PlayedDevice
from daq.errors import DeviceError, LinkLost
from daq.log.samples import RawChunk
from daq.playback.outlets import Outlet
from daq.replay.pace import Clock, Pace
from daq.transports.host_clock import HostClock

_log = logging.getLogger(__name__)

BACKLOG_BYTES = 4 * 2**20
"""Number of waiting bytes above which playing waits for slow readers."""
_TURN_S = 0.02  # longest time without service of the ports
_SETTLE_S = 0.3  # time for a program to flush a port after opening it, or to send its first command
# Longest time from a host's first command to the last expected one.
_SETUP_TIMEOUT_S = 60.0


@dataclass(frozen=True)
class PlaybackState:
    """State of a playback.

    Attributes:
        log_ns: log time of the last delivered bytes, ns since 1970; 0 before any were delivered.
        late_s, most_late_s: delay of the last bytes, and largest delay so far, s.
        delivered, undelivered: bytes by device; undelivered are those whose reader had gone.
        withheld: bytes by device while its host had not started its transmission, or had stopped it.
        unfollowed: number of commands by device that the recorded bytes cannot follow.
        waiting_bytes: number of bytes not delivered yet.
        gone: devices whose reader went away, with the log time of the detection, ns since 1970.
        cut_short: True if every reader had gone before the end.
        stopped: True if a host has stopped the transmission of every device that has a stop command.
    """

    log_ns: int
    late_s: float
    most_late_s: float
    delivered: Mapping[str, int]
    undelivered: Mapping[str, int]
    withheld: Mapping[str, int]
    unfollowed: Mapping[str, int]
    waiting_bytes: int
    gone: Mapping[str, int]
    cut_short: bool
    stopped: bool


class _Line:
    """One device, its outlet and the bytes that wait for it."""

    def __init__(self, outlet: Outlet, device: PlayedDevice) -> None:
        self.outlet, self.device = outlet, device
        self.waiting: deque[tuple[int | None, bytes]] = deque()  # with the log time; answers have None
        self.delivered = self.undelivered = self.waiting_bytes = 0
        self.gone_ns: int | None = None

    def add(self, log_ns: int | None, data: bytes) -> None:
        if self.gone_ns is not None:
            self.undelivered += len(data) if log_ns is not None else 0
        elif data:
            self.waiting.append((log_ns, data))
            self.waiting_bytes += len(data)

    def give_up(self, log_ns: int) -> None:
        self.gone_ns = log_ns
        self.undelivered += sum(len(data) for of_log_ns, data in self.waiting if of_log_ns is not None)
        self.waiting.clear()
        self.waiting_bytes = 0


class Playback:
    """Plays bytes on outlets.

    Args:
        outlets: outlets by device; bytes of other devices are not played.
        devices: simulated device behind each outlet, see `played_devices`.
        speed: seconds of the log per second; `math.inf` is limited by the readers only.
        clock: clock of the pace; None for the host's clock.
    """

    def __init__(
        self,
        outlets: Mapping[str, Outlet],
        devices: Mapping[str, PlayedDevice],
        speed: float = 1.0,
        clock: Clock | None = None,
    ) -> None:
        self._clock = clock or HostClock()
        self._pace = Pace(speed, self._clock)
        self._lines = {name: _Line(outlet, devices[name]) for name, outlet in outlets.items()}
        self._log_ns = 0
        self._looked_ns = 0
        self._configured = self._cut_short = False

    @property
    def configured(self) -> bool:
        """True if the reader is a host that configures its devices first; valid when all ports are open."""
        return self._configured

    @property
    def state(self) -> PlaybackState:
        """State of the playback."""
        lines = self._lines.items()
        startable = [line.device for _, line in lines if line.device.expects]
        return PlaybackState(
            self._log_ns,
            self._pace.late_s,
            self._pace.most_late_s,
            {name: line.delivered for name, line in lines},
            {name: line.undelivered for name, line in lines},
            {name: line.device.withheld_bytes for name, line in lines},
            {name: line.device.unfollowed for name, line in lines},
            sum(line.waiting_bytes for _, line in lines),
            {name: line.gone_ns for name, line in lines if line.gone_ns is not None},
            self._cut_short,
            bool(startable) and not any(device.sending for device in startable),
        )

    def wait_for_readers(self, notify: Callable[[list[str]], None] = lambda waiting: None) -> None:
        """Return when every port has been open for `_SETTLE_S`, or was open and a command arrived.

        A program that opens a port discards what it finds there, so earlier bytes would be lost. A program that
        configures its devices sends commands at once.

        Args:
            notify: called with the devices whose port has not been opened yet, at every change.
        """
        reported: list[str] | None = None
        open_since_ns: int | None = None
        while not self._configured and not self._passed(open_since_ns, _SETTLE_S):
            self._serve()
            waiting = [name for name, line in self._lines.items() if not line.outlet.connected()]
            if waiting != reported:
                reported = waiting
                notify(waiting)
            for name in waiting:
                self._lines[name].device.commands = 0  # commands of a program that has left again
            open_since_ns = None if waiting else open_since_ns or self._clock.now_ns()
            self._configured = not waiting and any(line.device.commands for line in self._lines.values())
            self._wait(_TURN_S)

    def wait_for_setup(self, notify: Callable[[Mapping[str, str]], None] = lambda waiting: None) -> None:
        """Return when a configuring host has started every device's transmission; at once for a receiving program.

        Args:
            notify: called with the devices and the commands that they still need, at every change.

        Raises:
            DeviceError: the host leaves, or does not finish within `_SETUP_TIMEOUT_S`.
        """
        started_ns = self._clock.now_ns()
        reported: dict[str, str] | None = None
        while self._configured:
            self._serve()
            waiting = {name: line.device.expects for name, line in self._lines.items() if not line.device.sending}
            if waiting != reported:
                reported = waiting
                notify(waiting)
            if not waiting:
                return
            expected = ", ".join(f"{expects} at {name}" for name, expects in waiting.items())
            if not any(line.outlet.connected() for line in self._lines.values()):
                raise DeviceError(
                    f"the host closed its ports before it had set up its devices; still expected: {expected}. See the "
                    "messages of the host for the reason"
                )
            if self._passed(started_ns, _SETUP_TIMEOUT_S):
                raise DeviceError(
                    f"the host began to configure its devices, {_SETUP_TIMEOUT_S:g} s later still expected: "
                    f"{expected}. A program that only receives must not send commands when it opens its ports"
                )
            self._wait(_TURN_S)

    def play(
        self, chunks: Iterable[tuple[str, RawChunk]], report: Callable[[PlaybackState], None] = lambda state: None
    ) -> PlaybackState:
        """Play bytes until all are delivered, or every reader has gone.

        Args:
            chunks: raw bytes in the recorded order, as a log returns them.
            report: called with the state each time the ports are served.
        """
        if not self._configured:
            for line in self._lines.values():
                line.device.begin()
        for name, chunk in chunks:
            line = self._lines.get(name)
            if line is None:
                continue
            while (left := self._pace.left_s(chunk.host_ns)) > 0 and self._alive():
                self._turn(min(left, _TURN_S))
                report(self.state)
            line.add(chunk.host_ns, line.device.play(chunk.direction, chunk.data))
            self._send(line)
            if self._passed(self._looked_ns, _TURN_S):
                self._turn(0.0)
            while sum(each.waiting_bytes for each in self._lines.values()) > BACKLOG_BYTES:
                self._turn(_TURN_S)
                report(self.state)
            if not self._alive():
                self._cut_short = True
                break
        for line in self._lines.values():
            line.add(self._log_ns, line.device.remainder())
        while any(line.waiting for line in self._lines.values()):
            self._turn(_TURN_S)
            report(self.state)
        self._listen()  # a host may have sent commands just before it left
        return self.state

    def hold(self, linger_s: float | None = None) -> None:
        """Keep the ports open until their readers close them, or for at most `linger_s` seconds.

        Data that a reader has not fetched yet would be lost if its port were closed.
        """
        started_ns = self._clock.now_ns()
        while any(line.outlet.connected() for line in self._lines.values()):
            if linger_s is not None and self._passed(started_ns, linger_s):
                return
            self._serve()
            self._wait(_TURN_S)
        self._listen()

    def close(self) -> None:
        """Close every port."""
        for line in self._lines.values():
            line.outlet.close()

    def _passed(self, since_ns: int | None, seconds: float) -> bool:
        return since_ns is not None and self._clock.now_ns() - since_ns >= seconds * 1e9

    def _alive(self) -> bool:
        return any(line.gone_ns is None for line in self._lines.values())

    def _turn(self, wait_s: float) -> None:
        """Serve every port, detect readers that have gone, then wait for a port at most `wait_s`."""
        self._serve()
        for line in self._lines.values():
            if line.gone_ns is None and not line.outlet.connected():
                line.give_up(self._log_ns)
        if wait_s > 0:
            self._wait(wait_s)

    def _serve(self) -> None:
        self._looked_ns = self._clock.now_ns()
        self._listen()
        for line in self._lines.values():
            self._send(line)

    def _wait(self, wait_s: float) -> None:
        """Wait until a port has something to read, or has room for waiting bytes."""
        open_lines = [line for line in self._lines.values() if line.outlet.connected()]
        full = [line.outlet.descriptor() for line in open_lines if line.waiting]
        readable = [descriptor for line in open_lines if (descriptor := line.outlet.descriptor()) is not None]
        if readable:
            select.select(readable, [descriptor for descriptor in full if descriptor is not None], [], wait_s)
        else:
            self._clock.wait(wait_s)

    def _send(self, line: _Line) -> None:
        """Send as many waiting bytes as there is room for."""
        while line.waiting:
            log_ns, data = line.waiting[0]
            try:
                sent = line.outlet.offer(data)
            except LinkLost as error:
                _log.info("the waiting bytes of a lost port are counted as not delivered: %s", error)
                line.give_up(self._log_ns if log_ns is None else log_ns)
                return
            line.waiting_bytes -= sent
            if log_ns is not None:
                line.delivered += sent
                self._pace.note(log_ns)
            if sent < len(data):
                line.waiting[0] = (log_ns, data[sent:])
                return
            line.waiting.popleft()
            self._log_ns = max(self._log_ns, log_ns or 0)

    def _listen(self) -> None:
        """Read what readers sent, so that their side does not fill up, and queue the answers."""
        for line in self._lines.values():
            if data := line.outlet.receive():
                line.add(None, line.device.hear(data))

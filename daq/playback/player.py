"""Bytes out at their time, answers in between, one thread for all ports.

Bytes leave in the order they came; nothing is dropped, a program that reads slowly is waited for, and a slow reader of
one port does not hold up the others until a few MB wait.
"""

from __future__ import annotations

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

BACKLOG_BYTES = 4 * 2**20
"""More waiting for slow readers than this, and the playing itself waits."""
_TURN_S = 0.02  # longest time without a look at the ports
_SETTLE_S = 0.3  # between a program's opening a port and its flushing what it finds there, or its first command
_PATIENCE_S = 60.0  # from a host's first command to the last that was waited for


@dataclass(frozen=True)
class Played:
    """How far it is.

    Attributes:
        log_ns: log time of what was handed over last, ns since 1970; 0 before anything was.
        late_s, most_late_s: how late that was, and the latest so far, wall s.
        delivered, undelivered: bytes by device; undelivered are those whose reader had gone.
        withheld: bytes by device that its host had not told it to send, or not any more.
        unfollowed: commands by device that a log cannot follow.
        waiting_bytes: not handed over yet.
        gone: devices whose reader went away, with the log time when it was noticed, ns since 1970.
        cut_short: every reader had gone before the end.
        stopped: a host told every device it can tell to send no more.
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
    """One device, its outlet and what waits for it."""

    def __init__(self, outlet: Outlet, device: PlayedDevice) -> None:
        self.outlet, self.device = outlet, device
        self.waiting: deque[tuple[int | None, bytes]] = deque()  # with the log time; an answer has none
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
    """Plays bytes out on outlets.

    Args:
        outlets: by device; bytes of other devices are not played.
        devices: what stands behind each outlet, see `played_devices`.
        speed: seconds of the log per wall second; `math.inf` as fast as the readers read.
        clock: of the pace; the host's if None.
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
        """Whether the reader is a host that configures its devices before it listens; known when all ports are open."""
        return self._configured

    @property
    def state(self) -> Played:
        """How far it is."""
        lines = self._lines.items()
        told = [line.device for _, line in lines if line.device.expects]
        return Played(
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
            bool(told) and not any(device.sending for device in told),
        )

    def wait_for_readers(self, tell: Callable[[list[str]], None] = lambda waiting: None) -> None:
        """Return when every port has been open for a little while, or was open and a command came.

        A program that opens a port throws away what it finds there; what is sent before that is lost. One that
        configures its devices does so at once.

        Args:
            tell: given the devices whose port nobody has opened yet, whenever they change.
        """
        told: list[str] | None = None
        open_since_ns: int | None = None
        while not self._configured and not self._passed(open_since_ns, _SETTLE_S):
            self._serve()
            waiting = [name for name, line in self._lines.items() if not line.outlet.connected()]
            if waiting != told:
                told = waiting
                tell(waiting)
            for name in waiting:
                self._lines[name].device.commands = 0  # of somebody who has left again
            open_since_ns = None if waiting else open_since_ns or self._clock.now_ns()
            self._configured = not waiting and any(line.device.commands for line in self._lines.values())
            self._wait(_TURN_S)

    def wait_for_setup(self, tell: Callable[[Mapping[str, str]], None] = lambda waiting: None) -> None:
        """With a host that configures, return when it has told every device to send; with a listener at once.

        Args:
            tell: given the devices and what they have not been told yet, whenever they change.

        Raises:
            DeviceError: it leaves, or never gets that far.
        """
        started_ns = self._clock.now_ns()
        told: dict[str, str] | None = None
        while self._configured:
            self._serve()
            waiting = {name: line.device.expects for name, line in self._lines.items() if not line.device.sending}
            if waiting != told:
                told = waiting
                tell(waiting)
            if not waiting:
                return
            wanted = ", ".join(f"{expects} at {name}" for name, expects in waiting.items())
            if not any(line.outlet.connected() for line in self._lines.values()):
                raise DeviceError(
                    f"the host closed its ports before it had set up its devices; still expected: {wanted}. What it "
                    "says itself tells why"
                )
            if self._passed(started_ns, _PATIENCE_S):
                raise DeviceError(
                    f"the host began to configure its devices, {_PATIENCE_S:g} s later still expected: {wanted}. "
                    "A program that only listens must not send commands when it opens its ports"
                )
            self._wait(_TURN_S)

    def play(
        self, chunks: Iterable[tuple[str, RawChunk]], tell: Callable[[Played], None] = lambda state: None
    ) -> Played:
        """Play bytes until all were handed over, or every reader has gone.

        Args:
            chunks: raw bytes in the order they came, as a log gives them.
            tell: given the state at every look at the ports.
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
                tell(self.state)
            line.add(chunk.host_ns, line.device.play(chunk.direction, chunk.data))
            self._send(line)
            if self._passed(self._looked_ns, _TURN_S):
                self._turn(0.0)
            while sum(each.waiting_bytes for each in self._lines.values()) > BACKLOG_BYTES:
                self._turn(_TURN_S)
                tell(self.state)
            if not self._alive():
                self._cut_short = True
                break
        for line in self._lines.values():
            line.add(self._log_ns, line.device.rest())
        while any(line.waiting for line in self._lines.values()):
            self._turn(_TURN_S)
            tell(self.state)
        self._listen()  # a host's last words may have come just before it left
        return self.state

    def hold(self, linger_s: float | None = None) -> None:
        """Keep the ports open until their readers close them, or for some wall seconds at most.

        What a reader has not fetched yet would be lost if its port was closed under it.
        """
        started_ns = self._clock.now_ns()
        while any(line.outlet.connected() for line in self._lines.values()):
            if linger_s is not None and self._passed(started_ns, linger_s):
                return
            self._serve()
            self._wait(_TURN_S)
        self._listen()

    def close(self) -> None:
        """Let go of every port."""
        for line in self._lines.values():
            line.outlet.close()

    def _passed(self, since_ns: int | None, seconds: float) -> bool:
        return since_ns is not None and self._clock.now_ns() - since_ns >= seconds * 1e9

    def _alive(self) -> bool:
        return any(line.gone_ns is None for line in self._lines.values())

    def _turn(self, wait_s: float) -> None:
        """Serve every port, notice who has gone, then wait until one has something or has room, at most so long."""
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
        """Until a port has something to read, or room where something waits."""
        open_lines = [line for line in self._lines.values() if line.outlet.connected()]
        full = [line.outlet.descriptor() for line in open_lines if line.waiting]
        readable = [descriptor for line in open_lines if (descriptor := line.outlet.descriptor()) is not None]
        if readable:
            select.select(readable, [descriptor for descriptor in full if descriptor is not None], [], wait_s)
        else:
            self._clock.sleep(wait_s)

    def _send(self, line: _Line) -> None:
        """Hand over what there is room for."""
        while line.waiting:
            log_ns, data = line.waiting[0]
            try:
                sent = line.outlet.offer(data)
            except LinkLost:
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
        """Take what readers send, so that their side does not fill up, and answer behind what waits."""
        for line in self._lines.values():
            if data := line.outlet.receive():
                line.add(None, line.device.hear(data))

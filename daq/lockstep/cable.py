"""Cables of a simulated rig, and the links of the ports that a host opens."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from typing_extensions import override

from daq.acquisition.reader import Pause, Waits
from daq.errors import LinkLost
from daq.lockstep.clock import SimulatedClock
from daq.transports.link import Link

_WAKE_S = (40e-6, 80e-6)  # least time to wake a thread, and mean of the additional time
_LATE_SHARE, _LATE_S = 2e-3, (1e-3, 15e-3)  # share of wake-ups that the host's scheduler delays, and range of the delay
_QUEUE_BYTES = 4 * 2**20  # driver queue of an adapter


class Cable:
    """Cable of one device. The far end supplies bytes, and the link that a host has opened wakes its reader.

    Args:
        device: name of the device.
        clock: the simulated clock.
        random: random numbers of the wake-up times.

    Attributes:
        port: name of the port, which changes when the cable is plugged in again.
        sent: bytes from the host that have not reached the device.
        collected: bytes of the device that the adapter has not passed to the host.
        asked: whether the host has written since the adapter last passed bytes to it.
        overrun_bytes: number of bytes lost because the driver queue was full.
        link: link that the host has opened; None if there is no open link.
        on_write: called when the host has written.
    """

    def __init__(self, device: str, clock: SimulatedClock, random: np.random.Generator) -> None:
        self._device, self._clock, self._random = device, clock, random
        self._plugged, self._times = True, 0
        self.port: str = f"lockstep:{device}"
        self.sent: bytearray = bytearray()
        self.collected: bytearray = bytearray()
        self.asked: bool = False
        self.overrun_bytes: int = 0
        self.link: LockstepLink | None = None
        self.on_write: Callable[[], None] = lambda: None

    def open(self, port: str) -> LockstepLink:
        """Open the port.

        Raises:
            LinkLost: the port does not exist.
        """
        if not self._plugged or port != self.port:
            raise LinkLost(f"{port}: cannot be opened (no such port). Is the device plugged in?")
        self.sent.clear()
        self.collected.clear()
        self.link = LockstepLink(self)
        return self.link

    def cut(self) -> None:
        """Unplug the cable. The next read or write of an open link raises LinkLost."""
        self._plugged = False
        self.collected.clear()
        link, self.link = self.link, None
        if link is not None:
            link.lose()

    def plug(self) -> str:
        """Plug the cable in again and return the new port name."""
        if not self._plugged:
            self._plugged, self._times = True, self._times + 1
            self.port = f"lockstep:{self._device}#{self._times}"
        return self.port

    def wake_s(self) -> float:
        """Return a random time that a thread takes to wake up, s."""
        least, mean = _WAKE_S
        late = self._random.uniform(*_LATE_S) if self._random.random() < _LATE_SHARE else 0.0
        return least + self._random.exponential(mean) + late

    def after(self, seconds: float, do: Callable[[], object]) -> None:
        """Schedule an action of the host."""
        self._clock.after(seconds, do)

    def deliver(self) -> None:
        """Pass the collected bytes to the open link."""
        if self.link is not None and self.collected:
            self.overrun_bytes += self.link.arrive(bytes(self.collected))
            self.asked = False
        self.collected.clear()


class LockstepLink(Link):
    """Link of a simulated rig, which carries out its reader's waits on the simulated clock.

    It implements Link and FollowedLink.
    """

    def __init__(self, cable: Cable) -> None:
        self.name: str = cable.port
        self._cable = cable
        self._buffer = bytearray()
        self._waits: Waits | None = None
        self._failed: Callable[[Exception], None] = lambda error: None
        self._lost = self._closed = False
        self._reading = 0  # number of the present wait for bytes; 0 if there is none
        self._count = 0

    def read(self, timeout_s: float) -> bytes:
        """See Link. A followed link is not read by a thread.

        Raises:
            NotImplementedError: always.
        """
        raise NotImplementedError("a simulated link is followed, not read")

    @override
    def write(self, data: bytes) -> None:
        if self._lost or self._closed:
            raise LinkLost(f"{self.name}: lost while writing. Look at cable and power")
        self._cable.sent += data
        self._cable.asked = True
        self._cable.on_write()

    @override
    def close(self) -> None:
        self._closed = True
        if self._cable.link is self:
            self._cable.link = None

    def follow(self, waits: Waits, failed: Callable[[Exception], None]) -> None:
        """See FollowedLink."""
        self._waits, self._failed = waits, failed
        self._go(None)

    def arrive(self, data: bytes) -> int:
        """Add received bytes to the queue and return the number of bytes for which it had no space."""
        room = max(0, _QUEUE_BYTES - len(self._buffer))
        self._buffer += data[:room]
        self._wake()
        return max(0, len(data) - room)

    def lose(self) -> None:
        """Mark the link as lost."""
        self._lost = True
        self._wake()

    def _wake(self) -> None:
        if self._reading:
            number, self._reading = self._reading, 0
            self._cable.after(self._cable.wake_s(), lambda: self._woken(number))

    def _woken(self, number: int) -> None:
        if number == self._count and not self._closed:
            self._go(self._taken())

    def _timed_out(self, number: int) -> None:
        if number == self._reading and not self._closed:
            self._reading = 0
            self._go(b"")

    def _taken(self) -> bytes:
        data = bytes(self._buffer)
        self._buffer.clear()
        return data

    def _go(self, data: bytes | None) -> None:
        """Run the reader until its next wait, with the bytes of the last wait (None for its start)."""
        waits = self._waits
        assert waits is not None
        try:
            wanted = next(waits) if data is None else waits.send(data)
            while not isinstance(wanted, Pause):
                if self._buffer:  # bytes that arrived before the loss are read first
                    wanted = waits.send(self._taken())
                elif self._lost:
                    waits.throw(LinkLost(f"{self.name}: the other end closed. Look at cable and power"))
                elif wanted.seconds <= 0:
                    wanted = waits.send(b"")
                else:
                    self._wait_for_bytes(wanted.seconds)
                    return
            self._count += 1
            number = self._count
            self._cable.after(wanted.seconds + self._cable.wake_s(), lambda: self._rested(number))
        except Exception as error:
            self._waits = None
            if not self._closed:
                self._failed(error)

    def _wait_for_bytes(self, seconds: float) -> None:
        self._count += 1
        number = self._reading = self._count
        self._cable.after(seconds, lambda: self._timed_out(number))

    def _rested(self, number: int) -> None:
        if number == self._count and not self._closed:
            self._go(b"")

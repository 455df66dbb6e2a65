# pyright: strict
"""A cable of a simulated rig: what a host has in hand when it opens the port."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from daq.acquisition.reader import Rest, Turns
from daq.errors import LinkLost
from daq.lockstep.clock import SimulatedClock

_WAKE_S = (40e-6, 80e-6)  # the least that waking a thread takes, and the mean of what comes on top
_LATE_SHARE, _LATE_S = 2e-3, (1e-3, 15e-3)  # now and then the host's scheduler has something else to do
_QUEUE_BYTES = 4 * 2**20  # an adapter's driver queue


class Cable:
    """One device's cable. The far end puts bytes in; the link that a host has opened wakes its reader.

    Attributes:
        port: its name; another one after it was plugged in again.
        sent: by the host, not yet at the device.
        overrun_bytes: that came while no room was left.
        asked: called when the host has written.
    """

    def __init__(self, device: str, clock: SimulatedClock, random: np.random.Generator) -> None:
        self._device, self._clock, self._random = device, clock, random
        self._plugged, self._times = True, 0
        self.port = f"lockstep:{device}"
        self.sent = bytearray()
        self.overrun_bytes = 0
        self.link: LockstepLink | None = None
        self.asked: Callable[[], None] = lambda: None

    def open(self, port: str) -> LockstepLink:
        """Open the port.

        Raises:
            LinkLost: nothing is there.
        """
        if not self._plugged or port != self.port:
            raise LinkLost(f"{port}: cannot be opened (no such port). Is the device plugged in?")
        self.sent.clear()
        self.link = LockstepLink(self)
        return self.link

    def cut(self) -> None:
        """Unplug it: whoever has it open learns of it with its next read or write."""
        self._plugged = False
        link, self.link = self.link, None
        if link is not None:
            link.lose()

    def plug(self) -> str:
        """Plug it in again; its new name."""
        if not self._plugged:
            self._plugged, self._times = True, self._times + 1
            self.port = f"lockstep:{self._device}#{self._times}"
        return self.port

    def wake_s(self) -> float:
        """How long a thread takes to wake up."""
        least, mean = _WAKE_S
        late = self._random.uniform(*_LATE_S) if self._random.random() < _LATE_SHARE else 0.0
        return least + self._random.exponential(mean) + late

    def after(self, seconds: float, do: Callable[[], object]) -> None:
        """Have the host do something."""
        self._clock.after(seconds, do)

    def arrive(self, data: bytes) -> None:
        """Bytes of the device reach the host's port."""
        if self.link is not None and data:
            self.overrun_bytes += self.link.arrive(data)


class LockstepLink:
    """See Link and FollowedLink: its reader's waits are those of the simulated clock."""

    def __init__(self, cable: Cable) -> None:
        self.name = cable.port
        self._cable = cable
        self._buffer = bytearray()
        self._turns: Turns | None = None
        self._failed: Callable[[Exception], None] = lambda error: None
        self._lost = self._closed = False
        self._reading = 0  # number of the wait for bytes under way; 0: none
        self._count = 0

    def read(self, timeout_s: float) -> bytes:
        """See Link; only a thread would read so."""
        raise NotImplementedError("a simulated link is followed, not read")

    def write(self, data: bytes) -> None:
        """See Link."""
        if self._lost or self._closed:
            raise LinkLost(f"{self.name}: lost while writing. Look at cable and power")
        self._cable.sent += data
        self._cable.asked()

    def close(self) -> None:
        """See Link."""
        self._closed = True
        if self._cable.link is self:
            self._cable.link = None

    def follow(self, turns: Turns, failed: Callable[[Exception], None]) -> None:
        """See FollowedLink."""
        self._turns, self._failed = turns, failed
        self._go(None)

    def arrive(self, data: bytes) -> int:
        """Bytes are there; how many found no room."""
        room = max(0, _QUEUE_BYTES - len(self._buffer))
        self._buffer += data[:room]
        if self._reading:
            number, self._reading = self._reading, 0
            self._cable.after(self._cable.wake_s(), lambda: self._woken(number))
        return max(0, len(data) - room)

    def lose(self) -> None:
        """The cable is cut."""
        self._lost = True
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
        """The reader goes on until it waits again."""
        turns = self._turns
        assert turns is not None
        try:
            wanted = next(turns) if data is None else turns.send(data)
            while not isinstance(wanted, Rest):
                if self._buffer:  # what had arrived is read before a cut is noticed
                    wanted = turns.send(self._taken())
                elif self._lost:
                    turns.throw(LinkLost(f"{self.name}: the other end closed. Look at cable and power"))
                elif wanted.wall_s <= 0:
                    wanted = turns.send(b"")
                else:
                    self._wait_for_bytes(wanted.wall_s)
                    return
            self._count += 1
            number = self._count
            self._cable.after(wanted.seconds + self._cable.wake_s(), lambda: self._rested(number))
        except Exception as error:
            self._turns = None
            if not self._closed:
                self._failed(error)

    def _wait_for_bytes(self, wall_s: float) -> None:
        self._count += 1
        number = self._reading = self._count
        self._cable.after(wall_s, lambda: self._timed_out(number))

    def _rested(self, number: int) -> None:
        if number == self._count and not self._closed:
            self._go(b"")

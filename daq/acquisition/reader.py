# pyright: strict
"""One device being read: its link, the turns in which its bytes are taken, and the thread that takes them.

The turns (`DeviceReader.turns`) wait for nothing: they yield what is to be waited for. A thread waits in real time; a
link of a simulated rig (`FollowedLink`) waits in the simulation's.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import queue
import sys
import threading
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from daq.errors import LinkLost
from daq.transports import HostClock, Link

_NEXT_S = 0.005  # wall seconds to wait for the next arrival
_QUICK = 8  # arrivals in a row, each so soon behind the one before
_M_MMAP_THRESHOLD, _M_ARENA_MAX = -3, -8  # malloc.h
_LARGE_BYTES = 128 * 1024
_HURRIED_S = 0.015  # rig seconds of a rest where rig time passes faster: a turn costs more of it
_CALM_S = 0.04  # rig seconds that bytes may gather where no interlock waits for them
_WAIT_S = 0.1  # wall seconds between two looks whether to end

Take = Callable[[Sequence[tuple[bytes, int]], bytes, int], None]
"""Takes what went out, each with its host time in ns, then what arrived and when."""


@dataclass(frozen=True)
class Read:
    """Wait for bytes, at most so long, wall s; what had arrived before counts."""

    wall_s: float


@dataclass(frozen=True)
class Rest:
    """Let bytes gather for so long, rig s."""

    seconds: float


Turns = Generator[Read | Rest, bytes, None]
"""Takes the bytes that a wait gave; LinkLost is thrown into it when the link is gone."""


@runtime_checkable
class FollowedLink(Protocol):
    """A link that carries out a reader's waits itself."""

    def follow(self, turns: Turns, failed: Callable[[Exception], None]) -> None:
        """Begin; an exception that the turns raise goes to `failed` and ends them."""
        ...


def keep_heap_whole() -> None:
    """Keep holes out of this process's heap over a run of hours, where the C library is glibc.

    Readers make arrays that the recorder's thread lets go of. With a heap for each thread, glibc's way, such memory
    comes back in pieces that fit nothing any more; so there is one. And once a large array has been let go of, glibc
    takes the next ones of that size from the heap too, where the first small thing that settles in the gap makes the
    heap grow by another such array; so large arrays keep coming from the system and go back to it.
    """
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):  # another C library
            mallopt = ctypes.CDLL(None).mallopt
            mallopt(_M_ARENA_MAX, 1)
            mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)  # naming one ends its being moved


class _Sparse:
    """Whether a device's bytes come so seldom that each arrival is worth a turn of its own."""

    def __init__(self) -> None:
        self._is, self._quick, self._last_s = False, 0, -math.inf

    def arrived(self, alone: bool, some: bool, wall_s: float) -> bool:
        """Whether they do.

        Args:
            alone: nothing followed what had come during a rest.
            some: bytes have come.
            wall_s: when.
        """
        if alone:
            self._is, self._quick = True, 0
        elif self._is and some:
            self._quick = self._quick + 1 if wall_s - self._last_s < _NEXT_S else 0
            self._is = self._quick < _QUICK
        self._last_s = wall_s
        return self._is


class DeviceReader:
    """One link and its turns.

    Args:
        name: the device, as in the rig file.
        link: an open one.
        clock: stamps arrivals.
        rest_s: rig time between two turns: what a wake-up costs counts, not the bytes.
        calm: whether nothing waits for the device's samples: bytes may gather for longer then.

    Attributes:
        lock: held while bytes, in either direction, go to log and pipeline: both see one order. Nothing that goes out
            waits for it.
        replies: text answers of the device.
        bytes_in: how many bytes have come.
        heard_s: when bytes came last, wall s of the clock.
    """

    def __init__(
        self, name: str, link: Link, clock: HostClock, rest_s: float = 0.01, calm: Callable[[], bool] = bool
    ) -> None:
        self.name, self.link = name, link
        self.lock = threading.Lock()
        self.replies: queue.Queue[str] = clock.queue()
        self.bytes_in = 0
        self.heard_s = clock.wall_s()
        self._clock = clock
        self._writing, self._stamping = threading.Lock(), threading.Lock()
        self._sent: list[tuple[bytes, int]] = []  # on their way into the log
        self._rest_s, self._calm = rest_s, calm
        self._ending = False
        self._thread: threading.Thread | None = None

    def send(self, data: bytes) -> None:
        """Write bytes to the device at once, whatever log and decoders are busy with; the log gets them afterwards.

        Raises:
            LinkLost: the device is gone.
        """
        with self._writing:  # what goes out and what is kept of it have one order
            with self._stamping:
                self._sent.append((data, self._clock.now_ns()))
            self.link.write(data)

    def sent(self) -> list[tuple[bytes, int]]:
        """What went out since the last call, each with its host time, ns; call it under `lock`."""
        with self._stamping:
            out, self._sent = self._sent, []
            return out

    def start(self, take: Take, fail: Callable[[Exception], None]) -> None:
        """Begin to read.

        Args:
            take: called under `lock` with what went out since its last call, then the bytes that arrived (or none) and
                the host time of the last one's arrival.
            fail: called once when the device is gone, or with a decoder's bug: either must stop the rig.
        """
        self.heard_s = self._clock.wall_s()
        turns = self.turns(take)

        def failed(error: Exception) -> None:
            if not self._ending:
                fail(error)

        if isinstance(self.link, FollowedLink):
            self.link.follow(turns, failed)
            return
        self._thread = threading.Thread(target=self._run, args=(turns, failed), name=self.name, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the turns and let go of the link."""
        self._ending = True
        if self._thread is not None and threading.current_thread() is not self._thread:
            self._thread.join(timeout=2.0)
        self.link.close()

    def _run(self, turns: Turns, failed: Callable[[Exception], None]) -> None:
        try:
            self._wait_for(turns)
        except Exception as error:
            failed(error)

    def _wait_for(self, turns: Turns) -> None:
        wanted = next(turns)
        while not self._ending:
            if isinstance(wanted, Rest):
                self._clock.wait(self._clock.wall(wanted.seconds))
                wanted = turns.send(b"")
                continue
            try:
                data = self.link.read(wanted.wall_s)
            except LinkLost as error:
                turns.throw(error)
                raise
            wanted = turns.send(data)

    def turns(self, take: Take) -> Turns:
        """Take bytes at every rest's end, each turn stamped with the arrival of its last byte.

        What came during a rest is not stamped as it is fetched, which would be late by an unknown part of the rest: it
        waits for the next arrival, as long as that is near. Where none is, bytes come message by message: there is no
        rest then until they come thick and fast again.
        """
        rested, sparse = b"", _Sparse()
        while True:
            try:
                data = yield Read(_NEXT_S if rested else _WAIT_S)
            except LinkLost:
                if rested:  # its last bytes are bytes too
                    self._arrived(rested, take)
                raise
            if rested or data or self._sent:
                self._arrived(rested + data, take)
                alone, rested = bool(rested) and not data, b""  # not twice, should the next line fail
                if not sparse.arrived(alone, bool(data), self._clock.wall_s()):
                    least_s = _HURRIED_S if self._clock.rate > 1 else _CALM_S if self._calm() else 0.0
                    yield Rest(max(self._rest_s, least_s))
                    rested = yield Read(0.0)

    def _arrived(self, data: bytes, take: Take) -> None:
        host_ns = self._clock.now_ns()
        with self.lock:
            if data:
                self.bytes_in += len(data)
                self.heard_s = self._clock.wall_s()
            if not self._sent:  # nearly always
                take((), data, host_ns)
                return
            sent = self.sent()
            take([item for item in sent if item[1] <= host_ns], data, host_ns)
            if later := [item for item in sent if item[1] > host_ns]:
                take(later, b"", host_ns)


@dataclass(frozen=True)
class OpenDevice:
    """A device being read, as its driver talks to it (see Talk).

    Attributes:
        reader: of the device.
        clock: what a dialogue waits by.
        begin_anew: gives the device a fresh pipeline.
    """

    reader: DeviceReader
    clock: HostClock
    begin_anew: Callable[[], None]

    @property
    def replies(self) -> queue.Queue[str]:
        """See Talk."""
        return self.reader.replies

    @property
    def bytes_in(self) -> int:
        """See Talk."""
        return self.reader.bytes_in

    def send(self, data: bytes) -> None:
        """See Talk."""
        self.reader.send(data)

"""Reading of one device: its link, the waits after which its bytes are taken, and the thread that carries them out.

`DeviceReader.waits` is a generator that does not wait itself; it yields the waits. A thread carries them out in
real time. A link of a simulated rig (`FollowedLink`) carries them out in simulated time.
"""

from __future__ import annotations

import ctypes
import logging
import math
import queue
import sys
import threading
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from daq.errors import LinkLost
from daq.transports import HostClock, Link
from rig_basics.ignoring import ignoring

_log = logging.getLogger(__name__)

_NEXT_S = 0.005  # wait for the next arrival after a pause, s
_M_MMAP_THRESHOLD, _M_ARENA_MAX = -3, -8  # malloc.h
_LARGE_BYTES = 128 * 1024  # smallest array that glibc takes directly from the system
_CALM_PAUSE_S = 0.04  # least pause if no interlock waits for the bytes, s
_WAIT_S = 0.1  # longest wait for bytes, after which the thread checks whether to end; s

Take = Callable[[Sequence[tuple[bytes, int]], bytes, int], None]
"""Called with the bytes sent (each with its host time, ns), the bytes received, and their host time, ns."""


@dataclass(frozen=True)
class Read:
    """Wait for bytes; bytes that have arrived before count.

    Attributes:
        seconds: timeout, s.
    """

    seconds: float


@dataclass(frozen=True)
class Pause:
    """Let bytes accumulate.

    Attributes:
        seconds: duration, s.
    """

    seconds: float


Waits = Generator[Read | Pause, bytes, None]
"""Generator that yields waits and receives their bytes. LinkLost is thrown into it if the link is lost."""


@runtime_checkable
class FollowedLink(Protocol):
    """A link that carries out the waits of a reader itself."""

    def follow(self, waits: Waits, failed: Callable[[Exception], None]) -> None:
        """Start the waits. An exception of the generator ends them and is passed to `failed`."""
        ...


def keep_heap_whole() -> None:
    """Prevent fragmentation of this process's heap in runs of hours, if the C library is glibc.

    Readers allocate arrays that the recorder's thread frees. With one heap for each thread, the default of glibc, the
    freed pieces cannot be reused. Therefore the process uses one heap. After the first large array is freed, glibc
    would raise its threshold and allocate further arrays of that size on the heap, where small objects in the gaps make
    the heap grow. Therefore the threshold is fixed, and large arrays are returned to the system.
    """
    if sys.platform == "linux":
        with ignoring(_log, "fixing the thresholds of the heap", OSError, AttributeError):  # another C library
            mallopt = ctypes.CDLL(None).mallopt
            mallopt(_M_ARENA_MAX, 1)
            mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)  # an explicit threshold is no longer adapted


class _Sparse:
    """Detects devices that send so rarely that each arrival is taken without a pause.

    After bytes that no others followed, arrivals are taken one by one until they have followed each other for as long
    as the last gap, or as the longest wait: a packet arrives in parts, but in less time than passes until the next one.
    A sender of many bytes that a busy host held up, or that was silent, is thus soon read with pauses again.
    """

    def __init__(self) -> None:
        self._gap_s, self._since_s, self._last_s = 0.0, -math.inf, -math.inf

    def arrived(self, is_isolated: bool, has_bytes: bool, now_s: float) -> bool:
        """Register an arrival and return whether the device is sparse.

        Args:
            is_isolated: whether no bytes followed the bytes that arrived during the pause.
            has_bytes: whether bytes have arrived.
            now_s: its time, s; it never steps.
        """
        if is_isolated:
            self._gap_s, self._since_s = _NEXT_S, now_s
        elif has_bytes and self._gap_s:
            if now_s - self._last_s >= _NEXT_S:
                self._gap_s, self._since_s = min(now_s - self._last_s, _WAIT_S), now_s
            elif now_s - self._since_s >= self._gap_s:
                self._gap_s = 0.0
        if has_bytes or is_isolated:
            self._last_s = now_s
        return self._gap_s > 0


class DeviceReader:
    """Reads one link. Implements Talk, for the dialogues of the device's driver.

    Args:
        name: name of the device in the rig file.
        link: the open link.
        clock: host clock for the time stamps of arrivals.
        pause_s: pause between two reads, s. The cost of a read depends on the wake-up, not on the number of bytes.
        calm: returns whether no interlock waits for the device's samples, so that the pause may be longer.
        restart_decoding: see Talk.

    Attributes:
        clock, restart_decoding: see above.
        lock: held while bytes of either direction are passed to log and pipeline, so that both get the same order.
            Sending does not wait for it.
        replies: text answers of the device.
        bytes_in: number of bytes received.
        heard_s: time of the last bytes, s.
    """

    def __init__(
        self,
        name: str,
        link: Link,
        clock: HostClock,
        pause_s: float = 0.01,
        calm: Callable[[], bool] = bool,
        restart_decoding: Callable[[], None] = lambda: None,
    ) -> None:
        self.name: str = name
        self.link: Link = link
        self.lock: threading.Lock = threading.Lock()
        self.replies: queue.Queue[str] = clock.queue()
        self.bytes_in: int = 0
        self.heard_s: float = clock.now_s()
        self.clock: HostClock = clock
        self.restart_decoding: Callable[[], None] = restart_decoding
        self._writing, self._stamping = threading.Lock(), threading.Lock()
        self._sent: list[tuple[bytes, int]] = []  # sent but not yet taken, each with its host time
        self._pause_s, self._calm = pause_s, calm
        self._ending = False
        self._thread: threading.Thread | None = None

    def send(self, data: bytes) -> None:
        """Write to the device immediately, without waiting for log and decoders. The bytes are logged afterwards.

        Raises:
            LinkLost: the link of the device is lost.
        """
        with self._writing:  # the order on the link is the order in the log
            with self._stamping:
                self._sent.append((data, self.clock.now_ns()))
            self.link.write(data)

    def sent(self) -> list[tuple[bytes, int]]:
        """Return the bytes sent since the last call, each with its host time, ns. The caller holds `lock`."""
        with self._stamping:
            out, self._sent = self._sent, []
            return out

    def start(self, take: Take, fail: Callable[[Exception], None]) -> None:
        """Start reading.

        Args:
            take: called under `lock` with the bytes sent since its last call, the bytes received (possibly none) and
                the host time of the last arrival, ns.
            fail: called once, with the error of a lost link or an exception of `take`.
        """
        self.heard_s = self.clock.now_s()
        waits = self.waits(take)

        def failed(error: Exception) -> None:
            if not self._ending:
                fail(error)

        if isinstance(self.link, FollowedLink):
            self.link.follow(waits, failed)
            return
        self._thread = threading.Thread(target=self._run, args=(waits, failed), name=self.name, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the waits and close the link."""
        self._ending = True
        if self._thread is not None and threading.current_thread() is not self._thread:
            self._thread.join(timeout=2.0)
        self.link.close()

    def _run(self, waits: Waits, failed: Callable[[Exception], None]) -> None:
        try:
            self._wait_for(waits)
        except Exception as error:
            failed(error)

    def _wait_for(self, waits: Waits) -> None:
        wanted = next(waits)
        while not self._ending:
            if isinstance(wanted, Pause):
                self.clock.wait(wanted.seconds)
                wanted = waits.send(b"")
                continue
            try:
                data = self.link.read(wanted.seconds)
            except LinkLost as error:
                waits.throw(error)
                raise
            wanted = waits.send(data)

    def waits(self, take: Take) -> Waits:
        """Take bytes at the end of every pause, with the arrival time of the last byte.

        Bytes that arrived during a pause are not stamped when they are read, since that time is late by an unknown part
        of the pause. They are taken with the next arrival, for which the reader waits up to `_NEXT_S`. If no bytes
        follow, the device sends single messages, and there is no pause until arrivals follow each other quickly again.
        """
        rested, sparse = b"", _Sparse()
        while True:
            try:
                data = yield Read(_NEXT_S if rested else _WAIT_S)
            except LinkLost:
                if rested:  # bytes that arrived before the loss of the link are taken too
                    self._arrived(rested, take)
                raise
            if rested or data or self._sent:
                self._arrived(rested + data, take)
                is_isolated, rested = bool(rested) and not data, b""  # cleared here: the bytes must not be taken twice
                if not sparse.arrived(is_isolated, bool(data), self.clock.now_s()):
                    yield Pause(max(self._pause_s, _CALM_PAUSE_S) if self._calm() else self._pause_s)
                    rested = yield Read(0.0)

    def _arrived(self, data: bytes, take: Take) -> None:
        host_ns = self.clock.now_ns()
        with self.lock:
            if data:
                self.bytes_in += len(data)
                self.heard_s = self.clock.now_s()
            if not self._sent:  # the usual case
                take((), data, host_ns)
                return
            sent = self.sent()
            take([item for item in sent if item[1] <= host_ns], data, host_ns)
            if later := [item for item in sent if item[1] > host_ns]:
                take(later, b"", host_ns)

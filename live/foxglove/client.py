# pyright: strict
"""One client of the Foxglove connection: what it subscribed to, and what waits to be sent to it.

Whoever has something to show leaves it here and goes on. What waits is bounded: of a client that takes too little, the
oldest is left out and counted, and it is told so once.
"""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from websockets.asyncio.server import ServerConnection

from live.foxglove.protocol import (
    ERROR,
    WARNING,
    Block,
    NotUnderstood,
    Offered,
    Subscribe,
    Unsubscribe,
    in_order,
    message_data,
    status,
    time_data,
    understood,
)

MOST_BYTES = 4 * 2**20
"""That may wait for one client: some seconds of every channel."""
MOST_REFUSED = 100
"""Messages of a client that are answered by a refusal; then it is shown out."""
LEFT_OUT = "this client takes less than the rig gives: messages are left out"
_TURN_BYTES, _YIELD_EVERY = 64, 256
_POLICY_VIOLATION = 1008


@dataclass(frozen=True)
class Turn:
    """What is new.

    Attributes:
        blocks: of any channels.
        until_ns: the clock of what is shown, ns since 1970.
        anew: the clock may have gone back: somebody sought another place in a log.
    """

    blocks: Sequence[Block]
    until_ns: int
    anew: bool = False


class Subscriptions:
    """A client's subscriptions; one thread changes them, others may look.

    Attributes:
        by_channel: the client's id by channel number; replaced whole when it changes.
    """

    def __init__(self, offered: Sequence[Offered]) -> None:
        self._known = frozenset(each.number for each in offered)
        self.by_channel: Mapping[int, int] = {}

    def apply(self, asked: Subscribe | Unsubscribe) -> list[str]:
        """Do what is asked; returns what could not be done, in words."""
        now, faults = dict(self.by_channel), list[str]()
        if isinstance(asked, Unsubscribe):
            self.by_channel = {number: own for number, own in now.items() if own not in asked.ids}
            return [f"subscription {own}: there is none" for own in asked.ids if own not in now.values()]
        for own, number in asked.wanted:
            if number not in self._known:
                faults.append(f"channel {number}: there is none")
            elif number in now:
                faults.append(f"channel {number}: subscribed to already, as {now[number]}")
            elif own in now.values():
                faults.append(f"subscription {own}: the id is in use")
            else:
                now[number] = own
        self.by_channel = now
        return faults


class Client:
    """See the module.

    Args:
        socket: its line.
        offered: the channels.

    Attributes:
        left_out: messages that it did not take in time.
    """

    def __init__(self, socket: ServerConnection, offered: Sequence[Offered]) -> None:
        self.left_out = 0
        self.subscriptions = Subscriptions(offered)
        self._socket, self._loop = socket, asyncio.get_running_loop()
        self._waiting: deque[tuple[Turn, int]] = deque()
        self._bytes = 0
        self._lock, self._come = threading.Lock(), asyncio.Event()
        self._clock_ns = -1

    @property
    def waiting_bytes(self) -> int:
        """Of messages that it has not taken yet; the line's own buffer is not counted."""
        return self._bytes

    def show(self, turn: Turn) -> None:
        """Leave something to be sent; never waits. Any thread."""
        wanted = self.subscriptions.by_channel
        size = _TURN_BYTES + sum(len(block.data) for block in turn.blocks if block.number in wanted)
        with self._lock:
            self._waiting.append((turn, size))
            self._bytes += size
            while self._bytes > MOST_BYTES and len(self._waiting) > 1:
                oldest, bytes_of_it = self._waiting.popleft()
                self._bytes -= bytes_of_it
                self.left_out += sum(len(block.time_ns) for block in oldest.blocks if block.number in wanted)
        self._loop.call_soon_threadsafe(self._come.set)

    async def listen(self) -> None:
        """Take its wishes until it is gone, or has been refused too often."""
        refused = 0
        async for said in self._socket:
            try:
                faults = self.subscriptions.apply(understood(said))
            except NotUnderstood as why:
                faults = [str(why)]
            for fault in faults:
                await self._socket.send(status(ERROR, fault))
            refused += len(faults)
            if refused > MOST_REFUSED:
                await self._socket.close(_POLICY_VIOLATION, "too much that was refused")

    async def send(self) -> None:
        """Send what waits, in order of time, until the line is gone."""
        told = False
        while True:
            await self._come.wait()
            self._come.clear()
            while self._waiting:
                with self._lock:
                    turn, size = self._waiting.popleft()
                    self._bytes -= size
                if self.left_out and not told:
                    told = True
                    await self._socket.send(status(WARNING, LEFT_OUT, "left out"))
                await self._send(turn)

    async def _send(self, turn: Turn) -> None:
        if turn.anew:
            self._clock_ns = -1
        wanted = self.subscriptions.by_channel
        for number, (channel, own, time_ns, message) in enumerate(in_order(turn.blocks, wanted)):
            if self.subscriptions.by_channel.get(channel) != own:
                continue  # it wants no more of this, since
            await self._tick(time_ns)
            await self._socket.send(message_data(own, time_ns, message))
            if number % _YIELD_EVERY == 0:
                await asyncio.sleep(0)  # others have their turn
        await self._tick(turn.until_ns)

    async def _tick(self, time_ns: int) -> None:
        """The clock before a message: some programs take it as the message's time. It never goes back by itself."""
        if time_ns > self._clock_ns:
            self._clock_ns = time_ns
            await self._socket.send(time_data(time_ns))

"""One client of the Foxglove connection: its subscriptions, and its queue of messages.

Messages are queued without waiting. The queue is bounded: for a slow client the oldest messages are omitted and
counted, and the client receives one warning.
"""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from websockets.asyncio.server import ServerConnection

from live.errors import InvalidRequest
from live.foxglove.protocol import (
    ERROR,
    WARNING,
    ChannelMessages,
    Offered,
    Subscribe,
    Unsubscribe,
    in_order,
    message_data,
    parsed_request,
    status,
    time_data,
)

MOST_BYTES = 4 * 2**20
"""Largest size of one client's queue: some seconds of all channels."""
MOST_REFUSED = 100
"""Number of refused messages after which the client is disconnected."""
LEFT_OUT = "this client reads more slowly than the rig sends: messages are omitted"
_TURN_BYTES, _YIELD_EVERY = 64, 256
_POLICY_VIOLATION = 1008


@dataclass(frozen=True)
class Turn:
    """New messages.

    Attributes:
        blocks: messages of any channels.
        until_ns: clock of the display, ns since 1970.
        restarted: whether the clock may have gone back, because a viewer sought another place in a log.
    """

    blocks: Sequence[ChannelMessages]
    until_ns: int
    restarted: bool = False


class Subscriptions:
    """Subscriptions of a client; one thread changes them, others may read them.

    Attributes:
        by_channel: subscription id of the client by channel number; replaced as a whole at each change.
    """

    def __init__(self, offered: Sequence[Offered]) -> None:
        self._known = frozenset(each.number for each in offered)
        self.by_channel: Mapping[int, int] = {}

    def apply(self, request: Subscribe | Unsubscribe) -> list[str]:
        """Carry out a request; return the errors in words."""
        now, faults = dict(self.by_channel), list[str]()
        if isinstance(request, Unsubscribe):
            self.by_channel = {number: own for number, own in now.items() if own not in request.ids}
            return [f"subscription {own} does not exist" for own in request.ids if own not in now.values()]
        for own, number in request.wanted:
            if number not in self._known:
                faults.append(f"channel {number} does not exist")
            elif number in now:
                faults.append(f"channel {number} is already subscribed to as {now[number]}")
            elif own in now.values():
                faults.append(f"subscription id {own} is in use")
            else:
                now[number] = own
        self.by_channel = now
        return faults


class Client:
    """One client with its queue.

    Args:
        socket: connection to the client.
        offered: channels.

    Attributes:
        left_out: number of messages that were omitted because the client was too slow.
    """

    def __init__(self, socket: ServerConnection, offered: Sequence[Offered]) -> None:
        self.left_out: int = 0
        self.subscriptions: Subscriptions = Subscriptions(offered)
        self._socket, self._loop = socket, asyncio.get_running_loop()
        self._waiting: deque[tuple[Turn, int]] = deque()
        self._bytes = 0
        self._lock, self._come = threading.Lock(), asyncio.Event()
        self._clock_ns = -1

    @property
    def waiting_bytes(self) -> int:
        """Size of the queue in bytes, without the buffer of the socket."""
        return self._bytes

    def show(self, turn: Turn) -> None:
        """Queue messages without waiting. Any thread."""
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
        """Receive requests until the client disconnects or has been refused too often."""
        refused = 0
        async for message in self._socket:
            try:
                faults = self.subscriptions.apply(parsed_request(message))
            except InvalidRequest as why:
                faults = [str(why)]
            for fault in faults:
                await self._socket.send(status(ERROR, fault))
            refused += len(faults)
            if refused > MOST_REFUSED:
                await self._socket.close(_POLICY_VIOLATION, "too many refused messages")

    async def send(self) -> None:
        """Send the queue in order of time until the connection ends."""
        warned = False
        while True:
            await self._come.wait()
            self._come.clear()
            while self._waiting:
                with self._lock:
                    turn, size = self._waiting.popleft()
                    self._bytes -= size
                if self.left_out and not warned:
                    warned = True
                    await self._socket.send(status(WARNING, LEFT_OUT, "left out"))
                await self._send(turn)

    async def _send(self, turn: Turn) -> None:
        if turn.restarted:
            self._clock_ns = -1
        wanted = self.subscriptions.by_channel
        for number, (channel, own, time_ns, message) in enumerate(in_order(turn.blocks, wanted)):
            if self.subscriptions.by_channel.get(channel) != own:
                continue  # the subscription has ended meanwhile
            await self._tick(time_ns)
            await self._socket.send(message_data(own, time_ns, message))
            if number % _YIELD_EVERY == 0:
                await asyncio.sleep(0)  # lets other tasks run
        await self._tick(turn.until_ns)

    async def _tick(self, time_ns: int) -> None:
        """Send the clock before a message, which some programs use as its time. The clock does not go back."""
        if time_ns > self._clock_ns:
            self._clock_ns = time_ns
            await self._socket.send(time_data(time_ns))

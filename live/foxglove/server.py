"""Server of the Foxglove connection in a separate thread: access, first messages, end.

It serves the loopback only: the protocol has no token, so every program that reaches the port can read. `live.guard`
rejects pages of foreign origin.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket as sockets
import threading
import uuid
from collections.abc import Callable, Collection, Mapping, Sequence
from http import HTTPStatus
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from live.errors import PortTaken
from live.foxglove.client import Client, Turn
from live.foxglove.protocol import SUBPROTOCOLS, Offered, advertise, server_info
from live.guard import LOOPBACK, hosts_of, judge_without_token
from live.port import bound

USUAL_PORT = 8765
"""Default port in Foxglove and Lichtblick."""
MOST_CLIENTS = 16
_MAX_MESSAGE_BYTES, _MAX_UNREAD = 64 * 2**10, 4
_HANDSHAKE_S, _SILENT_S, _CLOSE_S, _END_S = 5.0, 20.0, 1.0, 5.0
_UNSENT_BYTES = 256 * 2**10
"""Send buffer of a connection; by default the system lets it grow to several MB of old messages."""
_QUIET = logging.getLogger("live.foxglove")
_QUIET.addHandler(logging.NullHandler())
_QUIET.propagate = False  # port scanners are not reported to the operator


class FoxgloveServer:
    """A connection that is served while the context lasts.

    Args:
        name: name for clients.
        offered: channels.
        metadata: metadata for clients.
        origins: origins of pages in a browser that may connect, in addition to the desktop programs; see live.guard.
        port: port; 0 for any free one.
        refused: called by the server's thread with the origin of a refused page.

    Attributes:
        url: address of the connection.
    Raises:
        PortTaken: the port is not available.
    """

    def __init__(
        self,
        name: str,
        offered: Sequence[Offered],
        metadata: Mapping[str, str],
        origins: Collection[str] = (),
        port: int = USUAL_PORT,
        refused: Callable[[str], None] = lambda origin: None,
    ) -> None:
        try:
            self._listening = bound("", port)
        except PortTaken as fault:
            raise PortTaken(
                f"{LOOPBACK[0]}:{port}: the connection for Foxglove cannot be offered there "
                f"({fault.__cause__ or fault}); another run may offer one; choose another port"
            ) from fault
        self._listening.setsockopt(sockets.SOL_SOCKET, sockets.SO_SNDBUF, _UNSENT_BYTES)  # connections inherit it
        port = int(self._listening.getsockname()[1])
        self.url: str = f"ws://{LOOPBACK[0]}:{port}"
        self._offered, self._hosts, self._origins = list(offered), frozenset(hosts_of("", port)), frozenset(origins)
        self._first = (server_info(name, uuid.uuid4().hex, metadata), advertise(self._offered))
        self._refused = refused
        self._clients: list[Client] = []
        self._left_out = 0
        self._loop = asyncio.new_event_loop()
        self._loop.set_exception_handler(self._not_accepted)
        self._ending = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="foxglove", daemon=True)

    def __enter__(self) -> FoxgloveServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(RuntimeError):  # usual: the loop has already ended
            self._loop.call_soon_threadsafe(self._ending.set)
        if self._thread.is_alive():
            self._thread.join(_END_S)
        self._listening.close()

    @property
    def clients(self) -> list[Client]:
        """Clients that are connected now."""
        return list(self._clients)

    @property
    def wanted(self) -> frozenset[int]:
        """Numbers of the subscribed channels."""
        return frozenset(number for client in self.clients for number in client.subscriptions.by_channel)

    @property
    def left_out(self) -> int:
        """Number of messages omitted for slow clients, disconnected ones included."""
        return self._left_out + sum(client.left_out for client in self.clients)

    def show(self, turn: Turn) -> None:
        """Queue messages for all clients without waiting. Any thread."""
        for client in self.clients:
            with contextlib.suppress(RuntimeError):  # usual: the server has just ended
                client.show(turn)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._loop.close()

    def _not_accepted(self, loop: asyncio.AbstractEventLoop, context: Mapping[str, Any]) -> None:
        """Keep connections off the operator's terminal for which the process has no file left: they wait for others.

        The event loop reports each of them, a thousand times a second, and by default prints a traceback. It tries
        again after a second, and fails with a ValueError if the server has closed its socket in the meantime.
        """
        error = context.get("exception")
        if isinstance(error, OSError) or self._listening.fileno() < 0:
            _QUIET.debug("%s: %s", context.get("message"), error)
        else:
            loop.default_exception_handler(dict(context))

    async def _serve(self) -> None:
        async with serve(
            self._attend,
            sock=self._listening,
            subprotocols=[Subprotocol(name) for name in SUBPROTOCOLS],
            process_request=self._judge,
            compression=None,
            server_header=None,
            logger=_QUIET,
            open_timeout=_HANDSHAKE_S,
            ping_interval=_SILENT_S,
            ping_timeout=_SILENT_S,
            close_timeout=_CLOSE_S,
            max_size=_MAX_MESSAGE_BYTES,
            max_queue=_MAX_UNREAD,
        ):
            await self._ending.wait()

    def _judge(self, socket: ServerConnection, request: Request) -> Response | None:
        headers = request.headers
        came = headers.get_all("Origin")
        code, why = judge_without_token(headers.get_all("Host"), came, self._hosts, self._origins)
        if code != 200:
            if code == 403:
                self._refused(", ".join(came))
            return socket.respond(HTTPStatus(code), f"{why}\n")
        if len(self._clients) >= MOST_CLIENTS:
            return socket.respond(HTTPStatus.SERVICE_UNAVAILABLE, f"{MOST_CLIENTS} clients are already connected\n")
        return None

    async def _attend(self, socket: ServerConnection) -> None:
        client = Client(socket, self._offered)
        with contextlib.suppress(ConnectionClosed):  # usual: the client leaves
            for text in self._first:
                await socket.send(text)
            self._clients.append(client)
            sending = asyncio.create_task(client.send())
            try:
                await client.listen()
            finally:
                self._clients.remove(client)
                self._left_out += client.left_out
                sending.cancel()
                await asyncio.gather(sending, return_exceptions=True)

"""Serving of a source in separate threads: entrance, server of the accepted connections, followers."""

from __future__ import annotations

import asyncio
import logging
import socket
import threading
from collections.abc import Collection
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from live.entrance import Connections, Entrance
from live.followers import Followers
from live.guard import Access, hosts_of, new_token
from live.model import LiveModel
from live.picture import Pictures
from live.port import bound, page_address
from live.server import PageApplication
from live.source import PageSource
from rig_basics.ignoring import ignoring

_ENDS_S = 5.0
_MAX_MESSAGE_BYTES = 4096  # of one message from a browser
MOST_CONNECTIONS = 64
"""Connections of the server, all with a token: 16 viewers, and the requests of pages that are being opened."""
_BUSY = b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"
_log = logging.getLogger(__name__)


class _Accepted(H11Protocol):
    """A connection from which the head of its request has already been read."""

    def __init__(self, head: bytes, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._head = head

    def connection_made(self, transport: asyncio.Transport) -> None:
        super().connection_made(transport)
        self.data_received(self._head)


class PageServer:
    """A page that is served to connections accepted elsewhere, while the context lasts.

    Args:
        source: displayed source.
        model: model of its rig.
        token, hosts: as for live.guard.Access.

    Attributes:
        page: application.
    """

    def __init__(self, source: PageSource, model: LiveModel, token: str, hosts: Collection[str]) -> None:
        self._followers = Followers(source.signals, model)
        self.page: PageApplication = PageApplication(source, Pictures(source, model, self._followers), token)
        self._config = uvicorn.Config(
            self.page.app(hosts),
            log_config=None,
            log_level=logging.CRITICAL,
            access_log=False,
            lifespan="off",
            http=_Accepted,
            ws="websockets-sansio",
            ws_max_size=_MAX_MESSAGE_BYTES,
            ws_per_message_deflate=False,
            server_header=False,
            timeout_graceful_shutdown=1,
        )
        self._config.load()  # its imports, in this thread: imports of both threads at once may block each other
        self._server = uvicorn.Server(self._config)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._running = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), name="live page", daemon=True)
        self._opening = set[asyncio.Task[None]]()

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._running.set()
        await self._server.serve(sockets=[])

    def __enter__(self) -> PageServer:
        self._followers.__enter__()
        self._thread.start()
        self._running.wait(_ENDS_S)
        return self

    def __exit__(self, *_: object) -> None:
        self._server.should_exit = True
        self._thread.join(_ENDS_S)
        self._followers.__exit__()

    def adopt(self, accepted: socket.socket, head: bytes) -> bool:
        """Serve a connection from which `head` has been read. Any thread."""
        assert self._loop is not None
        try:
            self._loop.call_soon_threadsafe(self._adopt, accepted, head)
        except RuntimeError:  # usual: the server has ended
            return False
        return True

    def _adopt(self, accepted: socket.socket, head: bytes) -> None:
        if len(self._server.server_state.connections) + len(self._opening) >= MOST_CONNECTIONS:
            with ignoring(_log, "turning a connection away", OSError), accepted:
                accepted.setblocking(False)
                accepted.send(_BUSY)
            return
        assert self._loop is not None
        task = self._loop.create_task(self._open(accepted, head))
        self._opening.add(task)
        task.add_done_callback(self._opening.discard)

    async def _open(self, accepted: socket.socket, head: bytes) -> None:
        loop = asyncio.get_running_loop()

        def protocol() -> _Accepted:
            state = self._server.server_state
            return _Accepted(head, config=self._config, server_state=state, app_state={}, _loop=loop)

        with ignoring(_log, "a connection that is gone already", OSError):
            accepted.setblocking(False)
            await loop.connect_accepted_socket(protocol, accepted)


class Serving:
    """A page with its entrance in this process, while the context lasts.

    Args:
        source: displayed source, which carries out STOP.
        model: model of its rig.
        host, port: as for live.port.bound.

    Attributes:
        url: complete address with the token.
        token: token of the page.
        page: application.
    """

    def __init__(self, source: PageSource, model: LiveModel, host: str = "", port: int = 0) -> None:
        self.token: str = new_token()
        self._listening = bound(host, port)
        self.url: str = page_address(host, self._listening, self.token)
        hosts = hosts_of(host, int(self._listening.getsockname()[1]))
        self._server = PageServer(source, model, self.token, hosts)
        self.page: PageApplication = self._server.page
        self._entrance = Entrance(
            self._listening,
            Access(self.token, hosts),
            lambda: source.act("stop", {}),
            self._server.adopt,
            self._report,
        )
        self._thread = threading.Thread(target=self._entrance.run, name="live page: entrance", daemon=True)

    def _report(self, connections: Connections) -> None:
        self.page.connections = connections

    def __enter__(self) -> Serving:
        self._server.__enter__()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._entrance.end()
        self._thread.join(_ENDS_S)
        self._listening.close()
        self._server.__exit__()

"""Serving of a source in a separate thread: port, address and followers."""

from __future__ import annotations

import logging
import threading

import uvicorn

from live.followers import Followers
from live.guard import LOOPBACK, hosts_of, new_token
from live.model import LiveModel
from live.picture import Pictures
from live.port import bound
from live.server import PageApplication
from live.source import PageSource

_ENDS_S = 5.0
_MAX_MESSAGE_BYTES = 4096  # of one message from a browser


class Serving:
    """A page that is served while the context lasts.

    Args:
        source: displayed source.
        model: model of its rig.
        host, port: as for live.port.bound.

    Attributes:
        url: complete address with the token.
        token: token of the page.
        page: application.
    """

    def __init__(self, source: PageSource, model: LiveModel, host: str = "", port: int = 0) -> None:
        self.token: str = new_token()
        self._socket = bound(host, port)
        self._port = int(self._socket.getsockname()[1])
        shown = host or LOOPBACK[0]
        self.url: str = f"http://{f'[{shown}]' if ':' in shown else shown}:{self._port}/?token={self.token}"
        self._followers = Followers(source.signals, model)
        self.page: PageApplication = PageApplication(source, Pictures(source, model, self._followers), self.token)
        config = uvicorn.Config(
            self.page.app(hosts_of(host, self._port)),
            log_config=None,
            log_level=logging.CRITICAL,
            access_log=False,
            lifespan="off",
            ws="websockets-sansio",
            ws_max_size=_MAX_MESSAGE_BYTES,
            ws_per_message_deflate=False,
            server_header=False,
            timeout_graceful_shutdown=1,
        )
        config.load()  # its imports, in this thread: imports of both threads at once may block each other
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._serve, name="live page", daemon=True)

    def _serve(self) -> None:
        self._server.run(sockets=[self._socket])

    def __enter__(self) -> Serving:
        self._followers.__enter__()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.should_exit = True
        self._thread.join(_ENDS_S)
        self._followers.__exit__()
        self._socket.close()

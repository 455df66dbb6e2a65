# pyright: strict
"""A source served in a thread of its own: binding the port, making the address, following the signals."""

from __future__ import annotations

import logging
import socket
import threading
from ipaddress import ip_address

import uvicorn

from daq.errors import RigError
from live.followers import Followers
from live.guard import LOOPBACK, new_token
from live.model import Model
from live.picture import Pictures
from live.server import Page, hosts_of
from live.source import Source

_ENDS_S = 5.0
_MOST_BYTES = 4096  # of one message from a browser


class PortTaken(RigError):
    """The page's port cannot be had."""


def bound(host: str, port: int) -> socket.socket:
    """A listening socket's address, bound.

    Args:
        host: name or address under which others reach this machine; "" for this machine alone.
        port: 0 for any free one.
    Raises:
        PortTaken: it cannot be bound, is no port, or the host stands for every address at once.
    """
    if not 0 <= port <= 65535:  # the system would take it modulo 65536
        raise PortTaken(f"port {port}: expected a port of 1 … 65535, or 0 for any free one")
    name = host or LOOPBACK[0]
    if _is_any(name):
        raise PortTaken(f"--host {host}: expected the name or address by which others reach this machine, not all of "
                        "them: the page checks by which name it was asked for")  # fmt: skip
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(name, port, type=socket.SOCK_STREAM)[0]
        made = socket.socket(family, kind, protocol)
    except OSError as fault:
        raise PortTaken(f"--host {host}: no address of this machine ({fault.strerror or fault})") from fault
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind(address)
        made.listen(64)
    except OSError as fault:
        made.close()
        raise PortTaken(f"{name}:{port}: the page cannot be served there ({fault.strerror}); give another --port or "
                        "--host") from fault  # fmt: skip
    return made


def _is_any(name: str) -> bool:
    try:
        return ip_address(name.strip("[]")).is_unspecified
    except ValueError:
        return not name.strip()


class Serving:
    """A page that is there as long as the context lasts.

    Args:
        source: what is shown.
        model: of its rig.
        host, port: as `bound` takes them.

    Attributes:
        url: the whole address, with the token.
        token: of it.
        page: the application.
    """

    def __init__(self, source: Source, model: Model, host: str = "", port: int = 0) -> None:
        self.token = new_token()
        self._socket = bound(host, port)
        self._port = int(self._socket.getsockname()[1])
        shown = host or LOOPBACK[0]
        self.url = f"http://{f'[{shown}]' if ':' in shown else shown}:{self._port}/?token={self.token}"
        self._followers = Followers(source.signals, model)
        self.page = Page(source, Pictures(source, model, self._followers), self.token)
        config = uvicorn.Config(
            self.page.app(hosts_of(host, self._port)), log_config=None, log_level=logging.CRITICAL, access_log=False,
            lifespan="off", ws="websockets-sansio", ws_max_size=_MOST_BYTES, ws_per_message_deflate=False,
            server_header=False, timeout_graceful_shutdown=1,
        )  # fmt: skip
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

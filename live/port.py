"""Binding of a listening port."""

from __future__ import annotations

import socket
from ipaddress import ip_address

from live.errors import PortTaken
from live.guard import LOOPBACK

_BACKLOG = 1024  # connections that may arrive while none is accepted; a client of a full backlog waits for a second


def bound(host: str, port: int) -> socket.socket:
    """Bind a listening socket.

    Args:
        host: name or address of this machine for other machines; "" for this machine alone.
        port: port number; 0 for any free one.
    Raises:
        PortTaken: the port cannot be bound or is invalid, or the host stands for all addresses.
    """
    if not 0 <= port <= 65535:  # the system would take it modulo 65536
        raise PortTaken(f"port {port}: expected a port of 1 … 65535, or 0 for any free one")
    name = host or LOOPBACK[0]
    if _is_any(name):
        raise PortTaken(
            f"host {host}: expected the name or address by which others reach this machine, not all of "
            "them: the page checks the name in each request"
        )
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(name, port, type=socket.SOCK_STREAM)[0]
        made = socket.socket(family, kind, protocol)
    except OSError as fault:
        raise PortTaken(f"host {host}: no address of this machine ({fault.strerror or fault})") from fault
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind(address)
        made.listen(_BACKLOG)
    except OSError as fault:
        made.close()
        raise PortTaken(
            f"{name}:{port}: the page cannot be served there ({fault.strerror}); choose another port or host"
        ) from fault
    return made


def page_address(host: str, listening: socket.socket, token: str) -> str:
    """Return the complete address of a page with its token; `host` as for live.port.bound."""
    shown = host or LOOPBACK[0]
    return f"http://{f'[{shown}]' if ':' in shown else shown}:{listening.getsockname()[1]}/?token={token}"


def _is_any(name: str) -> bool:
    try:
        return ip_address(name.strip("[]")).is_unspecified
    except ValueError:  # usual: a name
        return not name.strip()

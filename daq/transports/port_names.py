"""Names of ports that other modules make or list."""

from __future__ import annotations

CAN_INTERFACES_WITHOUT_HARDWARE = frozenset({"virtual", "udp_multicast", "socketcand"})
"""Interfaces of python-can without an adapter on this computer; the last one waits for broadcasts."""


def network_port(host: str, port: int) -> str:
    """Return the name of a TCP port, in the notation of `daq.transports.open_link`."""
    return f"socket://{host}:{port}"

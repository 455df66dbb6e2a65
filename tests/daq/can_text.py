"""Records of CAN frames, written as the text of an adapter: a short notation for tests."""

from __future__ import annotations

from daq.transports.slcan import AdapterText, HostText


def rx(text: bytes) -> bytes:
    """Records that a host reads from an adapter."""
    host = HostText()
    host.received(b"\r")
    return host.received(text)


def tx(text: bytes) -> bytes:
    """Records that a host writes to an adapter."""
    return AdapterText().received(text)[0]

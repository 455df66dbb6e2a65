"""What a driver uses to recognise a device on an unknown port, for `daq.discovery`."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from typing import Any

LOSSES_OF_READINGS = frozenset({"invalid", "suspect"})
"""Kinds of `Pipeline.losses` that count samples without a valid reading, as without a target: the line is intact."""


@dataclass(frozen=True)
class FoundDevice:
    """A device that was recognised.

    Attributes:
        settings: settings of its table in the rig file, by name, as far as its bytes contain them.
        identity: name, serial number, firmware and the like, for the operator.
    """

    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])
    identity: Mapping[str, str | int | float] = field(default_factory=dict[str, str | int | float])


@dataclass(frozen=True)
class IdentityRequest:
    """A request for identification, or a pause without one.

    Attributes:
        data: bytes to send; none to only receive.
        is_answered: whether the bytes received since the request contain its answer.
        wait_s: longest wait for the answer, s.
    """

    data: bytes
    is_answered: Callable[[bytes], bool]
    wait_s: float = 0.3


IdentityTurns = Generator[IdentityRequest, bytes, FoundDevice | None]
"""Dialogue without I/O. It yields requests, receives the bytes that arrived after each, and returns the device."""


@dataclass(frozen=True)
class NetworkDevice:
    """A device that announced itself on the network.

    Attributes:
        port: its port in the notation of a rig file, `socket://HOST:PORT`.
        found: the device.
    """

    port: str
    found: FoundDevice


@dataclass(frozen=True)
class Announcement:
    """Datagrams (UDP) by which devices announce themselves.

    Attributes:
        port: port on which the announcements or answers arrive; 0: answers return to the port of the request.
        read: returns the device of a datagram and its sender's address; None if it is another one.
        request: datagram that is broadcast; none if devices announce themselves without one.
        request_port: port to which it is broadcast.
        wait_s: time to wait for announcements, s.
    """

    port: int
    read: Callable[[bytes, str], NetworkDevice | None]
    request: bytes = b""
    request_port: int = 0
    wait_s: float = 2.5

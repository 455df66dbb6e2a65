"""Errors of the live page and of the connections to viewers.

LiveError
├── PortTaken        a port cannot be bound, or a host is not an address of this machine
├── CommandRefused   a command of the page cannot be carried out for this source
└── InvalidRequest   a viewer's message violates its protocol, or requests a write
"""

from __future__ import annotations

from rig_basics.errors import RigError


class LiveError(RigError):
    """Root of the errors of the live page."""


class PortTaken(LiveError):
    """The port is not available, or the host is not an address of this machine."""


class CommandRefused(LiveError):
    """A command cannot be carried out here; the text contains the reason."""


class InvalidRequest(LiveError):
    """The client's message violates the protocol or requests a write. The text contains what was expected."""

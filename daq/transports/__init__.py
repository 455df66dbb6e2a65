"""Byte streams in and out, and the host's clock. The layers above do not depend on what is behind a link."""

from daq.transports.host_clock import HostClock
from daq.transports.link import Link, open_link

__all__ = ["HostClock", "Link", "open_link"]

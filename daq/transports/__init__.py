"""Byte streams in and out, and the host's clock. Nothing above may ask what is behind them."""

from daq.transports.host_clock import HostClock
from daq.transports.link import Link, open_link

__all__ = ["HostClock", "Link", "open_link"]

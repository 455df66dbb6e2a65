"""A log's bytes played out on ports, so that any program sees the rig as it was.

`open_outlets` makes or opens the ports, `played_devices` stands in for the devices behind them, `Playback` plays.
A program that only listens gets every byte from the first; one that configures its devices first is answered, and
gets the bytes from when it has told them to send.
"""

from daq.drivers.played import PlayedDevice
from daq.playback.devices import played_devices
from daq.playback.outlets import LinkOutlet, Outlet, open_outlets
from daq.playback.player import BACKLOG_BYTES, Playback, Played

__all__ = [
    "BACKLOG_BYTES",
    "LinkOutlet",
    "Outlet",
    "Playback",
    "Played",
    "PlayedDevice",
    "open_outlets",
    "played_devices",
]

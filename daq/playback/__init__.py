"""Playback of a log's bytes on ports, so that any program receives the data of the rig as recorded.

`open_outlets` makes or opens the ports, `played_devices` simulates the devices behind them, `Playback` plays. A program
that only receives gets every byte from the first. A program that configures its devices gets answers, and gets the
bytes from the time at which it has started the devices' transmission.
"""

from daq.drivers.played import PlayedDevice
from daq.playback.outlets import LinkOutlet, Outlet, open_outlets, played_devices
from daq.playback.player import BACKLOG_BYTES, Playback, PlaybackState

__all__ = [
    "BACKLOG_BYTES",
    "LinkOutlet",
    "Outlet",
    "Playback",
    "PlaybackState",
    "PlayedDevice",
    "open_outlets",
    "played_devices",
]

"""Replay: a log's raw bytes decoded again through the pipelines that recorded it.

check(path)             again, and compared with what was decoded live, bit for bit
decode_anew(path)       into a new log, with corrected calibration
replay_interlocks(log)  when its interlocks would have tripped, with its limits or others
paced(log, speed)       at the pace it was recorded at, for the live view

`daq.playback` sends the bytes themselves out, on ports that any program can open.
"""

from daq.replay.anew import Anew, decode_anew
from daq.replay.calibration import Calibration
from daq.replay.checking import Check, check, check_log
from daq.replay.compare import ChannelCheck
from daq.replay.interlocked import InterlockReplay, WouldTrip, replay_interlocks
from daq.replay.pace import Pace, Paced, paced

__all__ = [
    "Anew",
    "Calibration",
    "ChannelCheck",
    "Check",
    "InterlockReplay",
    "Pace",
    "Paced",
    "WouldTrip",
    "check",
    "check_log",
    "decode_anew",
    "paced",
    "replay_interlocks",
]

"""Replay: decode a log's raw bytes again with the pipelines that recorded it.

check(path)             decode again and compare with the recorded samples, bit for bit
decode_anew(path)       decode into a new log, with corrected calibration
replay_interlocks(log)  times at which its interlocks would have tripped, with its limits or others
paced(log, speed)       decode at the recorded pace, for the live view

`daq.playback` sends the bytes themselves to ports that any program can open.
"""

from daq.replay.calibration import Calibration
from daq.replay.checking import ReplayCheck, check, check_log
from daq.replay.compare import ChannelCheck
from daq.replay.decoded_again import DecodedLog, decode_again
from daq.replay.interlocked import InterlockReplay, WouldTrip, replay_interlocks
from daq.replay.pace import Pace, Paced, paced

__all__ = [
    "Calibration",
    "ChannelCheck",
    "DecodedLog",
    "InterlockReplay",
    "Pace",
    "Paced",
    "ReplayCheck",
    "WouldTrip",
    "check",
    "check_log",
    "decode_again",
    "paced",
    "replay_interlocks",
]

"""Replay: a log's raw bytes decoded again through the pipelines that recorded it.

check(path)        again, and compared with what was decoded live, bit for bit
decode_anew(path)  into a new log, with corrected calibration
paced(log, speed)  at the pace it was recorded at, for the live view

`daq.playback` sends the bytes themselves out, on ports that any program can open.
"""

from daq.replay.anew import Anew, decode_anew
from daq.replay.calibration import Calibration
from daq.replay.checking import Check, check, check_log
from daq.replay.compare import ChannelCheck
from daq.replay.pace import Pace, Paced, paced

__all__ = [
    "Anew",
    "Calibration",
    "ChannelCheck",
    "Check",
    "Pace",
    "Paced",
    "check",
    "check_log",
    "decode_anew",
    "paced",
]

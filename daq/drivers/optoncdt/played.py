"""Stand-in for an optoNCDT sensor of a log while the log is played."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from daq.channels import RX
from daq.drivers.optoncdt import distance_words, sensor_answers
from daq.drivers.optoncdt.commands import SensorCommands, info_lines, outputs_of
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.optoncdt.stream import DEFAULT_WORDS
from daq.drivers.played import PlayedDevice
from daq.errors import LogError

_UNKNOWN = "unknown"
_WORD = re.compile(r"[A-Z0-9_]{1,40}")


class WholeBlocks:
    """A sensor's stream in complete blocks, so that an answer is never inserted into a block.

    Bytes after the last complete block are held until the block is complete. Bytes longer than a block are passed on.

    Args:
        words: values in a block.
    """

    def __init__(self, words: int) -> None:
        self._words = words
        self._tail = b""

    def feed(self, direction: int, data: bytes) -> bytes:
        """See BytesFromDevice."""
        if direction != RX:
            return b""
        line = self._tail + data
        end = self._end_of_blocks(line)
        if len(line) - end > 3 * self._words:
            end = len(line)
        self._tail = line[end:]
        return line[:end]

    def _end_of_blocks(self, line: bytes) -> int:
        """Return the end of the last complete block, or otherwise the beginning of the incomplete block."""
        high = np.flatnonzero(np.frombuffer(line, np.uint8) >= 0x80)  # last bytes of values …
        first = np.flatnonzero(np.frombuffer(line, np.uint8)[high] < 0xC0)  # … and those that begin a block
        if not len(first):
            return 0
        begun = int(first[-1])
        ended = begun + self._words - 1
        return int(high[ended]) + 1 if ended < len(high) else max(0, int(high[begun]) - 2)

    def rest(self) -> bytes:
        """See BytesFromDevice."""
        tail, self._tail = self._tail, b""
        return tail


class PlayedLaser(PlayedDevice):
    """An optoNCDT sensor that answers as the sensor of the log. Rate and output words are those of the log.

    It answers ECHO, GETINFO, OUTPUT, OUTADD_RS422, GETOUTINFO_RS422, MEASRATE, OUTHOLD, OUTREDUCEDEVICE, MASTERMV and
    RESETCNT. Other rates and output words are refused; RESETCNT does not change the counters.

    Args:
        identity: identity of the sensor from its opening. Missing entries are taken from the rig file.
        config: table of the sensor in the rig file.

    Raises:
        LogError: the identity is impossible for such a sensor.
    """

    expects = "OUTPUT RS422"

    def __init__(self, config: Laser, identity: Mapping[str, Any]) -> None:
        words = _words(identity.get("words", config.output_words or DEFAULT_WORDS))
        super().__init__(WholeBlocks(len(words)))
        self._sensor = SensorCommands(
            info_lines(_info(identity, config)), float(config.rate_Hz), outputs_of(words), fixed=True
        )

    @property
    def sending(self) -> bool:
        """See PlayedDevice."""
        return self._sensor.streaming

    def begin(self) -> None:
        """See PlayedDevice."""
        self._sensor.streaming = True

    def hear(self, data: bytes) -> bytes:
        """See PlayedDevice."""
        answers = self._sensor.receive(data)
        self.commands += answers.count(sensor_answers.PROMPT.encode())
        return answers


def _words(found: object) -> list[str]:
    """Return the output words of an identity.

    Raises:
        LogError: they are not a list of names.
    """
    items = cast("Sequence[object]", found) if isinstance(found, list | tuple) else ()
    words = [word for word in items if isinstance(word, str) and _WORD.fullmatch(word)]
    if not words or len(words) != len(items):
        raise LogError(f"identities.json: expected names of output words as the sensor gives them, got {found!r}")
    return words


def _info(identity: Mapping[str, Any], config: Laser) -> sensor_answers.SensorInfo:
    """Return the sensor's own identity. The range is the reported one, not one that was corrected afterwards."""
    scaling = identity.get("scaling", config.scaling or distance_words.USUAL_SCALING)
    if not isinstance(scaling, str) or scaling not in distance_words.SCALINGS:
        raise LogError(
            f"identities.json: expected a scaling, one of {', '.join(distance_words.SCALINGS)}, got {scaling!r}"
        )
    range_m = identity.get("told_range_m", identity.get("range_m", config.range_m))
    if not isinstance(range_m, int | float) or not 0 < range_m < 100:
        raise LogError(f"identities.json: expected a measuring range in m, got {range_m!r}")
    serial, version = (str(identity.get(key, _UNKNOWN)) for key in ("serial", "version"))
    name = str(identity.get("name", scaling))  # a host derives the scaling from it
    return sensor_answers.SensorInfo(name=name, serial=serial, range_m=float(range_m), version=version)

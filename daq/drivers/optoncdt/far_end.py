"""A simulated optoNCDT sensor: answers ASCII commands, streams binary blocks on its own clock.

Stand-in for an optoNCDT sensor of a log while the log is played.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from daq.channels import RX
from daq.drivers.optoncdt import distance_words, sensor_answers, wire as optoncdt
from daq.drivers.optoncdt.commands import SensorCommands, info_lines, outputs_of
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.optoncdt.stream import DEFAULT_WORDS
from daq.drivers.played import BytesFromDevice, PlayedDevice
from daq.drivers.simulated import FarEnd, FaultKind, MotionInterval
from daq.errors import LogError
from daq.virtual_rig.beam import Beam
from daq.virtual_rig.world import World


class SimulatedLaser(FarEnd):
    """One sensor on its serial line.

    Attributes:
        beam: its beam.
        fault_code: distance word that the sensor sends in place of the measured one (262076: no peak); None without a
            fault.

    Args:
        config: table of the sensor in the rig file.
        beam: its beam.
        serial: serial number.
    """

    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        "blocked": FaultKind("the beam is blocked: every distance is the code for no peak"),
        "code": FaultKind(
            "every distance is an error code", distance_words.NO_PEAK, meaning="the code", limits=(0, 2**18 - 1)
        ),
    }

    def __init__(
        self,
        config: Laser,
        beam: Beam,
        serial: str,
    ) -> None:
        self._config = config
        self.beam: Beam = beam
        self.fault_code: int | None = None
        self._counter = int(beam.rng.integers(0, optoncdt.COUNTER_WRAP))
        model = config.scaling or distance_words.USUAL_SCALING
        self._scaling = distance_words.SCALINGS[model]
        self._info = sensor_answers.SensorInfo(name=model, serial=serial, range_m=config.range_m, version="001.019")
        self._commands = self._fresh_commands()

    def _fresh_commands(self) -> SensorCommands:
        return SensorCommands(
            [*info_lines(self._info), "Option: 000", "Article: 4120232"],
            float(self._config.rate_Hz),
            rate_set=self.beam.restart,
            counter_reset=self._reset_counter,
        )

    @classmethod
    def of(cls, device: str, config: Laser, world: World) -> SimulatedLaser:
        """Make the sensor of a simulated rig."""
        return cls(config, Beam.of(device, config, world), f"1420{world.number(device, config.topic):04d}")

    def receive(self, data: bytes, now_s: float = 0.0) -> bytes:
        """Take command bytes; return the answers."""
        return self._commands.receive(data)

    def _reset_counter(self) -> None:
        self._counter = 0

    def sample(self, motion: MotionInterval) -> bytes:
        """Return the bytes of the samples in an interval of motion."""
        period = 1.0 / self._commands.rate_Hz
        numbers = self.beam.due(motion, period)
        if not len(numbers):
            return b""
        counter = (self._counter + np.arange(len(numbers))) % optoncdt.COUNTER_WRAP
        self._counter = int(counter[-1] + 1) % optoncdt.COUNTER_WRAP
        device_s = numbers * period
        reading = self.beam.reading(motion, device_s)
        if not self._commands.streaming:
            return b""
        return optoncdt.encode_block(self._words(reading, counter, device_s))

    def fail(self, what: str, value: Any) -> None:
        """See FarEnd and `fault_kinds`; the value 0 ends either fault."""
        match what:
            case "blocked":
                self.fault_code = distance_words.NO_PEAK if value else None
            case "code":
                self.fault_code = int(value) or None
            case _:
                super().fail(what, value)

    def power(self, on: bool, now_s: float) -> None:
        """See FarEnd. After power-up the sensor answers commands, does not stream, and counts from 0."""
        super().power(on, now_s)
        if on:
            self.beam.power_up(now_s)
            self._counter = 0
            self._commands = self._fresh_commands()

    def _words(
        self, reading: NDArray[np.floating], counter: NDArray[np.int_], device_s: NDArray[np.floating]
    ) -> NDArray[np.uint32]:
        half = 0.5 * self._config.range_m
        distance = np.clip(reading, -half, half) + half
        codes = distance_words.code(distance, self._config.range_m, self._scaling).astype(np.int64)
        codes[reading > half] = distance_words.BEHIND_RANGE
        codes[reading < -half] = distance_words.BEFORE_RANGE
        if self.fault_code is not None:
            codes[:] = self.fault_code
        ticks = np.rint(device_s / optoncdt.TICK_S).astype(np.int64) % optoncdt.TIMESTAMP_WRAP
        columns = [codes]
        if "COUNTER" in self._commands.outputs:
            columns.append(counter)
        if "TIMESTAMP" in self._commands.outputs:
            columns += [ticks & 0xFFFF, ticks >> 16]
        if len(columns) * 30 * self._commands.rate_Hz > self._config.baud:
            columns[0] = np.full_like(codes, distance_words.TOO_MUCH_DATA)
        return np.column_stack(columns).astype(np.uint32)


_UNKNOWN = "unknown"
_WORD = re.compile(r"[A-Z0-9_]{1,40}")


class WholeBlocks(BytesFromDevice):
    """A sensor's stream in complete blocks, so that an answer is never inserted into a block.

    Bytes after the last complete block are held until the block is complete. Bytes longer than a block are passed on.

    Args:
        words: values in a block.
    """

    def __init__(self, words: int) -> None:
        self._words = words
        self._tail = b""

    @override
    def feed(self, direction: int, data: bytes) -> bytes:
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

    @override
    def remainder(self) -> bytes:
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
    @override
    def sending(self) -> bool:
        return self._sensor.streaming

    @override
    def begin(self) -> None:
        self._sensor.streaming = True

    @override
    def hear(self, data: bytes) -> bytes:
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

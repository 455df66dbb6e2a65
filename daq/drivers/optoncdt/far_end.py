"""A simulated optoNCDT sensor: answers ASCII commands, streams binary blocks on its own clock."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from daq.drivers.optoncdt import distance_words, sensor_answers, wire as optoncdt
from daq.drivers.optoncdt.commands import SensorCommands, info_lines
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.simulated import FarEnd, FaultKind, MotionInterval
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

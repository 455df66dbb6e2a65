"""The driver under test: its settings, its roles, and a recording that the tests share."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from daq.channels import Channel
from daq.drivers.contract import Pipeline, SampleClock
from daq.drivers.driver import Driver
from daq.items import RX, Batch, DeviceEvent, joined
from rig_configs.device import DeviceSettings
from rig_configs.roles import (
    DisplacementSensor,
    OtherQuantity,
    PendulumAngles,
    PendulumLocks,
    Role,
    RotorPhase,
    SpeedSource,
)
from rig_testing.bench import NAME, DriverBench, Items, Tape, decoded, settings_for
from rig_testing.report import Failed

SPEED_RPM, RAMP_RPM_S = 200.0, 400.0
_TAPE_S = 3.0
_LEAST_READS, _LONGEST_TAPE_S = 40, 60.0  # a slow sensor is recorded for longer, until so many reads came in
_TROUBLE = ("gap", "damage", "restart", "rate", "words", "foreign", "fault", "emergency")

Reads = Sequence[tuple[int, bytes, int]]


class Subject:
    """The driver under test, see the module.

    Args:
        thorough: whether the tests may take long.
        processes: number of processes for a test that is split; 1 for this process alone.
        progress: called with the completed share, 0 … 1, of a test that takes long.
    """

    def __init__(
        self,
        driver: Driver,
        thorough: bool,
        processes: int = 1,
        progress: Callable[[float], None] = lambda share: None,
    ) -> None:
        self.driver: Driver = driver
        self.thorough: bool = thorough
        self.processes: int = processes
        self.progress: Callable[[float], None] = progress

    @cached_property
    def settings(self) -> DeviceSettings:
        """Settings of the driver's example."""
        return settings_for(self.driver)

    @cached_property
    def roles(self) -> tuple[Role, ...]:
        """Roles of the device."""
        return self.settings.roles(NAME)

    @cached_property
    def channels(self) -> dict[str, Channel]:
        """All channels that the device may fill, by topic."""
        driver, settings = self.driver, self.settings
        return {channel.topic: channel for channel in (*driver.channels(settings), *driver.occasional(settings))}

    @cached_property
    def constant(self) -> tuple[str, ...]:
        """Topics of channels that it fills continuously."""
        return tuple(channel.topic for channel in self.driver.channels(self.settings))

    @cached_property
    def clocks(self) -> tuple[SampleClock, ...]:
        """See Driver."""
        return self.driver.clocks(self.settings)

    def claims(self, word: str) -> bool:
        """Return whether the driver makes a claim."""
        return word in self.driver.claims

    def measured(self) -> dict[str, tuple[str, ...]]:
        """Return the fields of measured values, by topic."""
        out: dict[str, tuple[str, ...]] = {}
        for role in self.roles:
            if not isinstance(role, PendulumLocks):
                out[role.topic] = _fields(role)
        return out

    @cached_property
    def tape(self) -> Tape:
        """Three seconds of the device on a moving rig, or as long as it takes to receive enough reads.

        Raises:
            Failed: it cannot be opened.
        """
        return self.record(_TAPE_S, least_reads=_LEAST_READS)

    @cached_property
    def another(self) -> Tape:
        """The same of another device of the kind."""
        return self.record(_TAPE_S, seed=2, least_reads=_LEAST_READS)

    def record(self, seconds: float, seed: int = 1, clock_at_s: float | None = None, least_reads: int = 0) -> Tape:
        """Record the device; a device that turns the rotor turns it.

        Args:
            seconds: duration, s.
            seed: of the simulated device.
            clock_at_s: see DriverBench.
            least_reads: the recording continues until so many reads came in, or up to a minute.
        Raises:
            Failed: the device cannot be opened or does not accept commands.
        """
        bench = DriverBench(self.driver, seed, clock_at_s)
        try:
            bench.begin()
            bench.stir()
            if bench.control is not None:
                turn(bench)
        except Exception as error:
            raise Failed(f"it cannot be set up: {type(error).__name__}: {error}") from error
        bench.clock.wait(seconds)
        passed_s = seconds
        while passed_s < _LONGEST_TAPE_S and sum(read[0] == RX for read in bench.reads) < least_reads:
            bench.clock.wait(seconds)
            passed_s += seconds
        return bench.cut_tape()

    def decode(self, reads: Reads) -> tuple[Items, Pipeline]:
        """Decode reads of the tape's device by a fresh pipeline."""
        return decoded(self.driver, self.settings, self.tape.identity, reads)

    def rows(self, items: Iterable[Batch | DeviceEvent], topic: str) -> NDArray[np.float64]:
        """Return the measured values, shape (samples, fields)."""
        whole = together(items, topic)
        fields = self.measured().get(topic, ())
        if whole is None or not fields:
            return np.zeros((0, len(fields)))
        return np.column_stack([np.asarray(whole.columns[name], np.float64) for name in fields])


def turn(bench: DriverBench) -> None:
    """Command a speed source to turn the rotor."""
    assert bench.control is not None
    assert bench.driver.speed_source is not None
    bench.control.set_ramp(RAMP_RPM_S)
    bench.clock.wait(0.2)
    bench.control.enable()
    bench.control.set_speed(SPEED_RPM)


def _fields(role: DisplacementSensor | PendulumAngles | RotorPhase | SpeedSource | OtherQuantity) -> tuple[str, ...]:
    match role:
        case DisplacementSensor():
            return ("displacement_m",)
        case PendulumAngles():
            return ("theta3_rad", "theta4_rad")
        case RotorPhase():
            return ("revolutions",)
        case SpeedSource():
            return ("speed_rpm",)
        case OtherQuantity():
            return role.fields


def together(items: Iterable[Batch | DeviceEvent], topic: str) -> Batch | None:
    """Return all batches of a channel as one; None without any."""
    batches = [item for item in items if isinstance(item, Batch) and item.channel.topic == topic]
    return joined([(batch, 0) for batch in batches])[0] if batches else None


def events(items: Iterable[Batch | DeviceEvent], *kinds: str) -> list[DeviceEvent]:
    """Return events of the given kinds; without kinds, all that report trouble."""
    return [item for item in items if isinstance(item, DeviceEvent) and item.kind in (kinds or _TROUBLE)]


def lost(before: dict[str, int], after: dict[str, int]) -> dict[str, int]:
    """Return the losses counted in the meantime, by kind."""
    return {kind: count - before.get(kind, 0) for kind, count in after.items() if count != before.get(kind, 0)}

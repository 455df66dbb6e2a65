"""The measuring part of a simulated displacement sensor: what it sees of the disk, and when it takes a sample."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.drivers.simulated import MotionInterval
from daq.virtual_rig.world import DeviceClock, World
from rig_configs.device import DisplacementTable

Array = NDArray[np.floating[Any]]

_OFFSET_STD_M = 5e-5  # of the reading at rest from mid-range: how well a sensor is positioned


@dataclass
class Beam:
    """One sensor's beam, sampled on the sensor's clock.

    Args:
        sensitivity: to x and y, including axis angle and gain, dimensionless, shape (2,).
        offset_m: reading at rest, from mid-range, m.
        noise_m: standard deviation of one sample, m.
        clock: clock of the sensor.
        rng: source of the noise.
    """

    sensitivity: Array
    offset_m: float
    noise_m: float
    clock: DeviceClock
    rng: np.random.Generator
    _next: int | None = field(default=None, init=False)  # number of the next sample on the clock; None before the first

    @classmethod
    def of(cls, device: str, config: DisplacementTable, world: World) -> Beam:
        """Make the beam of a sensor of a simulated rig: its gain and its offset are drawn."""
        gain = config.lever_ratio * (1 + world.spread * config.gain_std * world.calibration.standard_normal())
        sensitivity = gain * world.direction(config.axis, config.direction_deg)
        offset = _OFFSET_STD_M * world.calibration.standard_normal()
        noise, rng = world.virtual.sensors.laser_noise_m, world.rng(f"noise {device}")
        return cls(sensitivity, offset, noise, world.clock(device), rng)

    @classmethod
    def unmoved(cls) -> Beam:
        """Make a beam on nothing that moves, with an exact clock."""
        return cls(np.zeros(2), 0.0, 0.0, DeviceClock(0.0, 0.0), np.random.default_rng(0))

    def restart(self) -> None:
        """Begin with the first sample of the next interval."""
        self._next = None

    def power_up(self, now_s: float) -> None:
        """Start the clock at 0 and begin to count samples, as after a loss of the supply."""
        self.clock.reset(now_s)
        self.restart()

    def due(self, motion: MotionInterval, period_s: float) -> NDArray[np.int64]:
        """Return the numbers of the samples that the clock takes in the interval.

        Args:
            motion: interval of motion that follows the one before.
            period_s: sampling period in the clock's time, s.
        """
        first, last = (int(np.floor(float(self.clock.device_s(motion.time_s[i])) / period_s)) for i in (0, -1))
        if self._next is None:
            self._next = first + 1
        numbers = np.arange(self._next, last + 1)
        self._next = max(self._next, last + 1)
        return numbers

    def reading(self, motion: MotionInterval, device_s: Array) -> Array:
        """Return the displacements from mid-range at times of the sensor's clock, m."""
        times = np.clip(self.clock.rig_s(device_s), motion.time_s[0], motion.time_s[-1])
        moved = self.sensitivity[0] * motion.at(times, 0, 4) + self.sensitivity[1] * motion.at(times, 1, 5)
        return moved + self.offset_m + self.noise_m * self.rng.standard_normal(len(device_s))

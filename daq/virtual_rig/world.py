"""Common data of the far ends of a simulated rig: the motion, and the errors of sensors and clocks from the seed."""

from __future__ import annotations

import math
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.virtual_rig.motion import SimulatedMotion
from rig_configs.schema import Virtual

Array = NDArray[np.floating[Any]]


class DeviceClock:
    """A device clock with an offset and a rate error: device = offset + (1 + drift) · rig time, s."""

    def __init__(self, offset_s: float, drift: float) -> None:
        self.offset_s: float = offset_s
        self.drift: float = drift

    def device_s(self, time_s: Array | float) -> Array | float:
        """Return the time of the device clock at a rig time, s."""
        return self.offset_s + (1 + self.drift) * time_s

    def rig_s(self, device_s: Array) -> Array:
        """Return the rig time at which the device clock has a value, s."""
        return (device_s - self.offset_s) / (1 + self.drift)

    def reset(self, now_s: float) -> None:
        """Reset the clock to 0 at a rig time, as after a loss of the device's supply."""
        self.offset_s = -(1 + self.drift) * now_s


class World:
    """Data of the simulation that the far ends use.

    Args:
        virtual: [virtual] table of the rig file.
        motion: motion of the rig.

    Attributes:
        virtual, motion: see the arguments.
        calibration: random numbers of the calibration errors, drawn in the order of the devices in the rig file.
        spread: 1 if calibration errors are drawn, 0 if the sensors are exact.
    """

    def __init__(self, virtual: Virtual, motion: SimulatedMotion) -> None:
        self.virtual: Virtual = virtual
        self.motion: SimulatedMotion = motion
        self.calibration: np.random.Generator = self.rng("calibration")
        self.spread: float = 1.0 if virtual.sensors.draw_calibration else 0.0

    def rng(self, name: str) -> np.random.Generator:
        """Return a random number stream for one purpose, which is independent of the draws of other purposes."""
        return np.random.default_rng([self.virtual.seed, zlib.crc32(name.encode())])

    def clock(self, device: str) -> DeviceClock:
        """Return the clock of a device."""
        rng, sensors = self.rng(f"clock {device}"), self.virtual.sensors
        return DeviceClock(
            rng.uniform(0, sensors.clock_offset_s), 1e-6 * sensors.clock_drift_ppm * rng.standard_normal()
        )

    def direction(self, axis: str, direction_deg: float | None = None) -> Array:
        """Return the unit vector (x, y) along which a sensor measures, shape (2,), with its error of alignment.

        Args:
            axis: nominal axis, "x" or "y".
            direction_deg: direction of the sensor relative to +x, degrees; None: along its axis.
        """
        own_deg = 0.0 if axis == "x" else 90.0
        angle = math.radians(own_deg if direction_deg is None else direction_deg)
        beta = angle + math.radians(self.virtual.sensors.axis_angle_deg)
        return np.array([math.cos(beta), math.sin(beta)])

    def number(self, device: str, topic: str) -> int:
        """Return the end of a sensor's serial number: 1 or 2 for laser/x and laser/y, 10 … 999 for witnesses."""
        return {"laser/x": 1, "laser/y": 2}.get(topic, 10 + zlib.crc32(device.encode()) % 990)

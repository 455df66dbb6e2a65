# pyright: strict
"""What the far ends of a simulated rig share: one motion, and how far its sensors fall short, drawn from the seed."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.virtual_rig.motion import Motion
from rig_configs.schema import Virtual

Array = NDArray[np.floating[Any]]


class DeviceClock:
    """A clock with its own offset and rate: device = offset + (1 + drift) · rig time, s."""

    def __init__(self, offset_s: float, drift: float) -> None:
        self.offset_s, self.drift = offset_s, drift

    def device_s(self, time_s: Array | float) -> Array | float:
        """What the device's clock shows at a rig time."""
        return self.offset_s + (1 + self.drift) * time_s

    def rig_s(self, device_s: Array) -> Array:
        """Rig time at which the device's clock shows a value."""
        return (device_s - self.offset_s) / (1 + self.drift)

    def begin_anew(self, now_s: float) -> None:
        """Show 0 at a rig time, as after the device's supply came back."""
        self.offset_s = -(1 + self.drift) * now_s


class World:
    """All that a far end may know.

    Args:
        virtual: of the rig file.
        motion: of the rig.
        patience: rig seconds of a time-out given in wall seconds (`HostClock.patience`).

    Attributes:
        calibration: random numbers for what sensors are off by, drawn in the order of the rig file's devices.
        spread: 1 where calibrations are drawn, 0 where they are exact.
    """

    def __init__(self, virtual: Virtual, motion: Motion, patience: Callable[[float], float] = float) -> None:
        self.virtual, self.motion, self.patience = virtual, motion, patience
        self.calibration = self.rng("calibration")
        self.spread = 1.0 if virtual.sensors.draw_calibration else 0.0

    def rng(self, name: str) -> np.random.Generator:
        """An own stream of random numbers for each purpose: one more draw here moves nothing there."""
        return np.random.default_rng([self.virtual.seed, zlib.crc32(name.encode())])

    def clock(self, device: str) -> DeviceClock:
        """The clock of a device."""
        rng, sensors = self.rng(f"clock {device}"), self.virtual.sensors
        return DeviceClock(
            rng.uniform(0, sensors.clock_offset_s), 1e-6 * sensors.clock_drift_ppm * rng.standard_normal()
        )

    def direction(self, axis: str, direction_deg: float | None = None) -> Array:
        """What a sensor sees of x and y, shape (2,): sensors stand a little askew.

        Args:
            axis: that it is meant for.
            direction_deg: where it looks, from +x; None: along its axis.
        """
        own_deg = 0.0 if axis == "x" else 90.0
        angle = math.radians(own_deg if direction_deg is None else direction_deg)
        beta = angle + math.radians(self.virtual.sensors.axis_angle_deg)
        return np.array([math.cos(beta), math.sin(beta)])

    def number(self, device: str, topic: str) -> int:
        """The end of a sensor's serial number: 1 and 2 for those that measure, else one of its own below 1000."""
        return {"laser/x": 1, "laser/y": 2}.get(topic, 10 + zlib.crc32(device.encode()) % 990)

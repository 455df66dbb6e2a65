"""A sensor that only sends, slowly and in short lines, passes the tests that every driver must pass."""

from __future__ import annotations

import re
from typing import Any
from unittest import SkipTest

import numpy as np
import pytest

import rig_testing
from daq.channels import Channel
from daq.drivers.contract import Pipeline
from daq.drivers.driver import Driver
from daq.drivers.simulated import FarEnd, MotionInterval
from daq.items import TX, Batch, DeviceEvent
from rig_configs.device import DeviceSettings
from rig_configs.roles import OtherQuantity, Role

PERIOD_S = 0.4
LINE = re.compile(rb"[+-]\d{3}\.\d{2} C\r")  # 11 bytes with its line feed


class Thermometer(DeviceSettings):
    """A thermometer that sends a reading every 0.4 s."""

    baud: int = 9600

    def roles(self, device: str) -> tuple[Role, ...]:
        return (OtherQuantity(device=device, topic="temperature", fields=("temperature_degC",)),)


class Readings(Pipeline):
    """Lines to readings. Without a clock a sample has the time of its arrival."""

    def __init__(self, device: str, channel: Channel) -> None:
        super().__init__(device, "damaged_lines")
        self._channel = channel
        self._rest, self._heard, self._count = b"", False, 0

    def feed(self, direction: int, data: bytes, host_ns: int) -> list[Batch | DeviceEvent]:
        if direction == TX:
            return []
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[:12]
        out: list[Batch | DeviceEvent] = []
        for line in lines:
            if LINE.fullmatch(line):
                values = {"temperature_degC": np.array([float(line[:7])])}
                out.append(Batch(self._channel, np.array([host_ns]), np.array([self._count], np.uint32), values))
                self._count = (self._count + 1) % 2**32
            elif self._heard:
                self.losses["damaged_lines"] += 1
                out.append(DeviceEvent("damage", self._device, "a damaged line was dropped", {"lines": 1}))
            self._heard = True
        return out


class Room(FarEnd):
    """The simulated thermometer, in a room that gets warmer."""

    def __init__(self, world: Any, device: str) -> None:
        self._clock, self._next = world.clock(device), 0

    def receive(self, data: bytes, now_s: float) -> bytes:
        return b""

    def sample(self, motion: MotionInterval) -> bytes:
        first, last = (int(float(self._clock.device_s(motion.time_s[i])) / PERIOD_S) for i in (0, -1))
        due = range(self._next or first + 1, last + 1)
        self._next = max(last + 1, self._next)
        return b"".join(f"{20 + 0.01 * n:+07.2f} C\r\n".encode() for n in due)


def _channels(settings: DeviceSettings) -> tuple[Channel, ...]:
    return (Channel("temperature", "thermometer.Reading", (("temperature_degC", "double"),)),)


THERMOMETER = Driver(
    name="thermometer",
    settings=Thermometer,
    channels=_channels,
    pipeline=lambda device, settings, identity: Readings(device, _channels(settings)[0]),
    far_end=lambda device, settings, world: Room(world, device),
)


@pytest.mark.parametrize("case", rig_testing.cases(THERMOMETER), ids=str)
def test_it_passes(case: rig_testing.ContractCase) -> None:
    try:
        case()
    except SkipTest as reason:
        if str(case) in ("garbage", "damage"):
            pytest.fail(f"{case} was not tried: {reason}")
        raise

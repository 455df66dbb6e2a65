"""Pipeline of an optoNCDT on Ethernet at its limits: numbers of samples, gaps, flags, complaints, rates."""

from __future__ import annotations

import numpy as np
import pytest

from daq.items import RX, Batch, DeviceEvent
from rig_drivers.optoncdt_ethernet.stream import EthernetPipeline
from tests.rig_drivers.test_optoncdt_ethernet import MID, S, kinds, packet, pipeline, recorded

Items = list[Batch | DeviceEvent]
PERIOD_NS = 200_000


class Sensor:
    """Packets of a sensor, 20 a second, and what its pipeline makes of them."""

    def __init__(self, line: EthernetPipeline, rate_Hz: int = 5000) -> None:
        self.line, self.items = line, list[Batch | DeviceEvent]()
        self.counter, self.now_ns = 0, S
        self._rate_Hz = rate_Hz

    def run(self, seconds: float, rate_Hz: int = 0, reads_Hz: int = 20, parts: int = 1) -> list[str]:
        """Let the sensor measure for a time, and return the kinds of the events."""
        items: Items = []
        for _ in range(round(seconds * reads_Hz)):
            size = (rate_Hz or self._rate_Hz) // reads_Hz
            data = packet(self.counter, [MID] * size)
            self.now_ns += S // reads_Hz
            for part in np.array_split(np.frombuffer(data, np.uint8), parts):
                items += self.line.feed(RX, part.tobytes(), self.now_ns)
            self.counter += size
        self.items += items
        return kinds(items)


# --- numbers of samples ----------------------------------------------------------------------------------------------


def test_packets_of_one_read_are_one_batch_that_begins_with_the_counter() -> None:
    line = pipeline(lever_ratio=2.0, range_m=0.02)
    items = line.feed(RX, packet(0, [MID, MID + 1000]) + packet(2, [MID]), S)
    (batch,) = items
    assert isinstance(batch, Batch)
    assert batch.columns["counter"].tolist() == batch.sequence.tolist() == [0, 1, 2]
    assert batch.columns["device_ticks"].tolist() == [0, 20, 40]
    assert batch.columns["displacement_m"] == pytest.approx([0, 5e-7, 0], abs=1e-12)
    assert batch.columns["flags"].tolist() == [0, 0, 0]
    assert batch.time_ns.tolist() == [S - 2 * PERIOD_NS, S - PERIOD_NS, S]
    seed = line.status.clock_seed
    assert seed is not None
    assert (seed.wrap_ns, seed.device_ns, seed.host_ns) == (2**32 * PERIOD_NS, 2 * PERIOD_NS, S)


# --- damage and other frames -----------------------------------------------------------------------------------------


# --- serial numbers and flags ----------------------------------------------------------------------------------------


def test_a_packet_of_another_sensor_does_not_hide_those_after_it_in_a_read() -> None:
    line = pipeline()
    assert recorded(line.feed(RX, packet(0, [1]), S)) == [1]
    assert (line.status.has_reported, line.losses) == (True, {"samples": 0, "bytes": 0, "invalid": 0})
    items = line.feed(RX, packet(0, [2], serial=78) + packet(1, [3]), S + 1)
    assert (kinds(items), recorded(items)) == (["fault"], [3])


# --- another rate ----------------------------------------------------------------------------------------------------


def test_few_packets_a_second_show_their_rate_though_they_come_in_parts() -> None:
    sensor = Sensor(pipeline())
    assert sensor.run(3, reads_Hz=4, parts=3) == []
    assert sensor.run(12, reads_Hz=4, parts=3) == []
    assert sensor.run(12, 2500, reads_Hz=4, parts=3) == ["fault"]

"""Pipeline of an RF60x sensor on Ethernet at its limits: other sensors, damage, long losses, single results."""

from __future__ import annotations

import numpy as np
import pytest

from daq.items import RX, Batch, DeviceEvent
from tests.rig_drivers.test_riftek_ethernet import S, packet, pipeline

Items = list[Batch | DeviceEvent]


def batches(items: Items) -> list[Batch]:
    return [item for item in items if isinstance(item, Batch)]


def test_packets_of_another_sensor_do_not_hide_those_read_with_them() -> None:
    line = pipeline(serial=678)
    others = [packet(number, serial=677) for number in range(3)]
    found = line.feed(RX, b"".join([packet(0, serial=678), *others, packet(1, serial=678)]), 0)
    assert len(batches(found)) == 2
    assert line.losses["bytes"] == 3 * 512


@pytest.mark.parametrize(("status", "valid"), [(0, False), (1, True), (2, False), (3, True)])
def test_a_status_that_means_no_reading_is_invalid(status: int, valid: bool) -> None:
    line = pipeline(valid_status=(1, 3))
    (batch,) = line.feed(RX, packet(0, status=status), S)
    assert isinstance(batch, Batch)
    assert np.isfinite(batch.columns["displacement_m"]).tolist() == [valid] * 168

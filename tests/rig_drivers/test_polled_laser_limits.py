"""The pipeline of a polled displacement sensor at its limits, with every field of its samples and events."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from daq.items import RX, TX, Batch, DeviceEvent
from rig_drivers.polled_laser.settings import PolledLaser
from rig_drivers.polled_laser.stream import PolledPipeline

MS = 1_000_000
NO_LOSSES = dict.fromkeys(("samples", "damaged_lines", "unasked", "refused", "invalid"), 0)
Items = list[Batch | DeviceEvent]


def pipeline(**settings: Any) -> PolledPipeline:
    table = {"driver": "polled_laser", "port": "p", "axis": "x", "dialect": "LK-G", **settings}
    return PolledPipeline("gauge", PolledLaser.model_validate(table), {})


def batches(items: Items) -> list[Batch]:
    return [item for item in items if isinstance(item, Batch)]


def asked(line: PolledPipeline, answer: bytes, at_ns: int, request: bytes = b"M1\r") -> Items:
    """The items of a request and its answer 2 ms later."""
    return line.feed(TX, request, at_ns) + line.feed(RX, answer + b"\r", at_ns + 2 * MS)


@pytest.mark.parametrize(("text", "invalid"), [(b"+25.0000", 0), (b"-25.0000", 0), (b"+25.0001", 1), (b"-25.0001", 1)])
def test_the_end_of_the_range_is_a_reading(text: bytes, invalid: int) -> None:
    line = pipeline(range_m=0.025)
    for count in (1, 2):
        (batch,) = batches(asked(line, b"M1," + text, count * 10 * MS))
        assert np.isnan(batch.columns["displacement_m"]).tolist() == [bool(invalid)]
        assert line.losses == NO_LOSSES | {"invalid": invalid * count}


@pytest.mark.parametrize("other", [b"M0\r", b"M3\r", b"M1", b"M1\r\r", b"A\r", b"Z\r"])
def test_other_bytes_of_the_host_are_no_request(other: bytes) -> None:
    line = pipeline()
    assert line.feed(TX, other, 0) == []
    line.feed(TX, b"M1\r", 10 * MS)
    assert line.feed(TX, other, 12 * MS) == []
    (batch,) = batches(line.feed(RX, b"M1,+01.0000\r", 14 * MS))
    assert batch.time_ns.tolist() == [12 * MS]
    assert line.losses == NO_LOSSES

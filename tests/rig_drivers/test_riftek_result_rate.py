"""A sensor that streams at another rate than it was set to is noticed, also if its packets' numbers continue."""

from __future__ import annotations

import numpy as np
import pytest

from daq.items import RX, TX
from rig_drivers.riftek import wire
from rig_drivers.riftek.driver import DRIVER
from rig_drivers.riftek.settings import RiftekLaser

TABLE = RiftekLaser.model_validate(
    {"driver": "riftek", "port": "p", "axis": "x", "rate_Hz": 1000, "baud": 460_800, "range_m": 0.025}
)
T0 = 1_700_000_000_000_000_000


class Stream:
    """A pipeline and what arrives in it."""

    def __init__(self) -> None:
        self.pipeline = DRIVER.pipeline("x", TABLE, {})
        self._now_ns, self._number = T0, 0

    def run(self, seconds: float, rate_Hz: int, read_s: float = 0.02) -> str:
        for _ in range(round(seconds / read_s)):
            count = round(rate_Hz * read_s)
            numbers = self._number + np.arange(count)
            self._number += count
            self._now_ns += round(read_s * 1e9)
            self.pipeline.feed(RX, wire.results(np.full(count, 8000), numbers % 4), self._now_ns)
        return self.pipeline.status.set_up_lost

    def wait(self, seconds: float) -> None:
        self._now_ns += round(seconds * 1e9)

    def start(self) -> None:
        self.pipeline.feed(TX, wire.request(1, wire.START), self._now_ns)


@pytest.mark.parametrize("rate_Hz", [500, 2000])
def test_another_rate_is_a_sign_until_the_stream_is_started_again(rate_Hz: int) -> None:
    stream = Stream()
    assert stream.run(10.0, 1000) == ""
    assert stream.run(4.0, rate_Hz) == ""
    assert f"arrive {rate_Hz} times a second and it was set to 1000" in stream.run(6.0, rate_Hz)
    stream.start()
    assert stream.run(10.0, 1000) == ""


def test_what_a_suspended_host_reads_late_is_no_sign() -> None:
    stream = Stream()
    stream.run(5.0, 1000)
    stream.wait(20.0)
    stream.run(0.2, 100_000)  # the results of the suspension, at once
    assert stream.run(10.0, 1000) == ""


def test_a_gap_of_some_seconds_is_no_sign() -> None:
    stream = Stream()
    stream.run(5.0, 1000)
    stream.wait(4.0)
    assert stream.run(10.0, 1000) == ""

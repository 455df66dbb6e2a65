"""Any rate a model may have is set, refused by the sensor if it cannot, and read with exact losses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from pydantic import ValidationError

from daq.drivers.optoncdt import wire as optoncdt
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.optoncdt.stream import LaserPipeline
from daq.errors import DeviceError
from daq.items import RX, Batch
from tests.daq.hand_made_laser import HandMadeLaser
from tests.effort import cases

START_NS = 1_700_000_000_000_000_000
RATES_HZ = (
    10.0,
    250.0,
    300.0,
    333.3,
    375.0,
    1500.0,
    2500.0,
    4000.0,
    7500.0,
    10_000.0,
    20_000.0,
    30_000.0,
    49_020.0,
    50_000.0,
)


def laser(rate_Hz: float) -> LaserPipeline:
    config = Laser.model_validate({"driver": "optoncdt", "port": "p", "axis": "x", "rate_Hz": rate_Hz})
    return LaserPipeline("laser_x", config, {})


def blocks(counters: np.ndarray, rate_Hz: float, tick0: int = 0) -> bytes:
    ticks = tick0 + np.floor(counters * (1e5 / rate_Hz)).astype(np.int64)
    columns = [np.full(len(counters), 30_000), counters % optoncdt.COUNTER_WRAP, ticks & 0xFFFF, ticks >> 16 & 0xFFFF]
    return optoncdt.encode_block(np.column_stack(columns).astype(np.uint32))


@settings(max_examples=cases(20, 40), deadline=None)
@given(st.sampled_from(RATES_HZ), st.integers(300, 600), st.integers(0, 11))
def test_at_any_rate_a_lost_byte_costs_at_most_two_samples(rate_Hz: float, block: int, byte: int) -> None:
    counters = np.arange(1000)
    pipeline, wire = laser(rate_Hz), bytearray(blocks(counters, rate_Hz))
    del wire[12 * block + byte]
    found: list[int] = []
    for at in range(0, len(wire), 480):
        for item in pipeline.feed(RX, bytes(wire[at : at + 480]), START_NS + round(at / 12 / rate_Hz * 1e9)):
            if isinstance(item, Batch):
                found += item.columns["counter"].tolist()
    assert set(found) <= set(counters.tolist())
    assert len(found) + pipeline.losses["samples"] == 1000
    assert pipeline.losses["samples"] <= 2


# --- settings and set-up -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate_Hz", "text"), [(300.0, "0.3"), (1500, "1.5"), (7500.0, "7.5"), (49_020.0, "49.02"), (20_000, "20")]
)
def test_the_rate_is_commanded_in_kHz(rate_Hz: float, text: str) -> None:
    sensor = HandMadeLaser()
    sensor.set_up(rate_Hz=rate_Hz)
    assert f"MEASRATE {text}" in sensor.heard


def test_a_rate_the_sensor_has_not_is_refused_in_its_own_words() -> None:
    sensor = HandMadeLaser(answers={"MEASRATE": "E230 Unknown parameter"})
    with pytest.raises(DeviceError, match=r"laser_x: 'MEASRATE 7\.5' refused: E230 Unknown parameter\. .*Hz is 7500"):
        sensor.set_up(rate_Hz=7500)
    assert "OUTPUT RS422" not in sensor.heard


@pytest.mark.parametrize("rate_Hz", [0, -1.0, 0.1, 60_000, float("nan"), float("inf"), "4 kHz", True])
def test_an_invalid_rate_is_refused_by_the_rig_file(rate_Hz: object) -> None:
    with pytest.raises(ValidationError, match="rate_Hz"):
        Laser.model_validate({"driver": "optoncdt", "port": "p", "axis": "x", "rate_Hz": rate_Hz})

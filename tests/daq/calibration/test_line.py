"""The line through readings at known positions: its uncertainty covers the error, and wrong readings are named."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from daq.calibration.lengths import BadLength, positions_of
from daq.calibration.line import GaugeReading, TooFewPositions, fit_line
from daq.calibration.sensor import SensorSetup, calibrate, mean_with_std
from daq.drivers.optoncdt.settings import Laser
from rig_basics.arrays import Array
from tests.count_limits import share_limits
from tests.effort import cases

RANGE_M = 0.025
POSITIONS_M = np.linspace(-4e-3, 4e-3, 5)
SENSOR = Laser(driver="optoncdt", port="x", axis="x", rate_Hz=4000)


def readings(
    seed: int = 0,
    gain: float = 1.003,
    seat_m: float = 0.0,
    hysteresis_m: float = 0.0,
    cubic_m: float = 0.0,
    positions: Array = POSITIONS_M,
) -> list[GaugeReading]:
    """Readings up and down of blocks with errors of 1 µm and noise of 0.2 µm; the offset is 30 µm."""
    rng = np.random.default_rng(seed)
    errors = dict(zip(positions.tolist(), 1e-6 * rng.standard_normal(len(positions)), strict=True))
    found: list[GaugeReading] = []
    for k, position in enumerate([*positions.tolist(), *positions[::-1].tolist()]):
        target = position + errors[position] + seat_m * rng.standard_normal()
        play = hysteresis_m / 2 * (1 if k < len(positions) else -1)
        read = target / gain + 30e-6 + play + cubic_m * (position / 4e-3) ** 3 + 2e-7 * rng.standard_normal()
        found.append(GaugeReading(position, 1e-6, read, 2e-7))
    return found


@pytest.mark.parametrize(("seat_m", "count"), [(0.0, 5), (2e-6, 5), (2e-6, 3)])
def test_a_gain_that_is_off_by_3_per_mille_lies_in_95_per_cent_of_the_intervals(seat_m: float, count: int) -> None:
    hits, tried = np.zeros(2), cases(100, 200)
    for seed in range(tried):
        line = fit_line(readings(seed, seat_m=seat_m, positions=np.linspace(-4e-3, 4e-3, count)), RANGE_M)
        offset, std = line.offset_m(0.0)
        hits += abs(line.gain - 1.003) < 1.96 * line.gain_std, abs(offset + 1.003 * 30e-6) < 1.96 * std
        assert line.outlier is None
    fewest, most = share_limits(tried, 200, 0.92, 0.98)
    assert np.all((fewest <= hits / tried) & (hits / tried <= most))


def test_the_stated_uncertainty_of_the_blocks_alone_is_that_of_ordinary_least_squares() -> None:
    exact = [replace(r, reading_m=r.position_m, reading_std_m=0.0) for r in readings()]
    line = fit_line(exact, RANGE_M)
    assert (line.gain, line.scatter_m) == (pytest.approx(1.0, abs=1e-9), 0.0)
    assert line.gain_std == pytest.approx(1e-6 / math.sqrt(np.sum(POSITIONS_M**2)), rel=1e-3)


def test_hysteresis_is_measured_and_widens_the_uncertainty() -> None:
    found = [fit_line(readings(seed, hysteresis_m=4e-6), RANGE_M) for seed in range(20)]
    assert np.mean([line.hysteresis_m for line in found]) == pytest.approx(4e-6, rel=0.1)
    assert np.mean([line.gain_std for line in found]) > 1.3 * fit_line(readings(), RANGE_M).gain_std
    text = " ".join(calibrate(readings(hysteresis_m=4e-6), SENSOR, 0.003, SensorSetup()).warnings)
    assert "readings from below and above differ by +" in text


def test_a_curved_sensor_is_reported_and_its_gain_std_covers_the_gain_in_the_middle() -> None:
    found = calibrate(readings(cubic_m=20e-6), SENSOR, 0.001, SensorSetup())
    assert found.line.curved
    assert not fit_line(readings(), RANGE_M).curved
    assert any("not linear" in text for text in found.warnings)
    assert abs(found.line.gain - 1.003) < 1.96 * found.line.gain_std


def test_a_mistyped_block_is_named_and_refused() -> None:
    wrong = [replace(r, position_m=0.003) if r.position_m == 0.002 else r for r in readings()]
    (text,) = calibrate(wrong, SENSOR, 0.001, SensorSetup()).refusals
    assert text.startswith("reading 4 and 7 (position 3 mm) is +")
    assert "mistyped size" in text


def test_a_single_disturbed_reading_is_named() -> None:
    wrong = readings(3)
    wrong[6] = replace(wrong[6], reading_m=wrong[6].reading_m + 40e-6)
    line = fit_line(wrong, RANGE_M)
    assert line.outlier.numbers == (6,)
    assert line.outlier.off_m == pytest.approx(-40e-6, rel=0.1)


def test_a_swapped_sign_and_an_impossible_gain_are_refused_with_what_to_do() -> None:
    falling = [replace(r, position_m=-r.position_m) for r in readings()]
    assert "the reading falls where it should rise" in calibrate(falling, SENSOR, 0.001, SensorSetup()).refusals[0]
    assert "compare both with the sensor" in calibrate(readings(gain=1.5), SENSOR, 0.001, SensorSetup()).refusals[0]


def test_few_or_near_positions_are_refused_with_what_to_do() -> None:
    same = [replace(r, position_m=0.001) for r in readings()]
    with pytest.raises(TooFewPositions, match="at least two different positions, better five"):
        fit_line(same, RANGE_M)
    with pytest.raises(TooFewPositions, match="less than 5 % of the range of 25 mm"):
        fit_line(readings(positions=np.linspace(0, 1e-3, 5)), RANGE_M)
    vague = [replace(r, position_std_m=1e-4) for r in readings()]
    with pytest.raises(TooFewPositions, match="farther apart or better known"):
        fit_line(vague, RANGE_M)


def test_two_positions_yield_a_gain_and_a_warning() -> None:
    found = calibrate(readings(positions=np.array([-4e-3, 4e-3])), SENSOR, 0.003, SensorSetup())
    assert abs(found.line.gain - 1.003) < 4 * found.line.gain_std
    assert "few readings" in found.warnings[0]


def test_the_spread_of_parts_is_the_uncertainty_of_a_mean_also_with_a_slow_disturbance() -> None:
    rng = np.random.default_rng(1)
    slow = np.repeat(rng.standard_normal(50), 200)
    _, std = mean_with_std(slow)
    assert std == pytest.approx(1 / math.sqrt(50), rel=0.5)
    assert np.std(slow) / math.sqrt(len(slow)) < 0.1 * std


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2.000 mm ± 1 µm", [(0.002, 1e-6)]),
        ("-4, 0,4mm +- 0.5um", [(-0.004, 5e-7), (0.0, 5e-7), (0.004, 5e-7)]),
    ],
)
def test_lengths_are_read(text: str, expected: list[tuple[float, float]]) -> None:
    assert [(one.position_m, one.std_m) for one in positions_of(text)] == [pytest.approx(pair) for pair in expected]


@pytest.mark.parametrize(
    "text", ["", "2.000 mm", "2 ± 1", "2 mm ± 0 µm", "2 inch ± 1 µm", "2 mm ± 1 inch", "2000 mm ± 1 µm"]
)
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(BadLength, match="expected"):
        positions_of(text)

"""Readings of a sensor's column, checked: increasing times, plausible units, gaps and invalid readings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.exchange.columns import Column
from daq.exchange.errors import ExchangeError
from daq.exchange.units import UNITS, ColumnChoice, Quantity
from daq.log.time_span import LATEST_NS
from rig_basics.texts import number_of

LEAST_ROWS = 20
_SINCE_1970_S = 1e8  # three years: larger times do not count from the recording's own start
_MIN_RATE_HZ, _MAX_RATE_HZ = 10.0, 1e6  # of samples that can resolve this rig's motion
_UNIFORM_SHARE, _UNIFORM_STEP = 0.9, 0.1


@dataclass(frozen=True)
class Gap:
    """Gap in a uniformly sampled recording: time before it, number of missing samples, and duration."""

    after_ns: int
    samples: int
    span_s: float


@dataclass(frozen=True)
class SensorReadings:
    """Samples of one sensor.

    Attributes:
        time_ns: sample times, ns, strictly increasing, shape (n,); from the recording's own zero until `shifted`.
        value: readings in SI units, NaN if invalid, shape (n,).
        row: row in the file, counted from 0, shape (n,).
        invalid: number of readings that are NaN.
    """

    time_ns: NDArray[np.int64]
    value: NDArray[np.float64]
    row: NDArray[np.intp]
    invalid: int

    def within(self, begin_ns: int, end_ns: int) -> SensorReadings:
        """Return the readings from a beginning until before an end, ns on their own axis of times."""
        rows = slice(*np.searchsorted(self.time_ns, [begin_ns, end_ns]).tolist())
        value = self.value[rows]
        return SensorReadings(self.time_ns[rows], value, self.row[rows], int(np.count_nonzero(np.isnan(value))))

    def shifted(self, start_ns: int) -> SensorReadings:
        """Return the readings with times since 1970.

        Raises:
            ExchangeError: a time is before 1970 or after 2116.
        """
        time_ns = self.time_ns + start_ns
        if time_ns[0] < 0 or time_ns[-1] > LATEST_NS:
            raise ExchangeError(
                f"expected times from 1970 to 2116, got {time_ns[0] / 1e9:g} s to {time_ns[-1] / 1e9:g} s"
            )
        return replace(self, time_ns=time_ns)


def times_ns(column: Column, choice: ColumnChoice, field: str) -> NDArray[np.int64]:
    """Convert a time column to ns, shape (n,): exact for whole numbers, to the nearest ns otherwise.

    Raises:
        ExchangeError: a time is missing, not a number or too large, or not later than the one before it.
    """
    factor = choice.factor * 1e9
    bad = np.flatnonzero(column.absent | ~np.isfinite(column.values))
    if len(bad):
        raise ExchangeError(
            f"{field} {column.name}: {column.place(int(bad[0]))}: expected a time, got none; "
            f"{len(bad)} of {number_of(len(column.values), 'row')} without a time"
        )
    largest = float(np.max(np.abs(column.values.astype(np.float64)), initial=0.0))
    if largest * factor > LATEST_NS:
        raise ExchangeError(
            f"{field} {column.name}: expected times of less than 146 years, got {largest:g} {choice.unit}"
        )
    if column.values.dtype.kind == "i" and factor >= 1 and abs(factor - round(factor)) < 1e-6 * factor:
        time = column.values * np.int64(round(factor))
    else:
        time = np.rint(column.values * factor).astype(np.int64)
    _check_rising(time, column, choice, field)
    return time


def since_1970(time_ns: NDArray[np.int64]) -> bool:
    """Return True if times count from 1970: they are too large to count from the recording's start."""
    return bool(len(time_ns)) and float(time_ns[-1]) > _SINCE_1970_S * 1e9


def _check_rising(time: NDArray[np.int64], column: Column, choice: ColumnChoice, field: str) -> None:
    wrong = np.flatnonzero(np.diff(time) <= 0)
    if not len(wrong):
        return
    row = int(wrong[0]) + 1
    before, now = column.values[row - 1], column.values[row]
    what = "the same time again" if time[row] == time[row - 1] else "an earlier time"
    raise ExchangeError(
        f"{field} {column.name}: {column.place(row)}: expected a time after {before} {choice.unit}, got {what} "
        f"({now}); {number_of(len(wrong), 'row')} of {len(time)} not later than the row before. Sort the rows, remove "
        "repeated ones, or give the rate instead of the column of times"
    )


def read_sensor(
    column: Column, choice: ColumnChoice, time: Column, time_choice: ColumnChoice, invalid: Sequence[float], field: str
) -> SensorReadings:
    """Return a sensor's samples; rows without a value for it are omitted.

    Args:
        column, choice: its readings and their unit.
        time, time_choice: the times of all rows and their unit.
        invalid: values that mean "no reading", as in the file.
        field: field of the recipe that named the column, for messages.

    Raises:
        ExchangeError: different lengths, too few samples, or bad times.
    """
    if len(time.values) != len(column.values):
        raise ExchangeError(
            f"{field} {column.name}: expected as many values as there are times, got {len(column.values)} and "
            f"{len(time.values)}; name its own times: {column.name}:{choice.unit}@TIME:s"
        )
    value = column.values.astype(np.float64)
    no_time = time.absent | np.isnan(time.values.astype(np.float64))
    row = np.flatnonzero(~column.absent & ~(np.isnan(value) & no_time))  # a shorter column ends with empty rows
    if len(row) < LEAST_ROWS:
        raise ExchangeError(f"{field} {column.name}: expected at least {LEAST_ROWS} samples, got {len(row)}")
    time_ns = times_ns(time.keep(row), time_choice, "time")
    value = value[row]
    is_invalid = ~np.isfinite(value) | np.isin(value, np.asarray(invalid, float))
    if is_invalid.all():
        raise ExchangeError(f"{field} {column.name}: expected readings, every one of {len(row)} is invalid")
    with np.errstate(over="ignore"):  # an infinite value exceeds every limit
        value = np.where(is_invalid, np.nan, value * choice.factor)
    return SensorReadings(time_ns, value, row, int(np.count_nonzero(is_invalid)))


def find_gaps(time_ns: NDArray[np.int64]) -> list[Gap] | None:
    """Return the gaps of a uniformly sampled recording; None if it is not uniform."""
    steps = np.diff(time_ns).astype(np.float64)
    usual = float(np.median(steps))
    if np.mean(np.abs(steps - usual) <= _UNIFORM_STEP * usual) < _UNIFORM_SHARE:
        return None
    return [
        Gap(int(time_ns[i]), round(float(steps[i]) / usual) - 1, float(steps[i]) * 1e-9)
        for i in np.flatnonzero(steps > 1.5 * usual)
    ]


def check_rate(time_ns: NDArray[np.int64], choice: ColumnChoice | None, field: str) -> str | None:
    """Return a warning if the sampling rate is implausible."""
    rate = 1e9 / float(np.median(np.diff(time_ns)))
    if _MIN_RATE_HZ <= rate <= _MAX_RATE_HZ:
        return None
    span_s = (time_ns[-1] - time_ns[0]) * 1e-9
    text = f"{field}: sampled at {rate:.3g} Hz, {span_s:.3g} s long; is the unit of time right?"
    if choice is None:
        return text
    per_unit = rate * choice.factor
    times = UNITS["time"].items()
    meant = [unit for unit, factor in times if _MIN_RATE_HZ <= per_unit / factor <= _MAX_RATE_HZ / 10]
    return text + (f" Did you mean {' or '.join(meant)}?" if meant else "")


def check_size(
    readings: SensorReadings, choice: ColumnChoice, quantity: Quantity, limit: float, column: Column, field: str
) -> None:
    """Raise for readings ten times beyond the range of the sensor or the rig.

    Args:
        readings, choice, quantity, column, field: the readings, and how the column was named.
        limit: largest possible value, SI.

    Raises:
        ExchangeError: with the largest reading, and a unit in which all readings would be in range.
    """
    size = np.abs(np.nan_to_num(readings.value))
    worst = int(np.argmax(size))
    if size[worst] <= 10 * limit:
        return
    raw = float(size[worst]) / abs(choice.factor)
    typical = float(np.median(size)) / abs(choice.factor)
    words = UNITS[quantity]
    meant = next((unit for unit, factor in sorted(words.items(), key=lambda u: -u[1]) if raw * factor <= limit), None)
    value = column.values[readings.row[worst]]
    hint = f"did you mean {column.name}:{meant}?" if meant else "is the unit right?"
    if raw > 20 * typical and typical > 0:
        hint += f" Or does {value:g} mean that there was no reading (invalid = {value:g})?"
    raise ExchangeError(
        f"{field} {column.name}: expected readings within {limit:g} {_SI[quantity]}, got {size[worst]:g} "
        f"({value:g} {choice.unit} in {column.place(int(readings.row[worst]))}); {hint}"
    )


def check_small(readings: SensorReadings, least: float, field: str, what: str) -> str | None:
    """Return a warning if all readings are smaller than a sensor can resolve."""
    span = float(np.nanmax(readings.value) - np.nanmin(readings.value))
    if span >= least:
        return None
    return f"{field}: the readings span {span:.3g} {what} only; is the unit right, and was the sensor connected?"


_SI: dict[Quantity, str] = {"time": "s", "length": "m", "angle": "rad", "speed": "rad/s"}


def unwrapped(angle: NDArray[np.float64]) -> NDArray[Any]:
    """Remove jumps of whole turns from angles, shape (n,), rad; NaN stays NaN; unchanged without jumps."""
    good = np.isfinite(angle)
    out = angle.copy()
    if np.any(np.abs(np.diff(angle[good])) > math.pi):
        out[good] = np.unwrap(angle[good])
    return out

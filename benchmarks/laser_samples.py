"""Laser samples as a rig at rest and in a slow ring-down gives them, for benchmarks of logs.

Not a flattering ramp: optoNCDT bytes of a noisy signal go through the real decoder and clock mapping, read by read,
so code, counter, sensor ticks, mapped time and host time are as in a recording.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq import channels
from daq.drivers.optoncdt import distance_words, wire as optoncdt
from daq.drivers.optoncdt.stream import LaserPipeline
from daq.items import RX, Batch
from rig_configs import load_rig

RATE_HZ = 4000.0
NOISE_M = 4e-6
START_NS = 1_767_225_600_000_000_000
_SENSOR_PPM = 11.0  # how much too fast the sensor's clock runs


@dataclass(frozen=True)
class LaserSamples:
    """n samples: host and sample times, ns; device counters; the fields of laser/x; each (n,)."""

    log_time_ns: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    sequence: NDArray[np.uint32]
    columns: dict[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.time_ns)

    def __getitem__(self, part: slice) -> LaserSamples:
        columns = {name: column[part] for name, column in self.columns.items()}
        return LaserSamples(self.log_time_ns[part], self.time_ns[part], self.sequence[part], columns)

    def blocks(self, size: int) -> Iterator[LaserSamples]:
        """Consecutive parts of `size` samples."""
        for first in range(0, len(self), size):
            yield self[first : first + size]

    def messages(self) -> NDArray[Any]:
        """As messages of laser/x."""
        return channels.LASER_X.pack(self.columns)


def laser_reads(count: int, seed: int = 1) -> Iterator[tuple[bytes, int]]:
    """Reads of 2 … 50 ms of a laser: bytes and when they were read, ns since 1970."""
    rng = np.random.default_rng(seed)
    number = np.arange(count)
    time_s = number / RATE_HZ
    ring_down = 1e-3 * np.exp(-time_s / 40.0) * np.sin(2 * np.pi * 1.9 * time_s)
    codes = distance_words.code(0.0125 + ring_down + NOISE_M * rng.standard_normal(count), 0.025)
    ticks = np.rint(time_s * (1 + 1e-6 * _SENSOR_PPM) / optoncdt.TICK_S).astype(np.int64) + 123_456
    words = np.column_stack([codes, number % optoncdt.COUNTER_WRAP, ticks & 0xFFFF, ticks >> 16 & 0xFFFF]).astype(
        np.uint32
    )
    first = 0
    while first < count:
        last = min(count, first + int(rng.integers(8, 201)))
        late_s = 0.2e-3 + rng.exponential(0.3e-3)
        yield optoncdt.encode_block(words[first:last]), START_NS + round(1e9 * (time_s[last - 1] + late_s))
        first = last


def laser_samples(count: int, seed: int = 1) -> LaserSamples:
    """Samples of a laser at 4 kHz, decoded from its bytes."""
    pipeline = LaserPipeline("laser_x", load_rig("virtual").devices["laser_x"], {})
    batches: list[Batch] = []
    log_times: list[NDArray[np.int64]] = []
    for data, host_ns in laser_reads(count, seed):
        for item in pipeline.feed(RX, data, host_ns):
            if isinstance(item, Batch):
                batches.append(item)
                log_times.append(np.full(len(item.time_ns), host_ns, np.int64))
    return LaserSamples(
        np.concatenate(log_times),
        np.concatenate([batch.time_ns for batch in batches]),
        np.concatenate([batch.sequence for batch in batches]),
        {name: np.concatenate([batch.columns[name] for batch in batches]) for name in channels.LASER_X.names},
    )

"""Which devices are read with pauses, and which arrival by arrival."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, count, islice

import numpy as np
import pytest

from daq.acquisition.reader import DeviceReader, Pause
from daq.transports import HostClock


class _Time(HostClock):
    """Clock that the test sets."""

    def __init__(self) -> None:
        super().__init__()
        self.at_s = 0.0

    def now_s(self) -> float:
        return self.at_s


class _Silent:
    """Link that the generator of waits never touches."""


def read(arrivals: Iterator[float], until_s: float) -> tuple[int, list[float]]:
    """Number of pauses, and how much later than its last byte each take is stamped, s."""
    clock, paused, late = _Time(), 0, list[float]()
    reader = DeviceReader("sensor", _Silent(), clock)  # pyright: ignore[reportArgumentType]  # never read
    last, due = 0.0, next(arrivals)

    def take(_: object, data: bytes, __: int) -> None:
        late.extend([clock.at_s - last] if data else [])

    waits = reader.waits(take)
    wanted = next(waits)
    while clock.at_s < until_s:
        end, data = clock.at_s + wanted.seconds, b""
        if isinstance(wanted, Pause):
            paused, clock.at_s = paused + 1, end
        else:
            clock.at_s = max(clock.at_s, min(due, end))
            while due <= clock.at_s:
                data, last, due = data + b"x", due, next(arrivals)
        wanted = waits.send(data)
    return paused, late


def every(period_s: float, parts: int = 1, apart_s: float = 0.001) -> Iterator[float]:
    """Packets at a period, each in several parts."""
    return (k * period_s + part * apart_s for k in count(1) for part in range(parts))


@pytest.mark.parametrize(
    ("period_s", "parts"), [(0.02, 1), (0.02, 4), (0.013, 1), (0.007, 2), (0.05, 12), (0.05, 9), (0.1, 3), (0.011, 3)]
)
def test_packets_are_stamped_when_they_arrive(period_s: float, parts: int) -> None:
    """A pause in which a packet ends stamps it 5 ms late; then arrivals are taken one by one."""
    _, late = read(every(period_s, parts), 10.0)
    assert np.mean(np.array(late[10:]) > 1e-3) < 0.02


def test_a_quick_sender_that_a_busy_host_holds_up_is_read_with_pauses() -> None:
    """Every fifth of its bytes is 3 ms late: 65 pauses a second without that, none if five in a row are too few."""
    paused, _ = read((0.004 * k + 0.003 * (k % 5 == 0) for k in count(1)), 10.0)
    assert paused > 10.0 * 40


def test_a_stream_after_a_long_silence_is_read_with_pauses() -> None:
    packets = islice(every(0.05, 9), 900)
    paused, _ = read(chain(packets, (100.0 + 0.002 * k for k in count())), 105.0)
    assert paused > 4.0 * 40 + 5

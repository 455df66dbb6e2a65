"""Time-outs of a session on a host that is busy or stalled."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from daq.acquisition.session import Session
from daq.errors import DeviceError
from daq.transports import HostClock
from rig_configs import load_rig


class Waits(HostClock):
    """A clock that advances by given times, s, one for each wait; the last one is repeated."""

    def __init__(self, *seconds: float) -> None:
        super().__init__()
        self._of, self._at_s, self.waits = seconds, 100.0, 0

    def now_ns(self) -> int:
        return round(self._at_s * 1e9)

    def wait(self, seconds: float) -> None:
        self._at_s += self._of[min(self.waits, len(self._of) - 1)]
        self.waits += 1


def true_from(evaluation: int) -> Iterator[bool]:
    yield from (k >= evaluation for k in range(1, 10_000))


def test_a_host_that_stalls_for_longer_than_a_time_out_does_not_blame_the_devices() -> None:
    clock, answers = Waits(0.003, 5.0, 0.003, 60.0, 0.003), true_from(100)
    Session(load_rig("virtual"), clock).wait_for(lambda: next(answers), 1.0, "samples")
    assert clock.waits == 99


@pytest.mark.parametrize(("seconds", "waits"), [(0.003, 334), (0.19, 6), (0.24, 5), (5.0, 5)])
def test_a_busy_host_has_its_time_outs(seconds: float, waits: int) -> None:
    """A wait counts up to a quarter of a second."""
    clock = Waits(seconds)
    with pytest.raises(DeviceError, match=r"waited 1 s for samples: timeout"):
        Session(load_rig("virtual"), clock).wait_for(lambda: False, 1.0, "samples")
    assert clock.waits == waits

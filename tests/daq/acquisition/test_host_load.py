"""A host that is late is named before a device is."""

from __future__ import annotations

from hypothesis import given, strategies as st

from daq.acquisition.core import Core, DriveState
from daq.acquisition.host_load import HostLoad

SECOND = 1_000_000_000


def ticked(*gaps_s: float) -> tuple[HostLoad, int]:
    load, now_ns = HostLoad(0.1), 10**18
    load.tick(now_ns)
    for gap_s in gaps_s:
        now_ns += round(gap_s * SECOND)
        load.tick(now_ns)
    return load, now_ns


@given(st.lists(st.floats(0.05, 0.38), max_size=100))
def test_a_host_that_keeps_up_is_no_excuse(gaps_s: list[float]) -> None:
    load, now_ns = ticked(*gaps_s)
    assert load.words(now_ns) == ""


def test_a_late_tick_is_named_until_it_is_old() -> None:
    load, now_ns = ticked(0.1, 1.3, *[0.1] * 20)
    assert "late by up to 1.2 s" in load.words(now_ns)
    for _ in range(100):
        now_ns += round(0.1 * SECOND)
        load.tick(now_ns)
    assert load.words(now_ns) == ""


def test_a_tick_that_is_still_missing_counts() -> None:
    load, now_ns = ticked(0.1)
    assert "late by up to 2.0 s" in load.words(now_ns + round(2.1 * SECOND))


def test_a_drop_out_of_a_late_host_is_not_blamed_on_the_drive() -> None:
    state = DriveState(True, "FAULT", "; emergency 0x8130")
    assert "Look at the events of the log and at the drive" in str(Core.dropped_out(state, ""))
    load, now_ns = ticked(0.1, 1.0)
    late = str(Core.dropped_out(state, load.words(now_ns)))
    assert "This host was late by up to 0.9 s" in late
    assert "at the drive" not in late

"""Every row of the interlock table trips in its scenario; code, table and documentation agree."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from daq.acquisition.interlock_table import CHANNELS, INTERLOCKS, SESSION, interlock
from daq.drivers.optoncdt import distance_words
from daq.items import DeviceEvent
from rig_configs import load_rig
from rig_configs.roles import Roles
from rig_configs.schema import Limits
from tests.daq.far_ends import Bench

ROOT = Path(__file__).parents[3]
Scenario = Callable[[Bench], None]


def fails(device: str, what: str, value: float = 1) -> Scenario:
    return lambda bench: bench.fails(device, what, value)


def mutes(device: str) -> Scenario:
    return lambda bench: bench.muted.add(device)


def happens(event: DeviceEvent) -> Scenario:
    return lambda bench: bench._heed(bench.interlocks.happened(event))


def swings_out_of_sight(bench: Bench) -> None:
    """Measured at 9 mm, then invalid for less time than the blind-sensor interlock needs."""
    sensor = bench.rig.roles.along("x")
    seen = distance_words.code([0.5 * sensor.range_m + 9e-3 * sensor.lever_ratio], sensor.range_m)
    bench.fails("laser_x", "code", int(seen[0]))
    bench.pass_time(0.06)
    bench.fails("laser_x", "code", 262076)


def hangs_with_its_neighbour(bench: Bench) -> None:
    for laser in ("laser_x", "laser_y"):
        bench.fails(laser, "code", 33_000)


def slips_in_its_lock(bench: Bench) -> None:
    bench.node._offset_counts[0] += 8.0 / 360.0 * bench.rig.devices["encoder"].counts_per_revolution


def nothing(bench: Bench) -> None:
    """Do nothing: the limit is exceeded without a fault."""


SCENARIOS: dict[str, tuple[Scenario, tuple[str, ...]]] = {
    "amplitude": (nothing, ("limits.amplitude_m=0.0001",)),
    "out of sight": (swings_out_of_sight, ()),
    "blind sensor": (fails("laser_y", "code", 262076), ()),
    "stuck sensor": (fails("laser_x", "code", 33_000), ()),
    "no motion": (hangs_with_its_neighbour, ()),
    "silent displacement": (mutes("laser_x"), ()),
    "silent angles": (fails("encoder", "dead"), ()),
    "silent speed": (fails("drive", "silent reports"), ()),
    "no index mark": (fails("encoder", "marks lost"), ()),
    "encoder fault": (fails("encoder", "flags", 2), ()),
    "loose lock": (slips_in_its_lock, ()),
    "lock fault": (lambda bench: bench._hear("encoder", bench.node._lock_event(bench.now_s, 1, 3, 7) or b""), ()),
    "overspeed": (nothing, ("limits.speed_rpm=500",)),
    "runaway": (fails("drive", "speed", 1100), ()),
    "speed disagreement": (fails("drive", "reported share", 0.5), ()),
    "restart": (fails("drive", "restart"), ()),
    "fault": (happens(DeviceEvent("fault", "drive", "the rotor does not follow")), ()),
    "left operation": (fails("drive", "network", 0x04), ()),
}
"""Fault that trips each row at 600 rpm, and the settings of the limits."""


@pytest.mark.parametrize("row", CHANNELS, ids=lambda row: row.name)
def test_every_row_trips_and_is_named(row) -> None:
    assert row.name in SCENARIOS, f"{row.name}: no scenario trips it"
    scenario, settings = SCENARIOS[row.name]
    with Bench(*settings) as bench:
        bench.turn(600)
        scenario(bench)
        bench.pass_time(4.0)
        named = [stop.interlock for _, stop in bench.stops]
    assert row.name in named
    assert {interlock(name).judge for name in named} == {"channels"}  # every name is that of a row


def test_every_scenario_is_of_a_row() -> None:
    assert set(SCENARIOS) == {row.name for row in CHANNELS}


def test_rows_have_unique_names_and_no_empty_columns() -> None:
    assert len({row.name for row in INTERLOCKS}) == len(INTERLOCKS) == len(CHANNELS) + len(SESSION)
    for row in INTERLOCKS:
        assert all((row.name, row.guards, row.threshold, row.source, row.deadline, row.reaction))
        assert ("limits." in row.threshold) == ("limits." in row.source)


def test_a_threshold_shows_the_rig_s_own_limit() -> None:
    limits = Limits(amplitude_m=0.004, speed_rpm=900)
    assert interlock("amplitude").threshold_of(limits).startswith("4 mm")
    assert "beyond 900 rpm" in interlock("overspeed").threshold_of(limits)


def test_a_row_requires_its_role() -> None:
    whole, hand, none = load_rig("virtual").roles, load_rig("by_hand").roles, Roles()
    assert [row.name for row in CHANNELS if not row.has_role(whole)] == []
    assert not interlock("runaway").has_role(hand)
    assert interlock("no index mark").has_role(hand)
    assert {row.name for row in CHANNELS if row.has_role(none)} == {"restart", "fault"}
    assert not interlock("stuck sensor").has_role(load_rig("one_laser").roles)


def test_the_documents_show_the_table() -> None:
    page = (ROOT / "docs" / "interlocks.md").read_text(encoding="utf-8")
    lines = re.findall(r"^\| (.*) \|$", page, re.MULTILINE)
    shown = [tuple(cell.strip() for cell in line.split(" | ")) for line in lines]
    there = [cells for cells in shown if cells[0] in {row.name for row in INTERLOCKS}]
    assert there == [
        (row.name, row.guards, row.threshold, row.source, row.deadline, row.reaction, row.role or "—")
        for row in INTERLOCKS
    ]

"""Distances to limits from signals that are known, and lamps with memory."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from daq.acquisition.interlock_table import INTERLOCKS
from daq.channels import ENCODER_FAULT_A, LOCKS_CLOSED
from live.limits import Distance, Lamps, distances
from live.signals import Signals
from rig_configs import load_rig

RIG = load_rig("virtual")
SECOND = 1_000_000_000


def _signals(seconds: float = 3.0, rpm: float = 600.0, target: float = 600.0, mm: float = 2.0) -> Signals:
    """x of 2 mm, y of 1 mm, a rotor that turns evenly."""
    signals = Signals(RIG, 0)
    time = np.arange(0, int(seconds * SECOND), SECOND // 1000)
    for topic, size in (("laser/x", mm), ("laser/y", mm / 2)):
        swing = 1e-3 * size * np.sin(2 * np.pi * rpm / 60 * time * 1e-9)
        signals.feed(topic, time, {"displacement_m": swing, "flags": np.zeros(len(time), np.uint32)})
    angles = np.zeros(len(time))
    flags = np.full(len(time), LOCKS_CLOSED, np.uint32)
    signals.feed("pendulums", time, {"theta3_rad": angles, "theta4_rad": angles + np.pi, "flags": flags})
    slow = time[::10]
    signals.feed("motor", slow, {"speed_rpm": np.full(len(slow), rpm), "target_rpm": np.full(len(slow), target)})
    marks = np.arange(0, int(seconds * SECOND), int(60 / rpm * SECOND))
    signals.feed("tacho", marks, {"revolutions": np.arange(len(marks), dtype=np.uint32)})
    return signals


def _by_what(signals: Signals, at_s: float, heard_s: float, **more: Any) -> dict[str, Distance]:
    return {found.what: found for found in distances(signals, at_s, heard_s, **more)}


def test_distances_follow_from_the_signals() -> None:
    found = _by_what(_signals(), 2.9, 2.95, disk={"backlog_bytes": 32e6})
    assert found["|x|, last 1 s"].value == pytest.approx(2.0, rel=1e-3)
    assert found["|x|, last 1 s"].used == pytest.approx(2 / 11, rel=1e-3)
    assert found["|y|, last 1 s"].value == pytest.approx(1.0, rel=1e-3)
    assert found["speed"].value == pytest.approx(600)
    assert found["speed"].limit == pytest.approx(1.05 * RIG.limits.speed_rpm + 10)
    assert found["beyond its command"].value == 0
    assert found["drive against index marks"].value == pytest.approx(0, abs=1e-6)
    assert found["x: no sample for"].value == pytest.approx(0.05, abs=0.002)
    assert found["x: no sample for"].limit == pytest.approx(0.6)
    assert found["log behind"].used == 0.5
    assert all(math.isfinite(each.used) for each in found.values())
    assert {each.interlock for each in found.values()} <= {row.name for row in INTERLOCKS}


def test_a_silent_sensor_comes_nearer_to_its_limit_while_it_is_silent() -> None:
    signals = _signals()
    ages = [_by_what(signals, at_s, at_s)["x: no sample for"].used for at_s in (2.99, 3.3, 3.7)]
    assert ages == sorted(ages)
    assert ages[0] < 0.1 < ages[1] < 1 < ages[2]


def test_a_slower_command_is_no_runaway_and_a_faster_rotor_is_one() -> None:
    assert _by_what(_signals(target=0.0), 2.9, 2.9)["beyond its command"].value == 0
    signals = _signals(seconds=1.0)
    time = SECOND + np.arange(0, SECOND, SECOND // 100)
    rising = {"speed_rpm": 600 + 300 * (time - SECOND) / SECOND, "target_rpm": np.full(len(time), 600.0)}
    signals.feed("motor", time, rising)
    assert _by_what(signals, 1.99, 1.99)["beyond its command"].value == pytest.approx(297, abs=4)
    assert _by_what(signals, 1.99, 1.99)["beyond its command"].used > 1


def test_a_rotor_that_is_braked_does_not_disagree_with_its_marks() -> None:
    signals = Signals(RIG, 0)
    time = np.arange(0, 2 * SECOND, SECOND // 100)
    rpm = 600 - 250 * time / SECOND
    signals.feed("motor", time, {"speed_rpm": rpm, "target_rpm": np.zeros(len(time))})
    turns = np.cumsum(rpm) / 6000
    marks = np.array([time[np.searchsorted(turns, n)] for n in range(1, int(turns[-1]))])
    signals.feed("tacho", marks, {"revolutions": np.arange(len(marks), dtype=np.uint32)})
    for at_s in (0.5, 1.0, 1.9):
        assert _by_what(signals, at_s, at_s)["drive against index marks"].used < 0.1
    faster = {"speed_rpm": np.full(50, 600.0), "target_rpm": np.zeros(50)}
    signals.feed("motor", 2 * SECOND + time[:50], faster)
    signals.feed("tacho", np.array([2 * SECOND + 450_000_000]), {"revolutions": np.array([len(marks)], np.uint32)})
    assert _by_what(signals, 2.46, 2.46)["drive against index marks"].used > 0.3


def test_invalid_and_faulty_samples_count() -> None:
    signals = _signals(seconds=1.0)
    time = SECOND + np.arange(0, SECOND // 4, SECOND // 1000)
    half = np.where(np.arange(len(time)) % 2 == 0, np.nan, 0.0)
    signals.feed("laser/x", time, {"displacement_m": half, "flags": np.zeros(len(time), np.uint32)})
    flags = np.full(len(time), ENCODER_FAULT_A, np.uint32)
    signals.feed("pendulums", time, {"theta3_rad": half, "theta4_rad": half, "flags": flags})
    found = _by_what(signals, 1.25, 1.25)
    assert found["x: invalid samples"].value == pytest.approx(50, abs=1)
    assert found["angles: samples with a fault"].value == 100
    assert signals.locked(1.25) is False
    assert signals.locked(0.9) is True


def _beyond(used: float) -> Distance:
    return Distance("amplitude", "|x|", used, 1.0, "mm")


def test_a_lamp_that_recovered_stays_listed() -> None:
    lamps = Lamps(_signals())
    states: list[str] = []
    for at_s, used in enumerate([0.1, 0.85, 1.2, 0.5, 0.1, math.nan]):
        lamps.look(float(at_s), [_beyond(used)], [])
        states.append(lamps.all["amplitude"].state)
    assert states == ["quiet", "near", "beyond", "recovered", "recovered", "recovered"]
    assert "1.2 of 1 mm" in lamps.all["amplitude"].text


def test_a_trip_stays_and_seeking_back_resets_it() -> None:
    lamps = Lamps(_signals())
    trip = {"kind": "trip", "at_s": 4.0, "number": 0, "reasons": [{"interlock": "overspeed", "text": "1300 rpm"}]}
    lamps.look(5.0, [], [trip])
    lamps.look(6.0, [Distance("overspeed", "speed", 0.1, 1.0, "rpm")], [trip])
    assert (lamps.all["overspeed"].state, lamps.all["overspeed"].text) == ("tripped", "1300 rpm")
    lamps.look(1.0, [], [])
    assert lamps.all["overspeed"].state == "quiet"


def test_a_device_that_was_gone_and_is_back_is_recovered() -> None:
    lamps = Lamps(_signals())
    gone = {"kind": "gone", "at_s": 1.0, "number": 0, "text": "laser_x: unplugged"}
    back = {"kind": "back", "at_s": 2.0, "number": 1, "text": "laser_x: streams again"}
    lamps.look(1.5, [], [gone])
    assert lamps.all["lost device"].state == "beyond"
    lamps.look(2.5, [], [gone, back])
    assert (lamps.all["lost device"].state, lamps.all["lost device"].text) == ("recovered", "laser_x: streams again")


def test_only_interlocks_that_the_rig_has_are_listed() -> None:
    by_hand = load_rig("by_hand")
    assert "runaway" not in Lamps(Signals(by_hand, 0)).all
    assert set(Lamps(_signals()).all) == {row.name for row in INTERLOCKS if row.has_role(RIG.roles)}


def test_the_index_marks_give_the_speed_and_the_drive_only_after_they_ceased() -> None:
    """A drive with a wrong number of pole pairs reports 476 rpm of a rotor that turns at 544."""
    signals = Signals(RIG, 0)
    marks = np.arange(0, 3 * SECOND, round(60 / 544 * SECOND))
    reports = np.arange(0, 6 * SECOND, SECOND // 100)
    signals.feed("tacho", marks, {"revolutions": np.arange(len(marks))})
    signals.feed(
        "motor", reports, {"speed_rpm": np.full(len(reports), 476.0), "target_rpm": np.full(len(reports), 476.0)}
    )
    assert signals.rpm(2.5) == pytest.approx(544, rel=1e-6)
    assert signals.rpm(5.9) == 476.0
    assert np.isnan(signals.rpm(9.0))

"""A trip is one event with all reasons of a short time and a bounded excerpt that keeps peaks and gaps."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from daq import channels
from daq.acquisition.recent import Recent
from daq.acquisition.trips import POINTS, Reason, Trips, kept_rows
from daq.channels import LASER_X
from daq.items import Batch, DeviceEvent

T0 = 1_700_000_000_000_000_000
S = 1_000_000_000


def made(*found: tuple[str, str, float]) -> Trips:
    """Trips with findings: interlock, text, and seconds after T0."""
    trips = Trips(channels.CHANNELS.values())
    for interlock, text, after_s in found:
        trips.tripped(Reason(interlock, text, T0 + round(after_s * S), 601.5))
    return trips


def laser(start_ns: int, seconds: float, displacement_m: np.ndarray | None = None) -> Batch:
    n = round(4000 * seconds)
    k = np.arange(n)
    seen = 1e-3 * np.sin(0.05 * k) if displacement_m is None else displacement_m
    columns = {
        "displacement_m": seen,
        "code": 30_000 + k % 7,
        "counter": k,
        "device_ticks": 25 * k,
        "flags": np.zeros(n, np.uint32),
    }
    return Batch(LASER_X, start_ns + 250_000 * k, k.astype(np.uint32), columns)


def only(events: list[DeviceEvent]) -> DeviceEvent:
    (event,) = events
    assert (event.kind, event.device) == ("trip", "host")
    return event


def test_the_event_waits_for_the_second_behind_it_and_comes_once() -> None:
    trips, recent = made(), Recent(10.0)
    recent.add(laser(T0 - 3 * S, 5.0))
    assert trips.tick(T0, recent) == trips.end(T0, recent) == []
    trips = made(("amplitude", "laser/x: 12.1 mm", 0.0))
    assert trips.tick(T0 + S, recent) == []
    event = only(trips.tick(T0 + 2 * S, recent))
    times = event.facts["excerpt"]["laser/x"]["displacement_m"]["t_ms"]
    assert (min(times), max(times)) == (pytest.approx(-1000, abs=20), pytest.approx(1000, abs=20))
    assert (event.facts["time_ns"], event.facts["until_ms"], event.facts["speed_rpm"]) == (T0, 1000.0, 601.5)
    trips.tripped(Reason("blind sensor", "laser/y: nothing", T0 + 3 * S))
    assert trips.tick(T0 + 9 * S, recent) == trips.end(T0 + 9 * S, recent) == []
    assert [reason.interlock for reason in trips.reasons] == ["amplitude"]


def test_a_log_that_ends_sooner_has_the_trip_as_far_as_it_goes() -> None:
    trips, recent = made(("amplitude", "laser/x: 12.1 mm", 0.0)), Recent(10.0)
    recent.add(laser(T0 - S // 2, 1.0))
    event = only(trips.end(T0 + S // 4, recent))
    times = event.facts["excerpt"]["laser/x"]["displacement_m"]["t_ms"]
    assert (min(times), max(times)) == (pytest.approx(-500, abs=20), pytest.approx(250, abs=20))
    assert event.facts["until_ms"] == 250.0
    assert trips.end(T0 + S, recent) == []


def test_all_that_came_together_is_named_and_what_came_later_is_listed() -> None:
    trips = made(
        ("amplitude", "laser/x: 12.1 mm, limits.amplitude_m is 11 mm", 0.0),
        ("amplitude", "laser/x: 12.4 mm, limits.amplitude_m is 11 mm", 0.02),  # the same, again
        ("amplitude", "laser/y: 11.9 mm, limits.amplitude_m is 11 mm", 0.1),
        ("runaway", "the drive reports 700 rpm, 600 rpm were commanded", 0.3),
        ("silent angles", "pendulums: silent for 1.4 s", 0.4),
        ("silent angles", "pendulums: silent for 1.5 s", 0.5),
    )
    event = only(trips.end(T0 + S, Recent(10.0)))
    assert event.facts["interlocks"] == ["amplitude", "runaway"]
    assert [(r["text"][:13], r["after_ms"]) for r in event.facts["reasons"]] == [
        ("laser/x: 12.1", 0.0),
        ("laser/y: 11.9", 100.0),
        ("the drive rep", 300.0),
    ]
    assert event.facts["later"] == ["silent angles"]
    assert event.text.startswith("amplitude, runaway: laser/x: 12.1 mm")
    assert "; also the drive reports 700 rpm" in event.text
    assert [reason.text for reason in trips.reasons] == [r["text"] for r in event.facts["reasons"]]


@given(st.integers(0, 9000), st.integers(1, 300), st.integers(0, 2**31))
def test_the_excerpt_is_bounded_and_is_json_and_keeps_peaks_and_gaps(n: int, none: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    seen = rng.standard_normal(8000) * 1e-3
    seen[n : n + none] = np.nan
    trips, recent = made(("blind sensor", "laser/x: nothing", 0.0)), Recent(10.0)
    recent.add(laser(T0 - S, 2.0, seen))
    event = only(trips.end(T0 + S, recent))
    packed = channels.pack_note({"kind": event.kind, "device": "host", "text": event.text, **event.facts})
    assert len(packed) < 16_000
    series = json.loads(packed)["excerpt"]["laser/x"]["displacement_m"]
    assert len(series["value"]) == len(series["t_ms"]) <= POINTS
    assert series["t_ms"] == sorted(series["t_ms"])
    numbers = [value for value in series["value"] if value is not None]
    assert max(numbers) == pytest.approx(np.nanmax(seen), rel=1e-5)
    assert min(numbers) == pytest.approx(np.nanmin(seen), rel=1e-5)
    assert (None in series["value"]) == bool(np.isnan(seen).any())
    assert event.facts["excerpt"]["laser/x"]["counter"]["value"] == [0, 7999]  # a counter is reduced to its ends
    assert event.facts["excerpt"]["laser/x"]["flags"]["value"] == [0, 0]


VALUES = arrays(np.float64, st.integers(1, 700), elements=st.floats(-1e3, 1e3) | st.just(np.nan))


@given(VALUES)
def test_kept_rows_are_few_and_ascend_and_hold_the_extremes(values: np.ndarray) -> None:
    rows = kept_rows(values)
    assert len(rows) <= max(POINTS, 2)
    assert np.all(np.diff(rows) > 0)
    assert rows[0] >= 0
    assert rows[-1] < len(values)
    if not np.isnan(values).all():
        assert np.nanmax(values[rows]) == np.nanmax(values)
        assert np.nanmin(values[rows]) == np.nanmin(values)
    assert np.isnan(values[rows]).any() == np.isnan(values).any()

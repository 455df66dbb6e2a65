"""Pipeline of an RF60x sensor on Ethernet at its limits: other sensors, damage, long losses, single results."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from daq.items import RX, Batch, DeviceEvent
from rig_drivers.riftek_ethernet.stream import RiftekEthernetPipeline
from tests.rig_drivers.test_riftek_ethernet import S, at, kinds, packet, pipeline, settings

Items = list[Batch | DeviceEvent]
DAMAGE = "bytes skipped that belong to no packet of a sensor with a range of 25 mm"
EXPECTED = "expected packets of a sensor with a range of 25 mm, got"


def with_identity(identity: dict[str, Any], **more: Any) -> RiftekEthernetPipeline:
    return RiftekEthernetPipeline("laser", settings(**more), identity)


def events(items: Items) -> list[DeviceEvent]:
    return [item for item in items if isinstance(item, DeviceEvent)]


def batches(items: Items) -> list[Batch]:
    return [item for item in items if isinstance(item, Batch)]


@pytest.mark.parametrize("other", [677, 679])
def test_packets_of_another_sensor_are_a_fault_after_a_silence_of_one_second(other: int) -> None:
    for host_ns, found in ((999_999_999, "damage"), (1_000_000_000, "fault")):
        line = pipeline(serial=678)
        assert kinds(line.feed(RX, packet(0, serial=other), 0)) == ["damage"]
        assert (line.status.has_reported, line.losses["bytes"]) == (False, 512)
        assert kinds(line.feed(RX, packet(1, serial=other), host_ns)) == [found]
        assert line.losses["samples"] == 0
    assert line.status.complaint == (
        f"expected serial number 678, that of the rig file or of the sensor before, got packets of sensor {other}: "
        "look at its address"
    )
    (batch,) = line.feed(RX, packet(2, serial=678), 2 * S)
    assert isinstance(batch, Batch)
    assert line.status.complaint == ""


def test_packets_of_another_sensor_do_not_hide_those_read_with_them() -> None:
    line = pipeline(serial=678)
    others = [packet(number, serial=677) for number in range(3)]
    found = line.feed(RX, b"".join([packet(0, serial=678), *others, packet(1, serial=678)]), 0)
    assert len(batches(found)) == 2
    assert line.losses["bytes"] == 3 * 512


def test_of_a_slow_sensor_the_silence_is_that_of_four_packets() -> None:
    """At 80 Hz a packet lasts 2.1 s."""
    for later_ns, is_fault in ((8_399_999_999, False), (8_400_000_000, True)):
        line = pipeline(rate_Hz=80.0)
        assert len(batches(line.feed(RX, packet(0), 100 * S))) == 1
        line.feed(RX, packet(5, serial=678), 101 * S)
        assert ("fault" in kinds(line.feed(RX, packet(6, serial=678), 100 * S + later_ns))) == is_fault


def test_a_fault_of_another_sensor_has_its_number() -> None:
    line = with_identity({"serial": 70})
    line.feed(RX, packet(0), 0)
    (fault,) = line.feed(RX, packet(1), 5 * S)
    assert isinstance(fault, DeviceEvent)
    assert (fault.kind, fault.facts) == ("fault", {"serial": 677})
    assert line.feed(RX, packet(2), 5 * S) == []
    for unknown in ("70", True, None):
        assert len(batches(with_identity({"serial": unknown}).feed(RX, packet(0), 0))) == 1


def test_what_was_received_is_named_only_without_a_packet_of_the_sensor() -> None:
    line = pipeline()
    (damage,) = line.feed(RX, b"\xff" * 600, S)
    assert isinstance(damage, DeviceEvent)
    assert (damage.text, damage.facts, line.status.complaint) == (f"89 {DAMAGE}", {"bytes": 89}, "")
    (damage,) = line.feed(RX, packet(0, range_mm=50), S)
    assert isinstance(damage, DeviceEvent)
    named = "a packet of sensor 677 with a range of 50 mm"
    assert damage.text == f"512 {DAMAGE}; received: {named}"
    assert line.status.complaint == f"{EXPECTED} {named}. Look at the rig file, the sensor's settings and its address"
    assert line.losses["bytes"] == 89 + 512
    line = pipeline()
    items = line.feed(RX, packet(0) + 2 * packet(0, range_mm=50), S)
    assert [event.text for event in events(items)] == [f"513 {DAMAGE}"]
    assert len(batches(items)) == 1


def test_a_gap_has_its_exact_span_and_a_restart_begins_at_0() -> None:
    line = pipeline()
    line.feed(RX, packet(0), at(0))
    gap, batch = line.feed(RX, packet(3), at(3))
    assert isinstance(gap, DeviceEvent)
    assert isinstance(batch, Batch)
    assert gap.text == "336 samples lost (84.00 ms)"
    assert gap.facts == {"samples": 336, "span_s": pytest.approx(0.084, rel=1e-12)}
    assert batch.columns["counter"].tolist() == batch.sequence.tolist() == [*range(504, 672)]
    restart, batch = line.feed(RX, packet(200), at(5))
    assert isinstance(restart, DeviceEvent)
    assert isinstance(batch, Batch)
    assert (restart.kind, restart.text) == ("restart", "its packets' number does not continue: it started again")
    assert batch.sequence.tolist() == [*range(168)]
    assert batch.columns["flags"].tolist() == [0] * 168
    assert batch.columns["device_ticks"].tolist() == [25 * n for n in range(168)]


def test_numbers_of_samples_wrap_after_32_bits_and_their_ticks_do_not() -> None:
    """A loss of 19 days at 4 kHz."""
    line = pipeline()
    items = line.feed(RX, packet(0), at(0))
    for number in range(2, 12):
        items += line.feed(RX, packet(number), at(number) + 1_610_000 * S)
    (gap,) = events(items)
    lost = gap.facts["samples"]
    assert lost == pytest.approx(1_610_000 * 4000, rel=1e-5)
    assert gap.facts["span_s"] == pytest.approx(lost / 4000.0, rel=1e-12)
    last = batches(items)[1]
    assert last.columns["counter"].tolist() == [(168 + lost + n) % 2**32 for n in range(168)]
    assert last.columns["device_ticks"].tolist() == [25 * (168 + lost + n) for n in range(168)]


def test_the_ticks_of_a_rate_without_a_whole_period_are_exact() -> None:
    (batch,) = pipeline(rate_Hz=3000.0).feed(RX, packet(0), S)
    assert isinstance(batch, Batch)
    assert batch.columns["device_ticks"][150] == 5000


def test_single_results_are_readings_up_to_full_scale() -> None:
    line = pipeline(no_target_codes=(20_000, 300), lever_ratio=0.5)
    found = {}
    for number, code in enumerate((0, 16_384, 16_385, 20_000, 300)):
        (batch,) = line.feed(RX, packet(number, code=code), at(number))
        assert isinstance(batch, Batch)
        found[code] = float(batch.columns["displacement_m"][0])
    assert [found[0], found[16_384]] == pytest.approx([-0.025, 0.025])
    assert [math.isnan(found[code]) for code in (16_385, 20_000, 300)] == [True] * 3
    assert line.losses["invalid"] == 3 * 168


@pytest.mark.parametrize(("status", "valid"), [(0, False), (1, True), (2, False), (3, True)])
def test_a_status_that_means_no_reading_is_invalid(status: int, valid: bool) -> None:
    line = pipeline(valid_status=(1, 3))
    (batch,) = line.feed(RX, packet(0, status=status), S)
    assert isinstance(batch, Batch)
    assert np.isfinite(batch.columns["displacement_m"]).tolist() == [valid] * 168


def test_a_number_that_is_set_to_0_at_once_is_no_packet_that_comes_twice() -> None:
    line = pipeline()
    for number in range(4):
        line.feed(RX, packet(number), at(number))
    assert line.feed(RX, packet(0), at(4)) == []
    assert line.repeated_packets == 0

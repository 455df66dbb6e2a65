"""RF60x sensors on Ethernet: packets, losses by their number, identity, and other settings."""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

import rig_testing
from daq.items import RX, TX, Batch, DeviceEvent
from rig_drivers.riftek_ethernet import identity, wire
from rig_drivers.riftek_ethernet.driver import DRIVER
from rig_drivers.riftek_ethernet.settings import RiftekEthernetLaser
from rig_drivers.riftek_ethernet.stream import RiftekEthernetPipeline
from rig_testing.bench import DriverBench
from tests.daq.kit_cases import kit_cases

S = 1_000_000_000
PACKET_S = 168 / 4000


def settings(**more: Any) -> RiftekEthernetLaser:
    table = {"driver": "riftek_ethernet", "port": "udp://0.0.0.0:603", "axis": "x", **more}
    return RiftekEthernetLaser.model_validate(table)


def pipeline(**more: Any) -> RiftekEthernetPipeline:
    return RiftekEthernetPipeline("laser", settings(**more), {})


def packet(number: int, code: int = 8192, serial: int = 677, range_mm: int = 25, status: int = 0) -> bytes:
    """A packet by the layout of the maker's library."""
    data = 168 * struct.pack("<HB", code, status)
    return data + struct.pack("<HHHBB", serial, 80, range_mm, number % 256, 0)


def at(number: int) -> int:
    """Host time of a packet, ns."""
    return round((100 + number * PACKET_S) * S)


def kinds(items: list[Batch | DeviceEvent]) -> list[str]:
    return [item.kind for item in items if isinstance(item, DeviceEvent)]


def test_a_packet_has_168_results_and_the_sensor_s_identity() -> None:
    codes = np.arange(168) * 97
    data = b"".join(struct.pack("<HB", code, code % 3) for code in codes.tolist())
    data += bytes.fromhex("A502 5000 1900 FF 7B")
    found = wire.parse(data)
    assert (found.serial, found.base_mm, found.range_mm, found.number) == (677, 80, 25, 255)
    assert found.codes.tolist() == codes.tolist()
    assert found.status.tolist() == (codes % 3).tolist()
    assert len(data) == wire.PACKET_BYTES == 512


@pytest.mark.parametrize(("check", "value"), [("sum", 6), ("xor", 0)])
def test_a_wrong_check_is_no_packet(check: wire.Check, value: int) -> None:
    good = bytearray(packet(3, code=0))
    assert wire.check_of(b"\x01\x02\x03", check) == value
    good[-1] = wire.check_of(bytes(good[:-1]), check)
    assert len(wire.PacketDecoder(25, check).feed(bytes(good)).packets) == 1
    good[100] ^= 4
    assert wire.PacketDecoder(25, check).feed(bytes(good)).packets == []


def test_results_become_displacements() -> None:
    line = pipeline(lever_ratio=2.0, no_target_codes=[0, 16384], valid_status=[0])
    (batch,) = line.feed(RX, packet(0, code=12288), S)
    assert isinstance(batch, Batch)
    assert batch.columns["displacement_m"] == pytest.approx(0.25 * 0.025 / 2.0)
    assert np.diff(batch.time_ns).tolist() == [250_000] * 167
    assert batch.time_ns[-1] == S
    for number, more in enumerate(({"code": 0}, {"code": 16384}, {"code": 16385}, {"status": 1}), 1):
        (batch,) = line.feed(RX, packet(number, **more), S + number * 42_000_000)
        assert isinstance(batch, Batch)
        assert np.isnan(batch.columns["displacement_m"]).all()
    assert line.losses == {"samples": 0, "bytes": 0, "invalid": 4 * 168}
    assert line.feed(TX, packet(9), S) == []


def test_lost_packets_are_counted_exactly_even_more_than_the_number_s_range() -> None:
    line = pipeline()
    line.feed(RX, packet(250), at(250))
    gap, batch = line.feed(RX, packet(260), at(260))
    assert isinstance(gap, DeviceEvent)
    assert isinstance(batch, Batch)
    assert (gap.kind, gap.facts["samples"], gap.facts["span_s"]) == ("gap", 9 * 168, pytest.approx(9 * PACKET_S))
    assert batch.sequence[0] == 10 * 168
    (gap, _) = line.feed(RX, packet(260 + 600), at(260 + 600))
    assert isinstance(gap, DeviceEvent)
    assert gap.facts["samples"] == 599 * 168
    assert line.losses["samples"] == 608 * 168


def test_packets_that_come_twice_or_late_give_no_samples() -> None:
    line = pipeline()
    for number in (0, 1, 3):
        line.feed(RX, packet(number), at(number))
    assert line.feed(RX, packet(3) + packet(2), at(3)) == []
    assert kinds(line.feed(RX, packet(4), at(4))) == []
    assert line.repeated_packets == 2
    assert line.losses["samples"] == 168


def test_a_sensor_that_starts_again_is_reported() -> None:
    """Also if its number then happens to be that of a packet that is a little late, with all of its samples."""
    line = pipeline()
    line.feed(RX, packet(100), at(100))
    assert kinds(line.feed(RX, packet(0), at(130))) == ["restart"]
    found = [item for n in range(8) for item in line.feed(RX, packet(250 + n), at(131 + n))]
    assert kinds(found) == ["restart"]
    assert sum(isinstance(item, Batch) for item in found) == 8
    assert line.losses["samples"] == 0
    assert line.repeated_packets == 0


def test_another_sensor_gives_no_samples() -> None:
    line = pipeline(serial=678)
    assert kinds(line.feed(RX, packet(0), 0)) == ["damage"]
    assert kinds(line.feed(RX, packet(0), S)) == ["fault"]
    assert line.status.has_reported
    assert "expected serial number 678" in line.status.complaint
    assert line.feed(RX, packet(1), S) == []
    found = line.feed(RX, packet(2, serial=678) + packet(3, serial=678), 2 * S)
    assert [isinstance(item, Batch) for item in found] == [True, True]
    assert line.status.complaint == ""
    assert line.status.learned == {"serial": 678}
    first = RiftekEthernetPipeline("laser", settings(), {"serial": 5})
    assert first.status.learned == {}
    assert kinds(first.feed(RX, packet(0), 0) + first.feed(RX, packet(1), S)) == ["damage", "fault"]


def test_a_sensor_of_another_range_gives_bytes_that_are_not_packets() -> None:
    line = pipeline()
    (damage,) = line.feed(RX, 2 * packet(0, range_mm=50), S)
    assert isinstance(damage, DeviceEvent)
    assert "range of 25 mm" in damage.text
    assert line.losses["bytes"] == 513


@pytest.mark.parametrize(
    ("data", "check", "words"),
    [
        (packet(0, range_mm=50), "none", "a packet of sensor 677 with a range of 50 mm"),
        (packet(0, code=0), "xor", 'whose last byte is not that of checksum = "xor"'),
        (packet(0, code=0)[:-1] + bytes([sum(packet(0, code=0)) % 256]), "xor", 'but of checksum = "sum"'),
        (packet(0)[:300] + packet(0)[-8:], "none", "a packet of 100 results: set the sensor to 168"),
    ],
)
def test_what_comes_instead_of_packets_is_named_before_the_first_one(data: bytes, check: str, words: str) -> None:
    line = pipeline(checksum=check)
    texts = [item.text for _ in range(3) for item in line.feed(RX, data, S) if isinstance(item, DeviceEvent)]
    assert words in texts[-1]
    assert words in line.status.complaint
    assert line.status.complaint.startswith("expected packets of a sensor with a range of 25 mm, got a packet")
    assert not line.status.has_reported


def test_a_complaint_ends_with_the_first_packet_of_the_sensor() -> None:
    line = pipeline()
    line.feed(RX, packet(0, range_mm=50), S)
    assert "50 mm" in line.status.complaint
    found = [item for n in range(3) for item in line.feed(RX, packet(n), at(n))]
    assert line.status.complaint == ""
    assert sum(isinstance(item, Batch) for item in found) == 2
    line.feed(RX, packet(9, serial=678), at(3))
    (event,) = line.feed(RX, packet(3), at(3))[:1]
    assert isinstance(event, DeviceEvent)
    assert event.kind == "damage"


def test_a_log_that_begins_with_a_packet_of_another_sensor_goes_on() -> None:
    line = RiftekEthernetPipeline("laser", settings(), {"serial": 677})
    found = [item for n in range(30) for s in (678, 677) for item in line.feed(RX, packet(n, serial=s), at(n))]
    assert set(kinds(found)) == {"damage"}
    assert sum(isinstance(item, Batch) for item in found) >= 28
    assert line.status.complaint == ""


def test_another_sensor_that_sends_to_the_same_port_ends_no_recording() -> None:
    """Two of its packets in succession were a fault, and the packets of the sensor were skipped from then on."""
    line = pipeline()
    for number in range(3):
        line.feed(RX, packet(number), at(number))
    found: list[Batch | DeviceEvent] = []
    for number in range(3, 60):
        for data in (packet(2 * number, serial=678), packet(2 * number + 1, serial=678), packet(number)):
            found += line.feed(RX, data, at(number))
    assert set(kinds(found)) == {"damage"}
    assert sum(isinstance(item, Batch) for item in found) == 57
    assert line.losses["samples"] == 0
    assert line.losses["bytes"] == 57 * 2 * 512
    texts = {item.text[item.text.index(";") :] for item in found if isinstance(item, DeviceEvent) and ";" in item.text}
    assert "; received: a packet of sensor 678" in texts
    assert line.status.complaint == ""
    found = [item for n in range(30) for item in line.feed(RX, packet(n, serial=678), at(60 + n))]
    assert "fault" in kinds(found)
    assert "got packets of sensor 678" in line.status.complaint


@pytest.mark.parametrize("noise", [b"\x01\x02", b"\xff" * 512, bytes(512), b"M-SEARCH * HTTP/1.1" * 30, bytes(8)])
def test_bytes_that_are_no_packet_are_not_named(noise: bytes) -> None:
    assert identity.words_for(noise, 25, "none") == ""


def test_a_sensor_is_recognised_by_two_packets_of_any_range() -> None:
    found = identity.recognise(settings(), b"\x00" + packet(255, range_mm=50) + packet(256, range_mm=50) + b"\x01")
    assert found is not None
    assert found.settings == {"range_m": 0.05, "serial": "677"}
    assert found.identity == {"serial": 677, "base_mm": 80, "range_mm": 50}
    alone = identity.recognise(settings(), packet(3))
    assert alone is not None
    assert alone.settings == {"range_m": 0.025, "serial": "677"}
    for other in (
        packet(3)[1:],
        packet(3) + packet(3),
        packet(3, range_mm=0) + packet(4, range_mm=0),
        bytes(512),
        bytes(3000),
    ):
        assert identity.recognise(settings(), other) is None
    assert identity.recognise(settings(), packet(3, code=40000) + packet(4, code=40000)) is None


def test_the_uncertainty_of_the_times_is_stated() -> None:
    line = pipeline()
    stds = [line.status.clock_std_ns for n in range(50) for _ in line.feed(RX, packet(n), at(n))]
    assert stds[0] > 1e6
    assert stds[-1] < 1e5


def test_bytes_that_look_like_another_sensor_are_not_taken_for_one() -> None:
    """The end of a packet that lost two bytes contains the range of the rig file by chance."""
    line = pipeline()
    line.feed(RX, packet(24), at(24))
    found = line.feed(RX, packet(25)[2:] + packet(26), at(26))
    assert kinds(found) == ["damage", "gap"]
    assert line.status.complaint == ""
    assert line.losses == {"samples": 168, "bytes": 510, "invalid": 0}


def test_impossible_settings_are_refused() -> None:
    with pytest.raises(ValidationError, match="whole number of millimetres"):
        settings(range_m=0.0255)
    with pytest.raises(ValidationError, match="checksum"):
        settings(checksum="crc")


_CHECKED = replace(DRIVER, example={"axis": "y", "rate_Hz": 9400.0, "checksum": "sum", "serial": 12})


@pytest.mark.parametrize("case", kit_cases((_CHECKED,)))
def test_a_sensor_with_a_check_passes_the_tests_of_drivers(case: rig_testing.ContractCase) -> None:
    case()


@pytest.mark.parametrize(
    ("fault", "value", "kind"), [("dropped", 3, "samples"), ("blocked", 1, "invalid"), ("repeats", 1, "")]
)
def test_faults_of_the_simulated_sensor_reach_the_host(fault: str, value: int, kind: str) -> None:
    bench = DriverBench(DRIVER)
    bench.begin()
    bench.clock.wait(0.5)
    bench.far.fail(fault, value)
    bench.clock.wait(1.0)
    losses = {name: count for name, count in bench.pipeline.losses.items() if count}
    assert set(losses) == {kind} - {""}
    assert losses.get("samples", 3 * 168) == 3 * 168
    bench.far.fail("other", 9)
    bench.clock.wait(1.5)
    assert "got packets of sensor 9" in bench.pipeline.status.complaint
    with pytest.raises(ValueError, match="no fault 'x'"):
        bench.far.fail("x", math.nan)


@pytest.mark.parametrize("seed", range(4))
def test_a_sensor_without_supply_starts_again(seed: int) -> None:
    bench = DriverBench(DRIVER, seed=seed)
    bench.begin()
    bench.clock.wait(1.0)
    bench.far.power(False, bench.motion.time_s)
    bench.clock.wait(1.5)
    bench.far.power(True, bench.motion.time_s)
    bench.clock.wait(1.0)
    assert set(kinds(bench.items)) & {"restart", "gap"}


Items = list[Batch | DeviceEvent]


def batches(items: Items) -> list[Batch]:
    return [item for item in items if isinstance(item, Batch)]


def test_packets_of_another_sensor_do_not_hide_those_read_with_them() -> None:
    line = pipeline(serial=678)
    others = [packet(number, serial=677) for number in range(3)]
    found = line.feed(RX, b"".join([packet(0, serial=678), *others, packet(1, serial=678)]), 0)
    assert len(batches(found)) == 2
    assert line.losses["bytes"] == 3 * 512


@pytest.mark.parametrize(("status", "valid"), [(0, False), (1, True), (2, False), (3, True)])
def test_a_status_that_means_no_reading_is_invalid(status: int, valid: bool) -> None:
    line = pipeline(valid_status=(1, 3))
    (batch,) = line.feed(RX, packet(0, status=status), S)
    assert isinstance(batch, Batch)
    assert np.isfinite(batch.columns["displacement_m"]).tolist() == [valid] * 168

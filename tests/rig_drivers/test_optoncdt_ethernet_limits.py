"""Pipeline of an optoNCDT on Ethernet at its limits: numbers of samples, gaps, flags, complaints, rates."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from daq.items import RX, Batch, DeviceEvent
from rig_drivers.optoncdt_ethernet import wire
from rig_drivers.optoncdt_ethernet.stream import EthernetPipeline
from tests.rig_drivers.test_optoncdt_ethernet import MID, S, frames_packet, kinds, packet, pipeline, recorded, settings

Items = list[Batch | DeviceEvent]
PERIOD_NS = 200_000


def with_identity(identity: dict[str, Any], **more: Any) -> EthernetPipeline:
    return EthernetPipeline("laser", settings(**more), identity)


def events(items: Items, kind: str = "") -> list[DeviceEvent]:
    return [item for item in items if isinstance(item, DeviceEvent) and kind in ("", item.kind)]


class Sensor:
    """Packets of a sensor, 20 a second, and what its pipeline makes of them."""

    def __init__(self, line: EthernetPipeline, rate_Hz: int = 5000) -> None:
        self.line, self.items = line, list[Batch | DeviceEvent]()
        self.counter, self.now_ns = 0, S
        self._rate_Hz = rate_Hz

    def run(self, seconds: float, rate_Hz: int = 0, reads_Hz: int = 20, parts: int = 1) -> list[str]:
        """Let the sensor measure for a time, and return the kinds of the events."""
        items: Items = []
        for _ in range(round(seconds * reads_Hz)):
            size = (rate_Hz or self._rate_Hz) // reads_Hz
            data = packet(self.counter, [MID] * size)
            self.now_ns += S // reads_Hz
            for part in np.array_split(np.frombuffer(data, np.uint8), parts):
                items += self.line.feed(RX, part.tobytes(), self.now_ns)
            self.counter += size
        self.items += items
        return kinds(items)


# --- numbers of samples ----------------------------------------------------------------------------------------------


def test_packets_of_one_read_are_one_batch_that_begins_with_the_counter() -> None:
    line = pipeline(lever_ratio=2.0, range_m=0.02)
    items = line.feed(RX, packet(0, [MID, MID + 1000]) + packet(2, [MID]), S)
    (batch,) = items
    assert isinstance(batch, Batch)
    assert batch.columns["counter"].tolist() == batch.sequence.tolist() == [0, 1, 2]
    assert batch.columns["device_ticks"].tolist() == [0, 20, 40]
    assert batch.columns["displacement_m"] == pytest.approx([0, 5e-7, 0], abs=1e-12)
    assert batch.columns["flags"].tolist() == [0, 0, 0]
    assert batch.time_ns.tolist() == [S - 2 * PERIOD_NS, S - PERIOD_NS, S]
    seed = line.status.clock_seed
    assert seed is not None
    assert (seed.wrap_ns, seed.device_ns, seed.host_ns) == (2**32 * PERIOD_NS, 2 * PERIOD_NS, S)


def test_a_gap_between_packets_of_one_read_divides_their_samples() -> None:
    line = pipeline()
    before, gap, after = line.feed(RX, packet(10, [1, 2]) + packet(17, [3]), S)
    assert isinstance(before, Batch)
    assert isinstance(after, Batch)
    assert isinstance(gap, DeviceEvent)
    assert (before.sequence.tolist(), after.sequence.tolist()) == ([10, 11], [17])
    assert gap.text == "5 samples lost (1.00 ms)"
    assert gap.facts == {"samples": 5, "span_s": pytest.approx(0.001, rel=1e-12)}


def test_samples_of_a_sensor_that_counts_packets_are_numbered_from_0() -> None:
    """The missing packets are taken for as large as the one after them."""
    line = pipeline(counts="packets")
    (first,) = line.feed(RX, packet(7, [1, 2]), S)
    gap, batch = line.feed(RX, packet(11, [3] * 5), S)
    assert isinstance(first, Batch)
    assert isinstance(gap, DeviceEvent)
    assert isinstance(batch, Batch)
    assert first.sequence.tolist() == [0, 1]
    assert batch.sequence.tolist() == [17, 18, 19, 20, 21]
    assert gap.text == "about 15 samples lost (3.00 ms)"
    assert gap.facts == {"samples": 15, "span_s": pytest.approx(0.003), "uncertain_samples": 3}
    assert line.losses["samples"] == 15
    assert [event.text for event in events(line.feed(RX, packet(5, [4]), S))] == [
        "its counter does not continue: the sensor started again"
    ]


@pytest.mark.parametrize(("counter", "kind"), [(500, "gap"), (50_000, "restart")])
def test_frames_are_not_measured_long_after_they_are_received(counter: int, kind: str) -> None:
    """The first read of a log may be late by a quarter of a second; 50 000 frames are ten seconds."""
    line = pipeline()
    line.feed(RX, packet(0, [MID] * 50), S)
    assert kinds(line.feed(RX, packet(counter, [MID] * 50), S + 10_000_000)) == [kind]


# --- damage and other frames -----------------------------------------------------------------------------------------


def test_bytes_before_the_first_packet_are_no_damage() -> None:
    line = pipeline()
    assert line.feed(RX, b"\x01\x02", S) == []
    assert kinds(line.feed(RX, b"\x03" + packet(0, [1]), S)) == []
    assert line.losses["bytes"] == 0
    (damage,) = line.feed(RX, b"\x04" * 7, S)
    assert isinstance(damage, DeviceEvent)
    assert (damage.kind, damage.facts) == ("damage", {"bytes": 7})
    assert damage.text == "7 bytes skipped that belong to no packet"
    assert line.losses["bytes"] == 7


def test_frames_of_another_size_are_a_fault_in_place_of_damage() -> None:
    line = pipeline()
    line.feed(RX, packet(0, [1]), S)
    found = [line.feed(RX, frames_packet(3 * n, [[1, 2, 3]] * 50), S + n) for n in range(7)]
    names = [kinds(items) for items in found]
    assert names.count(["damage", "fault"]) == 1
    at = names.index(["damage", "fault"])
    assert names == [["damage"]] * at + [["damage", "fault"]] + [[]] * (6 - at)
    assert events(found[at], "fault")[0].facts == {"frame_bytes": 12}
    assert line.losses["bytes"] > 6 * 600


def test_a_sensor_of_which_only_the_size_of_frames_is_known_has_reported() -> None:
    line = pipeline()
    assert not line.status.has_reported
    for n in range(6):
        line.feed(RX, frames_packet(3 * n, [[1, 2, 3]] * 50), S + n)
    assert line.status.has_reported
    assert line.status.learned == {}


# --- serial numbers and flags ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("other", [70_001, 69_999])
def test_a_sensor_that_comes_back_is_the_same_as_before(other: int) -> None:
    line = pipeline()
    assert recorded(line.feed(RX, packet(0, [1], serial=70_000), S)) == [1]
    for _ in range(2):
        line.feed(RX, packet(1, [2], serial=other), S)
    assert line.status.complaint.startswith(
        f"the sensor has serial number {other}, expected 70000, that of the rig file"
    )
    back = line.feed(RX, packet(1, [3], serial=70_000), S)
    assert (kinds(back), recorded(back), line.status.complaint) == ([], [3], "")
    assert line.status.learned == {"order": 4120175, "serial": 70_000}
    named = pipeline(serial=70_000)
    assert recorded(named.feed(RX, packet(0, [1], serial=70_000), S)) == [1]


def test_a_packet_of_another_sensor_does_not_hide_those_after_it_in_a_read() -> None:
    line = pipeline()
    assert recorded(line.feed(RX, packet(0, [1]), S)) == [1]
    assert (line.status.has_reported, line.losses) == (True, {"samples": 0, "bytes": 0, "invalid": 0})
    items = line.feed(RX, packet(0, [2], serial=78) + packet(1, [3]), S + 1)
    assert (kinds(items), recorded(items)) == (["fault"], [3])


def test_a_sensor_that_started_again_is_numbered_by_its_counter() -> None:
    line = pipeline()
    line.feed(RX, packet(1000, [1, 2]), S)
    (_, batch) = line.feed(RX, packet(7, [3, 4]), 2 * S)
    assert isinstance(batch, Batch)
    assert batch.sequence.tolist() == [7, 8]


def test_the_serial_number_of_an_earlier_log_is_a_number() -> None:
    for known, found in (("78", [1]), (None, [1]), (77, [1]), (78, [])):
        assert recorded(with_identity({"serial": known}).feed(RX, packet(0, [1]), S)) == found


@pytest.mark.parametrize(("first", "other"), [(0, 1 << 16), (1 << 16, 1 << 3)])
def test_other_flags_are_one_fault_until_the_first_ones_come_back(first: int, other: int) -> None:
    line = pipeline(scaling="ILD1420")

    def fed(counter: int, one: int, two: int = 5) -> Items:
        words = np.array([[32_760]], np.uint32)
        return line.feed(RX, wire.encode(wire.Packet(4120175, 77, (one, two), counter, words)), S + counter)

    assert kinds(fed(0, first)) == []
    (fault,) = fed(1, other)
    assert isinstance(fault, DeviceEvent)
    assert (fault.kind, fault.facts) == ("fault", {"flags_1": other, "flags_2": 5})
    assert fed(2, other) == []
    assert kinds(fed(3, first, 6)) == ["fault"]
    assert f"flags {first:08X}h 00000006h, expected {first:08X}h 00000005h, those of" in line.status.complaint
    assert fed(4, first, 6) == []
    back = fed(5, first)
    assert (kinds(back), recorded(back), line.status.complaint) == (["gap"], [32_760], "")
    assert line.losses["samples"] == 4


def test_only_nanometres_have_flags_that_are_compared_with_the_words() -> None:
    line = pipeline(scaling="ILD1420", words=["DIST", "STATE"])
    assert kinds(line.feed(RX, frames_packet(0, [[512, 32_760]], flags=1 << 8), S)) == []
    assert line.doubt == ""
    line = pipeline(words=["DIST", "STATE"])
    (event, _) = line.feed(RX, frames_packet(0, [[512, 32_760]], flags=1 << 8), S)
    assert isinstance(event, DeviceEvent)
    assert (event.kind, event.facts) == ("doubt", {"flags_1": 1 << 8, "flags_2": 0})


def test_the_ticks_of_a_rate_without_a_whole_period_are_exact() -> None:
    (batch,) = pipeline(rate_Hz=3000.0).feed(RX, packet(30_000, [1]), S)
    assert isinstance(batch, Batch)
    assert batch.columns["device_ticks"].tolist() == [1_000_000]


def test_flags_other_than_those_of_the_first_packet_are_a_fault() -> None:
    line = pipeline()
    line.feed(RX, frames_packet(0, [[MID]]), S)
    assert kinds(line.feed(RX, frames_packet(1, [[MID]], flags=4), S + 1)) == ["fault"]


# --- another rate ----------------------------------------------------------------------------------------------------


def test_each_change_of_the_rate_counts_the_samples_that_were_not_taken() -> None:
    sensor = Sensor(pipeline())
    for _ in range(2):
        assert sensor.run(3) == []
        assert sensor.run(7, 2500) == ["fault"]
        assert sensor.run(3) == ["gap", "restart"]
    line = sensor.line
    assert 0 < line.status.clock_std_ns < 1e7
    assert line.losses["samples"] == sensor.counter - len(recorded(sensor.items))
    gaps = events(sensor.items, "gap")
    lost = [gap.facts["samples"] for gap in gaps]
    assert sum(lost) == line.losses["samples"]
    assert [gap.facts for gap in gaps] == [{"samples": n, "span_s": pytest.approx(n / 5000)} for n in lost]
    assert gaps[0].text == (f"{lost[0]} samples not taken, since their rate was another one ({lost[0] / 5:.2f} ms)")
    fault, restart = events(sensor.items, "fault")[0], events(sensor.items, "restart")[0]
    assert fault.facts == {"rate_Hz": pytest.approx(2500), "nominal_Hz": 5000.0}
    assert "about 2500 Hz, expected 5000 Hz. Set the rate as before" in fault.text
    assert restart.text == "it measures at the rate of the rig file again"


def test_samples_of_another_scaling_are_not_among_those_of_another_rate() -> None:
    """A fault of the scaling ends when another sensor has sent in between."""
    sensor = Sensor(pipeline(range_m=0.02))
    sensor.line.feed(RX, packet(0, [32_760] * 1000), S)
    assert 'set scaling = "ILD1420"' in sensor.line.status.complaint
    assert sensor.line.feed(RX, packet(1000, [32_760]), S) == []
    assert kinds(sensor.line.feed(RX, packet(0, [1], serial=78), S)) == ["fault"]
    sensor.counter = 1000
    assert sensor.run(3) == []
    assert sensor.run(7, 2500) == ["fault"]
    assert sensor.run(3) == ["gap", "restart"]
    assert sensor.line.losses["samples"] == sensor.counter - 1000 - len(recorded(sensor.items))


def test_few_packets_a_second_show_their_rate_though_they_come_in_parts() -> None:
    sensor = Sensor(pipeline())
    assert sensor.run(3, reads_Hz=4, parts=3) == []
    assert sensor.run(12, reads_Hz=4, parts=3) == []
    assert sensor.run(12, 2500, reads_Hz=4, parts=3) == ["fault"]

"""optoNCDT 2300 on Ethernet: packets, losses by the counter, identity, and a session in lockstep."""

from __future__ import annotations

import struct
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

import rig_testing
from daq.items import RX, TX, Batch, DeviceEvent
from rig_drivers.optoncdt_ethernet import wire
from rig_drivers.optoncdt_ethernet.driver import DRIVER
from rig_drivers.optoncdt_ethernet.settings import EthernetLaser
from rig_drivers.optoncdt_ethernet.stream import EthernetPipeline
from tests.daq.kit_cases import kit_cases

S = 1_000_000_000
HEADER = struct.Struct("<IIIIIHHI")


def settings(**more: Any) -> EthernetLaser:
    return EthernetLaser.model_validate({"driver": "optoncdt_ethernet", "port": "socket://x:1", "axis": "x", **more})


def pipeline(**more: Any) -> EthernetPipeline:
    return EthernetPipeline("laser", settings(**more), {})


def packet(counter: int, codes: list[int], serial: int = 77) -> bytes:
    return wire.encode(wire.Packet(4120175, serial, (1, 0), counter, np.array(codes, np.uint32)[:, None]))


def kinds(items: list[Batch | DeviceEvent]) -> list[str]:
    return [item.kind for item in items if isinstance(item, DeviceEvent)]


def test_a_packet_is_read_word_by_word_in_either_order_of_its_sizes() -> None:
    """Written here by hand: the figures of the manual disagree on which size is first."""
    words = struct.pack("<6I", 32760, 1, 2, 655, 3, 4)
    for sizes in ((2, 12), (12, 2)):
        data = HEADER.pack(0x4D454153, 4120175, 77, 0x7, 0x0, *sizes, 99) + words
        found = wire.PacketDecoder(3).feed(b"\x00SAE" + data)
        (one,) = found.packets
        assert (one.order, one.serial, one.flags, one.counter) == (4120175, 77, (7, 0), 99)
        assert one.frames.tolist() == [[32760, 1, 2], [655, 3, 4]]
        assert found.skipped_bytes == 4
    assert data[:4] == b"SAEM"


def test_a_header_with_impossible_sizes_is_skipped_byte_by_byte() -> None:
    good = packet(5, [1, 2])
    for sizes in ((0, 4), (3, 8), (8193, 4)):
        bad = HEADER.pack(wire.PREAMBLE, 1, 2, 3, 4, *sizes, 5)
        found = wire.PacketDecoder(1).feed(bad + good)
        assert [p.counter for p in found.packets] == [5]
        assert found.skipped_bytes == wire.HEADER_BYTES


def test_a_distance_is_signed_nanometres_and_the_largest_numbers_are_error_codes() -> None:
    """The maker's manual of the optoNCDT 2300, value output by Ethernet: a wrong reading is 300 times too large."""
    line = pipeline(range_m=0.02)
    codes = [10_000_000, 0, 20_000_000, 2**32 - 100_000]
    (batch,) = line.feed(RX, packet(0, codes + list(range(0x7FFF_FFF5, 0x7FFF_FFFC))), S)
    assert isinstance(batch, Batch)
    found = batch.columns["displacement_m"]
    assert found[:4] == pytest.approx([0.0, -0.01, 0.01, -0.0101], abs=1e-12)
    assert np.isnan(found[4:]).all()
    assert line.losses["invalid"] == 7


def test_words_of_the_serial_line_become_displacements_by_its_formula() -> None:
    line = pipeline(range_m=0.01, lever_ratio=2.0, scaling="ILD1420")
    (batch,) = line.feed(RX, packet(0, [32760, 642, 262076]), S)
    assert isinstance(batch, Batch)
    found = batch.columns["displacement_m"]
    assert found[:2] == pytest.approx([0.0, -0.0025], abs=1e-6)
    assert np.isnan(found[2])
    assert batch.columns["code"].tolist() == [32760, 642, 262076]
    assert line.losses == {"samples": 0, "bytes": 0, "invalid": 1}


def test_missing_frames_are_counted_exactly_and_keep_their_time() -> None:
    line = pipeline(rate_Hz=1000.0)
    line.feed(RX, packet(2**32 - 2, [1, 2, 3]), S)
    gap, batch = line.feed(RX, packet(11, [4, 5]), S + 15_000_000)
    assert isinstance(gap, DeviceEvent)
    assert isinstance(batch, Batch)
    assert (gap.kind, gap.facts["samples"], gap.facts["span_s"]) == ("gap", 10, pytest.approx(0.01))
    assert batch.columns["counter"].tolist() == [11, 12]
    first = 100 * (2**32 + 11)
    assert batch.columns["device_ticks"].tolist() == [first, first + 100]
    assert line.losses["samples"] == 10


def test_a_counter_of_packets_gives_about_the_number_of_lost_samples() -> None:
    line = pipeline(counts="packets")
    assert line.status.clock_seed is None
    line.feed(RX, packet(7, [1, 2]), S)
    assert kinds(line.feed(RX, packet(8, [3, 4, 5]), S + 1000)) == []
    (gap, _) = line.feed(RX, packet(11, [6, 7]), S + 2000)
    assert isinstance(gap, DeviceEvent)
    assert (gap.facts["samples"], gap.facts["uncertain_samples"]) == (4, 2)


def test_a_counter_that_steps_back_is_a_restart() -> None:
    line = pipeline()
    line.feed(RX, packet(1000, [1, 2]), S)
    assert kinds(line.feed(RX, packet(0, [3]), 2 * S)) == ["restart"]
    assert line.losses["samples"] == 0


def test_another_sensor_gives_no_samples() -> None:
    line = pipeline(serial=78)
    assert line.status.has_reported is False
    assert kinds(line.feed(RX, packet(0, [1]), S)) == ["fault"]
    assert line.status.has_reported
    assert "serial number 77, expected 78" in line.status.complaint
    assert line.feed(RX, packet(1, [1]), S) == []
    (batch,) = line.feed(RX, packet(2, [1], serial=78), 2 * S)
    assert isinstance(batch, Batch)
    assert line.status.complaint == ""
    assert line.status.learned == {"order": 4120175, "serial": 78}
    assert line.feed(TX, packet(3, [1]), 3 * S) == []


def test_a_sensor_that_takes_the_place_of_another_gives_no_samples() -> None:
    """In the same log, and in the next one of the session."""
    line = pipeline()
    line.feed(RX, packet(0, [1]), S)
    assert kinds(line.feed(RX, packet(1, [1], serial=78), S)) == ["fault"]
    assert len(line.feed(RX, packet(1, [1]), S)) == 1
    later = EthernetPipeline("laser", settings(), {"serial": 77})
    assert kinds(later.feed(RX, packet(1, [1], serial=78), S)) == ["fault"]


@pytest.mark.parametrize("wait_s", [0.2, 2.0, 100.0])
def test_the_next_log_continues_the_clock(wait_s: float) -> None:
    """Its first read arrives late: by the state of the clock before, its samples keep their time."""
    line = pipeline(rate_Hz=1000.0)
    for i in range(100):
        line.feed(RX, packet(10 * i, [1] * 10), S + i * 10_000_000)
    seed = line.status.clock_seed
    assert seed is not None
    identity = {"serial": 77, "clock_seed": asdict(seed)}
    later = EthernetPipeline("laser", settings(rate_Hz=1000.0), identity)
    number = 1000 + round(1000 * wait_s)
    true_ns = S + (number - 9) * 1_000_000
    (batch,) = later.feed(RX, packet(number, [1]), true_ns + 30_000_000)
    assert isinstance(batch, Batch)
    assert batch.time_ns.tolist() == [pytest.approx(true_ns, abs=1_000_000)]


@pytest.mark.parametrize("words", [(), ("COUNTER",), ("DIST", "DIST"), ("DIST", "COUNTER", "COUNTER")])
def test_words_without_one_distance_are_refused(words: tuple[str, ...]) -> None:
    with pytest.raises(ValidationError, match="words"):
        settings(words=words)


_THREE = replace(
    DRIVER, example={"axis": "y", "words": ["SHUTTER", "INTENSITY", "DIST"], "scaling": "ILD1900", "serial": 12}
)


_PACKETS = replace(DRIVER, example={"axis": "x", "counts": "packets", "rate_Hz": 20_000.0}, claims=frozenset[str]())


KINDS = (_THREE, _PACKETS)


@pytest.mark.parametrize("case", kit_cases(KINDS))
def test_every_set_up_passes_the_tests_of_drivers(case: rig_testing.ContractCase) -> None:
    case()


# --- a scaling that cannot be right ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scaling", "word", "remedy"), [("nm", 32_760, 'scaling = "ILD1420"'), ("ILD1420", 10_000_000, 'scaling = "nm"')]
)
def test_words_of_the_other_scaling_give_a_fault_and_no_more_samples(scaling: str, word: int, remedy: str) -> None:
    line = pipeline(range_m=0.02, scaling=scaling)
    for number in range(11):
        items = line.feed(RX, packet(100 * number, [word + number] * 100), number * S // 50)
    assert kinds(items) == []
    assert remedy in line.status.complaint
    assert not [item for item in items if isinstance(item, Batch)]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"range_m": 0.02, "scaling": "nm"}, [10_000_000] * 1100),
        ({"range_m": 0.02, "scaling": "nm"}, [32_760] * 999 + [-5] * 101),
        ({"range_m": 0.02, "scaling": "nm"}, [0x7FFF_FFFB] * 1100),
        ({"range_m": 0.02, "scaling": "ILD1420"}, [32_760] * 1100),
        ({"range_m": 0.02, "scaling": "ILD1420"}, [262_076] * 1100),
        ({"range_m": 0.001, "scaling": "nm"}, [50_000] * 1100),
    ],
)
def test_words_that_fit_their_scaling_are_no_fault(more: dict[str, Any], words: list[int]) -> None:
    line = pipeline(**more)
    for at in range(0, 1100, 100):
        codes = [word % 2**32 for word in words[at : at + 100]]
        line.feed(RX, packet(at, codes), at * S // 5000)
    assert line.status.complaint == ""


# --- a sensor that loses power, is set otherwise, or counts otherwise ------------------------------------------------


MID = 10_000_000  # word of the middle of a range of 20 mm


def frames_packet(counter: int, frames: list[list[int]], flags: int = 0) -> bytes:
    words = np.array(frames, np.uint32)
    return wire.encode(wire.Packet(4120175, 77, (flags, 0), counter, words))


def recorded(items: list[Batch | DeviceEvent]) -> list[int]:
    return [int(code) for item in items if isinstance(item, Batch) for code in item.columns["code"]]


@pytest.mark.parametrize("kept", [28, 28 + 1, 28 + 40, 28 + 188, 28 + 189, 28 + 195])
@pytest.mark.parametrize("cut", [0, 5, 12, 28, 31, 150])
def test_a_packet_cut_by_a_lost_connection_gives_no_false_samples(kept: int, cut: int) -> None:
    """After it the connection begins with a header, which would fill the frames that are missing."""
    line = pipeline()
    first, half = packet(1000, [MID] * 50), packet(1050, [MID] * 50)
    after = packet(0, [MID] * 50) + packet(50, [MID] * 50)
    data = half[:kept] + after
    items = line.feed(RX, first, S)
    items += line.feed(RX, data[: kept + cut], S + 10_000_000) + line.feed(RX, data[kept + cut :], S + 900_000_000)
    assert recorded(items) == [MID] * 150
    assert kinds(items).count("restart") == 1
    assert line.losses["bytes"] == kept
    assert line.losses["samples"] == 0


@pytest.mark.parametrize("end", [0, -1])
def test_a_counter_of_the_end_of_a_packet_gives_no_false_gaps(end: int) -> None:
    """The manual does not state whether it counts the frames before a packet or those up to its end."""
    line = pipeline()
    sizes = [50, 47, 60, 41, 55, 58, 43, 49] * 4
    number = 1000
    items: list[Batch | DeviceEvent] = []
    for i, size in enumerate(sizes):
        number += size
        items += line.feed(RX, packet(number + end, [MID] * size), S + i * 10_000_000)
    assert kinds(items) == []
    assert sum(line.losses.values()) == 0
    (gap, _) = line.feed(RX, packet(number + end + 130, [MID] * 30), S + 340_000_000)
    assert kinds([gap]) == ["gap"]
    assert line.losses["samples"] == 100
    assert line.status.clock_seed is None


@pytest.mark.parametrize(("counts", "step", "remedy"), [("frames", 1, "packets"), ("packets", 50, "frames")])
def test_a_counter_that_counts_otherwise_is_a_fault_with_the_remedy(counts: str, step: int, remedy: str) -> None:
    """Not a restart, or a loss, with each packet."""
    line = pipeline(counts=counts)
    items: list[Batch | DeviceEvent] = []
    for i in range(8):
        items += line.feed(RX, packet(7 + step * i, [MID] * 50), S + i * 10_000_000)
    assert kinds(items).count("fault") == 1
    assert "restart" not in kinds(items) or counts == "packets"  # so many packets could not have been sent
    assert f'set counts = "{remedy}"' in line.status.complaint
    assert len(recorded(items)) <= 150


def test_a_counter_of_24_bits_that_wraps_is_no_restart() -> None:
    """The counter of a frame has 24 bits; at 5 kHz it wraps after 56 minutes."""
    line = pipeline()
    items: list[Batch | DeviceEvent] = []
    for i, counter in enumerate((2**24 - 100, 2**24 - 50, 0, 50)):
        items += line.feed(RX, packet(counter, [MID] * 50), S + i * 10_000_000)
    assert kinds(items) == []
    assert len(recorded(items)) == 200
    assert kinds(line.feed(RX, packet(0, [MID] * 50), 2 * S)) == ["restart"]


def test_losses_are_counted_between_packets_of_any_size() -> None:
    """A loss as large as the difference of two packets does not change the meaning of the counter."""
    line = pipeline()
    for counter, size in ((0, 50), (50, 40), (90, 55), (145, 50)):
        line.feed(RX, packet(counter, [MID] * size), S)
    items = line.feed(RX, packet(145 + 60, [MID] * 60), S + 1000)
    assert kinds(items) == ["gap"]
    assert line.losses["samples"] == 10


def test_frames_of_another_size_are_named() -> None:
    line = pipeline()
    items: list[Batch | DeviceEvent] = []
    for i in range(6):
        items += line.feed(RX, frames_packet(50 * i, [[1, 2, 3]] * 50), S + i * 10_000_000)
    assert kinds(items) == ["fault"]
    assert "its frames have 3 values, expected 1 (words = DIST)" in line.status.complaint
    assert recorded(line.feed(RX, packet(300, [7]), 2 * S)) == [7]
    assert line.status.complaint == ""


@pytest.mark.parametrize("count", [8, 12])
def test_the_size_of_other_frames_is_found_though_their_number_could_be_one(count: int) -> None:
    line = pipeline()
    for i in range(4):
        line.feed(RX, frames_packet(count * i, [[1, 2, 3]] * count), S + i * 10_000_000)
    assert "have 3 values" in line.status.complaint


def test_values_selected_while_it_is_read_give_no_samples() -> None:
    """Of two values in frames of the same size, the other one would be recorded as distance."""
    line = pipeline(words=["DIST", "STATE"])
    first = frames_packet(0, [[10_000_000, 1]] * 50, flags=1 << 16)
    other = frames_packet(50, [[512, 10_000_000]] * 50, flags=1 << 8)
    assert recorded(line.feed(RX, first, S)) == [MID] * 50
    items = line.feed(RX, other, S + 10_000_000)
    assert (kinds(items), recorded(items)) == (["fault"], [])
    assert "flags 00000100h 00000000h, expected 00010000h" in line.status.complaint
    back = line.feed(RX, frames_packet(100, [[10_000_000, 1]] * 50, flags=1 << 16), S + 20_000_000)
    assert (kinds(back), recorded(back)) == (["gap"], [MID] * 50)
    assert (line.status.complaint, line.losses["samples"]) == ("", 50)


def test_flags_that_name_other_values_are_reported_once() -> None:
    """Their meaning is not verified, so the samples are taken all the same."""
    line = pipeline(words=["DIST", "STATE"])
    items = line.feed(RX, frames_packet(0, [[512, 10_000_000]] * 50, flags=1 << 8), S)
    assert kinds(items) == ["doubt"]
    assert "sends INTENSITY, DIST, expected words = DIST, STATE" in line.doubt
    assert line.status.complaint == ""
    assert kinds(line.feed(RX, frames_packet(50, [[512, 10_000_000]] * 50, flags=1 << 8), S + 10_000_000)) == []
    checks = DRIVER.checks(settings(words=["DIST", "STATE"]), line, None, [])
    assert [check.passed for check in checks.values()] == [False, True]
    assert all(check.passed for check in DRIVER.checks(settings(), pipeline(), None, []).values())


def test_a_check_states_why_no_samples_are_taken() -> None:
    """Other checks fail too then, such as that of the place in the range, whose advice would be wrong."""
    line = pipeline()
    for i in range(11):
        line.feed(RX, packet(100 * i, [32_760] * 100), S + i * 20_000_000)
    check = DRIVER.checks(settings(), line, None, [])["packets"]
    assert (check.passed, check.note) == (False, line.status.complaint)
    assert 'set scaling = "ILD1420"' in check.note


def test_a_rate_that_is_changed_ends_the_samples_until_it_is_right_again() -> None:
    """The times of samples follow from the rate: at half the rate they would be wrong by 0.5 s after each second."""
    line = pipeline()
    counter, items, true_ns = 0, list[Batch | DeviceEvent](), S
    ends: list[int] = []

    def run(rate_Hz: float, seconds: float) -> list[Batch | DeviceEvent]:
        nonlocal counter, true_ns
        out: list[Batch | DeviceEvent] = []
        for _ in range(int(seconds * 100)):
            true_ns += 10_000_000
            size = int(rate_Hz / 100)
            out += line.feed(RX, packet(counter, [MID] * size), true_ns)
            counter += size
        return out

    items += run(5000, 5)
    assert kinds(items) == []
    slow = run(2500, 10)
    assert kinds(slow) == ["fault"]
    assert "about 2500 Hz, expected 5000 Hz" in line.status.complaint
    assert len(recorded(slow)) < 2500 * 5
    back = run(5000, 5)
    assert kinds(back) == ["gap", "restart"]
    ends = [int(item.time_ns[-1]) for item in back if isinstance(item, Batch)]
    assert ends[-1] == pytest.approx(true_ns, abs=1_000_000)
    assert line.status.complaint == ""
    taken = len(recorded(items + slow + back))
    assert line.losses["samples"] + taken == counter


def test_packets_of_another_sensor_are_no_rate() -> None:
    line = pipeline()
    items: list[Batch | DeviceEvent] = []
    for i in range(1200):
        serial = 78 if 300 <= i < 900 else 77
        items += line.feed(RX, packet(50 * i, [MID] * 50, serial), S + i * 10_000_000)
    assert kinds(items) == ["fault", "gap"]
    assert line.losses["samples"] == 600 * 50


def test_frames_that_wait_are_no_change_of_the_rate() -> None:
    """Packets arrive 3 s late after a cable was out, or unevenly on a slow network, or a slow host reads them late."""
    line = pipeline()
    items: list[Batch | DeviceEvent] = []
    for i in range(2000):
        late = 3 * S if 500 <= i < 800 else 400_000_000 * (i % 150) // 150 if i > 1000 else 0
        due = S + i * 10_000_000
        items += line.feed(RX, packet(50 * i, [MID] * 50), max(due + late, S + 8 * S) if 500 <= i < 800 else due + late)
    assert kinds(items) == []


@pytest.mark.parametrize(
    "words", [["DIST"], ["COUNTER", "TIMESTAMP", "DIST"], ["SHUTTER", "INTENSITY", "DIST", "STATE"]]
)
def test_a_sensor_is_recognised_with_the_values_that_its_flags_name(words: list[str]) -> None:
    flags = sum(
        1 << {"SHUTTER": 2, "COUNTER": 3, "TIMESTAMP": 4, "INTENSITY": 8, "STATE": 16}.get(w, 31) for w in words
    )
    flags &= 2**31 - 1
    data = b"".join(frames_packet(50 * i, [[1] * len(words)] * 50, flags) for i in range(6))
    found = DRIVER.recognise(settings(), data[7:])
    assert found is not None
    assert found.settings == {"serial": 77} | ({"words": words} if len(words) > 1 else {})
    assert DRIVER.recognise(settings(words=words), data) == found  # the search reads on with these values
    assert DRIVER.recognise(settings(), frames_packet(0, [[1, 2, 3]] * 50)) is None


Items = list[Batch | DeviceEvent]
PERIOD_NS = 200_000


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


# --- damage and other frames -----------------------------------------------------------------------------------------


# --- serial numbers and flags ----------------------------------------------------------------------------------------


def test_a_packet_of_another_sensor_does_not_hide_those_after_it_in_a_read() -> None:
    line = pipeline()
    assert recorded(line.feed(RX, packet(0, [1]), S)) == [1]
    assert (line.status.has_reported, line.losses) == (True, {"samples": 0, "bytes": 0, "invalid": 0})
    items = line.feed(RX, packet(0, [2], serial=78) + packet(1, [3]), S + 1)
    assert (kinds(items), recorded(items)) == (["fault"], [3])


# --- another rate ----------------------------------------------------------------------------------------------------


def test_few_packets_a_second_show_their_rate_though_they_come_in_parts() -> None:
    sensor = Sensor(pipeline())
    assert sensor.run(3, reads_Hz=4, parts=3) == []
    assert sensor.run(12, reads_Hz=4, parts=3) == []
    assert sensor.run(12, 2500, reads_Hz=4, parts=3) == ["fault"]

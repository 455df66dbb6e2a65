"""LabJack: inputs above their range, logs that begin within a message, refused reads, new starts, its clock."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from daq.acquisition.session import Session
from daq.drivers.contract import NoticesLostSetUp
from daq.drivers.labjack import wire
from daq.drivers.labjack.far_end import SimulatedLabJack
from daq.drivers.labjack.stream import LabJackPipeline
from daq.items import RX, TX, DeviceEvent
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.replay import check
from rig_configs import load_rig
from rig_testing.bench import Items
from tests.daq.test_labjack import (
    LASERS,
    OWN,
    START,
    S,
    answer,
    batches,
    bench_of,
    events,
    numbers,
    pipeline,
    rig_file,
)

OTHER = {"quantity": "acceleration_m_per_s2", "per_V": 10.0}
THREE = {"others": {"a": {"input": "AIN3", **OTHER}}}  # three inputs with the two lasers
LASER_TOPICS = ("laser/x", "laser/y")
REFUSAL = bytes.fromhex("8000 0000 0003 01 cc 04")


# --- samples without a value ------------------------------------------------------------------------------------------


def test_an_input_above_its_range_is_invalid_and_its_scans_count() -> None:
    """Over-range input: only its own samples are invalid. Scans without any value count too, and are reported once."""
    lasers = {"east": {"axis": "x", "input": "AIN0", "far_V": 4.81}, "north": {"axis": "y", "input": "AIN1"}}
    scale = {"AIN0_zero": 33523.0, "AIN0_above_V": 1.5e-4, "AIN0_below_V": 1.5e-4}
    made = pipeline(scale, lasers=lasers, others={"a": {"input": "AIN3", **OTHER}})
    over = [[0xFFFF, 41000, 42000]] * 2 + [[40000, 0xFFFF, 42000], [40000, 41000, 0xFFFF]]
    items = made.feed(RX, answer(0x8000, [code for scan in over for code in scan]), START)
    items += made.feed(RX, answer(0x8001, [0xFFFF] * 3 * 20 + [40000, 41000, 42000]), START + 5_250_000)
    (damage,) = events(items)
    assert (damage.kind, damage.facts["samples"]) == ("damage", 20)
    assert numbers(items) == numbers(items, "laser/y") == numbers(items, "analogue/a") == [*range(25)]
    assert np.diff(np.concatenate([b.time_ns for b in batches(items, "laser/y")])).tolist() == [250_000] * 24

    def invalid(topic: str, name: str) -> list[int]:
        values = np.concatenate([batch.columns[name] for batch in batches(items, topic)])
        return np.flatnonzero(np.isnan(values)).tolist()

    empty = [*range(4, 24)]
    assert invalid("laser/x", "displacement_m") == [0, 1, *empty]
    assert invalid("laser/y", "displacement_m") == [2, *empty]
    assert invalid("analogue/a", "acceleration_m_per_s2") == [3, *empty]
    assert made.losses == {"samples": 0, "bytes": 0, "refused": 0, "invalid": 43}


def test_an_over_range_sample_before_the_separator_is_no_separator() -> None:
    samples = [40000, 41000, 0xFFFF, 41000, 0xFFFF, 0xFFFF, 40001, 41001]
    assert numbers(pipeline().feed(RX, answer(0x8000, samples, status=2941, info=7), START)) == [0, 1, 9]


def test_scans_without_any_value_have_no_index_mark() -> None:
    made = pipeline(tacho={"input": "AIN2"}, scan_rate_Hz=1000.0)
    low, high, empty = [40000, 41000, 33523], [40000, 41000, 48000], [0xFFFF] * 3
    scans = [low] * 5 + [empty] * 4 + [low] * 5 + [high] * 2
    items = made.feed(RX, answer(0x8000, [code for scan in scans for code in scan]), START)
    assert sum(len(batch.time_ns) for batch in batches(items, "tacho")) == 1


def test_a_separator_may_be_divided_between_two_answers() -> None:
    made = pipeline()
    items = made.feed(RX, answer(0x8000, [40000, 41000, 0xFFFF], 2, status=2941, info=7), START)
    items += made.feed(RX, answer(0x8001, [0xFFFF, 40001, 41001]), START + 2_000_000)
    assert numbers(items) == [0, 8]
    assert [event.kind for event in events(items)] == ["gap"]


# --- logs that begin within a scan or a message -----------------------------------------------------------------------


@pytest.mark.parametrize("lost", [False, True])
def test_an_answer_may_begin_within_a_scan(lost: bool) -> None:
    """A log begins, or an answer is missing, within a scan: the number of samples that wait gives the place."""
    made = pipeline(
        lasers={"east": LASERS["east"]}, others={"a": {"input": "AIN3", **OTHER}, "b": {"input": "AIN2", **OTHER}}
    )
    if lost:
        made.feed(RX, answer(0x8000, [40000, 41000, 42000] * 2), START)
    items = made.feed(RX, answer(0x8003, [41000, 42000, 40000, 41000], 2), START + S)
    items += made.feed(RX, answer(0x8004, [42000, 40000], 4), START + S)
    items += made.feed(RX, answer(0x8005, [41000, 42000, 40000, 41000, 42000]), START + S)
    assert {int(code) for batch in batches(items, "laser/x") for code in batch.columns["code"]} == {40000}
    assert len(numbers(items)) == 3


def test_answers_of_whole_scans_are_dropped_until_their_place_in_the_buffer_is_certain() -> None:
    """Part of a scan waits behind whole scans: the device divides scans, or it stores its samples one by one."""
    made = pipeline()
    for number in range(3):
        assert not made.feed(RX, answer(0x8000 + number, [41000, 40000], 6), START)
    assert numbers(made.feed(RX, answer(0x8003, [41000, 40000, 41000]), START)) == [0]
    made = pipeline()
    items = [made.feed(RX, answer(0x8000 + number, [40000, 41000], 6), START) for number in range(21)]
    assert [len(each) for each in items] == [0] * 20 + [2]
    assert made.losses["samples"] == 0


def read_samples(made: LabJackPipeline, taken: Sequence[tuple[int, int]]) -> Items:
    """Feed answers with these samples of one endless stream, which are (first, last + 1), and the rest that waits."""
    items: Items = []
    for number, (first, end) in enumerate(taken):
        scans = 20 * (number + 1)
        codes = [10_000 * (1 + at % 3) + at // 3 % 5000 for at in range(first, end)]
        items += made.feed(RX, answer(0x8000 + number, codes, 2 * (3 * scans - end)), START + scans * 250_000)
    return items


def test_a_sample_that_another_program_has_read_does_not_exchange_the_inputs() -> None:
    """60 samples an answer; from sample 1800 on one is missing, and the answers end within a scan."""
    taken = [(60 * each, 60 * each + 60) for each in range(30)]
    stolen = [(1801, 1860), *((60 * each, 60 * each + 60) for each in range(31, 50))]
    made = pipeline(**THREE)
    items = read_samples(made, taken + stolen)
    codes = {
        topic: np.concatenate([batch.columns["code"] for batch in batches(items, topic)]) for topic in LASER_TOPICS
    }
    assert [np.unique(each // 10_000).tolist() for each in codes.values()] == [[1], [2]]
    damage, gap = events(items)
    assert (damage.kind, gap.kind, damage.facts["samples"]) == ("damage", "gap", 179)
    assert "another program" in damage.text
    assert numbers(items) == [*range(600), *range(600 + gap.facts["samples"], 1000)]
    assert codes["laser/x"].tolist() == [10_000 + number for number in numbers(items)]
    assert made.losses["samples"] == gap.facts["samples"]


@pytest.mark.parametrize("waiting", [1, 2])
def test_an_answer_during_a_scan_is_no_sign_of_missing_samples(waiting: int) -> None:
    """The device has stored one or two samples of a scan when it answers: the answer is decoded with the next one."""
    made, usual = pipeline(**THREE), pipeline(**THREE)
    for number in range(40):
        codes = [40000, 41000, 42000] * 20
        at, within = START + (number + 1) * 5_000_000, waiting if number == 30 else 0
        found = made.feed(RX, answer(0x8000 + number, codes, 2 * within), at)
        wanted = usual.feed(RX, answer(0x8000 + number, codes), at)
        assert not events(found)
        assert numbers(found) == {30: [], 31: [*range(600, 640)]}.get(number, numbers(wanted))
    assert made.losses["samples"] == 0


def test_a_device_that_often_answers_during_a_scan_is_not_doubted() -> None:
    made = pipeline(**THREE)
    for number in range(60):
        codes = [40000, 41000, 42000] * 20
        found = made.feed(RX, answer(0x8000 + number, codes, 2 * (number % 3)), START + (number + 1) * 5_000_000)
        assert len(numbers(found)) == 20
    assert made.losses["samples"] == 0


def test_a_new_start_ends_the_doubt_about_answers() -> None:
    made = pipeline(**THREE)
    read_samples(made, [*((60 * each, 60 * each + 60) for each in range(30)), (1801, 1860)])
    made.feed(TX, start_command(9), START + 30 * 5_000_000)
    made.feed(RX, start_answer(9), START + 31 * 5_000_000)
    items = made.feed(RX, answer(0x8050, [40000, 41000, 42000] * 20), START + 40 * 5_000_000)
    (gap,) = events(items)
    assert gap.kind == "gap"
    (batch,) = batches(items, "laser/x")
    assert np.unique(batch.columns["code"]).tolist() == [40000]


def test_bytes_of_a_message_that_began_before_the_log_are_no_damage() -> None:
    made = pipeline()
    data = answer(0x8000, [40000, 41000] * 30) + answer(0x8001, [40000, 41000] * 30)
    assert numbers(made.feed(RX, data[50:], START)) == [*range(30)]
    assert not any(made.losses.values())
    later = made.feed(RX, bytes(5) + answer(0x8002, [40000, 41000]), START + 1)
    assert [event.kind for event in events(later)] == ["damage"]
    assert made.losses["bytes"] == 5


def test_more_bytes_than_those_of_a_message_are_damage_at_the_start_of_a_log() -> None:
    made = pipeline()
    made.feed(RX, b"\xff" * 1000 + answer(0x8002, [40000, 41000]), START)
    assert made.losses["bytes"] == 1000 - 518


# --- refused reads ----------------------------------------------------------------------------------------------------


def test_refused_reads_in_a_row_are_a_fault_once_and_counted_each_time() -> None:
    made = pipeline()
    found = [event for _ in range(4) for event in events(made.feed(RX, REFUSAL, START))]
    assert [event.kind for event in found] == ["refused", "fault"]
    assert made.losses["refused"] == 4


def test_a_single_refused_read_is_no_fault() -> None:
    made = pipeline()
    for number in range(6):
        assert not events(made.feed(RX, answer(0x8000 + 2 * number, [40000, 41000]), START + 500_000 * number))
        refusal = struct.pack(">H", 0x8001 + 2 * number) + REFUSAL[2:]
        found = events(made.feed(RX, refusal, START + 500_000 * number))
        assert [event.kind for event in found] == ["refused"]
    assert made.losses["refused"] == 6


@pytest.mark.parametrize(
    ("code", "kind", "words"), [(2620, "fault", "no stream runs"), (2501, "refused", "error 2501")]
)
def test_the_error_of_a_refused_read_is_explained(code: int, kind: str, words: str) -> None:
    made = pipeline()
    detail = struct.pack(">HHHBBH", wire.ERROR_NUMBER, 0, 4, 1, 0x4C, code)
    assert not made.feed(RX, detail, START)
    made.feed(RX, REFUSAL, START)
    (event,) = made.feed(RX, detail, START)
    assert isinstance(event, DeviceEvent)
    assert event.kind == kind
    assert words in event.text
    assert not made.feed(RX, detail, START)


class OneRefusal(SimulatedLabJack):
    """A device that refuses its first stream read after the opening, but continues its stream."""

    refuses: ClassVar[bool] = True

    def _read(self, address: int, count: int) -> bytes:
        if address == 4500 and type(self).refuses:
            type(self).refuses = False
            return super()._read(1, count)  # no such register
        return struct.pack(">H", 2501) if address == 55000 else super()._read(address, count)


def test_the_host_reads_the_error_of_a_refused_read_and_continues() -> None:
    bench, far = bench_of()
    with bench.running():
        bench.begin()
        far.__class__ = type("Own", (OneRefusal,), {})
        bench.time.pass_time(1.0)
    assert [event.kind for event in events(bench.items) if event.kind != "reply"] == ["refused", "refused"]
    assert "error 2501" in events(bench.items, "refused")[1].text
    assert bench.pipeline.losses == {"samples": 0, "bytes": 0, "refused": 1, "invalid": 0}
    assert numbers(bench.items)[-1] > 3800


# --- a stream that is started again -----------------------------------------------------------------------------------


def start_command(number: int, on: int = 1) -> bytes:
    return wire.request(number, [wire.write(wire.Register.STREAM_ENABLE, struct.pack(">I", on)), wire.read(4002, 2)])


def start_answer(number: int) -> bytes:
    return wire.encode(wire.Message(number, wire.FEEDBACK, struct.pack(">f", 4000.0)))


def test_a_stream_that_the_host_starts_again_is_a_gap_and_its_times_are_right() -> None:
    """The device is read until 10 ms, started again at 2 s, and read again 10 ms later: 7960 scans are missing."""
    made = pipeline()
    made.feed(TX, start_command(7), START)
    made.feed(RX, start_answer(7), START)
    assert not events(made.feed(RX, answer(0x8000, [40000, 41000] * 40), START + 10_000_000))
    assert not made.feed(TX, start_command(8, 0), START + 2 * S)
    assert not made.feed(TX, start_command(9), START + 2 * S)
    made.feed(RX, start_answer(9), START + 2 * S + 1_000_000)
    items = made.feed(RX, answer(0x8001, [40000, 41000] * 40), START + 2 * S + 10_000_000)
    (gap,) = events(items)
    assert gap.kind == "gap"
    assert gap.facts["uncertain_samples"] == gap.facts["samples"] == made.losses["samples"]
    assert made.losses["samples"] == pytest.approx(7960, abs=2)
    (batch,) = batches(items, "laser/x")
    assert int(batch.time_ns[-1]) == START + 2 * S + 10_000_000
    assert int(batch.sequence[0]) == 40 + made.losses["samples"]
    assert not events(made.feed(RX, answer(0x8002, [40000, 41000] * 40), START + 2 * S + 20_000_000))


def test_a_new_stream_begins_with_its_first_input() -> None:
    made = pipeline()
    made.feed(RX, answer(0x8000, [40000, 41000, 40000], 2), START)
    made.feed(TX, start_command(9), START + 1_000_000)
    made.feed(RX, start_answer(9), START + 1_000_000)
    (batch,) = batches(made.feed(RX, answer(0x8001, [40001, 41001], 2), START + 2_000_000), "laser/x")
    assert batch.columns["code"].tolist() == [40001]


def test_answers_before_the_new_start_belong_to_the_old_stream() -> None:
    made = pipeline()
    made.feed(RX, answer(0x8000, [40000, 41000] * 40), START)
    made.feed(TX, start_command(9), START + 10_000_000)
    assert not events(made.feed(RX, answer(0x8001, [40000, 41000] * 40), START + 10_000_000))
    made.feed(RX, wire.encode(wire.Message(9, wire.REFUSED, b"\x04")), START + 15_000_000)
    assert not events(made.feed(RX, answer(0x8002, [40000, 41000] * 40), START + 20_000_000))


def test_a_device_that_lost_power_is_started_again_and_its_gap_is_counted(tmp_path: Path) -> None:
    """The dialogue ends the stream while the session would poll it. The log continues, with the scans of the outage."""
    sim = LockstepRig(load_rig(rig_file(tmp_path), settings=OWN))
    session = Session(load_rig(rig_file(tmp_path), settings=[*OWN, *sim.port_settings()]), sim.clock, edge=sim.edge)
    with session:
        session.start_recording(tmp_path / "a.mcap", {"test": "record"})
        sim.clock.wait(1.0)
        sim.ask("fail", device="lab", what="deaf", value=1, seconds=3.0)
        end = sim.clock.wall_s() + 8.0
        while sim.clock.wall_s() < end:
            session.check()
            sim.clock.wait(0.05)
        session.stop_recording({})
    log = tmp_path / "a.mcap"
    assert [row.topic for row in check(log) if row.difference] == []
    with open_log(log) as opened:
        found = opened["laser/x"]
        (gap,) = [event for event in opened.events if (event["kind"], event["device"]) == ("gap", "lab")]
        assert "started again" in gap["text"]
        steps = np.diff(found.time_ns) * 1e-9
        assert gap["samples"] == int(np.max(np.diff(found.sequence.astype(np.int64)))) - 1
        assert gap["samples"] / 4000.0 == pytest.approx(float(np.max(steps)), abs=0.01)
        assert float(np.max(steps)) > 2.0
        assert (opened.end_ns - found.time_ns[-1]) * 1e-9 < 0.2


def test_scans_of_an_answer_missing_after_a_late_one_are_all_counted() -> None:
    """The 100th answer is 0.3 s late, the one with the scans of these 0.3 s is missing."""
    made = pipeline()
    for number in range(99):
        made.feed(RX, answer(0x8000 + number, [40000, 41000] * 40), START + (number + 1) * 10_000_000)
    made.feed(RX, answer(0x8063, [40000, 41000] * 40), START + 1_300_000_000)
    items = made.feed(RX, answer(0x8065, [40000, 41000] * 40), START + 1_310_000_000)
    assert made.losses["samples"] == 1200
    assert abs(int(batches(items, "laser/x")[-1].time_ns[-1]) - START - 1_310_000_000) < 1e6


@pytest.mark.parametrize(("rate_Hz", "shown"), [(1000, "1000 Hz instead of 4000"), (8000, "8000 Hz instead of 4000")])
def test_a_stream_that_another_program_has_set_up_is_recognised(rate_Hz: int, shown: str) -> None:
    """From the 100th answer on the scans come at another rate. The device must be set up again."""
    made = pipeline()
    at = START
    for number in range(1000):
        count = 40 if number < 100 else rate_Hz // 100
        at += 10_000_000
        made.feed(RX, answer(0x8000 + number, [40000, 41000] * count), at)
        if at - START <= 4 * S:
            assert not made.set_up_lost
    assert isinstance(made, NoticesLostSetUp)
    assert shown in made.set_up_lost
    assert "another program" in made.set_up_lost
    made.feed(TX, start_command(9), at)
    made.feed(RX, start_answer(9), at)
    assert not made.set_up_lost


def test_times_increase_when_a_stream_that_was_too_fast_is_started_again() -> None:
    """Another program doubled the rate, so that the times are ahead of the host's; then the host starts the stream."""
    made, at = pipeline(), START
    items: Items = []
    for number in range(600):
        if number == 200:
            made.feed(TX, start_command(9), at)
            made.feed(RX, start_answer(9), at)
        at += 10_000_000
        count = 80 if 100 <= number < 200 else 40
        items += made.feed(RX, answer(0x8000 + number + (number >= 200), [40000, 41000] * count), at)
    times = np.concatenate([batch.time_ns for batch in batches(items, "laser/x")])
    assert np.min(np.diff(times)) > 0
    assert abs(int(times[-1]) - at) < 1e6
    assert [event.kind for event in events(items, "gap")] == ["gap"]


def test_late_answers_missing_answers_and_skipped_scans_are_no_other_rate() -> None:
    """The network is 0.3 s late for some seconds, answers are missing, and the buffer overflows."""
    made = pipeline()
    number, at = 0, START
    for second in range(12):
        for part in range(20):
            number += 1 + (second == 4)
            at = START + second * S + part * 50_000_000 + (300_000_000 if 6 <= second < 8 else 0)
            full = second == 9
            made.feed(RX, answer(0x8000 + number, [40000, 41000] * (20 if full else 200), 0, 2940 if full else 0), at)
            assert not made.set_up_lost


# --- the clock --------------------------------------------------------------------------------------------------------


def test_reads_of_a_full_buffer_do_not_change_the_clock() -> None:
    """Stall of 2.4 s: the buffer holds old data, whose age is unknown. There is no step of the clock."""
    made = pipeline()
    for number in range(200):
        made.feed(RX, answer(0x8000 + number, [40000, 41000] * 40), START + (number + 1) * 10_000_000)
    at, scans, late_ns = START + 2 * S + 2_400_000_000, 8000, [0]
    for number in range(200, 280):
        at += 2_000_000
        items = made.feed(RX, answer(0x8000 + number, [40000, 41000] * 100, 400 * (279 - number), 2940), at)
        scans += 100
        late_ns.append(int(batches(items, "laser/x")[0].time_ns[-1]) - START - scans * 250_000)
    lost = round((at - START) / 250_000) - scans
    samples = [0xFFFF] * 2 + [40000, 41000] * 20
    items = made.feed(RX, answer(0x8000 + 280, samples, 0, 2941, lost), at + 20 * 250_000)
    assert [event.kind for event in events(items)] == ["gap"]
    late_ns.append(int(batches(items, "laser/x")[-1].time_ns[-1]) - START - (scans + lost + 20) * 250_000)
    assert max(map(abs, late_ns)) < 1e5


def test_more_skipped_scans_than_were_possible_are_estimated() -> None:
    """The device was full for 1 s, and states 65 535 skipped scans, which are 16 s."""
    made = pipeline()
    for number in range(100):
        made.feed(RX, answer(0x8000 + number, [40000, 41000] * 40), START + (number + 1) * 10_000_000)
    made.feed(RX, answer(0x8064, [40000, 41000] * 40, 0, 2940), START + 1_990_000_000)
    samples = [0xFFFF] * 2 + [40000, 41000] * 40
    items = made.feed(RX, answer(0x8065, samples, 0, 2941, 65_535), START + 2 * S)
    assert made.losses["samples"] == pytest.approx(3920, abs=1)
    assert "it states 65535" in events(items, "gap")[0].text
    assert int(batches(items, "laser/x")[-1].time_ns[-1]) == pytest.approx(START + 2 * S, abs=1e6)


def test_a_log_that_begins_with_a_full_buffer_has_right_times_after_it() -> None:
    made = pipeline()
    for number in range(10):
        made.feed(RX, answer(0x8000 + number, [40000, 41000] * 100, 0, 2940), START + number * 10_000_000)
    items = made.feed(RX, answer(0x800A, [0xFFFF] * 2 + [40000, 41000] * 20, 0, 2941, 9000), START + S)
    assert int(batches(items, "laser/x")[-1].time_ns[-1]) == START + S


def test_scans_that_vanish_without_a_report_are_a_step_of_the_clock() -> None:
    made = pipeline()
    found: list[DeviceEvent] = []
    for number in range(400):
        at = START + (number + 1) * 10_000_000 + (number > 150) * S
        found += events(made.feed(RX, answer(0x8000 + number, [40000, 41000] * 40), at))
    (step,) = found
    assert step.kind == "clock"
    assert step.facts["scans"] == pytest.approx(4000, abs=10)
    assert "another program" in step.text

"""CANopen encoders: bytes of the standards, instants and losses with and without SYNC, faults of the encoders."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError

import rig_testing
from daq import channels
from daq.acquisition.session import Session
from daq.errors import DeviceError, LogError
from daq.items import RX, TX, Batch, DeviceEvent
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.replay import check
from daq.transports.can_frames import CanFrame, encode, open_bus
from daq.transports.slcan import HostText
from rig_configs import load_rig
from rig_configs.roles import PendulumAngles, PendulumLocks, RotorPhase
from rig_drivers.cia406 import wire
from rig_drivers.cia406.driver import DRIVER
from rig_drivers.cia406.far_end import PlayedEncoders, SimulatedEncoders
from rig_drivers.cia406.reports import Instant, Marks, Turns
from rig_drivers.cia406.settings import EncoderBus
from rig_drivers.cia406.stream import EncoderPipeline
from rig_drivers.cia406.sync_sender import LATEST_S, SyncSender
from rig_drivers.cia406.synchronous import OwnTimer
from rig_testing.bench import DriverBench
from tests.daq.can_text import rx, tx
from tests.daq.kit_cases import kit_cases

MS = 1_000_000
PERIOD_NS = 10 * MS
SYNC = rx(b"t0800\r")
Items = list[Batch | DeviceEvent]


def settings(**other: Any) -> EncoderBus:
    table = {"driver": "cia406", "port": "p", "a_node": 3, "b_node": 4, "shaft_node": 5, "rate_Hz": 100, **other}
    return EncoderBus.model_validate(table)


def identity(positions: int = 4096) -> dict[str, int]:
    return {
        f"{name}_{key}": value
        for name in ("a", "b", "shaft")
        for key, value in (("positions", positions), ("counter_clockwise", 1))
    }


def report(node: int, position: int) -> bytes:
    return encode(CanFrame(0x180 + node, struct.pack("<I", position)))


class Line:
    """A pipeline on a bus with a SYNC each 10 ms, and what it has returned."""

    def __init__(self, **other: Any) -> None:
        self.pipeline = EncoderPipeline("encoders", settings(**other), identity())
        self.now_ms = 0.0
        self.items: Items = []
        self.at(0, TX, open_bus(500_000))

    def at(self, ms: float, direction: int, data: bytes) -> None:
        self.items += self.pipeline.feed(direction, data, round((self.now_ms + ms) * MS))

    def period(self, *reports: bytes, after_ms: float = 1.0) -> None:
        self.at(0.0, TX, SYNC)
        for data in reports:
            self.at(after_ms, RX, data)
        self.now_ms += 10.0

    def all_answer(self, position: int = 100) -> None:
        self.period(report(3, position), report(4, position) + report(5, position))

    def batches(self, topic: str = "pendulums") -> list[Batch]:
        return [item for item in self.items if isinstance(item, Batch) and item.channel.topic == topic]

    def events(self, *kinds: str) -> list[DeviceEvent]:
        return [item for item in self.items if isinstance(item, DeviceEvent) and (not kinds or item.kind in kinds)]

    @property
    def losses(self) -> dict[str, int]:
        return {kind: count for kind, count in self.pipeline.losses.items() if count}


# --- bytes -------------------------------------------------------------------------------------------------------


def test_bytes_of_the_standards() -> None:
    assert wire.SYNC == SYNC
    assert wire.network_command(0x01, 3) == tx(b"t00020103\r")
    assert wire.network_command(0x80, 127) == tx(b"t0002807F\r")
    assert wire.position(bytes.fromhex("D2040000")) == 1234
    assert wire.position(bytes.fromhex("FFFFFFFF00")) == 2**32 - 1
    assert wire.position(b"\x01\x02\x03") is None
    assert wire.POSITION_MAPPED == 0x60040020
    assert wire.PROFILE == 0x196


@given(st.binary(max_size=8))
def test_a_position_is_the_first_four_bytes_least_significant_first(data: bytes) -> None:
    expected = int.from_bytes(data[:4], "little") if len(data) >= 4 else None
    assert wire.position(data) == expected


@given(st.lists(st.integers(-2047, 2047), min_size=1, max_size=60), st.integers(0, 4095), st.sampled_from([1, -1]))
def test_positions_are_continuous_over_revolutions(steps: list[int], zero: int, sign: int) -> None:
    turns, raw, counts = Turns(4096, zero, sign), zero, 0
    for step in steps:
        raw += step
        counts += sign * step
        assert turns.counts(raw % (4096 * 4096)) == counts


def test_the_opening_writes_what_the_standards_define() -> None:
    bench = DriverBench(DRIVER)
    bench.driver.open("encoders", bench.settings, bench)
    sent = b"".join(data for direction, data, _ in bench.reads if direction == TX)
    lines = HostText().sent(sent).split(b"\r")
    assert lines[:4] == [b"", b"C", b"S6", b"O"]
    assert [line for line in lines if line.startswith(b"t000")] == [
        *(f"t000280{node:02X}".encode() for node in (3, 4, 5)),
        *(f"t000201{node:02X}".encode() for node in (3, 4, 5)),
    ]
    written = [line for line in lines if line.startswith(b"t60382")]
    assert written == [
        b"t60382B171000C8000000",  # heartbeat each 200 ms
        b"t60382301180183020080",  # TPDO2 off
        b"t60382300180183010080",  # TPDO1 off
        b"t60382F00180201000000",  # at each SYNC
        b"t60382300180183010000",  # TPDO1 on
    ]


# --- samples with SYNC -------------------------------------------------------------------------------------------


def test_a_sample_has_the_time_of_its_sync_and_both_angles() -> None:
    line = Line(sync_delay_s=0.0005, a_zero_counts=24)
    line.all_answer(1048)
    (batch,) = line.batches()
    assert batch.time_ns.tolist() == [500_000]
    assert batch.columns["theta3_rad"][0] == pytest.approx(math.pi / 2)
    assert batch.columns["theta4_rad"][0] == pytest.approx(1048 / 4096 * 2 * math.pi)
    assert (batch.columns["count_a"][0], batch.columns["count_b"][0]) == (1024, 1048)
    assert line.losses == {}


@pytest.mark.parametrize("missing", [(3,), (4,), (3, 4)])
def test_missing_reports_are_counted_exactly(missing: tuple[int, ...]) -> None:
    line = Line()
    line.all_answer()
    for _ in range(2):
        line.period(*(report(node, 100) for node in (3, 4, 5) if node not in missing))
    line.all_answer()
    line.at(0, RX, b"")  # the end of the log
    assert line.losses == {"samples": 2, "reports": 2 * len(missing)}
    assert [int(batch.sequence[0]) for batch in line.batches()] == [0, 3]
    (gap,) = line.events("gap")
    assert gap.facts["samples"] == 2
    assert gap.facts["span_s"] == pytest.approx(0.02)


def test_a_missing_report_of_the_shaft_is_no_missing_sample() -> None:
    line = Line()
    line.period(report(3, 1), report(4, 1))
    line.all_answer()
    assert line.losses == {"reports": 1}
    assert len(line.batches()) == 2
    assert [event.kind for event in line.events()] == ["gap"]


def test_an_encoder_that_does_not_answer_is_reported_once_until_it_answers_again() -> None:
    line = Line()
    for _ in range(60):
        line.period(report(3, 1), report(5, 1))
    line.all_answer()
    for _ in range(19):  # 0.2 s are not over: a busy host
        line.period(report(3, 1), report(5, 1))
    assert len(line.events("network")) == 1
    for _ in range(4):
        line.period(report(3, 1), report(5, 1))
    found = line.events("network")
    assert [event.facts["encoder"] for event in found] == ["b", "b"]
    assert found[0].text == "encoder b (node 4) has not answered 21 SYNCs: it gives no position"


def test_an_adapter_that_refuses_frames_is_named_as_the_cause() -> None:
    line = Line()
    line.at(0, RX, rx(b"\a"))  # of an earlier frame
    line.all_answer()
    line.all_answer()
    for _ in range(4):
        line.at(0, TX, SYNC)
        line.at(1, RX, rx(b"\a"))
        line.now_ms += 200
    found = line.events("network")
    assert len(found) == 3
    assert all(
        "has not answered 3 SYNCs: the adapter has refused 3 lines since the last answer" in e.text for e in found
    )


def turning(late_ms: dict[int, float], read_ms: dict[int, float] | None = None, **other: Any) -> Line:
    """Three seconds at 1000 rpm.

    Args:
        late_ms: delay of the SYNC on the bus after the host's write, by its number, ms.
        read_ms: delay of the host's read after the reports, by the number of the SYNC, ms; others 1 ms.
    """
    line = Line(**other)
    for number in range(300):
        late = late_ms.get(number, 0.0)
        shaft = round((line.now_ms + late) * 1e-3 * 1000 / 60 * 4096) % 4096
        after_ms = late + (read_ms or {}).get(number, 1.0)
        line.period(report(3, 100) + report(4, 200) + report(5, shaft), after_ms=after_ms)
    return line


def speeds_rpm(line: Line) -> np.ndarray:
    return 60e9 / np.diff(np.concatenate([batch.time_ns for batch in line.batches("tacho")]))


LATE_MS = {12: 8.0, 126: 7.0, 240: 6.5}  # at index marks


def test_a_sync_that_leaves_late_is_no_other_speed() -> None:
    line = turning(LATE_MS)
    assert len(speeds_rpm(line)) == 48
    np.testing.assert_allclose(speeds_rpm(line), 1000.0, rtol=2e-3)
    assert line.losses == {"samples": 3, "late": 3}
    assert [event.facts["samples"] for event in line.events("gap") if "samples" in event.facts] == [1, 1, 1]
    assert [event.text.partition(",")[0] for event in line.events("gap") if "late" in event.facts] == [
        "a SYNC was answered after 9.0 ms",
        "a SYNC was answered after 8.0 ms",
        "a SYNC was answered after 7.5 ms",
    ]
    assert all("usually after 1.0 ms" in event.text for event in line.events("gap") if "late" in event.facts)
    assert np.ptp(speeds_rpm(turning(LATE_MS, max_lateness_s=0.02))) > 100.0, "what the limit prevents"


def test_a_report_after_a_prompt_one_is_of_the_same_instant() -> None:
    line = Line()
    line.at(10, TX, SYNC)
    line.at(11, RX, report(3, 100))
    line.at(19, RX, report(4, 200))
    assert [int(batch.time_ns[0]) for batch in line.batches()] == [10 * MS]
    assert line.losses == {}


def test_a_late_sync_that_an_encoder_has_not_answered_is_one_missing_sample() -> None:
    line = turning({})
    line.period(report(3, 100) + report(5, round((line.now_ms + 8.0) * 1e-3 * 1000 / 60 * 4096) % 4096), after_ms=9.0)
    line.all_answer()
    line.at(0, RX, b"")
    assert line.losses == {"reports": 1, "samples": 1, "late": 1}
    assert line.events("gap")[-1].facts["samples"] == 1


def test_answers_that_are_only_read_late_lose_nothing() -> None:
    prompt, late = turning({}), turning({}, dict.fromkeys(range(20, 300, 5), 8.0))
    assert late.losses == prompt.losses == {}
    assert [batch.time_ns.tolist() for batch in late.batches()] == [
        batch.time_ns.tolist() for batch in prompt.batches()
    ]
    assert speeds_rpm(late).tolist() == speeds_rpm(prompt).tolist()


def test_late_syncs_are_answered_and_reported_once_a_second() -> None:
    line = turning({number: 6.0 for number in range(20, 300) if number % 10 >= 7})
    assert sum(len(batch.time_ns) for batch in line.batches()) == 300 - 84
    assert line.losses == {"samples": 84, "late": 84}
    assert line.events("network") == []
    assert len([event for event in line.events("gap") if "late" in event.facts]) == 3
    assert [event.facts["samples"] for event in line.events("gap") if "samples" in event.facts] == [3] * 27
    np.testing.assert_allclose(speeds_rpm(line), 1000.0, rtol=2e-3)


@pytest.mark.parametrize("usual_ms", [0.5, 9.0])
def test_an_adapter_that_is_always_slow_is_not_late(usual_ms: float) -> None:
    late = {number: usual_ms - 0.4 + 0.9 * (number % 2) for number in range(300)}
    line = turning(late, dict.fromkeys(range(300), 0.4))
    assert line.losses == {}
    np.testing.assert_allclose(speeds_rpm(line), 1000.0, rtol=2e-2)


def test_noise_at_rest_is_no_late_sync() -> None:
    rng, line = np.random.default_rng(1), Line()
    for number in range(3000):
        after_ms = 9.0 if number % 50 == 49 else 1.0
        line.period(report(3, 100) + report(4, 200) + report(5, int(rng.integers(100, 103))), after_ms=after_ms)
    assert line.losses == {}


def test_what_is_usual_follows_the_adapter() -> None:
    """The shaft turns further at each of these SYNCs, since it is not sampled in between."""
    line = turning({number: 4.0 * (number >= 60) for number in range(300)}, max_lateness_s=0.002)
    numbers = np.concatenate([batch.sequence for batch in line.batches()])
    assert set(range(300)) - set(map(int, numbers)) == set(range(60, 75))  # until half of the newest 31 are slow


def test_angles_that_wait_for_a_report_of_the_shaft_come_without_it() -> None:
    line = turning({})
    line.period(report(3, 100) + report(4, 200), after_ms=8.0)  # read late, or left late: not known
    assert len(line.batches()) == 300
    line.all_answer()
    assert len(line.batches()) == 302
    line.period(report(3, 100) + report(4, 200), after_ms=8.0)
    line.at(0, RX, b"")  # the end of the log
    assert len(line.batches()) == 303
    assert "late" not in line.losses


def test_a_report_without_a_sync_or_too_late_gives_no_sample() -> None:
    line = Line()
    line.at(0, RX, report(3, 5))  # before any SYNC: its own was sent before the log began
    line.period(report(3, 100), report(3, 200), report(4, 100), report(5, 100))  # A twice
    line.period(report(3, 7), report(4, 7), report(5, 7), after_ms=1e3 * LATEST_S + 1)
    assert line.losses == {"unasked": 4}
    assert [int(batch.columns["count_a"][0]) for batch in line.batches()] == [100]
    assert len(line.events("damage")) == 4


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (report(3, 4096), "position 4096, expected less than 4096"),
        (rx(b"t18330102" + b"03\r"), "a report of 3 bytes, expected 4"),
        (rx(b"t1830\r"), "a report of 0 bytes"),
    ],
)
def test_an_impossible_report_is_dropped(data: bytes, words: str) -> None:
    line = Line()
    line.period(data, report(4, 1), report(5, 1))
    assert line.losses == {"invalid": 1}
    assert words in line.events("damage")[0].text
    assert line.batches() == []


def test_reports_of_other_nodes_and_kinds_are_ignored() -> None:
    line = Line()
    line.period(report(9, 1), rx(b"T00000183401000000\rr1834\rt1010\r"), report(3, 1) + report(4, 1))
    assert line.losses == {}
    assert len(line.batches()) == 1


def test_a_session_that_only_receives_takes_the_sync_of_the_bus() -> None:
    pipeline = EncoderPipeline("encoders", settings(), {})
    items: Items = []
    for number in range(3):
        items += pipeline.feed(RX, SYNC + report(3, 70_000) + report(4, 1) + report(5, 1), number * PERIOD_NS)
    times = [int(item.time_ns[0]) for item in items if isinstance(item, Batch)]
    assert times == pytest.approx([0, PERIOD_NS, 2 * PERIOD_NS], abs=1)
    assert set(pipeline.losses.values()) == {0}


@pytest.mark.parametrize(
    ("positive", "counter_clockwise", "sign"), [("cw", 0, 1), ("ccw", 1, 1), ("cw", 1, -1), ("ccw", 0, -1)]
)
def test_the_sign_follows_the_code_sequence_of_the_encoder(positive: str, counter_clockwise: int, sign: int) -> None:
    known = {**identity(), "a_counter_clockwise": counter_clockwise}
    pipeline = EncoderPipeline("encoders", settings(a_positive=positive), known)
    pipeline.feed(TX, SYNC, 0)
    items = pipeline.feed(RX, report(3, 10) + report(4, 10), MS)
    (batch,) = [item for item in items if isinstance(item, Batch)]
    assert int(batch.columns["count_a"][0]) == 10 * sign


@pytest.mark.parametrize("positions", [0, 4097, -4096, "4096", 2**40, True])
def test_an_impossible_identity_is_refused(positions: object) -> None:
    with pytest.raises(DeviceError, match="encoder b: expected a number of positions"):
        EncoderPipeline("encoders", settings(), {"b_positions": positions})


# --- network state -----------------------------------------------------------------------------------------------


def test_an_encoder_that_starts_again_gives_no_samples_until_the_rig_is_opened() -> None:
    line = Line()
    line.all_answer()
    line.at(0, RX, rx(b"t7041" + b"00\r"))
    line.all_answer()
    (restart,) = line.events("restart")
    assert "encoder b (node 4) started again" in restart.text
    assert "started again" in line.pipeline.status.complaint
    assert len(line.batches()) == 1
    assert line.losses == {"invalid": 1}


def test_network_states_and_lost_heartbeats_are_reported() -> None:
    line = Line(heartbeat_ms=50)
    line.at(0, RX, rx(b"t7031" + b"05\r"))  # operational: expected
    line.all_answer()
    line.at(0, RX, rx(b"t7031" + b"04\r" + b"t7031" + b"09\r" + b"t7030\r"))
    for _ in range(40):
        line.all_answer()
    line.at(0, RX, rx(b"t7031" + b"85\r"))  # with the toggle bit
    texts = [event.text for event in line.events("network")]
    assert len(texts) == 3
    assert texts[0] == "encoder a (node 3): network state STOPPED: it reports no position"
    assert texts[1].startswith("encoder a (node 3): no heartbeat for 0.2 s")
    assert texts[2] == "encoder a (node 3): network state OPERATIONAL"
    assert line.losses == {"heartbeats": 1}


def test_an_emergency_sets_the_flag_of_its_pendulum_until_it_ends() -> None:
    line = Line()
    line.at(0, RX, rx(b"t0838" + b"0050" + b"21" + b"0102000000\r"))
    line.all_answer()
    line.at(0, RX, rx(b"t0838" + bytes(8).hex().encode() + b"\r"))
    line.all_answer()
    line.at(0, RX, rx(b"t0834" + b"00500000\r"))  # too short
    flags = [int(batch.columns["flags"][0]) for batch in line.batches()]
    assert flags == [channels.ENCODER_FAULT_A, 0]
    began, ended = line.events("emergency")
    assert began.facts == {"encoder": "a", "error_code": 0x5000, "register": 0x21, "maker_bytes": "01 02 00 00 00"}
    assert DRIVER.words(began) == "of encoder a: 0x5000, device hardware"
    assert DRIVER.words(ended) == ""


# --- index marks -------------------------------------------------------------------------------------------------


def marks_of(positions: list[float], step_ns: int = PERIOD_NS) -> list[tuple[int, float]]:
    """Return the marks of positions in revolutions: revolution, and time in steps."""
    marks, out = Marks(4096, step_ns), list[tuple[int, float]]()
    for number, position in enumerate(positions):
        time_ns = number * step_ns
        counts = round(position * 4096)
        out += [(edge, at / step_ns) for edge, at, _ in marks.feed(Instant(number, time_ns, time_ns), counts)]
    return out


def test_a_mark_is_interpolated_between_two_positions() -> None:
    assert marks_of([-0.25, -0.125, 0.375, 0.75]) == [(0, pytest.approx(1.25))]
    assert marks_of([-0.25, 0.0, 0.25]) == [(0, pytest.approx(1.0))]
    assert marks_of([0.25, 0.125, -0.125]) == [(0, pytest.approx(1.5))]  # the other direction


def test_a_position_that_flickers_at_the_mark_gives_one_mark() -> None:
    assert len(marks_of([-0.01, 0.01, -0.01, 0.01, -0.001, 0.001])) == 1
    assert len(marks_of([-0.01, 0.01, 0.2, 0.01, -0.01])) == 2


@given(st.floats(-0.4, 0.4).filter(lambda speed: abs(speed) > 0.02), st.floats(0.05, 0.95))
def test_every_revolution_has_its_mark(speed: float, begin: float) -> None:
    """Constant speed, revolutions for each step; ± one count."""
    positions = [begin + speed * number for number in range(40)]
    found = marks_of(positions)
    first, last = sorted((positions[0], positions[-1]))
    sure = [edge for edge in range(math.ceil(first), math.floor(last) + 1) if first + 1e-3 < edge < last - 1e-3]
    assert [edge for edge, _ in found if edge in sure] == (sure if speed > 0 else sure[::-1])
    for edge, at in found:
        assert begin + speed * at == pytest.approx(edge, abs=2e-3)


def test_missing_positions_are_bridged_with_the_speed_before() -> None:
    marks = Marks(4096, PERIOD_NS)
    out: list[int] = []
    for number in [*range(6), *range(12, 14)]:  # 0.3 revolutions each; 6 steps missing: 2.1 revolutions
        out += [edge for edge, _, _ in marks.feed(Instant(number, number * PERIOD_NS, 0), round(4096 * 0.3 * number))]
    assert out == [1, 2, 3]
    again = marks.feed(Instant(500, 500 * PERIOD_NS, 0), 100)
    assert again == []  # too long ago


def test_gaps_in_quick_succession_are_bridged_with_the_last_known_speed() -> None:
    marks = Marks(4096, PERIOD_NS)
    out: list[tuple[int, int]] = []
    for number in [*range(8), *range(15, 17), *range(24, 26), *range(33, 35)]:  # 0.3 revolutions each
        instant = Instant(number, number * PERIOD_NS, 0)
        out += [(edge, at_ns) for edge, at_ns, _ in marks.feed(instant, round(4096 * 0.3 * number))]
    assert [edge for edge, _ in out] == list(range(1, 11))
    assert [at_ns for _, at_ns in out] == pytest.approx([edge / 0.3 * PERIOD_NS for edge, _ in out], rel=2e-3)


def test_an_instant_that_is_wrong_does_not_become_the_speed() -> None:
    """One sample 4.9 ms late, a tenth of a revolution each 5 ms."""
    marks, out = Marks(4096, 5 * MS), list[int]()
    for number in range(60):
        time_ns = number * 5 * MS + (4_900_000 if number == 20 else 0)
        out += [edge for edge, _, _ in marks.feed(Instant(number, time_ns, 0), round(409.6 * number + 100))]
    assert out == list(range(1, 6))


def test_an_impossible_speed_gives_no_flood_of_marks() -> None:
    marks = Marks(4096, PERIOD_NS)
    for number in range(12):
        marks.feed(Instant(number, number, number), 2000 * number)
    assert len(marks.feed(Instant(20, 900_000_000, 0), 0)) <= 1000


# --- own timers --------------------------------------------------------------------------------------------------


def timed(arrivals_ms: list[float], delay_ns: int = 0) -> tuple[list[int], list[float], OwnTimer]:
    timer = OwnTimer(PERIOD_NS, delay_ns)
    found = [each for at in arrivals_ms for each in timer.feed((1,), round(at * MS))] + timer.end()
    return [instant.number for instant, _ in found], [instant.time_ns / MS for instant, _ in found], timer


def test_missing_reports_of_a_timer_are_whole_periods() -> None:
    numbers, times, timer = timed([0, 10, 20, *range(50, 150, 10)])
    assert numbers == [0, 1, 2, *range(5, 15)]
    assert timer.missing == 2
    assert times == pytest.approx([10.0 * number for number in numbers], abs=0.2)


def test_delayed_reports_are_not_missing() -> None:
    numbers, times, timer = timed([0, 10, 20, 75, 75, 75, 75, 75, 80, 90])
    assert numbers == list(range(10))
    assert timer.missing == 0
    assert times == pytest.approx([10.0 * number for number in numbers], abs=0.2)


def test_a_delayed_report_after_missing_ones_does_not_add_to_them() -> None:
    numbers, _, timer = timed([0, 10, 20, 61, 61, *range(70, 160, 10)])
    assert timer.missing == 2
    assert numbers == [0, 1, 2, *range(5, 16)]


def test_a_timer_may_be_slow() -> None:
    arrivals = [number * 10.005 + (3.0 if number % 7 else 0.0) for number in range(2000)]
    numbers, times, timer = timed(arrivals)
    assert numbers == list(range(2000))
    assert timer.missing == 0
    assert max(abs(time - 10.005 * number) for number, time in zip(numbers, times, strict=True)) < 3.1


def free(**other: Any) -> EncoderPipeline:
    return EncoderPipeline("encoders", settings(sync=False, **other), identity())


def test_without_sync_a_sample_has_the_newest_position_of_b() -> None:
    pipeline, items = free(sync_delay_s=0.002), list[Batch | DeviceEvent]()
    for number in range(4):
        items += pipeline.feed(RX, report(4, 10 * number), number * PERIOD_NS)
        items += pipeline.feed(RX, report(3, 20 * number), number * PERIOD_NS + 3 * MS)
    batches = [item for item in items if isinstance(item, Batch)]
    assert [int(batch.columns["count_b"][0]) for batch in batches] == [0, 10, 20, 30]
    assert [int(batch.columns["count_a"][0]) for batch in batches] == [0, 20, 40, 60]
    assert [int(batch.time_ns[0]) for batch in batches] == pytest.approx(
        [number * PERIOD_NS + MS for number in range(4)], abs=0.1 * MS
    )
    assert [int(batch.columns["node_time_us"][0]) for batch in batches] == [0, 10_000, 20_000, 30_000]
    assert set(pipeline.losses.values()) == {0}


@pytest.mark.parametrize(("node", "samples", "counted"), [(3, 4, 4), (4, 3, 4), (5, 0, 4)])
def test_without_sync_missing_reports_are_counted_by_time(node: int, samples: int, counted: int) -> None:
    pipeline, items = free(), list[Batch | DeviceEvent]()
    for number in range(40):
        for each in (4, 3, 5):
            if each != node or not 20 <= number < 24:
                items += pipeline.feed(RX, report(each, 7), number * PERIOD_NS + each * 100_000)
    items += pipeline.feed(RX, b"", 41 * PERIOD_NS)
    losses = {kind: count for kind, count in pipeline.losses.items() if count}
    assert losses == {"reports": counted, **({"samples": samples} if samples else {})}
    gaps = [item for item in items if isinstance(item, DeviceEvent) and item.kind == "gap"]
    assert sum(gap.facts.get("samples", 0) for gap in gaps) == samples
    assert len(gaps) >= 1
    assert len([item for item in items if isinstance(item, Batch)]) == 40 - samples


# --- the opening -------------------------------------------------------------------------------------------------


def bench_of(**other: Any) -> tuple[DriverBench, SimulatedEncoders]:
    other = replace(DRIVER, example={"a_node": 3, "b_node": 4, "shaft_node": 5, **other})

    bench = DriverBench(other)
    assert isinstance(bench.far, SimulatedEncoders)
    return bench, bench.far


def put(index: int, sub: int, value: int, form: str = "<I") -> Callable[[SimulatedEncoders], None]:
    def change(far: SimulatedEncoders) -> None:
        far.encoders[1].objects[index, sub] = (value, form)

    return change


def without(index: int, sub: int) -> Callable[[SimulatedEncoders], None]:
    def change(far: SimulatedEncoders) -> None:
        del far.encoders[1].objects[index, sub]

    return change


def dead(far: SimulatedEncoders) -> None:
    far.fail("dead", 2)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (put(0x1000, 0, 0x00020192), "node 4 is no encoder.*profile 402, expected the profile 406"),
        (without(0x1000, 0), "node 4 is no encoder.*is nothing"),
        (put(0x6001, 0, 8192), "encoder b .node 4. counts 8192 a revolution, the rig file states 4096"),
        (put(0x6002, 0, 4096 * 3 + 1), "counts 4096 a revolution and 12289 in all: expected whole revolutions"),
        (put(0x6001, 0, 0), "counts 0 a revolution"),
        (without(0x1800, 2), "encoder b: refused 1 at 1800h sub 2.*type None, which cannot be changed"),
        (dead, "encoder b: no answer to reading 1000h"),
    ],
)
def test_an_encoder_that_contradicts_the_rig_file_is_refused(
    change: Callable[[SimulatedEncoders], None], words: str
) -> None:
    bench, far = bench_of()
    change(far)
    with pytest.raises(DeviceError, match=words):
        bench.begin()


def test_an_exchanged_encoder_is_refused() -> None:
    bench, far = bench_of(b_serial=77)
    far.encoders[1].objects[0x1018, 4] = (78, "<I")
    with pytest.raises(DeviceError, match="has serial number 78, the rig file states 77"):
        bench.begin()


def test_serial_numbers_are_in_the_identity() -> None:
    bench, _ = bench_of(b_serial=77)
    bench.begin()
    assert bench.identity["serial"] == "1003/77/1005"


def test_an_encoder_without_scaling_counts_with_its_own_resolution() -> None:
    bench, far = bench_of()
    objects = far.encoders[0].objects
    objects[0x6000, 0], objects[0x6001, 0], objects[0x6502, 0] = (0, "<H"), (999, "<I"), (16, "<H")
    bench.begin()
    assert bench.identity["a_positions"] == 16 * 4096


def test_another_mapping_is_corrected_and_optional_objects_may_be_missing() -> None:
    bench, far = bench_of()
    objects = far.encoders[0].objects
    objects[0x1A00, 1], objects[0x1005, 0] = (0x60300110, "<I"), (1 << 30 | 0x80, "<I")
    del objects[0x1017, 0], far.encoders[1].objects[0x1801, 1]
    bench.begin()
    bench.clock.wait(0.3)
    assert objects[0x1A00, 1][0] == 0x60040020
    assert objects[0x1005, 0][0] == 0x80
    assert sum(isinstance(item, Batch) for item in bench.items) > 30


@pytest.mark.parametrize("without_cyclic_timer", [False, True])
def test_without_sync_the_timer_is_set(without_cyclic_timer: bool) -> None:
    bench, far = bench_of(sync=False, rate_Hz=50)
    objects = far.encoders[0].objects
    objects[0x1800, 3] = (500, "<H")
    if without_cyclic_timer:
        del objects[0x6200, 0]
    bench.begin()
    assert [objects[0x1800, sub][0] for sub in (2, 3, 5)] == [254, 0, 20]


# --- a device on the bench ---------------------------------------------------------------------------------------


def run(fault: str, value: int, seconds: float = 1.0) -> DriverBench:
    bench, far = bench_of()
    bench.begin()
    bench.clock.wait(0.5)
    far.fail(fault, value)
    bench.clock.wait(seconds)
    return bench


def kinds(bench: DriverBench) -> set[str]:
    return {item.kind for item in bench.items if isinstance(item, DeviceEvent)}


def test_syncs_that_an_encoder_does_not_answer_are_counted_exactly() -> None:
    bench = run("missed", 2)
    assert bench.pipeline.losses["samples"] == bench.pipeline.losses["reports"] == 2
    sequence = [
        int(item.sequence[0]) for item in bench.items if isinstance(item, Batch) and item.channel is channels.PENDULUMS
    ]
    assert sequence[-1] + 1 - len(sequence) == 2


def test_a_dead_encoder_does_not_slow_down_the_others() -> None:
    bench = run("dead", 2, 2.0)
    syncs = [host_ns for direction, data, host_ns in bench.reads if direction == TX and data == SYNC]
    last = syncs[-1]
    assert sum(last - each < 1_000_000_000 for each in syncs) > 180
    texts = [item.text for item in bench.items if isinstance(item, DeviceEvent) and item.kind == "network"]
    assert any("encoder b (node 4) has not answered" in text for text in texts)
    assert any("encoder b (node 4): no heartbeat" in text for text in texts)


@pytest.mark.parametrize(("fault", "value", "kind"), [("restart", 2, "restart"), ("stopped", 1, "network")])
def test_an_encoder_that_leaves_operation_is_reported(fault: str, value: int, kind: str) -> None:
    bench = run(fault, value)
    assert kind in kinds(bench)
    batches = [item for item in bench.items if isinstance(item, Batch)]
    assert len(batches) < 130


def test_a_second_sender_of_sync_is_a_fault() -> None:
    bench = run("second master", 1)
    assert "fault" in kinds(bench)
    assert bench.pipeline.losses["foreign_syncs"] > 10


def test_an_emergency_and_a_supply_that_returns_are_reported() -> None:
    bench = run("emergency", 0x5000)
    assert "emergency" in kinds(bench)
    checks = bench.driver.checks(
        bench.settings, bench.pipeline, None, [item for item in bench.items if isinstance(item, DeviceEvent)]
    )
    assert not checks["emergencies"].passed
    assert checks["missing reports"].passed
    bench, far = bench_of()
    bench.begin()
    far.power(False, bench.clock.now_s())
    bench.clock.wait(0.2)
    far.power(True, bench.clock.now_s())
    bench.clock.wait(0.2)
    assert sum(isinstance(i, DeviceEvent) and i.kind == "restart" for i in bench.items) == 3


def test_a_frozen_position_and_unknown_faults() -> None:
    bench = run("frozen", 1)
    counts = [
        int(item.columns["count_a"][0])
        for item in bench.items
        if isinstance(item, Batch) and item.channel is channels.PENDULUMS
    ]
    assert len(set(counts[-50:])) == 1
    assert isinstance(bench.far, SimulatedEncoders)
    with pytest.raises(ValueError, match="no fault 'burnt'"):
        bench.far.fail("burnt", 1)
    far = SimulatedEncoders.of("e", settings(shaft_node=None), bench.world)
    with pytest.raises(ValueError, match="2 encoders, no number 3"):
        far.fail("restart", 3)


def test_the_next_sync_waits_for_all_answers() -> None:
    bench, _ = bench_of()
    sent: list[tuple[float, bytes]] = []
    sender = SyncSender(settings(), lambda data: sent.append((bench.clock.now_s(), data)), bench.clock)
    sender.start()
    bench.clock.wait(0.1)
    assert [data for _, data in sent] == [SYNC]
    sender.heard(report(3, 1) + report(4, 1))
    bench.clock.wait(0.05)
    assert len(sent) == 1
    sender.heard(report(5, 1)[:6])
    sender.heard(report(5, 1)[6:])
    assert len(sent) == 2
    bench.clock.wait(2 * LATEST_S + 0.02)
    assert len(sent) == 3
    sender.stop()
    bench.clock.wait(1.0)
    assert len(sent) == 3


# --- settings and the stand-in -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("other", "words"),
    [
        ({"b_node": 3}, "a node number of its own"),
        ({"shaft_node": 4}, "a node number of its own"),
        ({"locks": True}, "command no locks"),
        ({"rate_Hz": 300}, "baud = 115200 carries 230 samples a second of 3 encoders"),
        ({"rate_Hz": 500, "baud": 1_000_000, "bitrate": 125_000}, "bitrate = 125000 carries"),
        ({"sync": False, "rate_Hz": 150}, "whole milliseconds"),
        ({"a_zero_counts": 4096}, "a_zero_counts = 4096: expected less than a revolution"),
        ({"a_node": 128}, "a_node"),
    ],
)
def test_impossible_settings_are_refused(other: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        settings(**other)


def test_roles_follow_the_encoders() -> None:
    with_shaft, without_shaft = settings(), settings(shaft_node=None)
    assert [type(role) for role in with_shaft.roles("e")] == [PendulumAngles, RotorPhase]
    assert [type(role) for role in without_shaft.roles("e")] == [PendulumAngles]
    assert not any(isinstance(role, PendulumLocks) for role in with_shaft.roles("e"))
    assert [channel.topic for channel in DRIVER.occasional(without_shaft)] == []


def test_the_sync_of_a_new_host_replaces_that_of_the_log() -> None:
    played = PlayedEncoders(settings(), identity())
    assert not played.sending
    played.begin()
    assert played.play(TX, SYNC) + played.play(RX, report(3, 1)) == SYNC + report(3, 1)
    assert played.hear(SYNC) == b""
    assert played.commands == 0
    assert played.play(TX, SYNC) == b""
    assert played.hear(tx(b"t00028104\r")) == rx(b"t704100\r")
    assert not played.sending
    assert played.commands == 1


@pytest.mark.parametrize("key", ["a_serial", "b_positions", "shaft_maker"])
def test_an_impossible_identity_of_a_log_is_refused(key: str) -> None:
    with pytest.raises(LogError, match="expected numbers of 32 bits"):
        PlayedEncoders(settings(), {**identity(), key: "x"})


_OWN_TIMERS = replace(DRIVER, example={"a_node": 3, "b_node": 4, "shaft_node": 5, "sync": False, "rate_Hz": 100})


_OTHER_SENSE = replace(
    DRIVER,
    example={
        "a_node": 30,
        "b_node": 4,
        "shaft_node": 127,
        "rate_Hz": 50,
        "counts_per_revolution": 8192,
        "a_positive": "cw",
        "shaft_positive": "cw",
        "b_zero_counts": 77,
        "shaft_zero_counts": 8191,
        "index_angle_deg": 30.0,
    },
)


@pytest.mark.parametrize("case", kit_cases((_OWN_TIMERS, _OTHER_SENSE)))
def test_every_way_of_sampling_passes_the_tests_of_drivers(case: rig_testing.ContractCase) -> None:
    case()


def test_times_of_marks_with_sync_are_those_of_the_shaft() -> None:
    """A shaft at 5 revolutions a second, sampled each 10 ms."""
    line = Line()
    for number in range(100):
        position = round(4096 * (0.05 * number + 0.013)) % 4096
        line.period(report(3, 1), report(4, 1), report(5, position))
    marks = line.batches("tacho")
    times_s = np.array([int(mark.time_ns[0]) for mark in marks]) * 1e-9
    expected = (np.arange(1, len(marks) + 1) - 0.013) / 5
    assert len(marks) == 4
    assert np.allclose(times_s, expected, atol=1e-4)
    assert [int(mark.columns["revolutions"][0]) for mark in marks] == [1, 2, 3, 4]


# --- a session ---------------------------------------------------------------------------------------------------

ENCODERS = """[devices.encoders]
driver = "cia406"
port = "p"
a_node = 3
b_node = 4
shaft_node = 6
a_zero_counts = 1234
counts_per_revolution = 4096
rate_Hz = 200

"""


def test_a_session_samples_both_angles_and_its_log_is_decoded_again_to_the_same(tmp_path: Path) -> None:
    text = (resources.files("rig_configs") / "virtual.toml").read_text()
    begin = text.index("[devices.encoder]")
    file = tmp_path / "rig.toml"
    file.write_text(text[:begin] + ENCODERS + text[text.index("[devices.drive]") :])
    sim = LockstepRig(load_rig(file, settings=["virtual.seed=4"]))
    session = Session(load_rig(file, settings=["virtual.seed=4", *sim.port_settings()]), sim.clock, edge=sim.edge)
    log = tmp_path / "a.mcap"
    with session:
        session.start_recording(log, {"test": "record"})
        sim.clock.wait(4.0)
        session.stop_recording({})
    assert [row.topic for row in check(log) if row.difference] == []
    with open_log(log) as opened:
        found = opened["pendulums"]
        syncs = [chunk for chunk in opened.raw("encoders") if chunk.direction == TX]
    assert len(found.time_ns) == pytest.approx(800, abs=4)
    assert len(syncs) == pytest.approx(800, abs=4)
    assert np.degrees(np.mean(found["theta3_rad"])) == pytest.approx(0.0, abs=0.5)
    assert np.degrees(np.mean(np.abs(found["theta4_rad"]))) == pytest.approx(180.0, abs=0.5)

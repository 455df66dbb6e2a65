"""Polled displacement sensors: texts of the dialects, the pipeline's times and losses, and a session in lockstep."""

from __future__ import annotations

import math
import queue
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError

import rig_testing
from daq.drivers.contract import Pipeline
from daq.errors import DeviceError
from daq.items import RX, TX, Batch, DeviceEvent
from daq.lockstep.clock import SimulatedClock
from daq.log import open_log
from daq.replay import check
from daq.signals.run import load_run
from daq.virtual_rig.beam import Beam
from rig_drivers.polled_laser import wire
from rig_drivers.polled_laser.driver import DRIVER
from rig_drivers.polled_laser.far_end import SimulatedPolledLaser
from rig_drivers.polled_laser.poller import NextRequest
from rig_drivers.polled_laser.settings import PolledLaser
from rig_drivers.polled_laser.stream import PolledPipeline
from rig_testing.bench import DriverBench
from tests.daq.kit_cases import kit_cases
from tests.daq.simulated_sessions import recorded_at_rest

MS = 1_000_000


def sensor(**settings: Any) -> PolledLaser:
    table = {"driver": "polled_laser", "port": "p", "axis": "x", "dialect": "LK-G", **settings}
    return PolledLaser.model_validate(table)


def pipeline(**settings: Any) -> PolledPipeline:
    return PolledPipeline("gauge", sensor(**settings), {})


def samples(items: list[Batch | DeviceEvent]) -> list[tuple[int, float]]:
    found = [item for item in items if isinstance(item, Batch)]
    return [(int(b.time_ns[0]), float(b.columns["displacement_m"][0])) for b in found]


def events(items: list[Batch | DeviceEvent]) -> list[str]:
    return [item.kind for item in items if isinstance(item, DeviceEvent)]


@dataclass
class Still:
    """An interval in which nothing moves; implements MotionInterval."""

    time_s: np.ndarray
    rows: np.ndarray = field(default_factory=lambda: np.zeros((2, 10)))

    def at(self, time_s: np.ndarray, value: int, rate: int) -> np.ndarray:
        return np.zeros(len(time_s))


# --- texts -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dialect", "output", "line", "metres"),
    [
        ("LK-G", 1, b"M1,+01.2345", 1.2345e-3),
        ("LK-G", 1, b"M1,-00.0120", -12e-6),
        ("LK-G", 2, b"M2,+1234.56", 1.23456),
        ("LK-G", 1, b"M1,-00001.2", -1.2e-3),
        ("LK-G5000", 1, b"MS,01,+01.2345", 1.2345e-3),
        ("LK-G5000", 12, b"MS,12,-0001.2345", -1.2345e-3),
        ("IL", 0, b"M0,+01.234", 1.234e-3),
        ("IL", 1, b"M0,+01.234,-012.34", -12.34e-3),
        ("HL-G1", 3, b"%03$RMD-0123456**", -12.3456e-3),
        ("HL-G1", 1, b"%01$RMD+0000001" + wire.check_sum(b"%01$RMD+0000001"), 1e-7),
    ],
)
def test_a_value_is_read_in_the_dialect_s_unit(dialect: str, output: int, line: bytes, metres: float) -> None:
    found = wire.DIALECTS[dialect].parse(line, output)
    assert isinstance(found, wire.Reading)
    assert found.value * wire.DIALECTS[dialect].unit_m == pytest.approx(metres, rel=1e-12)


@pytest.mark.parametrize(
    ("dialect", "line", "state"),
    [
        ("LK-G", b"M1,XXXXXXXX", "nothing"),
        ("LK-G", b"M1,+FFFFFFF", "over"),
        ("LK-G", b"M1,-FFFFFFF", "under"),
        ("LK-G5000", b"MS,01,--------", "nothing"),
        ("LK-G5000", b"MS,01,FFFFFFFFF", "over"),
    ],
)
def test_a_text_without_a_value_has_its_state(dialect: str, line: bytes, state: str) -> None:
    found = wire.DIALECTS[dialect].parse(line, 1)
    assert isinstance(found, wire.Reading)
    assert math.isnan(found.value)
    assert found.state == state


@pytest.mark.parametrize(
    ("dialect", "line"),
    [
        ("LK-G", b"M2,+01.2345"),  # another output
        ("LK-G", b"M1,+1.2345"),  # seven characters: something is missing
        ("LK-G", b"M1,+01.2345,+01.2345"),
        ("LK-G", b"M1,+0l.2345"),
        ("LK-G", b"M1"),
        ("LK-G5000", b"MS,02,+01.2345"),
        ("LK-G5000", b"MS,01,+1.2345"),
        ("IL", b"M0"),
        ("IL", b"MS,01,+01.234"),
        ("HL-G1", b"%02$RMD+0000001**"),
        ("HL-G1", b"%01$RMD+000001**"),
        ("HL-G1", b"%01$RMD+0000001"),
    ],
)
def test_a_line_that_is_no_answer_is_not_read(dialect: str, line: bytes) -> None:
    assert wire.DIALECTS[dialect].parse(line, 1) is None


def test_a_refusal_has_its_reason() -> None:
    for dialect in ("LK-G", "LK-G5000", "IL"):
        found = wire.DIALECTS[dialect].parse(b"ER,M1,01", 1)
        assert found == wire.Refusal("M1 refused with code 01: not possible in its present state")
    assert wire.DIALECTS["LK-G"].parse(b"ER,M1,77", 1) == wire.Refusal("M1 refused with code 77: unknown code")
    assert wire.DIALECTS["HL-G1"].parse(b"%01!05**", 1) == wire.Refusal("refused with code 5")


@given(st.sampled_from(sorted(wire.DIALECTS)), st.floats(-99.9, 99.9), st.sampled_from(["", "over", "under"]))
def test_what_the_simulated_sensor_answers_is_read(dialect: str, value: float, state: str) -> None:
    kind = wire.DIALECTS[dialect]
    output = kind.outputs[1]
    scale = 1e-3 / kind.unit_m
    answer = kind.answer(kind.request(output), output, wire.Reading(value * scale if not state else math.nan, state))
    assert answer is not None
    found = kind.parse(answer.rstrip(b"\r\n"), output)
    assert isinstance(found, wire.Reading)
    if not state:
        assert found.value / scale == pytest.approx(value, abs=6e-4)
    elif dialect != "HL-G1":
        assert found.state == state
    assert kind.answer(b"M9\r", output, wire.Reading(0.0)) is None


# --- pipeline ----------------------------------------------------------------------------------------------------


def test_a_sample_has_the_time_between_its_request_and_its_answer() -> None:
    line = pipeline(lever_ratio=2.0, delay_s=0.001)
    assert line.feed(TX, b"M1\r", 100 * MS) == []
    assert events(line.feed(RX, b"M1,+0", 103 * MS)) == []
    found = line.feed(RX, b"1.0000\r", 104 * MS)
    assert samples(found) == [(101 * MS, pytest.approx(0.5e-3))]
    line.feed(TX, b"M1\r", 120 * MS)
    (batch,) = [item for item in line.feed(RX, b"M1,-01.0000\r\n", 122 * MS) if isinstance(item, Batch)]
    assert batch.time_ns.tolist() == [120 * MS]
    assert batch.sequence.tolist() == [1]
    assert set(line.losses.values()) == {0}


def test_samples_are_numbered() -> None:
    line, numbers = pipeline(), list[int]()
    for k in range(5):
        line.feed(TX, b"M1\r", 10 * k * MS)
        for item in line.feed(RX, b"M1,+01.0000\r", (10 * k + 1) * MS):
            numbers += item.sequence.tolist() if isinstance(item, Batch) else []
    assert numbers == [0, 1, 2, 3, 4]


def test_values_may_grow_towards_the_sensor_or_have_another_unit() -> None:
    for settings, metres in (({"positive": "towards"}, -1e-3), ({"unit_m": 1e-6}, 1e-6)):
        line = pipeline(**settings)
        line.feed(TX, b"M1\r", 0)
        assert samples(line.feed(RX, b"M1,+01.0000\r", MS))[0][1] == pytest.approx(metres)


def test_a_request_without_an_answer_is_a_lost_sample_reported_once() -> None:
    line = pipeline()
    line.feed(TX, b"M1\r", 0)
    assert events(line.feed(TX, b"M1\r", 500 * MS)) == ["gap"]
    assert events(line.feed(TX, b"M1\r", 1000 * MS)) == []
    (batch,) = [item for item in line.feed(RX, b"M1,+01.0000\r", 1002 * MS) if isinstance(item, Batch)]
    assert batch.time_ns.tolist() == [1001 * MS]
    assert batch.sequence.tolist() == [2]
    assert line.losses["samples"] == 2
    found = line.feed(RX, b"M1,+01.0000\r", 1003 * MS)  # the answer to a request that was given up
    assert samples(found) == []
    assert line.losses["unasked"] == 1


def test_times_increase_also_if_the_host_s_clock_was_set_back() -> None:
    line = pipeline()
    line.feed(TX, b"M1\r", 1000 * MS)
    found = line.feed(RX, b"M1,+01.0000\r", 1002 * MS)
    line.feed(TX, b"M1\r", 500 * MS)
    found += line.feed(RX, b"M1,+01.0000\r", 502 * MS)
    assert [time_ns for time_ns, _ in samples(found)] == [1001 * MS, 1001 * MS + 1]


def test_a_log_may_begin_between_a_request_and_its_answer() -> None:
    """A recording begins while the sensor is polled. Answers to requests that another program sends are unasked."""
    line = pipeline()
    assert line.feed(RX, b"M1,+01.0000\r", 0) == []
    assert line.losses["unasked"] == 0
    line.feed(RX, b"M1,+01.0000\r", 20 * MS)
    assert line.losses["unasked"] == 1


def test_an_answer_that_is_too_late_has_no_known_time_and_is_dropped() -> None:
    line = pipeline()
    line.feed(TX, b"M1\r", 0)
    assert samples(line.feed(RX, b"M1,+01.0000\r", 501 * MS)) == []
    assert line.losses["unasked"] == 1
    line.feed(TX, b"M1\r", 600 * MS)
    (batch,) = [item for item in line.feed(RX, b"M1,+01.0000\r", 1100 * MS) if isinstance(item, Batch)]
    assert (batch.time_ns.tolist(), batch.sequence.tolist()) == ([850 * MS], [1])
    assert line.losses["samples"] == 0


def test_damage_and_refusals_are_counted_and_a_first_line_that_was_cut_is_not() -> None:
    line = pipeline()
    assert line.feed(RX, b"0000\r", 0) == []
    line.feed(TX, b"M1\r", 0)
    assert events(line.feed(RX, b"M1,+0?.0000\r", MS)) == ["damage", "reply"]
    assert events(line.feed(RX, b"x" * 1000 + b"\r", MS)) == ["damage", "reply"], "for the opening dialogue"
    assert events(line.feed(RX, b"ER,M1,01\r", MS)) == ["reply"]
    line.feed(TX, b"M1\r", 2 * MS)
    assert events(line.feed(RX, b"ER,M1,01\r", 3 * MS)) == ["reply"]
    assert line.losses == {"samples": 0, "damaged_lines": 2, "unasked": 0, "refused": 2, "invalid": 0}


def test_refusals_in_a_row_are_a_fault_and_a_single_one_is_not() -> None:
    """A fault ends a recording."""
    line = pipeline()
    found: list[list[str]] = []
    answers = [b"ER,M1,01\r", b"ER,M1,01\r", b"M1,+00.0000\r", *[b"ER,M1,01\r"] * 4]
    for number, answer in enumerate(answers):
        line.feed(TX, b"M1\r", 1000 * number * MS)
        found.append(events(line.feed(RX, answer, (1000 * number + 5) * MS)))
    assert found == [["reply"]] * 5 + [["reply", "fault"], ["reply"]]
    assert line.losses["refused"] == 6


def test_the_echo_of_a_request_is_ignored() -> None:
    """Two-wire adapters return what the host sends."""
    line = pipeline()
    line.feed(TX, b"M1\r", 0)
    assert line.feed(RX, b"M1\r", MS) == []
    ((_, metres),) = samples(line.feed(RX, b"M1,+01.0000\r", 2 * MS))
    assert metres == pytest.approx(1e-3)
    assert sum(line.losses.values()) == 0


def test_the_first_output_is_that_of_a_single_sensor() -> None:
    assert sensor(dialect="IL").output == 0
    assert sensor(dialect="HL-G1").output == 1
    assert sensor(dialect="IL", output=2).output == 2


@pytest.mark.parametrize("text", [b"XXXXXXXX", b"+FFFFFFF", b"+26.0000"])
def test_a_sample_without_a_reading_is_not_a_number(text: bytes) -> None:
    """Also one that is farther off than the range allows."""
    line = pipeline(range_m=0.025)
    line.feed(TX, b"M1\r", 0)
    ((_, metres),) = samples(line.feed(RX, b"M1," + text + b"\r", MS))
    assert math.isnan(metres)
    assert line.losses["invalid"] == 1


# --- settings and dialogue ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"output": 3}, "expected 1 to 2 for LK-G, got 3"),
        ({"dialect": "HL-G1", "output": 0}, "expected 1 to 16"),
        ({"rate_Hz": 100, "baud": 9600}, "set rate_Hz to at most 40"),
        ({"dialect": "LKG"}, "dialect"),
    ],
)
def test_impossible_settings_are_refused(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        sensor(**settings)


_LKG5000 = replace(DRIVER, example={"axis": "y", "dialect": "LK-G5000", "output": 7, "rate_Hz": 100.0})


_IL = replace(DRIVER, example={"axis": "x", "dialect": "IL", "output": 2, "positive": "towards"})


_HLG1 = replace(DRIVER, example={"axis": "x", "dialect": "HL-G1", "output": 16, "parity": "O"})


@pytest.mark.parametrize("case", kit_cases((_LKG5000, _IL, _HLG1)))
def test_every_dialect_passes_the_tests_of_drivers(case: rig_testing.ContractCase) -> None:
    case()


@pytest.mark.parametrize(
    ("fault", "words"), [("deaf", "no answer to"), ("refuses", "not possible in its present state")]
)
def test_a_sensor_that_cannot_be_opened_is_explained(fault: str, words: str) -> None:
    bench = DriverBench(DRIVER)
    assert isinstance(bench.far, SimulatedPolledLaser)
    bench.far.fail(fault, 1)
    with pytest.raises(DeviceError, match=words):
        bench.begin()


def test_requests_in_any_pieces_are_answered_once() -> None:
    """Requests of another output are not answered."""
    far, still = SimulatedPolledLaser(sensor(), Beam.unmoved()), Still(np.array([0.0, 0.01]))
    for byte in b"xx\rM1\rM3\rM1\r":
        assert far.receive(bytes([byte]), 0.0) == b""
    assert far.sample(still) == 2 * b"M1,+00.0000\r"
    assert far.sample(still) == b""


# --- a session ---------------------------------------------------------------------------------------------------

GAUGE = """
[devices.gauge]
driver = "polled_laser"
dialect = "LK-G5000"
port = "p"
axis = "x"
witness = "gauge"
rate_Hz = 50
"""


def test_a_session_polls_it_while_it_reads_the_other_devices(tmp_path: Path) -> None:
    """It is asked at its rate, and decoding the log's bytes gives the same samples again."""
    file = tmp_path / "rig.toml"
    file.write_text((resources.files("rig_configs") / "virtual.toml").read_text() + GAUGE)
    log = tmp_path / "a.mcap"
    recorded_at_rest(file, log, ["virtual.seed=4", "virtual.sensors.axis_angle_deg=0"])
    assert [row.topic for row in check(log) if row.difference] == []
    with open_log(log) as opened:
        asked = [chunk for chunk in opened.raw("gauge") if chunk.direction == TX]
        found = opened["laser/gauge"]
    assert len(asked) == pytest.approx(200, abs=10)  # an adapter that collects bytes delays some answers by a period
    assert len(found.time_ns) == pytest.approx(200, abs=10)
    assert np.std(found["displacement_m"]) < 2e-5
    (witness,) = load_run(log).witnesses
    assert witness.device == "gauge"


NO_LOSSES = dict.fromkeys(("samples", "damaged_lines", "unasked", "refused", "invalid"), 0)
Items = list[Batch | DeviceEvent]


def batches(items: Items) -> list[Batch]:
    return [item for item in items if isinstance(item, Batch)]


def asked(line: PolledPipeline, answer: bytes, at_ns: int, request: bytes = b"M1\r") -> Items:
    """The items of a request and its answer 2 ms later."""
    return line.feed(TX, request, at_ns) + line.feed(RX, answer + b"\r", at_ns + 2 * MS)


@pytest.mark.parametrize(("text", "invalid"), [(b"+25.0000", 0), (b"-25.0000", 0), (b"+25.0001", 1), (b"-25.0001", 1)])
def test_the_end_of_the_range_is_a_reading(text: bytes, invalid: int) -> None:
    line = pipeline(range_m=0.025)
    for count in (1, 2):
        (batch,) = batches(asked(line, b"M1," + text, count * 10 * MS))
        assert np.isnan(batch.columns["displacement_m"]).tolist() == [bool(invalid)]
        assert line.losses == NO_LOSSES | {"invalid": invalid * count}


@pytest.mark.parametrize("other", [b"M0\r", b"M3\r", b"M1", b"M1\r\r", b"A\r", b"Z\r"])
def test_other_bytes_of_the_host_are_no_request(other: bytes) -> None:
    line = pipeline()
    assert line.feed(TX, other, 0) == []
    line.feed(TX, b"M1\r", 10 * MS)
    assert line.feed(TX, other, 12 * MS) == []
    (batch,) = batches(line.feed(RX, b"M1,+01.0000\r", 14 * MS))
    assert batch.time_ns.tolist() == [12 * MS]
    assert line.losses == NO_LOSSES


START_NS = 1_700_000_000_000_000_000
_USUAL_S = 0.008
_RATE_M_PER_S = 1e-4  # of the measured displacement


def pipeline_of(settings: PolledLaser) -> Pipeline:
    return DRIVER.pipeline("gauge", settings, {})


def kinds(items: list[Batch | DeviceEvent]) -> list[str]:
    return [item.kind if isinstance(item, DeviceEvent) else "sample" for item in items]


def texts_of(items: list[Batch | DeviceEvent]) -> list[str]:
    return [item.text for item in items if isinstance(item, DeviceEvent)]


class Line:
    """A sensor that answers in order, whose value is the time of its measurement, and the host's side of its line.

    Args:
        settings: of the sensor.
        delay_s: returns the time from a request with this number to its answer; None: it does not answer.
    """

    def __init__(self, settings: PolledLaser, delay_s: Callable[[int], float | None]) -> None:
        self.clock = SimulatedClock(START_NS)
        self.pipeline = pipeline_of(settings)
        self.items: list[Batch | DeviceEvent] = []
        self.errors_s: list[float] = []  # of the samples' times
        self.half_trips_s: list[float] = []
        self._settings, self._delay_s = settings, delay_s
        self._dialect = wire.DIALECTS[settings.dialect]
        self._number = 0
        self._free_s = 0.0  # time of the end of the newest answer
        self._asked_ns = 0
        self.poller = DRIVER.poller(settings, self._sent, self.clock)

    def _sent(self, data: bytes) -> None:
        now_s = self.clock.now_s()
        self.items += self.pipeline.feed(TX, data, self.clock.now_ns())
        self._asked_ns = self.clock.now_ns()
        delay_s = self._delay_s(self._number)
        self._number += 1
        if delay_s is None:
            return
        value_m = (self.clock.now_ns() - START_NS) * 1e-9 * _RATE_M_PER_S
        reading = wire.Reading(value_m / self._dialect.unit_m)
        answer = self._dialect.answer(data, self._settings.output, reading)
        if answer is None:
            answer = self._dialect.probe_answer(self._settings.output)
        self._free_s = max(self._free_s, now_s + delay_s)
        self.clock.after(self._free_s - now_s, lambda: self.receive(answer))

    def receive(self, data: bytes) -> None:
        now_ns = self.clock.now_ns()
        found = self.pipeline.feed(RX, data, now_ns)
        self.items += found
        for item in found:
            if isinstance(item, Batch):
                measured_s = float(item.columns["displacement_m"][0]) / _RATE_M_PER_S
                self.errors_s.append((int(item.time_ns[0]) - START_NS) * 1e-9 - measured_s)
                self.half_trips_s.append((now_ns - int(item.time_ns[0])) * 1e-9)
        self.poller.heard(data)

    def run(self, seconds: float) -> None:
        self.poller.start()
        self.clock.wait(seconds)
        self.poller.stop()


def check_times(line: Line, least: int) -> None:
    """Check that every sample's time is wrong by at most half of the time from its request to its answer."""
    assert len(line.errors_s) >= least
    digit_s = 1e-3 * 1e-3 / _RATE_M_PER_S  # of the value
    assert all(abs(e) <= h + digit_s for e, h in zip(line.errors_s, line.half_trips_s, strict=True))


DIALECTS = [{"dialect": name, "baud": 115_200} for name in sorted(wire.DIALECTS)]


@pytest.mark.parametrize("settings", DIALECTS, ids=lambda each: each["dialect"])
def test_every_value_of_a_healthy_sensor_is_recorded(settings: dict[str, Any]) -> None:
    line = Line(sensor(**settings), lambda number: _USUAL_S)
    line.run(4.0)
    check_times(line, 195)
    assert sum(line.pipeline.losses.values()) == 0


@pytest.mark.parametrize("late_s", [0.6, 1.1, 1.7, 3.3, 7.0])
@pytest.mark.parametrize("settings", DIALECTS, ids=lambda each: each["dialect"])
def test_a_late_answer_does_not_become_the_next_ones_value(settings: dict[str, Any], late_s: float) -> None:
    """The line, or the converter to a network, holds everything back for a while."""
    line = Line(sensor(**settings), lambda number: late_s if number in (50, 120) else _USUAL_S)
    line.run(22.0)
    check_times(line, 200)
    assert line.pipeline.losses["unasked"] == 2


@pytest.mark.parametrize("settings", DIALECTS, ids=lambda each: each["dialect"])
def test_lost_answers_are_counted_and_shift_nothing(settings: dict[str, Any]) -> None:
    line = Line(sensor(**settings), lambda number: None if number in (50, 90, 91, 130) else _USUAL_S)
    line.run(8.0)
    check_times(line, 130)
    assert line.pipeline.losses["samples"] == 4
    assert line.pipeline.losses["unasked"] == 0


UNASKED = {
    "LK-G": [b"TG,1,+00.5000\r"],
    "IL": [b"DR,04,+01.234\r\n"],
    "HL-G1": [b"%01$+0012345**\r", b"%02#RMD**\r", b"%02$RMD+0777777**\r"],
}


@pytest.mark.parametrize("name", sorted(UNASKED))
def test_lines_that_are_sent_unasked_or_to_others_release_no_request(name: str) -> None:
    """They come between a request and its answer."""
    line = Line(sensor(dialect=name, baud=115_200), lambda number: _USUAL_S)
    for number, text in enumerate(UNASKED[name] * 20):
        line.clock.after(0.1 + 0.0237 * number, lambda text=text: line.receive(text))
    line.run(4.0)
    check_times(line, 190)
    assert line.pipeline.losses["damaged_lines"] == 20 * len(UNASKED[name])
    assert line.pipeline.losses["samples"] == 0
    assert any(isinstance(item, DeviceEvent) and "sent without a request" in item.text for item in line.items)


@pytest.mark.parametrize("settings", DIALECTS, ids=lambda each: each["dialect"])
def test_noise_before_an_answer_shifts_no_value(settings: dict[str, Any]) -> None:
    """Each disturbance costs one value, and the time of one answer. The sensor is slower than its period."""
    line = Line(sensor(**settings), lambda number: 0.03)
    for number in range(10):
        line.clock.after(0.1043 + 0.2 * number, lambda: line.receive(b"\x81?\r"))
    line.run(4.0)
    check_times(line, 100)
    assert line.pipeline.losses["damaged_lines"] == 10


def test_a_sensor_that_answers_no_probe_is_polled_without() -> None:
    line = Line(sensor(dialect="LK-G"), lambda number: None if number in (0, 1) else _USUAL_S)
    line.run(6.0)
    check_times(line, 190)
    assert sum(line.pipeline.losses.values()) == 0


# --- the order of the requests -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "probe", "answers"), [
    ("LK-G", b"M2\r", [b"M2,+01.0000\r", b"M2,XXXXXXXX\r", b"ER,M2,01\r"]),
    ("LK-G5000", b"M1\r", [b"ER,M1,00\r", b"M1,+01.0000\r"]),
    ("IL", b"SR,00,037\r", [b"SR,00,037,+01.234\r\n", b"ER,SR,65\r\n"]),
    ("HL-G1", b"%01#ROA**\r", [b"%01$ROA+00000**\r", b"%01$ROA+0000141\r", b"%01!01**\r"]),
])  # fmt: skip
def test_the_probe_s_answer_ends_the_doubt_and_is_no_sample(name: str, probe: bytes, answers: list[bytes]) -> None:
    settings = sensor(dialect=name, baud=115_200)
    value = wire.DIALECTS[name].request(settings.output)
    for answer in answers:
        requests, decoder = NextRequest(wire.DIALECTS[name], settings.output), pipeline_of(settings)
        assert requests.request(0) == probe
        assert decoder.feed(TX, probe, START_NS) == []
        assert requests.heard(probe) is False, "its echo"
        assert requests.heard(answer) is True
        assert decoder.feed(RX, answer, START_NS + MS) == []
        assert requests.request(1) == value
        assert sum(decoder.losses.values()) == 0


def test_a_value_between_a_probe_and_its_answer_has_no_known_time() -> None:
    settings = sensor(dialect="LK-G")
    requests, decoder = NextRequest(wire.DIALECTS["LK-G"], 1), pipeline_of(settings)
    talk: list[bytes] = []
    for number, answers in enumerate([b"M2,+00.0000\r", b"", b"M1,+01.0000\rM2,+00.0000\r", b"M1,+02.0000\r"]):
        talk.append(requests.request(number))
        decoder.feed(TX, talk[-1], START_NS + number * 1000 * MS)
        for part in answers.splitlines(keepends=True):
            found = decoder.feed(RX, part, START_NS + (number * 1000 + 5) * MS)
            requests.heard(part)
    assert talk == [b"M2\r", b"M1\r", b"M2\r", b"M1\r"]
    assert kinds(found) == ["reply", "sample"]
    assert decoder.losses == {"samples": 1, "damaged_lines": 0, "unasked": 1, "refused": 0, "invalid": 0}


def test_while_a_sensor_is_silent_each_probe_without_an_answer_is_a_lost_sample() -> None:
    line = Line(sensor(dialect="LK-G"), lambda number: None if 50 <= number < 54 else _USUAL_S)
    line.run(10.0)
    assert line.pipeline.losses["samples"] == 4
    numbers = [int(item.sequence[0]) for item in line.items if isinstance(item, Batch)]
    assert numbers[-1] - len(numbers) + 1 == 4


# --- codes, block checks, refusals -------------------------------------------------------------------------------


def asked_of(decoder: Pipeline, request: bytes, answer: bytes, at_ms: int) -> list[Batch | DeviceEvent]:
    return decoder.feed(TX, request, START_NS + at_ms * MS) + decoder.feed(
        RX, answer + b"\r\n", START_NS + (at_ms + 4) * MS
    )


@pytest.mark.parametrize(("dialect", "answer", "code"), [
    ("IL", b"M0,+99.999", 1), ("IL", b"M0,+999.99", 1), ("IL", b"M0,-9999.9", 2), ("IL", b"M0,-99.998", 3),
    ("IL", b"M0,+EE.EEE", 4), ("IL", b"M0,+EEEE.E", 4), ("LK-G", b"M1,+FFFFFFF", 1), ("LK-G", b"M1,-FFFFFFF", 2),
    ("LK-G", b"M1,XXXXXXXX", 3), ("LK-G5000", b"MS,01,-------", 3), ("HL-G1", b"%01$RMD+9999999**", 1),
    ("HL-G1", b"%01$RMD-9999999**", 2), ("LK-G", b"M1,+1001.00", 5), ("LK-G", b"M1,+01.0000", 0),
    ("LK-G5000", b"MS,+01.0000", 0),
])  # fmt: skip
def test_an_answer_without_a_reading_has_a_code(dialect: str, answer: bytes, code: int) -> None:
    """Also one whose number lies within the range of the rig file."""
    settings = sensor(dialect=dialect, baud=115_200, range_m=1.0)
    (batch,) = [
        item
        for item in asked_of(pipeline_of(settings), wire.DIALECTS[dialect].request(settings.output), answer, 0)
        if isinstance(item, Batch)
    ]
    assert int(batch.columns["code"][0]) == code
    assert math.isnan(float(batch.columns["displacement_m"][0])) == (code > 0)


def test_values_beyond_the_range_are_reported_once_with_the_unit_as_the_likely_cause() -> None:
    decoder = pipeline_of(sensor(dialect="LK-G", range_m=0.01))
    answers = [b"M1,+01.0000", b"M1,+02288.5", b"M1,+02287.5", b"M1,+01.0000", b"M1,-02288.5"]
    found = [asked_of(decoder, b"M1\r", answer, 20 * number) for number, answer in enumerate(answers)]
    reported = [[i.text for i in items if isinstance(i, DeviceEvent) and i.kind == "status"] for items in found]
    assert [len(texts) for texts in reported] == [0, 1, 0, 0, 1]
    assert "M1,+02288.5 is 2.2885 m, more than range_m = 0.01 m" in reported[1][0]
    assert "unit_m" in reported[1][0]
    assert decoder.losses["invalid"] == 3


def test_a_wrong_block_check_is_damage_once_right_ones_have_come() -> None:
    decoder = pipeline_of(sensor(dialect="HL-G1"))
    texts = [b"%%01$RMD+00012%02d" % n for n in range(10)]
    lines = [text + wire.check_sum(text) for text in texts]
    lines[6] = lines[6].replace(b"+0", b"+4")
    found: list[Batch | DeviceEvent] = []
    for number, line in enumerate(lines):
        found += asked_of(decoder, b"%01#RMD**\r", line, 20 * number)
    assert decoder.losses["damaged_lines"] == 1
    assert decoder.losses["samples"] == 1
    assert sum("wrong block check" in text for text in texts_of(found)) == 1


def test_block_checks_of_another_definition_are_no_damage() -> None:
    decoder = pipeline_of(sensor(dialect="HL-G1"))
    samples = [
        item
        for n in range(300)
        for item in asked_of(decoder, b"%01#RMD**\r", b"%%01$RMD+0001234%02X" % (n % 256), 20 * n)
        if isinstance(item, Batch)
    ]
    assert len(samples) == 300


def test_refusals_for_a_moment_are_no_fault() -> None:
    """As during a change of its settings. A fault ends a recording."""
    decoder = pipeline_of(sensor(dialect="LK-G"))
    found: list[str] = []
    for n in range(90):
        found += kinds(asked_of(decoder, b"M1\r", b"ER,M1,01", 20 * n))
    found += kinds(asked_of(decoder, b"M1\r", b"M1,+01.0000", 1800))
    assert (found.count("fault"), decoder.losses["refused"]) == (0, 90)
    assert found[-1] == "sample"


def test_refusals_that_last_are_one_fault_with_a_remedy() -> None:
    decoder = pipeline_of(sensor(dialect="HL-G1"))
    found = [item for n in range(300) for item in asked_of(decoder, b"%01#RMD**\r", b"%01!21**", 20 * n)]
    (fault,) = [item.text for item in found if isinstance(item, DeviceEvent) and item.kind == "fault"]
    assert "code 21: the sensor is being set up" in fault
    assert "Return it to its measuring state" in fault


# --- opening and search ------------------------------------------------------------------------------------------


class Dialogue:
    """The host's side of a line on which every request gets the same lines; implements Talk."""

    def __init__(self, settings: PolledLaser, answer: bytes) -> None:
        self.clock = SimulatedClock(START_NS)
        self.replies: queue.Queue[str] = queue.Queue()
        self.bytes_in = 0
        self._pipeline, self._answer = pipeline_of(settings), answer

    def send(self, data: bytes) -> None:
        self._pipeline.feed(TX, data, self.clock.now_ns())
        for item in self._pipeline.feed(RX, self._answer, self.clock.now_ns() + MS):
            if isinstance(item, DeviceEvent) and item.kind == "reply":
                self.replies.put(item.text)

    def restart_decoding(self) -> None:
        raise NotImplementedError


@pytest.mark.parametrize(("settings", "answer"), [
    ({"dialect": "HL-G1"}, b"%02$RMD+0012345**\r"),
    ({"dialect": "HL-G1"}, b"%01$+0012345**\r"),
    ({"dialect": "LK-G"}, b"M1,+0001.2345\r"),
    ({"dialect": "IL", "output": 1, "baud": 9600, "rate_Hz": 20}, b"M0,+01.234\r\n"),
])  # fmt: skip
def test_a_sensor_that_answers_otherwise_is_quoted_at_opening(settings: dict[str, Any], answer: bytes) -> None:
    """Not reported as one that does not answer: the cable is right."""
    known = sensor(**settings)
    with pytest.raises(DeviceError) as raised:
        DRIVER.open("gauge", known, Dialogue(known, answer))
    assert repr(answer.strip()) in str(raised.value)
    assert "no answer" not in str(raised.value)
    assert "devices.gauge.dialect and output" in str(raised.value)


@pytest.mark.parametrize(("answer", "is_found"), [(b"M0,+01.2345,+01.2345\r", False), (b"M0,+01.234\r\n", True)])
def test_an_lkg_that_answers_the_il_s_request_is_not_found_as_an_il(answer: bytes, is_found: bool) -> None:
    requests = DRIVER.identity_request(sensor(dialect="IL", baud=9600, rate_Hz=20))
    request = next(requests)
    assert request.is_answered(answer) == is_found
    with pytest.raises(StopIteration) as end:
        requests.send(answer)
    assert (end.value.value is not None) == is_found

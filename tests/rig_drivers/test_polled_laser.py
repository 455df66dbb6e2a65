"""Polled displacement sensors: texts of the dialects, the pipeline's times and losses, and a session in lockstep."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError

import rig_testing
from daq.errors import DeviceError
from daq.items import RX, TX, Batch, DeviceEvent
from daq.log import open_log
from daq.replay import check
from daq.signals.run import load_run
from daq.virtual_rig.beam import Beam
from rig_drivers.polled_laser import wire
from rig_drivers.polled_laser.driver import DRIVER
from rig_drivers.polled_laser.far_end import SimulatedPolledLaser
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

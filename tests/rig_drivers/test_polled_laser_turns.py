"""Polled displacement sensors: no value gets the time of another request if answers are late, lost or damaged."""

from __future__ import annotations

import math
import queue
from collections.abc import Callable
from typing import Any

import pytest

from daq.drivers.contract import Pipeline
from daq.errors import DeviceError
from daq.items import RX, TX, Batch, DeviceEvent
from daq.lockstep.clock import SimulatedClock
from rig_drivers.polled_laser import wire
from rig_drivers.polled_laser.driver import DRIVER
from rig_drivers.polled_laser.poller import Turns
from rig_drivers.polled_laser.settings import PolledLaser

START_NS = 1_700_000_000_000_000_000
MS = 1_000_000
_USUAL_S = 0.008
_RATE_M_PER_S = 1e-4  # of the measured displacement


def sensor(**settings: Any) -> PolledLaser:
    return PolledLaser.model_validate({"driver": "polled_laser", "port": "p", "axis": "x", **settings})


def pipeline(settings: PolledLaser) -> Pipeline:
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
        self.pipeline = pipeline(settings)
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
        now_s = self.clock.wall_s()
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
        turns, decoder = Turns(wire.DIALECTS[name], settings.output), pipeline(settings)
        assert turns.request(0) == probe
        assert decoder.feed(TX, probe, START_NS) == []
        assert turns.heard(probe) is False, "its echo"
        assert turns.heard(answer) is True
        assert decoder.feed(RX, answer, START_NS + MS) == []
        assert turns.request(1) == value
        assert sum(decoder.losses.values()) == 0


def test_a_value_between_a_probe_and_its_answer_has_no_known_time() -> None:
    settings = sensor(dialect="LK-G")
    turns, decoder = Turns(wire.DIALECTS["LK-G"], 1), pipeline(settings)
    talk: list[bytes] = []
    for number, answers in enumerate([b"M2,+00.0000\r", b"", b"M1,+01.0000\rM2,+00.0000\r", b"M1,+02.0000\r"]):
        talk.append(turns.request(number))
        decoder.feed(TX, talk[-1], START_NS + number * 1000 * MS)
        for part in answers.splitlines(keepends=True):
            found = decoder.feed(RX, part, START_NS + (number * 1000 + 5) * MS)
            turns.heard(part)
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


def asked(decoder: Pipeline, request: bytes, answer: bytes, at_ms: int) -> list[Batch | DeviceEvent]:
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
        for item in asked(pipeline(settings), wire.DIALECTS[dialect].request(settings.output), answer, 0)
        if isinstance(item, Batch)
    ]
    assert int(batch.columns["code"][0]) == code
    assert math.isnan(float(batch.columns["displacement_m"][0])) == (code > 0)


def test_values_beyond_the_range_are_reported_once_with_the_unit_as_the_likely_cause() -> None:
    decoder = pipeline(sensor(dialect="LK-G", range_m=0.01))
    answers = [b"M1,+01.0000", b"M1,+02288.5", b"M1,+02287.5", b"M1,+01.0000", b"M1,-02288.5"]
    found = [asked(decoder, b"M1\r", answer, 20 * number) for number, answer in enumerate(answers)]
    reported = [[i.text for i in items if isinstance(i, DeviceEvent) and i.kind == "status"] for items in found]
    assert [len(texts) for texts in reported] == [0, 1, 0, 0, 1]
    assert "M1,+02288.5 is 2.2885 m, more than range_m = 0.01 m" in reported[1][0]
    assert "unit_m" in reported[1][0]
    assert decoder.losses["invalid"] == 3


def test_a_wrong_block_check_is_damage_once_right_ones_have_come() -> None:
    decoder = pipeline(sensor(dialect="HL-G1"))
    texts = [b"%%01$RMD+00012%02d" % n for n in range(10)]
    lines = [text + wire.check_sum(text) for text in texts]
    lines[6] = lines[6].replace(b"+0", b"+4")
    found: list[Batch | DeviceEvent] = []
    for number, line in enumerate(lines):
        found += asked(decoder, b"%01#RMD**\r", line, 20 * number)
    assert decoder.losses["damaged_lines"] == 1
    assert decoder.losses["samples"] == 1
    assert sum("wrong block check" in text for text in texts_of(found)) == 1


def test_block_checks_of_another_definition_are_no_damage() -> None:
    decoder = pipeline(sensor(dialect="HL-G1"))
    samples = [
        item
        for n in range(300)
        for item in asked(decoder, b"%01#RMD**\r", b"%%01$RMD+0001234%02X" % (n % 256), 20 * n)
        if isinstance(item, Batch)
    ]
    assert len(samples) == 300


def test_refusals_for_a_moment_are_no_fault() -> None:
    """As during a change of its settings. A fault ends a recording."""
    decoder = pipeline(sensor(dialect="LK-G"))
    found: list[str] = []
    for n in range(90):
        found += kinds(asked(decoder, b"M1\r", b"ER,M1,01", 20 * n))
    found += kinds(asked(decoder, b"M1\r", b"M1,+01.0000", 1800))
    assert (found.count("fault"), decoder.losses["refused"]) == (0, 90)
    assert found[-1] == "sample"


def test_refusals_that_last_are_one_fault_with_a_remedy() -> None:
    decoder = pipeline(sensor(dialect="HL-G1"))
    found = [item for n in range(300) for item in asked(decoder, b"%01#RMD**\r", b"%01!21**", 20 * n)]
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
        self._pipeline, self._answer = pipeline(settings), answer

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
    turns = DRIVER.identity_request(sensor(dialect="IL", baud=9600, rate_Hz=20))
    request = next(turns)
    assert request.is_answered(answer) == is_found
    with pytest.raises(StopIteration) as end:
        turns.send(answer)
    assert (end.value.value is not None) == is_found

"""The parts of a plain sensor's driver: lines to samples, its commands, and its stand-in."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from daq.channels import Channel
from daq.drivers.contract import Pipeline
from daq.drivers.driver import Driver
from daq.drivers.line_sensor import Commands, LineSensor, Motion, Reading
from daq.items import RX, TX, Batch, DeviceEvent
from daq.numbered.messages import Count
from rig_configs.device import DeviceSettings
from rig_configs.roles import Role

PERIOD_NS = 10_000_000
CHANNEL = Channel("weight", "test.Weight", (("force_N", "double"), ("count", "fixed32"), ("own_time", "fixed64")))
CLOCKED = Count(100, PERIOD_NS, clock_size=2**16, clock_step=10)
COUNTED = Count(100, PERIOD_NS)


def parse(line: bytes) -> Reading | str | None:
    word, *numbers = line.split(b" ")
    if word == b"W" and len(numbers) == 3:
        return Reading(int(numbers[0]), (float(numbers[2]),), int(numbers[1]))
    return line.decode() if word == b"I" else None


def lines(first: int, last: int) -> bytes:
    return b"".join(b"W %d %d %d\r\n" % (n % 100, n * 10 % 2**16, n) for n in range(first, last))


class Scale(DeviceSettings):
    topic: str = "weight"
    clock_tolerance_ppm: float = 20.0

    def roles(self, device: str) -> tuple[Role, ...]:
        return ()


SETTINGS = Scale.model_validate({"driver": "scale", "port": "p"})
COMMANDS = Commands("GO", "HALT", "WHO", "I {serial}", {"serial": "7"})


def channel(settings: Scale) -> Channel:
    return CHANNEL


def encode(text: str) -> bytes:
    return f"{text}\r\n".encode()


def simulated(settings: Scale, numbers: Any, motion: Motion) -> bytes:
    return b"".join(lines(n, n + 1) for n in numbers)


def scale(count: Count = CLOCKED, commands: Commands = COMMANDS) -> Driver:
    kind = LineSensor(
        channel=channel, count=count, encode=encode, parse=parse, lines=simulated, commands=commands, longest=20
    )
    return kind.driver("scale", Scale)


def pipeline(count: Count) -> Pipeline:
    return scale(count).pipeline("scale", SETTINGS, {})


def fed(found: Pipeline, data: bytes, last: int) -> tuple[list[Batch], list[DeviceEvent]]:
    items = found.feed(RX, data, (last + 1) * PERIOD_NS)
    return [i for i in items if isinstance(i, Batch)], [i for i in items if isinstance(i, DeviceEvent)]


@pytest.mark.parametrize(("count", "own_ns"), [(CLOCKED, PERIOD_NS // 10), (COUNTED, PERIOD_NS)])
def test_lines_become_samples_also_when_cut_and_after_a_wrap(count: Count, own_ns: int) -> None:
    found, values, own = pipeline(count), [], []
    data = lines(0, 7000)
    for n in range(0, 7000, 50):  # the sensor's clock wraps after 6553 samples, its number after 100
        begin, end = len(lines(0, n)), len(lines(0, n + 50))
        for batch in [*fed(found, data[begin : end - 9], n + 49)[0], *fed(found, data[end - 9 : end], n + 49)[0]]:
            values += batch.columns["force_N"].tolist()
            own += batch.columns["own_time"].tolist()
    assert values == list(range(7000))
    assert np.all(np.diff(own) == PERIOD_NS / own_ns)
    assert found.losses == {"samples": 0, "damaged_lines": 0}


def test_what_is_missing_or_damaged_is_counted_and_reported() -> None:
    found = pipeline(CLOCKED)
    fed(found, b"rest of a line\n" + lines(0, 10), 9)
    assert found.losses["damaged_lines"] == 0
    (batch,), events = fed(found, lines(13, 20) + b"W 2", 19)
    assert [(e.kind, e.facts["samples"]) for e in events] == [("gap", 3)]
    assert batch.sequence[0] == 13
    _, events = fed(found, b"0 x" + b"9" * 1000 + b"\n" + lines(21, 22), 21)
    assert [e.kind for e in events] == ["damage", "gap"]
    assert found.losses == {"samples": 4, "damaged_lines": 1}
    assert fed(found, b"I am\r\n", 21)[1][0].text == "I am"
    assert found.feed(TX, b"STOP\n", 0) == []


def test_after_a_new_start_the_times_go_on() -> None:
    found = pipeline(CLOCKED)
    times: list[np.ndarray[Any, Any]] = []
    for n in range(0, 950, 10):
        times += [b.time_ns for b in fed(found, lines(n, n + 10), n + 9)[0]]
    kinds: list[str] = []
    for n in range(0, 500, 10):
        batches, events = fed(found, lines(n, n + 10), 1537 + n + 9)
        times += [b.time_ns for b in batches]
        kinds += [e.kind for e in events]
    assert "restart" in kinds
    assert np.all(np.diff(np.concatenate(times)) > 0)
    assert found.status.clock_seed is not None
    assert found.status.clock_std_ns > 0


def test_its_clock_is_that_of_the_count() -> None:
    (clock,) = scale().clocks(SETTINGS)
    assert (clock.rate_Hz, clock.tick_ns, clock.count_wrap, clock.field) == (100.0, 1_000_000, 100, "own_time")
    assert scale(COUNTED).clocks(SETTINGS)[0].tick_ns == PERIOD_NS


def test_the_stand_in_answers_and_sends_after_its_command() -> None:
    played = scale().played(SETTINGS, {"serial": "12", "port": "p"})
    assert played.expects == "GO"
    assert played.hear(b"WH") == b""
    assert played.hear(b"O\nHA") == b"I 12\r\n"
    assert not played.sending
    played.hear(b"LT\nGO\n")
    assert played.sending
    assert played.commands == 3
    played.hear(b"HALT\n")
    played.begin()
    assert played.sending
    assert scale(commands=Commands()).played(SETTINGS, {}).sending


def test_the_words_of_an_answer_are_the_identity() -> None:
    commands = Commands(answer="I {model} (no. {serial})")
    assert commands.identity_in("I tilt-2 (no. 47)") == {"model": "tilt-2", "serial": "47"}
    assert commands.identity_in("I tilt-2 (no. 47) x") is None

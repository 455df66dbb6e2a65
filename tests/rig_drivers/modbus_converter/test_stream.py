"""Pipeline of a frequency converter: answers and their requests, commands, faults, restarts, the rotor's speed."""

from __future__ import annotations

import math
from typing import Any

import pytest

from daq.items import Batch
from tests.rig_drivers.modbus_converter.line import POLL, Line, frame, report, write_of

WATCHDOG = 0x2012

# --- reports ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "status", "run", "reverse", "reference", "targets"),
    [
        ({}, {0x2100: 0x11}, (0x2000, 1), 2, (0x2001, 2000), (600, -600)),
        ({"table": "m-max"}, {2100: 0x02}, (2000, 0x0301), 0x0303, (2002, 5000), (750, -750)),
        ({"table": "altivar"}, {3201: 0x0637}, (8501, 0xF), 0xF, (8602, 300), (300, 300)),
        ({"table": "altivar"}, {3201: 0x0637}, (8501, 0xF), 0xF, (8602, 0xFED4), (-300, -300)),
    ],
)
def test_a_report_has_the_hosts_target(
    given: dict[str, Any],
    status: dict[int, int],
    run: tuple[int, int],
    reverse: int,
    reference: tuple[int, int],
    targets: tuple[float, float],
) -> None:
    """0 before the command to run, and before a reference."""
    line = Line(**given)
    line.write(*run)
    line.blocks(status)
    line.write(*reference)
    line.blocks(status)
    line.write(run[0], reverse)
    line.blocks(status)
    line.write(run[0], line.settings.registers.stop)
    line.blocks(status)
    assert line.column("target_rpm") == [0, *targets, 0]
    assert line.lost() == {}


def test_only_the_registers_of_command_and_reference_make_the_target() -> None:
    line = Line()
    line.ask(write_of(0x2000, 1, 1500, function=16))
    line.hear(frame("01 10 20 00 00 02"))
    line.poll()
    for register, value in ((0x2001, 2000), (0x1FFF, 3), (0x2010, 77), (0x2002, 2), (0x3000, 2)):
        line.write(register, value)
    line.poll()
    line.write(0x2000, 4)  # quick stop
    line.poll(status=0x10, counts=0)
    assert line.column("target_rpm") == [450, 600, 0]


@pytest.mark.parametrize(
    ("given", "words", "rpm"),
    [
        ({}, {0x2100: 0x11, 0x2103: 1000}, 300),
        ({}, {0x2100: 0x13, 0x2103: 1000}, -300),
        ({"table": "altivar"}, {3201: 0x0637, 8604: 0xFED5}, -299),
        ({"baud": 38_400, "registers": {"speed": 0x1000}}, {0x2100: 0x11, 0x1000: 1000}, 300),
    ],
)
def test_the_sign_of_the_speed_is_in_its_register_or_in_the_status(
    given: dict[str, Any], words: dict[int, int], rpm: float
) -> None:
    line = Line(**given)
    line.blocks(words)
    assert line.column() == [rpm]
    assert line.column("statusword") == [words[line.settings.registers.status]]


@pytest.mark.parametrize(("table", "lost"), [("altivar", 3201), ("altivar", 8606), ("invt", 0x2100)])
def test_a_report_of_which_a_part_is_lost_gives_no_sample(table: str, lost: int) -> None:
    line = Line(table=table, baud=38_400)
    words = {3201: 0x0637, 8604: 100, 0x2100: 1, 0x3000: 333}
    for each in (None, lost, None):
        line.blocks(words, each)
    assert len(line.column()) == 2
    assert line.lost() == {"unanswered": 1}
    assert line.events("gap") == [("1 request without an answer", {"samples": 1})]


def test_a_sample_has_the_time_of_its_answer_which_may_come_after_half_a_second() -> None:
    line = Line()
    for after_ms in (500, -1000, 500.000001):  # in between the clock of the host was set
        line.ask()
        line.hear(report(), after_ms=after_ms)
    found = [item for item in line.items if isinstance(item, Batch)]
    assert [batch.time_ns.tolist() for batch in found] == [[550_000_000], [-400_000_000]]
    assert line.lost() == {"late": 1}
    assert line.events("damage") == [("an answer too late for a sample", {"samples": 1})]


# --- answers and their requests --------------------------------------------------------------------------------------


def test_a_late_answer_is_not_the_next_requests() -> None:
    """The next request reads another number of registers; its own answer is still found."""
    line = Line()
    line.ask()
    line.ask(frame("01 03 21 00 00 01"), after_ms=100)
    line.hear(report())
    line.hear(frame("01 03 02 00 11"))
    assert line.column() == []
    assert line.lost() == {"unanswered": 1, "damaged_bytes": 13}
    assert line.pipeline.answers[0].registers == (0x11,)


def test_an_answer_without_a_request_is_dropped() -> None:
    line = Line()
    line.hear(report())  # its request was before the log
    line.poll()
    line.hear(report(counts=2000))
    assert line.column() == [300]
    assert line.lost() == {"damaged_bytes": 13}


def test_damaged_and_missing_answers_are_counted_and_reported() -> None:
    line = Line()
    line.ask()
    line.hear(report()[:-1] + b"\0")
    line.ask()
    line.poll()
    line.poll()
    assert line.lost() == {"damaged_answers": 1, "damaged_bytes": 13, "unanswered": 1}
    assert line.kinds() == ["damage", "gap", "drive"]
    assert line.events("gap") == [("2 requests without an answer", {"samples": 2})]


def test_bytes_around_an_answer_are_counted() -> None:
    line = Line()
    for data in (b"\xff\xff" + report() + bytes(3), report() + bytes(15)):
        line.ask()
        line.hear(data)
    assert line.events("damage") == [(f"{n} bytes outside of answers", {"bytes": n}) for n in (5, 15)]
    assert line.lost() == {"damaged_bytes": 20}
    assert not line.pipeline.echoes


def test_a_refusal_is_reported_once_until_it_changes() -> None:
    line = Line()
    for _ in range(3):
        line.ask()
        line.hear(frame("01 83 02"))
    line.ask(write_of(0x2001, 9))
    line.hear(frame("01 86 03"))
    assert [text for text, _ in line.events("refused")] == [
        "it refuses reading register 8448: exception 2: no such register, or not this many registers from it on",
        "it refuses writing 9 to register 8193: exception 3: the value is not allowed",
    ]
    assert line.lost() == {"refused": 4}


# --- an adapter that returns requests --------------------------------------------------------------------------------


def test_returned_bytes_of_the_host_are_no_damage() -> None:
    line = Line()
    for parts in ([POLL, report()], [POLL + report()], [POLL[:3], POLL[3:] + report()]):
        line.ask()
        for part in parts:
            line.hear(part)
    assert line.column() == [300] * 3
    assert line.lost() == {}
    assert line.pipeline.echoes


def test_the_reads_of_a_converter_with_gaps_are_returned_too() -> None:
    line = Line(table="altivar")
    for _ in range(2):
        line.blocks({}, echo=True)
    assert line.pipeline.echoes
    assert len(line.column()) == 2


def test_a_returned_write_is_not_its_answer() -> None:
    """With an echo the answer is the second copy, or the refusal behind the first one."""
    line = Line()
    line.poll()
    line.ask()
    line.hear(POLL + report())
    request = write_of(0x2001, 500)
    line.ask(request)
    line.hear(request)
    assert line.pipeline.answers == []
    line.hear(frame("01 86 03"))
    assert [answer.exception for answer in line.pipeline.answers] == [3]
    line.ask(request)
    line.hear(request[:3])
    line.hear(request[3:] + request)
    assert [answer.exception for answer in line.pipeline.answers] == [0]
    line.poll()  # without an echo
    assert not line.pipeline.echoes
    assert line.lost() == {"refused": 1}
    line.ask()
    line.hear(POLL)
    line.ask()
    assert line.lost() == {"refused": 1, "damaged_answers": 1, "damaged_bytes": 8}


def test_only_a_returned_read_shows_that_an_adapter_returns_requests() -> None:
    line = Line()
    line.ask()
    line.hear(b"\xff" + report())
    several = write_of(0x2001, 500, function=16)
    line.ask(several)
    line.hear(several + frame("01 10 20 01 00 01"))  # as it may be the rest of an earlier request
    assert not line.pipeline.echoes
    assert line.lost() == {"damaged_bytes": 1 + len(several)}


def test_an_adapter_that_returns_requests_is_one_also_after_damage() -> None:
    line = Line()
    request = write_of(0x2001, 500)
    for asked, heard in (
        (POLL, POLL + report()),
        (POLL, POLL + b"\x55" + report()),
        (request, request + b"\x55" + request),
    ):
        line.ask(asked)
        line.hear(heard)
        assert line.pipeline.echoes
    assert line.lost() == {"damaged_bytes": 2}
    line.ask()
    line.hear(POLL)  # nothing but the request comes back
    line.ask()
    line.hear(POLL + report())
    assert line.lost() == {"damaged_bytes": 2, "unanswered": 1}


def test_nothing_is_an_answer_before_a_returned_request() -> None:
    line = Line()
    line.ask()
    line.hear(POLL + report())
    line.ask()
    line.hear(frame("01 83 02"))  # shorter than the request
    assert line.pipeline.answers == []
    assert line.lost() == {}


# --- faults and the rotor's speed ------------------------------------------------------------------------------------


def test_a_fault_is_one_event_with_its_code_however_long_it_lasts() -> None:
    line = Line()
    for status, fault in ((0x11, 0), (0x08, 0x7510), (0x08, 0x7510), (0x10, 0x7510)):
        line.poll(status=status, fault=fault, counts=0)
    assert line.events("drive", "emergency") == [
        ("RUNNING", {"statusword": 0x11}),
        ("FAULT", {"statusword": 0x08}),
        ("fault 29968, see its manual", {"error_code": 0x7510}),
        ("READY", {"statusword": 0x10}),
        ("no fault any more", {"error_code": 0}),
    ]
    assert line.column("statusword") == [0x11, 0x7510 << 16 | 0x08, 0x7510 << 16 | 0x08, 0x10]


def test_a_converter_without_a_readable_code_has_faults_of_code_0() -> None:
    line = Line(registers={"fault_code": None})
    for status in (0x11, 0x08):
        line.blocks({0x2100: status, 0x2101: 9})
    assert line.column("statusword") == [0x11, 0x08]
    assert line.kinds() == ["drive", "drive"]


OFF = {"status": 0x10, "counts": 0}


@pytest.mark.parametrize(
    ("reports", "known"),
    [
        # a converter with its output off reports 0 Hz although the rotor runs down
        ([{"counts": 2000}, {"status": 0x08, "fault": 3, "counts": 0}, OFF, {"counts": 0}, OFF], [1, 0, 0, 1, 1]),
        # the output drops out between the reads of state and speed
        ([{"counts": 1000}, {"counts": 0}, {"status": 0x08, "fault": 4, "counts": 0}], [1, 0, 0]),
        # it goes on running at 0
        ([{"counts": 1000}, *[{"counts": 0}] * 3], [1, 0, 1, 1]),
        # no command in the log: only the communication timeout explains rest
        ([{"counts": 1000}, {"after_ms": 900, **OFF}], [1, 0]),
        # it decelerates by 120 rpm/s, 1 s after the last request
        ([{"counts": 1000}, {"after_ms": 2000, **OFF}], [1, 0]),
        ([{"counts": 1000}, {"after_ms": 3900, **OFF}], [1, 1]),
    ],
)
def test_the_speed_of_a_rotor_without_torque_is_unknown(reports: list[dict[str, int]], known: list[int]) -> None:
    line = Line()
    for each in reports:
        line.poll(**each)
    assert [not math.isnan(rpm) for rpm in line.column()] == list(map(bool, known))


def test_a_rotor_that_was_stopped_along_a_ramp_stands() -> None:
    line = Line()
    line.write(0x2000, 1)
    line.poll(counts=200)
    line.write(0x2000, 0)
    line.poll(**OFF)
    assert line.column() == [60, 0]


# --- a converter that was switched off and on ------------------------------------------------------------------------


def test_a_converter_without_its_timeout_was_switched_off_and_on() -> None:
    """Its rotor may turn, even if there was enough time for a ramp."""
    line = Line()
    line.write(WATCHDOG, 10)
    line.write(0x2000, 1)
    line.poll(counts=1000)
    line.read(WATCHDOG, 0, after_ms=20_000)
    line.poll(**OFF)
    assert line.kinds() == ["drive", "restart", "drive"]
    assert math.isnan(line.column()[-1])


@pytest.mark.parametrize(
    ("written", "found", "times"),
    [
        *((10, found, 0) for found in (1, 9, 10)),
        *((10, found, 1) for found in (0, 11, 100)),
        (1, 0, 1),
        (0, 0, 0),
        *((None, found, 0) for found in (1, 100, 0xFFFF)),
        (None, 0, 1),
    ],
)
def test_a_restart_is_derived_from_the_timeout_that_the_host_has_set(
    written: int | None, found: int, times: int
) -> None:
    line = Line()
    if written is not None:
        line.write(WATCHDOG, written)
    line.read(WATCHDOG, found)
    assert line.kinds() == ["emergency"] * times


@pytest.mark.parametrize("register", [0x2010, 0x2011, 0x2013])
def test_only_the_register_of_the_timeout_shows_a_restart(register: int) -> None:
    line = Line()
    line.write(WATCHDOG, 10)
    line.write(register, 0)
    line.read(register, 0)
    line.read(WATCHDOG, 0, 0)
    assert line.kinds() == []
    for _ in range(2):  # once, until the host sets it again
        line.read(WATCHDOG, 0)
    ((text, facts),) = line.events("emergency")
    assert text.startswith("it was switched off and on: its communication timeout (register 8210) is 0, not what")
    assert facts == {"error_code": 0, "restart": True}


def test_a_timeout_is_written_to_its_register_and_the_offset() -> None:
    line = Line(registers={"watchdog": 0x0E04, "write_offset": 0x0804})
    line.write(0x1608, 10)
    line.read(0x0E04, 10)
    assert line.kinds() == []
    line.read(0x0E04, 100)
    assert line.kinds() == ["emergency"]
    without = Line(registers={"watchdog": None})
    without.write(WATCHDOG, 10)
    without.read(WATCHDOG, 0)
    assert without.kinds() == []

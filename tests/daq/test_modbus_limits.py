"""Pipeline of a frequency converter at its limits: bytes around answers, late answers, commands, restarts, faults."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pytest

from daq.drivers.modbus_converter import wire
from daq.items import Batch, DeviceEvent
from tests.daq.test_modbus_wire import POLL, Line, frame, report, settings

Facts = list[tuple[str, Mapping[str, Any]]]


def facts(line: Line, *kinds: str) -> Facts:
    return [(item.text, item.facts) for item in line.items if isinstance(item, DeviceEvent) and item.kind in kinds]


def write_some(register: int, *values: int) -> bytes:
    return wire.encode(wire.Request(1, 16, register, len(values), values))


def read_one(line: Line, register: int, found: int) -> None:
    line.ask(wire.encode(wire.Request(1, 3, register, 1)))
    line.hear(frame(f"01 03 02 {found:04x}"))


def poll_blocks(line: Line, words: Mapping[int, int], lost: int | None = None, **given: Any) -> None:
    """Read the blocks of a report; the answer to the block with the register `lost` does not come."""
    for first, count in settings(**given).blocks:
        line.ask(wire.encode(wire.Request(1, 3, first, count)))
        if lost is None or not first <= lost < first + count:
            values = "".join(f"{words.get(register, 0):04x}" for register in range(first, first + count))
            line.hear(frame(f"01 03 {2 * count:02x} {values}"))


def test_a_sample_has_the_time_of_its_answer_which_may_come_after_half_a_second() -> None:
    line = Line()
    line.ask()
    line.hear(report(), after_ms=500)
    line.ask()
    line.hear(report(), after_ms=-1000)  # the clock of the host was set
    found = [item for item in line.items if isinstance(item, Batch)]
    assert [(batch.time_ns.tolist(), batch.sequence.tolist()) for batch in found] == [
        ([550_000_000], [0]),
        ([-400_000_000], [0]),
    ]
    line.ask()
    line.hear(report(), after_ms=500.000001)
    assert len(line.rows) == 2
    assert line.lost() == {"late": 1}
    assert facts(line, "damage") == [("an answer too late for a sample", {"samples": 1})]


def test_bytes_around_an_answer_are_counted() -> None:
    line = Line()
    line.ask()
    line.hear(b"\xff\xff" + report() + bytes(3))
    line.ask()
    line.hear(report() + bytes(15))
    assert [found["bytes"] for _, found in facts(line, "damage")] == [5, 15]
    assert facts(line, "damage")[0][0] == "5 bytes outside of answers"
    assert line.pipeline.losses["damaged_bytes"] == 20
    assert not line.pipeline.echoes


def test_as_many_bytes_as_two_frames_have_wait_for_an_answer() -> None:
    line = Line()
    line.ask()
    line.hear(b"\xff" * 511)
    line.hear(b"\xff")
    assert line.items == []
    line.hear(b"\xff")
    assert [found["bytes"] for _, found in facts(line, "damage")] == [1]
    line.hear(report())
    assert line.lost() == {"damaged_bytes": 513}
    assert [row[0] for row in line.rows] == [300]


def test_only_a_returned_read_shows_that_an_adapter_returns_requests() -> None:
    line = Line()
    line.poll()
    line.ask()
    line.hear(b"\xff" + report())
    several = write_some(0x2001, 500)
    line.ask(several)
    line.hear(several + frame("01 10 20 01 00 01"))  # as it may be the rest of an earlier request
    assert not line.pipeline.echoes
    assert line.lost() == {"damaged_bytes": 1 + len(several)}
    line.ask()
    line.hear(POLL + report())
    assert line.pipeline.echoes


def test_an_adapter_that_returns_requests_is_one_also_after_damage() -> None:
    line = Line()
    for data in (POLL + report(), POLL + b"\x55" + report()):
        line.ask()
        line.hear(data)
        assert line.pipeline.echoes
    request = wire.encode(wire.Request(1, 6, 0x2001, 1, (500,)))
    line.ask(request)
    line.hear(request + b"\x55" + request)
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


def test_requests_without_an_answer_are_counted_before_the_next_answer_only() -> None:
    line = Line()
    for _ in range(3):
        line.ask()
    line.hear(report())
    line.poll()
    assert facts(line, "gap") == [("2 requests without an answer", {"samples": 2})]
    assert line.lost() == {"unanswered": 2}


def test_only_the_registers_of_command_and_reference_make_the_target() -> None:
    line = Line()
    line.ask(write_some(0x2000, 1, 1500))
    line.hear(frame("01 10 20 00 00 02"))
    line.poll()
    for register, value in ((0x2001, 2000), (0x1FFF, 3), (0x2010, 77), (0x2002, 2), (0x3000, 2)):
        line.write(register, value)
    line.poll()
    line.write(0x2000, 4)  # quick stop
    line.poll(status=0x10, counts=0)
    assert [row[1] for row in line.rows] == [450, 600, 0]


def test_the_target_of_a_converter_whose_commands_are_large_numbers() -> None:
    """Its reference is in hundredths of a percent of 50 Hz: 1500 rpm."""
    line = Line(table="m-max")
    line.write(2002, 5000)
    for command in (0x0301, 0x0303, 0x0300):
        line.write(2000, command)
        poll_blocks(line, {2100: 0x02}, table="m-max")
    assert [row[1] for row in line.rows] == [750, -750, 0]


def test_a_signed_reference_has_both_signs() -> None:
    line = Line(table="altivar")
    line.write(8501, 0xF)
    for reference in (300, 0xFED4):
        line.write(8602, reference)
        poll_blocks(line, {3201: 0x0637}, table="altivar")
    assert [row[1] for row in line.rows] == [300, -300]


def test_without_a_command_in_the_log_only_the_communication_timeout_explains_rest() -> None:
    line = Line()
    line.poll(counts=1000)
    line.ask(after_ms=900)
    line.hear(report(status=0x10, counts=0))
    assert [math.isnan(row[0]) for row in line.rows] == [False, True]


@pytest.mark.parametrize("lost", [3201, 8606])
def test_a_report_of_which_a_part_is_lost_gives_no_sample(lost: int) -> None:
    line = Line(table="altivar")
    words = {3201: 0x0637, 8604: 100}
    poll_blocks(line, words, table="altivar")
    poll_blocks(line, words, lost, table="altivar")
    assert [row[0] for row in line.rows] == [100]
    poll_blocks(line, words, table="altivar")
    assert [row[0] for row in line.rows] == [100, 100]


def test_the_register_of_the_speed_may_be_the_lowest() -> None:
    given = {"baud": 38_400, "registers": {"speed": 0x1000}}
    line = Line(**given)
    poll_blocks(line, {0x2100: 0x11, 0x1000: 1000}, **given)
    assert [row[0] for row in line.rows] == [300]


def test_a_converter_without_a_readable_code_has_faults_of_code_0() -> None:
    given = {"registers": {"fault_code": None}}
    line = Line(**given)
    for status in (0x11, 0x08):
        poll_blocks(line, {0x2100: status, 0x2101: 9}, **given)
    assert [row[2] for row in line.rows] == [0x11, 0x08]
    assert line.kinds() == ["drive", "drive"]


def test_a_fault_is_one_event_with_its_code_however_long_it_lasts() -> None:
    line = Line()
    for status, fault in ((0x11, 0), (0x08, 0x7510), (0x08, 0x7510), (0x10, 0)):
        line.poll(status=status, fault=fault, counts=0)
    assert [found for _, found in facts(line, "emergency")] == [{"error_code": 0x7510}, {"error_code": 0}]
    assert [found for _, found in facts(line, "drive")] == [{"statusword": word} for word in (0x11, 0x08, 0x10)]


def test_an_adapter_that_returns_the_reads_of_a_converter_with_gaps_echoes() -> None:
    given = {"table": "altivar"}
    line = Line(**given)
    for _ in range(2):
        for first, count in settings(**given).blocks:
            request = wire.encode(wire.Request(1, 3, first, count))
            line.ask(request)
            line.hear(request + frame(f"01 03 {2 * count:02x} {'0000' * count}"))
    assert line.pipeline.echoes
    assert len(line.rows) == 2


# --- a converter that was switched off and on ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("written", "found", "times"), [(10, 9, 0), (10, 1, 0), (10, 11, 1), (1, 0, 1), (None, 0xFFFF, 0), (None, 1, 0)]
)
def test_a_shorter_timeout_than_the_host_s_is_no_restart(written: int | None, found: int, times: int) -> None:
    line = Line()
    if written is not None:
        line.write(0x2012, written)
    read_one(line, 0x2012, found)
    assert line.kinds() == ["emergency"] * times


@pytest.mark.parametrize("register", [0x2010, 0x2011, 0x2013])
def test_only_the_register_of_the_timeout_shows_a_restart(register: int) -> None:
    line = Line()
    line.write(0x2012, 10)
    line.write(register, 0)
    read_one(line, register, 0)
    line.ask(wire.encode(wire.Request(1, 3, 0x2012, 2)))
    line.hear(frame("01 03 04 0000 0000"))
    assert line.kinds() == []
    for _ in range(2):  # once, until the host sets it again
        read_one(line, 0x2012, 0)
    ((text, found),) = facts(line, "emergency")
    assert text.startswith("it was switched off and on: its communication timeout (register 8210) is 0, not what")
    assert found == {"error_code": 0, "restart": True}


def test_a_timeout_is_written_to_its_register_and_the_offset() -> None:
    line = Line(registers={"watchdog": 0x0E04, "write_offset": 0x0804})
    line.write(0x1608, 10)
    read_one(line, 0x0E04, 10)
    assert line.kinds() == []
    read_one(line, 0x0E04, 100)
    assert line.kinds() == ["emergency"]
    without = Line(registers={"watchdog": None})
    without.write(0x2012, 10)
    read_one(without, 0x2012, 0)
    assert without.kinds() == []

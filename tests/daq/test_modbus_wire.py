"""Modbus RTU frames of a frequency converter, and what its pipeline makes of them."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError

from daq.drivers.modbus_converter import states, wire
from daq.drivers.modbus_converter.registers import TABLES
from daq.drivers.modbus_converter.settings import ModbusConverter
from daq.drivers.modbus_converter.stream import ConverterPipeline
from daq.items import RX, TX, Batch, DeviceEvent

MS = 1_000_000
BYTE, WORD = st.integers(0, 255), st.integers(0, 65535)


def settings(**given: Any) -> ModbusConverter:
    return ModbusConverter.model_validate({"driver": "modbus_converter", "port": "p", **given})


def crc(data: bytes) -> bytes:
    """CRC-16 of Modbus, bit by bit, low byte first."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value.to_bytes(2, "little")


def frame(text: str) -> bytes:
    data = bytes.fromhex(text)
    return data + crc(data)


def _write(address: int, register: int, values: list[int]) -> wire.Request:
    return wire.Request(address, 6 if len(values) == 1 else 16, register, len(values), tuple(values))


requests = st.one_of(
    st.builds(wire.Request, st.integers(1, 247), st.sampled_from([3, 4]), WORD, st.integers(1, 16)),
    st.builds(_write, st.integers(1, 247), WORD, st.lists(WORD, min_size=1, max_size=1)),
    st.builds(_write, st.integers(1, 247), WORD, st.lists(WORD, min_size=2, max_size=5)),
    st.builds(wire.Request, st.integers(1, 247), st.just(16), WORD, st.just(1), st.tuples(WORD)),
)


# --- frames ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_", "text"),
    [
        (wire.Request(1, 3, 4, 2), "01 03 00 04 00 02 85 CA"),  # the maker's own example
        (wire.Request(1, 3, 0xFD00, 1), "01 03 FD 00 00 01 B5 A6"),  # of another maker
        (wire.Request(1, 6, 0x1001, 1, (1,)), "01 06 10 01 00 01 1D 0A"),  # of a third
        (wire.Request(1, 6, 0x1002, 1, (500,)), "01 06 10 02 01 F4 2C DD"),
        (wire.Request(1, 4, 0, 1), "01 04 00 00 00 01 31 CA"),
        (wire.Request(9, 16, 0x2000, 2, (5, 6)), "09 10 20 00 00 02 04 00 05 00 06 D0 0D"),
    ],
)
def test_requests_are_those_of_the_manuals(request_: wire.Request, text: str) -> None:
    assert wire.encode(request_) == bytes.fromhex(text)
    assert wire.parse_request(bytes.fromhex(text)) == request_


@given(requests)
def test_requests_round_trip_and_have_the_check_of_the_standard(request_: wire.Request) -> None:
    data = wire.encode(request_)
    assert data[-2:] == crc(data[:-2])
    assert wire.parse_request(data) == request_


@given(st.binary(max_size=40))
def test_other_bytes_are_not_requests(data: bytes) -> None:
    found = wire.parse_request(data)
    assert found is None or wire.encode(found) == data


def test_the_manuals_answers_are_found() -> None:
    read = wire.Request(1, 3, 0xFD00, 1)
    assert wire.find_answer(bytes.fromhex("01 03 02 17 70 B6 50"), read) == (0, 7, wire.Answer(read, (6000,)))
    refused = wire.find_answer(bytes.fromhex("01 83 03 01 31"), wire.Request(1, 3, 0xFD00, 2))
    assert refused is not None
    assert refused[2].refusal == "exception 3: the value is not allowed"


@given(requests, st.binary(max_size=20), st.binary(max_size=20), st.data())
def test_an_answer_is_found_after_other_bytes(request_: wire.Request, before: bytes, after: bytes, data: Any) -> None:
    values = tuple(data.draw(st.lists(WORD, min_size=request_.count, max_size=request_.count)))
    body = bytes([request_.address, request_.function])
    if request_.function in wire.READS:
        body += bytes([2 * len(values)]) + b"".join(value.to_bytes(2, "big") for value in values)
    else:
        values = ()
        body += wire.encode(request_)[2:6]
    answer = body + crc(body)
    found = wire.find_answer(before + answer + after, request_)
    assert found is not None
    assert found[2] == wire.Answer(request_, values)
    assert (before + answer + after)[found[0] : found[1]] == answer


@given(st.integers(0, 12), st.integers(0, 7))
def test_every_wrong_bit_is_found(byte: int, bit: int) -> None:
    read = wire.Request(1, 3, 0x2100, 4)
    answer = bytearray(frame("01 03 08 00 11 00 00 00 00 13 88"))
    answer[byte] ^= 1 << bit
    assert wire.find_answer(bytes(answer), read) is None


@pytest.mark.parametrize(
    "text",
    [
        "02 03 02 17 70",  # another address
        "01 04 02 17 70",  # another function
        "01 03 04 17 70 00 00",  # another number of registers
        "01 84 02",  # refusal of another function
        "01 83 00",  # not an exception
    ],
)
def test_the_answer_to_another_request_is_not_taken(text: str) -> None:
    assert wire.find_answer(frame(text), wire.Request(1, 3, 0xFD00, 1)) is None


def test_the_answer_to_a_write_repeats_register_and_value() -> None:
    run = wire.Request(1, 6, 0x2000, 1, (1,))
    assert wire.find_answer(frame("01 06 20 00 00 01"), run) is not None
    assert wire.find_answer(frame("01 06 20 00 00 05"), run) is None
    assert wire.find_answer(frame("01 06 20 01 00 01"), run) is None


def test_every_exception_has_words() -> None:
    read = wire.Request(1, 3, 0, 1)
    assert wire.Answer(read).refusal == ""
    assert all(wire.Answer(read, exception=code).refusal.startswith(f"exception {code}: ") for code in range(1, 256))


# --- states and settings -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("generic", {0x10: states.READY, 0x11: states.RUNNING, 0x08: states.FAULT, 0: states.NOT_READY}),
        ("invt", {1: states.RUNNING, 2: states.RUNNING, 3: states.READY, 4: states.FAULT, 5: states.NOT_READY}),
        ("m-max", {1: states.READY, 3: states.RUNNING, 0x0B: states.FAULT, 0: states.NOT_READY}),
        (
            "altivar",
            {0x0231: states.READY, 0x0637: states.RUNNING, 0x0218: states.FAULT, 0x0250: states.NOT_READY},
        ),
    ],
)
def test_states_of_each_table(table: str, words: dict[int, str]) -> None:
    registers = settings(table=table).registers
    assert {word: states.state(registers, word) for word in words} == words


def test_a_rig_file_replaces_single_entries_of_a_table() -> None:
    made = settings(table="invt", registers={"speed": 0x3005, "speed_unit": "rpm", "running_values": [1, 2, 9]})
    assert (made.registers.speed, made.registers.stop, made.registers.running_values) == (0x3005, 5, (1, 2, 9))
    assert made.blocks == ((0x2100, 3), (0x3005, 1))
    assert ModbusConverter.model_validate_json(made.model_dump_json()) == made


@pytest.mark.parametrize("table", TABLES)
def test_every_table_is_complete(table: str) -> None:
    made = settings(table=table)
    assert ModbusConverter.model_validate_json(made.model_dump_json()) == made
    assert made.blocks[-1][0] <= made.registers.speed < sum(made.blocks[-1])


@pytest.mark.parametrize(
    ("given_", "words"),
    [
        ({"table": "siemens"}, "table"),
        ({"registers": {"contol": 1}}, "contol"),
        ({"registers": {"control": 70_000}}, "control"),
        ({"registers": {"reference_unit": "mHz"}}, "reference_unit"),
        ({"registers": 3}, "registers"),
        ({"baud": 4800}, "reduce report_Hz, or raise baud"),
        ({"watchdog_s": 0.2}, "one lost answer stops the rig"),
        ({"address": 0}, "address"),
        ({"stop_bits": 3}, "stop_bits"),
    ],
)
def test_impossible_settings_are_refused(given_: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        settings(**given_)


def test_speeds_follow_pole_pairs_gear_and_slip() -> None:
    made = settings(pole_pairs=3, gear=2.0, slip=0.05, max_Hz=60)
    assert made.max_rpm == pytest.approx(60 * 60 / 3 * 0.95 / 2)
    assert made.speed_rpm == pytest.approx(0.01 * 60 / 3 * 0.95 / 2)
    percent = settings(table="m-max", max_Hz=50, pole_pairs=2)
    assert 10_000 * percent.reference_rpm == pytest.approx(1500)
    assert settings(table="altivar", gear=2.0).speed_rpm == 0.5


# --- pipeline ----------------------------------------------------------------------------------------------------

POLL = wire.encode(wire.Request(1, 3, 0x2100, 4))


def report(status: int = 0x11, fault: int = 0, counts: int = 1000) -> bytes:
    return frame(f"01 03 08 {status:04x} {fault:04x} 0000 {counts:04x}")


class Line:
    """A pipeline with what was fed to it."""

    def __init__(self, **given: Any) -> None:
        self.pipeline = ConverterPipeline("drive", settings(**given))
        self.now_ns = 0
        self.items: list[Batch | DeviceEvent] = []

    def ask(self, data: bytes = POLL, after_ms: float = 50) -> None:
        self._feed(TX, data, after_ms)

    def hear(self, data: bytes, after_ms: float = 5) -> None:
        self._feed(RX, data, after_ms)

    def _feed(self, direction: int, data: bytes, after_ms: float) -> None:
        self.now_ns += round(after_ms * MS)
        self.items += self.pipeline.feed(direction, data, self.now_ns)

    def poll(self, **given: int) -> None:
        self.ask()
        self.hear(report(**given))

    def write(self, register: int, value: int) -> None:
        request = wire.encode(wire.Request(1, 6, register, 1, (value,)))
        self.ask(request)
        self.hear(request)

    @property
    def rows(self) -> list[tuple[float, float, int]]:
        found = [item for item in self.items if isinstance(item, Batch)]
        names = ("speed_rpm", "target_rpm", "statusword")
        return [tuple(float(b.columns[name][0]) for name in names) for b in found]

    def kinds(self) -> list[str]:
        return [item.kind for item in self.items if isinstance(item, DeviceEvent) and item.kind != "reply"]

    def lost(self) -> dict[str, int]:
        return {kind: count for kind, count in self.pipeline.losses.items() if count}


def test_a_report_is_a_sample_with_the_hosts_target() -> None:
    line = Line()
    line.ask(wire.encode(wire.Request(1, 6, 0x2001, 1, (2000,))))
    line.hear(frame("01 06 20 01 07 d0"))
    line.poll(status=0x10, counts=0)
    line.ask(wire.encode(wire.Request(1, 6, 0x2000, 1, (1,))))
    line.hear(frame("01 06 20 00 00 01"))
    line.poll(counts=1000)
    line.ask(wire.encode(wire.Request(1, 6, 0x2000, 1, (2,))))
    line.hear(frame("01 06 20 00 00 02"))
    line.poll(status=0x13, counts=1000)
    assert line.rows == [(0, 0, 0x10), (300, 600, 0x11), (-300, -600, 0x13)]
    assert line.lost() == {}


def test_a_run_command_before_any_reference_has_the_target_0() -> None:
    line = Line()
    line.ask(wire.encode(wire.Request(1, 6, 0x2000, 1, (1,))))
    line.hear(frame("01 06 20 00 00 01"))
    line.poll(counts=0)
    assert [row[1] for row in line.rows] == [0.0]


def test_signed_words_of_reference_and_speed() -> None:
    line = Line(table="altivar")
    line.ask(wire.encode(wire.Request(1, 6, 8602, 1, (0xFED4,))))
    line.hear(frame("01 06 21 9a fe d4"))
    line.ask(wire.encode(wire.Request(1, 6, 8501, 1, (0xF,))))
    line.hear(frame("01 06 21 35 00 0f"))
    line.ask(wire.encode(wire.Request(1, 3, 3201, 1)))
    line.hear(frame("01 03 02 06 37"))
    line.ask(wire.encode(wire.Request(1, 3, 8606, 1)))
    line.hear(frame("01 03 02 00 00"))
    line.ask(wire.encode(wire.Request(1, 3, 8604, 1)))
    line.hear(frame("01 03 02 fe d5"))
    assert line.rows == [(-299, -300, 0x0637)]


def test_a_report_whose_state_was_lost_gives_no_sample() -> None:
    line = Line(table="invt", baud=38400)
    state = wire.encode(wire.Request(1, 3, 0x2100, 3)), frame("01 03 06 00 01 00 00 00 00")
    speed = wire.encode(wire.Request(1, 3, 0x3000, 1)), frame("01 03 02 03 e8")
    for asked, answered in (state, speed, (state[0], b""), speed, state, speed):
        line.ask(asked)
        line.hear(answered)
    assert [row[0] for row in line.rows] == [300, 300]
    assert line.lost() == {"unanswered": 1}
    assert line.kinds() == ["drive", "gap"]


@pytest.mark.parametrize("cut", [1, 5, 12])
def test_reads_of_any_length_give_the_same(cut: int) -> None:
    line = Line()
    line.ask()
    line.hear(report()[:cut])
    line.hear(report()[cut:])
    assert [row[0] for row in line.rows] == [300]
    assert line.lost() == {}


def test_a_late_answer_is_not_the_next_requests() -> None:
    """The next request reads another number of registers; its own answer is still found."""
    line = Line()
    line.ask()
    line.ask(wire.encode(wire.Request(1, 3, 0x2100, 1)), after_ms=100)
    line.hear(report())
    line.hear(frame("01 03 02 00 11"))
    assert line.rows == []
    assert line.lost() == {"unanswered": 1, "damaged_bytes": 13}
    assert line.pipeline.answers[0].registers == (0x11,)


def test_an_answer_after_half_a_second_gives_no_sample() -> None:
    line = Line()
    line.ask()
    line.hear(report(), after_ms=501)
    assert line.rows == []
    assert line.lost() == {"late": 1}
    assert line.kinds() == ["damage"]


def test_an_answer_without_a_request_is_dropped() -> None:
    line = Line()
    line.hear(report())  # its request was before the log
    line.poll()
    line.hear(report(counts=2000))
    assert [row[0] for row in line.rows] == [300]
    assert line.lost() == {"damaged_bytes": 13}


def test_damaged_and_missing_answers_are_counted_and_reported() -> None:
    line = Line()
    line.ask()
    line.hear(report()[:-1] + b"\0")
    line.ask()
    line.poll()
    assert line.lost() == {"damaged_answers": 1, "damaged_bytes": 13, "unanswered": 1}
    assert line.kinds() == ["damage", "gap", "drive"]


def test_a_refusal_is_reported_once_until_it_changes() -> None:
    line = Line()
    for _ in range(3):
        line.ask()
        line.hear(frame("01 83 02"))
    line.ask(wire.encode(wire.Request(1, 6, 0x2001, 1, (9,))))
    line.hear(frame("01 86 03"))
    texts = [item.text for item in line.items if isinstance(item, DeviceEvent) and item.kind == "refused"]
    assert texts == [
        "it refuses reading register 8448: exception 2: no such register, or not this many registers from it on",
        "it refuses writing 9 to register 8193: exception 3: the value is not allowed",
    ]
    assert line.lost() == {"refused": 4}


def test_faults_begin_and_end_as_events() -> None:
    line = Line()
    line.poll()
    line.poll(status=0x08, fault=7, counts=0)
    line.poll(status=0x10, fault=7, counts=0)
    found = [(e.kind, e.text) for e in line.items if isinstance(e, DeviceEvent) and e.kind in ("drive", "emergency")]
    assert found == [
        ("drive", "RUNNING"),
        ("drive", "FAULT"),
        ("emergency", "fault 7, see its manual"),
        ("drive", "READY"),
        ("emergency", "no fault any more"),
    ]
    assert [row[2] for row in line.rows] == [0x11, 7 << 16 | 0x08, 0x10]


def test_the_speed_of_a_rotor_without_torque_is_unknown() -> None:
    """A converter with its output off reports 0 Hz although the rotor runs down."""
    line = Line()
    line.poll(counts=2000)
    line.poll(status=0x08, fault=3, counts=0)
    line.poll(status=0x10, counts=0)
    assert [math.isnan(row[0]) for row in line.rows] == [False, True, True]
    line.poll(status=0x11, counts=0)
    line.poll(status=0x10, counts=0)
    assert [row[0] for row in line.rows][-2:] == [0, 0]


def test_a_rotor_that_was_stopped_along_a_ramp_stands() -> None:
    line = Line()
    line.write(0x2000, 1)
    line.poll(counts=200)
    line.write(0x2000, 0)
    line.poll(status=0x10, counts=0)
    assert [row[0] for row in line.rows] == [60, 0]


def test_an_output_that_drops_out_between_the_reads_of_a_report_leaves_the_speed_unknown() -> None:
    """The state was read before the fault, the speed after it: running with 0 rpm, which no ramp explains."""
    line = Line()
    line.poll(counts=1000)
    line.poll(counts=0)
    line.poll(status=0x08, fault=4, counts=0)
    assert [math.isnan(row[0]) for row in line.rows] == [False, True, True]


def test_a_converter_that_goes_on_running_at_0_stands() -> None:
    line = Line()
    line.poll(counts=1000)
    for _ in range(3):
        line.poll(counts=0)
    assert [row[0] for row in line.rows][2:] == [0, 0]


@pytest.mark.parametrize(("after_ms", "stands"), [(2000, False), (3900, True)])
def test_without_a_stop_only_the_communication_timeout_explains_rest(after_ms: float, stands: bool) -> None:
    """It decelerates by 120 rpm/s, 1 s after the last request; a supply that failed leaves the rotor turning."""
    line = Line()
    line.write(0x2000, 1)
    line.poll(counts=1000)
    line.ask(after_ms=after_ms)
    line.hear(report(status=0x10, counts=0))
    assert math.isnan(line.rows[-1][0]) is not stands


def test_a_converter_without_its_timeout_was_switched_off_and_on() -> None:
    """Its rotor may turn, even if there was enough time for a ramp."""
    line = Line()
    line.write(0x2012, 10)
    line.write(0x2000, 1)
    line.poll(counts=1000)
    line.ask(wire.encode(wire.Request(1, 3, 0x2012, 1)), after_ms=20_000)
    line.hear(frame("01 03 02 00 00"))
    line.poll(status=0x10, counts=0)
    assert line.kinds() == ["drive", "restart", "drive"]
    assert math.isnan(line.rows[-1][0])


@pytest.mark.parametrize(
    ("written", "found", "times"), [(10, 10, 0), (10, 100, 1), (0, 0, 0), (None, 100, 0), (None, 0, 1)]
)
def test_a_restart_is_derived_from_the_timeout_that_the_host_has_set(
    written: int | None, found: int, times: int
) -> None:
    line = Line()
    if written is not None:
        line.write(0x2012, written)
    line.ask(wire.encode(wire.Request(1, 3, 0x2012, 1)))
    line.hear(frame(f"01 03 02 {found:04x}"))
    assert line.kinds() == ["emergency"] * times


def test_returned_bytes_of_the_host_are_no_damage() -> None:
    line = Line()
    for _ in range(3):
        line.ask()
        line.hear(POLL)
        line.hear(report())
    assert [row[0] for row in line.rows] == [300] * 3
    assert line.lost() == {}
    assert line.pipeline.echoes


def test_a_returned_write_is_not_its_answer() -> None:
    """With an echo the answer is the second copy, or the refusal behind the first one."""
    line = Line()
    line.ask()
    line.hear(POLL + report())
    request = wire.encode(wire.Request(1, 6, 0x2001, 1, (500,)))
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


def test_a_refusal_of_every_register_is_reported_once() -> None:
    """Two reads alternate: each is refused with its own text."""
    line = Line(table="invt", baud=38400)
    for _ in range(3):
        for register, count in line.pipeline._blocks:
            line.ask(wire.encode(wire.Request(1, 3, register, count)))
            line.hear(frame("01 83 06"))
    assert line.kinds() == ["refused"] * 2
    line.ask(wire.encode(wire.Request(1, 3, 0x3000, 1)))
    line.hear(frame("01 03 02 00 00"))
    line.ask(wire.encode(wire.Request(1, 3, 0x3000, 1)))
    line.hear(frame("01 83 06"))
    assert line.kinds() == ["refused"] * 3

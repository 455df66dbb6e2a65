"""Modbus RTU frames of a frequency converter, its states and settings."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError

from rig_drivers.modbus_converter import registers, wire
from rig_drivers.modbus_converter.registers import TABLES
from rig_drivers.modbus_converter.settings import ModbusConverter
from tests.rig_drivers.modbus_converter.line import crc, frame, settings

WORD = st.integers(0, 65535)


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


@given(st.binary(max_size=300), st.sampled_from([3, 4, 6, 16]))
def test_other_bytes_are_not_requests(data: bytes, function: int) -> None:
    for frame_ in (data, data + crc(data), (whole := bytes([1, function]) + data) + crc(whole)):
        found = wire.parse_request(frame_)
        assert found is None or wire.encode(found) == frame_


def test_the_manuals_answers_are_found() -> None:
    read = wire.Request(1, 3, 0xFD00, 1)
    assert wire.find_answer(bytes.fromhex("01 03 02 17 70 B6 50"), read) == (0, 7, wire.Answer(read, (6000,)))
    refused = wire.Answer(wire.Request(1, 3, 0xFD00, 2), exception=3)
    assert wire.encode_answer(refused) == bytes.fromhex("01 83 03 01 31")
    assert wire.find_answer(bytes.fromhex("01 83 03 01 31"), refused.request) == (0, 5, refused)
    assert refused.refusal == "exception 3: the value is not allowed"


@given(requests, st.binary(max_size=20), st.binary(max_size=20), st.data())
def test_an_answer_is_found_after_other_bytes(request_: wire.Request, before: bytes, after: bytes, data: Any) -> None:
    values = tuple(data.draw(st.lists(WORD, min_size=request_.count, max_size=request_.count)))
    expected = wire.Answer(request_, values if request_.function in wire.READS else ())
    answer = wire.encode_answer(expected)
    assert answer[-2:] == crc(answer[:-2])
    found = wire.find_answer(before + answer + after, request_)
    assert found is not None
    assert found[2] == expected
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
        ("generic", {0x10: registers.READY, 0x11: registers.RUNNING, 0x08: registers.FAULT, 0: registers.NOT_READY}),
        (
            "invt",
            {
                1: registers.RUNNING,
                2: registers.RUNNING,
                3: registers.READY,
                4: registers.FAULT,
                5: registers.NOT_READY,
            },
        ),
        ("m-max", {1: registers.READY, 3: registers.RUNNING, 0x0B: registers.FAULT, 0: registers.NOT_READY}),
        (
            "altivar",
            {0x0231: registers.READY, 0x0637: registers.RUNNING, 0x0218: registers.FAULT, 0x0250: registers.NOT_READY},
        ),
    ],
)
def test_states_of_each_table(table: str, words: dict[int, str]) -> None:
    assert {word: settings(table=table).registers.state(word) for word in words} == words


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

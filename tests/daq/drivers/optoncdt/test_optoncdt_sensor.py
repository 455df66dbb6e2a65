"""The sensor's end of the command line: what was configured is what it answers, however the bytes are cut."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from daq.drivers.optoncdt import sensor_answers
from daq.drivers.optoncdt.commands import SensorCommands, info_lines, outputs_of

INFO = sensor_answers.SensorInfo(name="ILD1420", serial="14200001", range_m=0.025, version="001.019")


def sensor(fixed: bool = False) -> SensorCommands:
    return SensorCommands(info_lines(INFO), 4000.0, fixed=fixed)


def lines(answer: bytes) -> list[str]:
    assert answer.endswith(b"->")
    return answer[:-2].decode().splitlines()


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        (b"OUTPUT NONE\n", ["OUTPUT NONE ok"]),
        (b"output rs422\n", ["output rs422 ok"]),
        (b"OUTPUT\n", ["OUTPUT NONE"]),
        (b"MEASRATE\n", ["MEASRATE 4"]),
        (b"MEASRATE 0.5\n", ["MEASRATE 0.5 ok"]),
        (b"MEASRATE 3\n", ["E210 Rate 3 kHz not possible, only 0.25 0.5 1 2 4"]),
        (b"OUTADD_RS422 COUNTER TIMESTAMP\n", ["OUTADD_RS422 COUNTER TIMESTAMP ok"]),
        (b"OUTADD_RS422 SHUTTER\n", ["E210 Unknown output ['SHUTTER']"]),
        (b"GETOUTINFO_RS422\n", ["GETOUTINFO_RS422 DIST"]),
        (b"OUTHOLD NONE\n", ["OUTHOLD NONE ok"]),
        (b"RESETCNT(TIMESTAMP)\n", ["RESETCNT(TIMESTAMP) ok"]),
        (b"DANCE\n", ["E200 Unknown command DANCE"]),
        (b"\n", []),
        (b" ( )\n", []),
    ],
)
def test_a_command_and_its_answer(command: bytes, answer: list[str]) -> None:
    assert lines(sensor().receive(command)) == answer


def test_without_the_echo_only_requested_values_are_answered() -> None:
    quiet = sensor()
    assert lines(quiet.receive(b"ECHO OFF\n")) == []
    assert lines(quiet.receive(b"MEASRATE 2\n")) == []
    assert lines(quiet.receive(b"MEASRATE\n")) == ["MEASRATE 2"]
    assert lines(quiet.receive(b"ECHO ON\n")) == ["ECHO ON ok"]


def test_commands_change_the_state_of_the_sensor() -> None:
    happened: list[str] = []
    commands = SensorCommands(
        [], 4000.0, rate_set=lambda: happened.append("rate"), counter_reset=lambda: happened.append("counter")
    )
    commands.receive(
        b"MEASRATE 1\nOUTADD_RS422 TIMESTAMP COUNTER\nRESETCNT MEASCNT\nRESETCNT TIMESTAMP\nOUTPUT RS422\n"
    )
    assert (commands.rate_Hz, commands.outputs, commands.streaming) == (1000.0, ("COUNTER", "TIMESTAMP"), True)
    assert happened == ["rate", "counter"]
    commands.receive(b"OUTADD_RS422 NONE\nOUTPUT NONE\n")
    assert (commands.outputs, commands.streaming) == ((), False)


def test_a_stream_that_is_what_it_is_takes_no_other_rate_and_no_other_words() -> None:
    fixed = sensor(fixed=True)
    assert lines(fixed.receive(b"MEASRATE 2\n")) == ["E210 Rate 2 kHz not possible, only 4"]
    assert lines(fixed.receive(b"MEASRATE 4\n")) == ["MEASRATE 4 ok"]
    assert lines(fixed.receive(b"GETOUTINFO_RS422\n")) == ["GETOUTINFO_RS422 DIST COUNTER TIMESTAMP"]
    fixed.receive(b"OUTADD_RS422 COUNTER\n")
    assert lines(fixed.receive(b"OUTPUT RS422\n")) == ["E210 Output not possible without COUNTER TIMESTAMP"]
    assert not fixed.streaming
    fixed.receive(b"OUTADD_RS422 TIMESTAMP COUNTER\nOUTPUT RS422\n")
    assert fixed.streaming


@given(st.lists(st.sampled_from(["COUNTER", "TIMESTAMP", "SHUTTER", "INTENSITY"]), unique=True))
def test_words_and_outputs_are_inverse(outputs: list[str]) -> None:
    words = sensor_answers.parse_outinfo(" ".join(["GETOUTINFO_RS422 DIST", *outputs]))
    assert outputs_of(words) == tuple(outputs)


@given(st.integers(1, 10**9))
def test_the_range_comes_back_bit_for_bit(nanometres: int) -> None:
    range_m = float(f"{nanometres / 1e6:.6f}") / 1000.0  # as it was read from some sensor's answer
    assert sensor_answers.parse_info(info_lines({**INFO, "range_m": range_m})) == {**INFO, "range_m": range_m}


def test_a_name_is_one_line_of_the_sensors_alphabet() -> None:
    lines = info_lines({**INFO, "name": "A\r\n->\nMeasuring range: 99.00mm µ"})
    assert len(lines) == 4
    assert lines[0] == "Name: A??->?Measuring range: 99.00mm ?"


@given(st.binary(max_size=300), st.lists(st.integers(1, 30), min_size=1))
def test_any_bytes_in_any_pieces_give_the_same_answers(data: bytes, cuts: list[int]) -> None:
    whole, pieces = sensor(), sensor()
    expected = whole.receive(data[:250] + b"\n")
    got, rest = b"", data[:250] + b"\n"
    for cut in cuts * 300:
        got, rest = got + pieces.receive(rest[:cut]), rest[cut:]
    assert got + pieces.receive(rest) == expected
    assert max(expected) < 0x80


def test_a_line_without_an_end_is_not_kept_for_ever() -> None:
    endless = sensor()
    for _ in range(100):
        assert endless.receive(bytes(5000)) == b""
    assert len(endless._line) <= 256

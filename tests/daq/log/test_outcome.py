"""Result of a test in its log; and the numbers of logs in a folder."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from daq.log.numbering import next_number, one_at_a_time
from daq.log.outcome import ending, not_reached, tripping


@given(missed=st.text(max_size=40))
def test_what_is_written_is_what_is_read(missed: str) -> None:
    assert not_reached("run-up", {"reached_top": not missed, **ending(missed)}) == missed


@pytest.mark.parametrize(
    ("test", "outcome", "words"),
    [
        ("record", {"ended": "Ctrl-C"}, ""),
        ("spin-down", {"ended": "session closed"}, "broken off: session closed"),
        ("run-up", {"ended": "laser_x: silent"}, "broken off: laser_x: silent"),
        ("unknown", {}, ""),
        ("run-up", {}, ""),
        ("run-up", {"reached": 0, "ended": ""}, "the test's end"),
        ("of-another-package", {"reached": False, "ended": "not reached: five turns"}, "five turns"),
    ],
)
def test_broken_off_tests(test: str, outcome: dict, words: str) -> None:
    assert not_reached(test, outcome) == words


def test_numbers_go_on_with_any_files_in_the_folder() -> None:
    assert next_number([]) == 1
    assert next_number(["99-run-up.mcap", "100-ring-down-x.mcap"]) == 101
    assert next_number(["100-a.mcap", "12-b.mcap.part", "101-c.mcap.part"]) == 102
    assert next_number(["1234-a.mcap", "20260101-by-date.mcap", "notes.txt", "7-x.txt", "-1-x.mcap"]) == 1235
    assert next_number(["03-a.mcap", "²³-b.mcap", "٣-c.mcap", "9" * 400 + "-d.mcap", "04-e\nf.mcap"]) == 5
    assert next_number(["999999-a.mcap", "5-b.mcap"]) == 6


def test_two_tests_at_once_never_get_the_same_number(tmp_path: Path) -> None:
    def begin(name: str) -> None:
        for _ in range(20):
            with one_at_a_time(tmp_path):
                number = next_number(p.name for p in tmp_path.iterdir())
                (tmp_path / f"{number:02d}-{name}.mcap").touch(exist_ok=False)

    both = [threading.Thread(target=begin, args=(name,)) for name in ("x", "y")]
    for thread in both:
        thread.start()
    for thread in both:
        thread.join()
    numbers = sorted(int(p.name.split("-")[0]) for p in tmp_path.iterdir())
    assert numbers == list(range(1, 41))


def test_a_log_that_interlocks_ended_names_them_all() -> None:
    stopped = "laser/x: 12.1 mm; the rotor was commanded to stop"
    reasons = [
        ("amplitude", "laser/x: 12.1 mm"),
        ("amplitude", "laser/y: 11.9 mm"),
        ("runaway", "the drive reports 7 rpm"),
    ]
    facts = tripping(stopped, reasons)
    assert facts["tripped"] == "amplitude, runaway"
    assert facts["ended"] == f"{stopped}; also laser/y: 11.9 mm; also the drive reports 7 rpm"
    assert not_reached("run-up", facts) == f"broken off: {facts['ended']}"
    assert tripping("Ctrl-C", []) == {"ended": "Ctrl-C"}

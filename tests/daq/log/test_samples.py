"""Contents returned to Python: arrays that cannot be modified, and helpful errors for wrong names."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.errors import ChannelMissing
from daq.log import Log, open_log
from tests.daq.small_log import write_small_log


@pytest.fixture
def log(tmp_path: Path) -> Iterator[Log]:
    with open_log(write_small_log(tmp_path / "a.mcap")) as opened:
        yield opened


def test_arrays_cannot_be_written_to(log: Log) -> None:
    whole, part = log["laser/x"], log.between(log.start_ns, log.start_ns + 10**8)["laser/x"]
    for samples in (whole, part):
        for array in (samples.time_ns, samples.log_time_ns, samples.sequence, *(samples[name] for name in samples)):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 99
    mine = whole.displacement_m.copy()
    mine[0] = 99
    assert log["laser/x"].displacement_m[0] != 99


def test_samples_are_looked_through_by_the_names_of_their_fields(log: Log) -> None:
    samples = log["laser/x"]
    assert list(samples) == list(log.channel("laser/x").names)
    assert "code" in samples
    assert "cod" not in samples
    assert 0 not in samples
    assert {"code", "time_ns", "time_s", "displacement_m"} <= set(dir(samples))
    with pytest.raises(ChannelMissing, match="displacement_m"):
        samples["displacement"]


@pytest.mark.parametrize("wrong", [0, slice(None, 5), np.int64(3), ["code"]])
def test_rows_of_all_fields_are_refused_in_words(log: Log, wrong: Any) -> None:
    with pytest.raises(TypeError, match=r"name of a field.*rows are taken of a field"):
        log["laser/x"][wrong]


@pytest.mark.parametrize("wrong", [1.7e9, float("nan"), np.float64(1.7e18), "2026-03-01", None])
def test_a_window_is_in_whole_ns(log: Log, wrong: Any) -> None:
    with pytest.raises(TypeError, match="whole numbers of ns since 1970"):
        log.between(wrong, 2**62)
    with pytest.raises(TypeError, match="whole numbers of ns since 1970"):
        log.between(0, wrong)


def test_a_window_takes_any_whole_number(log: Log) -> None:
    count = len(log["laser/x"])
    for edges in ((np.int64(log.start_ns - 10**9), np.int64(2**62)), (-(2**70), 2**70)):
        assert len(log.between(*edges)["laser/x"]) == count
    assert len(log.between(2**62, 0)["laser/x"]) == 0


def test_a_log_is_itself_only_and_always_there(log: Log, tmp_path: Path) -> None:
    window = log.between(0, 1)
    assert log == log  # noqa: PLR0124 (comparison with itself is tested)
    assert log != window
    assert len({log, window, log}) == 2
    with open_log(log.path) as other:
        assert other != log
    (tmp_path / "empty.mcap").write_bytes(log.path.read_bytes()[:200])
    with open_log(tmp_path / "empty.mcap") as empty:
        assert len(empty) == 0
        assert empty

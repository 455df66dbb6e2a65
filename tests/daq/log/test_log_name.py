"""A log's name is reserved before anything else, by one recording only, and released when it is not used."""

from __future__ import annotations

from pathlib import Path

import pytest

from daq.errors import LogError
from daq.log import open_log
from daq.log.file import LogFile, ReservedName


def test_a_reserved_name_is_refused_to_others(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with ReservedName(path) as name:
        with pytest.raises(LogError, match="about to begin"):
            ReservedName(path)
        with LogFile(name, {"test": "record"}, {}, (), 1) as log:
            log.flush()
            with pytest.raises(LogError, match="another recording is writing it, or it is the rest"):
                ReservedName(path)
            log.finish({})
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]  # leaving a name that was used removes nothing
    with pytest.raises(LogError, match="never overwritten"):
        ReservedName(path)
    with open_log(path) as log:
        assert log.complete


def test_a_name_that_was_not_used_is_given_back(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), ReservedName(tmp_path / "a.mcap"):
        raise RuntimeError("a device did not open")
    assert list(tmp_path.iterdir()) == []


def test_a_cut_recording_keeps_its_name_and_its_bytes(tmp_path: Path) -> None:
    (tmp_path / "a.mcap.part").write_bytes(b"precious")
    with pytest.raises(LogError, match="rig recover"):
        ReservedName(tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap.part").read_bytes() == b"precious"

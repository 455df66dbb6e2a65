"""Logs of other programs: topics are listed, and the advice can be followed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from mcap.writer import Writer

from rig_cli.main import run


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    path = tmp_path / "foreign.mcap"
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start("ros2", "another program")
        schema = writer.register_schema("Imu", "jsonschema", b'{"type": "object"}')
        for topic, count in (("/imu", 30), ("/tf", 2)):
            channel = writer.register_channel(topic, "json", schema)
            for i in range(count):
                writer.add_message(channel, 10**18 + i, json.dumps({"x": i}).encode(), 10**18 + i)
        writer.finish()
    return path


def test_its_topics_are_listed(capsys: pytest.CaptureFixture[str], foreign: Path) -> None:
    assert run(["log", str(foreign)]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if line.startswith("topic")]
    assert [line[1:3] for line in lines] == [["/imu", "30"], ["/tf", "2"]]


def test_the_advice_names_formats_that_an_import_takes(
    capsys: pytest.CaptureFixture[str], foreign: Path, tmp_path: Path
) -> None:
    assert run(["identify", str(foreign), "-o", str(tmp_path / "p.toml")]) == 2
    text = capsys.readouterr().err
    assert "/imu, /tf" in text
    assert "saved as csv, parquet, mat or hdf5" in text
    words = ["--rig", "virtual", "--x", "x:m", "--rate", "100", "--test", "t", "-o", str(tmp_path / "a.mcap")]
    assert run(["import", str(foreign), *words]) == 2
    assert "expected csv, parquet, mat or hdf5, this is a log already" in capsys.readouterr().err

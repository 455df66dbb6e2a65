"""Identities of devices in a log are used if a stream can be decoded with them, and refused in words otherwise."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from daq.drivers.devices import make_pipelines
from daq.errors import LogError
from daq.log import open_log
from daq.log.file import LogFile
from daq.log.snapshot import identities_of, rig_of
from daq.replay.stream import pipelines_with
from rig_cli.main import run
from rig_configs import load_rig
from tests.daq.signals.test_signals import DISPLACEMENT_Y, START, batch

WORDS = ["DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI"]


def log_with(path: Path, identities: Any) -> Path:
    text = identities if isinstance(identities, bytes) else json.dumps(identities).encode()
    attachments = {"rig.json": load_rig("virtual").snapshot_json(), "identities.json": text}
    y = batch(DISPLACEMENT_Y, 1e-3, displacement_m=[1e-3, 2e-3, 3e-3])
    with LogFile(path, {"test": "record"}, attachments, (), START, [y.channel]) as log:
        log.batch(y, y.time_ns)
        return log.finish({"losses": {}})


@pytest.mark.parametrize(
    "identities",
    [
        {"laser_x": {"range_m": "wide"}},
        {"laser_x": {"range_m": True}},
        {"laser_x": {"range_m": -0.025}},
        {"laser_x": {"range_m": None}},
        b'{"laser_x": {"range_m": NaN}}',
        b'{"laser_x": {"range_m": 1e999}}',
        {"laser_x": {"words": "DIST"}},
        {"laser_x": {"words": 7}},
        {"laser_x": {"words": []}},
        {"laser_x": {"words": ["DIST", "COUNTER"]}},
        {"laser_x": {"words": [*WORDS, "DIST"]}},
        {"laser_x": {"words": [*WORDS, 5]}},
        {"laser_y": {"words": [*WORDS, *map(str, range(99))]}},
        {"laser_x": ["DIST"]},
        ["laser_x"],
        b"nonsense",
        b"[" * 100_000,
    ],
)
def test_identities_that_no_stream_can_be_decoded_with_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], identities: Any
) -> None:
    path = log_with(tmp_path / "a.mcap", identities)
    with open_log(path) as log, pytest.raises(LogError, match=r"identities\.json"):
        pipelines_with(rig_of(log), identities_of(log), "a.mcap")
    assert run(["record", str(path), "--listen", "-o", str(tmp_path / "b.mcap"), "--duration", "1"]) == 2
    assert "identities.json" in capsys.readouterr().err


def test_sound_identities_are_taken(tmp_path: Path) -> None:
    identities = {"laser_x": {"range_m": 0.025, "words": [*WORDS, "INTENSITY"], "serial": "1"}, "drive": {"node_id": 5}}
    with open_log(log_with(tmp_path / "a.mcap", identities)) as log:
        assert identities_of(log) == identities
        assert make_pipelines(load_rig("virtual").devices, identities_of(log))

"""Answers to GETOUTINFO_RS422: what can be read of them, and words that the rig file forces instead."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from daq.drivers.optoncdt import sensor_answers, wire as optoncdt
from daq.drivers.optoncdt.far_end import PlayedLaser
from daq.drivers.optoncdt.settings import Laser
from daq.drivers.optoncdt.stream import LaserPipeline
from daq.errors import DeviceError
from daq.items import RX, Batch
from tests.daq.hand_made_laser import HandMadeLaser

USUAL = ["DIST", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI"]
RIG_TABLE = {"driver": "optoncdt", "port": "p", "axis": "x"}
UNREADABLE = [
    "GETOUTINFO_RS422 01DIST1 01COUNTER TIMESTAMP",
    "GETOUTINFO_RS422 DIST1 COUNTER TIMESTAMP_LOW TIMESTAMP_HIGH",
    "GETOUTINFO_RS422 ok",
    "GETOUTINFO_RS422 SHUTTER COUNTER TIMESTAMP",
    "E200 Unknown command",
]


@pytest.mark.parametrize("name", ["DIST", "DIST1", "01DIST1", "LINEARIZED", "ABSTAND"])
def test_a_first_name_that_is_not_known_is_the_distance(name: str) -> None:
    assert HandMadeLaser(outinfo=f"GETOUTINFO_RS422 {name} COUNTER TIMESTAMP").set_up()["words"] == USUAL


@pytest.mark.parametrize(
    "echo",
    ["GETOUTINFO_RS422 ok", "GETOUTINFO_RS422", "GETOUTINFO_RS422 COUNTER", "W100 something", "getoutinfo_rs422 ok"],
)
def test_a_line_before_the_answer_is_skipped(echo: str) -> None:
    assert HandMadeLaser(outinfo=f"{echo}\r\nGETOUTINFO_RS422 DIST1 COUNTER TIMESTAMP").set_up()["words"] == USUAL


def test_a_line_behind_the_answer_is_skipped() -> None:
    assert (
        HandMadeLaser(outinfo="GETOUTINFO_RS422 DIST1 COUNTER TIMESTAMP\r\nGETOUTINFO_RS422 ok").set_up()["words"]
        == USUAL
    )


@pytest.mark.parametrize("answer", UNREADABLE)
def test_an_answer_that_cannot_be_read_is_refused_with_the_setting_that_helps(answer: str) -> None:
    with pytest.raises(DeviceError, match=r"laser_x.*(devices\.laser_x\.words|refused: E200)"):
        HandMadeLaser(outinfo=answer).set_up()


@pytest.mark.parametrize("answer", UNREADABLE)
def test_words_of_the_rig_file_take_its_place(answer: str) -> None:
    sensor = HandMadeLaser(outinfo=answer)
    identity = sensor.set_up(words=["DIST", "INTENSITY", "COUNTER", "TIMESTAMP"])
    assert identity["words"] == ["DIST", "INTENSITY", "COUNTER", "TIMESTAMP_LO", "TIMESTAMP_HI"]
    assert sensor.heard[-1] == "OUTPUT RS422"
    assert "OUTADD_RS422 COUNTER TIMESTAMP" in sensor.heard


def test_without_an_identity_the_stream_is_made_of_the_rig_files_words() -> None:
    words = ["SHUTTER", "DIST", "TIMESTAMP", "COUNTER"]
    config = Laser.model_validate({**RIG_TABLE, "words": words})
    k = np.arange(100)
    columns = [np.full(100, 7), np.full(100, 30_000), 25 * k & 0xFFFF, 25 * k >> 16, k]
    pipeline = LaserPipeline("laser_x", config, {})
    items = pipeline.feed(RX, optoncdt.encode_block(np.column_stack(columns).astype(np.uint32)), 10**18)
    assert [n for item in items if isinstance(item, Batch) for n in item.columns["counter"].tolist()] == k.tolist()
    assert not any(pipeline.losses.values())
    laser_with_identity = LaserPipeline("laser_x", config, {"words": USUAL})  # the log has priority
    assert laser_with_identity._decoder.words == tuple(USUAL)
    played = PlayedLaser(Laser.model_validate({**RIG_TABLE, "words": words[1:]}), {})
    assert b"GETOUTINFO_RS422 DIST TIMESTAMP COUNTER" in played.hear(b"GETOUTINFO_RS422\n")


@pytest.mark.parametrize(
    "words",
    [
        ["DIST"],
        ["DIST", "COUNTER"],
        ["DIST", "TIMESTAMP"],
        ["COUNTER", "TIMESTAMP"],
        ["DIST", "COUNTER", "TIMESTAMP", "COUNTER"],
        ["DIST", "COUNTER", "TIMESTAMP", "DIST"],
        ["DIST", "COUNTER", "TIMESTAMP", "TIMESTAMP_LO"],
        ["DIST", "COUNTER", "TIMESTAMP", "a word"],
        ["DIST", "COUNTER", "TIMESTAMP", ""],
        ["DIST", "COUNTER", "TIMESTAMP", 5],
        "DIST COUNTER TIMESTAMP",
        ["DIST", "COUNTER", "TIMESTAMP", *(f"W{i}" for i in range(29))],
        7,
    ],
)
def test_words_that_give_no_samples_are_refused_by_the_rig_file(words: object) -> None:
    with pytest.raises(ValidationError, match="words"):
        Laser.model_validate({**RIG_TABLE, "words": words})


def test_the_most_words_a_block_can_have_are_taken() -> None:
    names = ["DIST", "COUNTER", "TIMESTAMP", *(f"W{i}" for i in range(28))]
    config = Laser.model_validate({**RIG_TABLE, "words": names})
    assert len(config.output_words) == sensor_answers.MAX_WORDS
    assert LaserPipeline("laser_x", config, {})._decoder.words == config.output_words

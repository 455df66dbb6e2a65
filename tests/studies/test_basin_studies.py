"""Basins in tiles: each cell as of its own tile, ends that are one are one, and the command goes by tiles."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.maps.question import rig_source
from dynamics.steady.basins.basin_map import BasinMap, basins
from rig_cli.main import run
from rig_configs import load_rig
from studies import basins as kind
from studies.basins import BasinQuestion, assembled, basin_study
from studies.engines.threads import Threads
from studies.running import run_study
from studies.tile_files import TileFolder

SLIPPING = ("suspension.zeta1=0.05", "suspension.zeta2=0.05")


def question_at(point: str, settings: tuple[str, ...] = ()) -> BasinQuestion:
    rig = load_rig("virtual", settings=list(settings))
    speed = rig.physics.speed_rad_s(rig.points[point].speed_ratio)
    return BasinQuestion(rig_source("virtual"), None, settings, speed, (12, 8), 15.0)


def in_tiles(question: BasinQuestion, place: Path) -> BasinMap:
    folder = TileFolder(place, basin_study(question))
    assert folder.study.tiles == 4
    run_study(folder, Threads())
    return assembled(folder)


@pytest.fixture(autouse=True)
def small_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kind, "_MAX_RELEASES", 24)
    monkeypatch.setattr(kind, "_MAX_COLUMNS", 6)
    kind._parsed.cache_clear()


def test_tiles_are_the_whole_where_two_images_of_balance_coexist(tmp_path: Path) -> None:
    question = question_at("E")
    whole = basins(question.physics, question.speed_rad_s, *question.angles_rad, question.seconds)
    found = in_tiles(question, tmp_path)
    assert [(end.name, end.mirror) for end in found.ends] == [("I", 0), ("I", 1)]
    assert len(np.unique(found.end)) == 2, "both are reached"
    places = [next(i for i, end in enumerate(found.ends) if end.mirror == other.mirror) for other in whole.ends]
    np.testing.assert_array_equal(np.array([*places, -1])[whole.end], found.end)
    np.testing.assert_allclose(found.settled_s, whole.settled_s)
    np.testing.assert_allclose(found.amplitude_m, whole.amplitude_m)
    for end in found.ends:
        other = next(one for one in whole.ends if one.mirror == end.mirror)
        np.testing.assert_allclose(end.theta_rad, other.theta_rad)


def test_a_slipping_orbit_found_in_every_tile_is_one_end(tmp_path: Path) -> None:
    found = in_tiles(question_at("D", SLIPPING), tmp_path)
    slipping = [end for end in found.ends if end.name == "slipping"]
    assert len(slipping) == 1
    assert slipping[0].slipping is not None
    assert slipping[0].slipping.rotation == pytest.approx(-0.046273, abs=2e-6)
    assert 0 < slipping[0].slipping.multiplier_across < 1
    assert "slipping: A -0.0" in slipping[0].words or "slipping: A 0.0" in slipping[0].words
    assert np.mean(found.end == found.ends.index(slipping[0])) > 0.9


def test_a_question_is_itself_again_from_json() -> None:
    question = replace(question_at("B", SLIPPING), parameters=None)
    assert BasinQuestion.of_json(json.loads(json.dumps(question.as_json()))) == question


def test_the_command_goes_by_tiles_and_removes_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "b.npz"
    command = ["basins", "virtual", "--point", "E", "--grid", "12x8", "--seconds", "15", "-o", str(file), "--json"]
    assert run(command) == 0
    result = json.loads(capsys.readouterr().out)
    assert [end["type"] for end in result["ends"]] == ["I", "I"]
    assert sum(end["share"] for end in result["ends"]) + result["not_settled_share"] == pytest.approx(1.0)
    with np.load(file) as kept:
        assert kept["end"].shape == (8, 12)
    assert not (tmp_path / "b.npz.tiles").exists()

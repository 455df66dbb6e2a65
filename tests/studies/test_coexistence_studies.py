"""Maps of coexisting motions: what is stable by single services, in tiles, in a file and a figure."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from analysis.figures.coexistence import draw_coexistence
from analysis.maps import MapAxis, MapQuestion, load_map, rig_source
from analysis.maps.coexistence import COEXISTENCE_ARRAYS, CoexistenceMap, words_of
from dynamics import steady_states
from rig_cli.main import run
from rig_configs import RigFileError
from studies.coexistence import assembled, coexistence_study
from studies.engines.threads import Threads
from studies.running import run_study
from studies.tile_files import TileFolder

X, Y = MapAxis(("speed_ratio",), 1.6, 3.6, 9), MapAxis(("stiffness_ratio",), 8.0, 14.9, 2)
SLIPPING = ("suspension.zeta1=0.05", "suspension.zeta2=0.05")
QUESTION = MapQuestion(rig_source("virtual"), X, Y, settings=SLIPPING, quantity="coexisting")


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> CoexistenceMap:
    folder = TileFolder(tmp_path_factory.mktemp("coexistence"), coexistence_study(QUESTION))
    assert folder.study.tiles == 2, "a rectangle of neighbours is a tile"
    run_study(folder, Threads())
    return assembled(folder, QUESTION)


def test_steady_motions_are_those_of_the_service(found: CoexistenceMap) -> None:
    plane = QUESTION.plane()
    for row in range(2):
        for column in range(9):
            rig, speed = plane.rig_at(float(found.x[column]), float(found.y[row]))
            names = {state.type for state in steady_states(rig, speed) if state.stable}
            words = set(words_of(float(found.arrays["stable"][row, column])).split(" + "))
            assert words - {"slipping", "nothing stable found"} == names
            if "I" in names:
                truth = min(s.multiplier_max for s in steady_states(rig, speed) if s.type == "I" and s.stable)
                assert found.arrays["multiplier_I"][row, column] == pytest.approx(truth, abs=1e-5)


def test_slipping_is_an_orbit_with_rates_and_a_multiplier(found: CoexistenceMap) -> None:
    slips = found.arrays["slipping_orbits"] > 0
    assert np.any(slips), "at ζ = 0.05 the pendulums slip between the resonances"
    assert np.all(found.arrays["multiplier_slipping"][slips] < 1)
    rates = np.stack([found.arrays["turns3_per_rev"][slips], found.arrays["turns4_per_rev"][slips]])
    assert np.all(np.max(np.abs(rates), axis=0) > 1e-3)
    assert np.all(np.isnan(found.arrays["multiplier_slipping"][~slips]))


def test_words_and_shares(found: CoexistenceMap) -> None:
    assert words_of(1 + 16) == "I + slipping"
    assert words_of(0) == "nothing stable found"
    assert words_of(float("nan")) == "no answer"
    assert sum(found.shares.values()) == pytest.approx(1.0)


def test_the_figure_names_every_class(found: CoexistenceMap) -> None:
    figure, readout = draw_coexistence(found)
    texts = " ".join(text.get_text() for text in figure.findobj(lambda one: hasattr(one, "get_text")))
    for name in found.shares:
        assert f"{name} · " in texts
    assert readout is not None


def test_the_command_writes_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "c.npz"
    plane = ["--x", "speed_ratio=4.8:5.8:2", "--y", "stiffness_ratio=4:5:2"]
    assert run(["map", "virtual", "--quantity", "coexisting", *plane, "-o", str(file), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["shares"] == {"I": 1.0}
    assert set(COEXISTENCE_ARRAYS) <= set(load_map(file).grid)


def test_it_is_not_refined(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["map", "virtual", "--quantity", "coexisting", "--refine", "1"]) == 2
    assert "--refine is of states" in capsys.readouterr().err
    with pytest.raises(RigFileError):
        MapQuestion(rig_source("virtual"), X, Y, quantity="coexisting", seconds=0.0)

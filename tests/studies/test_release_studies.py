"""Maps of what releases come to: in tiles, refined, in files and figures; the states are those of single releases."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.figures.state_maps import draw_states
from analysis.maps import MapAxis, MapQuestion, load_map, rig_source
from analysis.maps.states import ARRAYS, RELEASED_RAD, STATES, StateMap, refined_states
from dynamics.steady.outcome import release_outcome
from rig_cli.main import run
from rig_configs import RigFileError
from studies.engines.processes import Processes
from studies.engines.threads import Threads
from studies.releases import assembled, refined, release_study
from studies.running import Lent, run_study
from studies.study import Study
from studies.tile_files import TileFolder

X, Y = MapAxis(("speed_ratio",), 0.8, 6.0, 9), MapAxis(("stiffness_ratio",), 4.0, 14.0, 5)
QUESTION = MapQuestion(rig_source("virtual"), X, Y, quantity="state", seconds=20.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> TileFolder:
    found = TileFolder(tmp_path_factory.mktemp("releases"), release_study(QUESTION))
    run_study(found, Threads())
    return found


@pytest.fixture(scope="module")
def whole(folder: TileFolder) -> StateMap:
    return assembled(folder, QUESTION)


def test_two_tiles_are_the_map_and_a_process_gives_their_bytes(folder: TileFolder, tmp_path: Path) -> None:
    assert folder.study.tiles == 2
    other = TileFolder(tmp_path, folder.study)

    def ignore(text: str) -> None:
        raise AssertionError(text)

    run_study(other, Processes(1, ignore))
    for path in folder.path.glob("*.npz"):
        assert (tmp_path / path.name).read_bytes() == path.read_bytes()


def test_sure_states_are_where_single_releases_end(whole: StateMap) -> None:
    plane, random = QUESTION.plane(), np.random.default_rng(3)
    reached = np.isin(whole.state, [STATES.index(name) for name in ("I", "III")]) & (whole.arrays["sure"] == 1)
    assert np.count_nonzero(reached) >= 12
    for row, column in random.permutation(np.argwhere(reached))[:6].tolist():
        rig, speed = plane.rig_at(float(whole.x[column]), float(whole.y[row]))
        truth = release_outcome(rig, speed, RELEASED_RAD)
        assert truth.state == STATES[whole.state[row, column]]
        angles = [float(whole.arrays[name][row, column]) for name in ("theta3_deg", "theta4_deg")]
        away = np.angle(np.exp(1j * (np.radians(angles) - np.array(truth.theta_rad))))
        assert np.max(np.abs(away)) < math.radians(0.5)
        assert whole.arrays["settled_s"][row, column] > 0


def test_shares_are_those_of_the_points(whole: StateMap) -> None:
    assert sum(whole.shares.values()) == pytest.approx(1.0)
    assert set(whole.shares) <= set(STATES)
    assert whole.shares["I"] == np.mean(whole.state == STATES.index("I"))


def test_a_refined_map_has_the_states_of_the_whole_where_it_was_computed(whole: StateMap) -> None:
    coarse = replace(QUESTION, x=replace(X, count=5), y=replace(Y, count=3), refine=1)
    found = refined_states(coarse)
    assert found.computed is not None
    assert 15 <= np.count_nonzero(found.computed) <= 45
    np.testing.assert_allclose(found.x, whole.x)
    assert np.array_equal(found.state[found.computed], whole.state[found.computed])
    assert np.all(np.isfinite(found.arrays["amplitude_m"][found.computed & (found.state >= 2)]))


def test_a_refined_map_goes_on_from_its_tiles_and_others_give_the_same(tmp_path: Path) -> None:
    coarse = replace(QUESTION, x=replace(X, count=5), y=replace(Y, count=3), refine=1, seconds=5.0)
    given = list[int]()

    def ended_early(study: Study) -> TileFolder:
        if len(given) == 1:
            raise KeyboardInterrupt
        return by_threads(study)

    def by_threads(study: Study) -> TileFolder:
        found = TileFolder(tmp_path / "tiles", study)
        given.append(study.tiles - run_study(found, Threads()))
        return found

    with pytest.raises(KeyboardInterrupt):
        refined(coarse, ended_early)
    assert given == [1]
    found, studies = refined(coarse, by_threads)
    assert given[1] == 0, "the coarse grid was there"
    assert len(studies) >= 2
    assert sum(given[2:]) >= 1
    with Processes(1, print) as engine:

        def by_processes(study: Study) -> TileFolder:
            other = TileFolder(tmp_path / "others", study)
            run_study(other, Lent(engine))
            return other

        same, _ = refined(coarse, by_processes)
    for name in ARRAYS:
        np.testing.assert_array_equal(found.arrays[name], same.arrays[name])
    for study in studies:
        TileFolder(tmp_path / "tiles", study).remove()
    assert not (tmp_path / "tiles").exists()


def test_the_command_refines_by_other_processes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "r.npz"
    plane = ["--x", "speed_ratio=1.2:3.2:3", "--y", "stiffness_ratio=6:14.9:2", "--seconds", "5"]
    command = ["map", "virtual", "--quantity", "state", *plane, "--refine", "1", "-o", str(file), "--json"]
    assert run([*command, "--scheduler", "local:1"]) == 0
    result = json.loads(capsys.readouterr().out)
    kept = load_map(file)
    assert kept.grid["state"].shape == (3, 5)
    assert result["computed_share"] == pytest.approx(np.mean(kept.grid["computed"] == 1))
    assert not (tmp_path / "r.npz.tiles").exists()


def test_the_command_writes_draws_and_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = tmp_path / "s.npz", tmp_path / "s.html"
    plane = ["--x", "speed_ratio=4.5:6:3", "--y", "stiffness_ratio=4:8:2"]
    written = ["-o", str(files[0]), "--plot", str(files[1])]
    assert run(["map", "virtual", "--quantity", "settling-time", *plane, "--seconds", "12", *written, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["shares"] == {"I": 1.0}
    kept = load_map(files[0])
    assert set(ARRAYS) <= set(kept.grid)
    assert kept.grid["settled_s"].shape == (2, 3)
    assert kept.question.quantity == "settling-time"
    assert kept.question.seconds == 12.0
    assert "settled after" in files[1].read_text(encoding="utf-8")
    assert not (tmp_path / "s.npz.tiles").exists()


@pytest.mark.parametrize("quantity", ["state", "amplitude", "settling-time"])
def test_every_quantity_has_a_figure_with_a_name_for_all_it_shows(whole: StateMap, quantity: str) -> None:
    shown = replace(whole, question=replace(QUESTION, quantity=quantity))
    figure, readout = draw_states(shown)
    assert readout is not None
    texts = " ".join(text.get_text() for text in figure.findobj(lambda one: hasattr(one, "get_text")))
    wanted = ["balanced", "together"] if quantity == "state" else ["amplitude" if quantity == "amplitude" else "stayed"]
    for word in (*wanted, "20 s"):
        assert word in texts


def test_families_and_best_values_are_not_of_releases() -> None:
    from analysis.maps import BorderFamily

    with pytest.raises(RigFileError, match="family and best are of borders"):
        replace(QUESTION, family=BorderFamily(("suspension.zeta1",), (0.01, 0.02)))

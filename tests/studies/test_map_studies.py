"""A map in tiles: they cover it, and all engines yield the same bytes."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from analysis.maps.question import MapQuestion
from dynamics.stability.stability_map import stability_map_over
from studies.engines import engine_of
from studies.engines.processes import Processes
from studies.engines.threads import Threads
from studies.errors import OtherSoftware, StudyInputError, TileFailed
from studies.maps import assembled, map_study
from studies.running import run_study
from studies.study import Study
from studies.tile_files import TileFolder
from studies.tiling import parts_of
from studies.worker import answer_tile
from tests.studies.small_maps import small_map


@given(st.integers(1, 5000), st.integers(1, 5000))
def test_tiles_cover_every_point_once_and_none_is_large(columns: int, rows: int) -> None:
    parts = parts_of(columns, rows, 400, 131_072)
    areas = [(r.stop - r.start) * (c.stop - c.start) for r, c in parts]
    assert sum(areas) == columns * rows
    assert max(areas) <= 140_000
    assert min(areas) > 0
    corners = {(r.start, c.start) for r, c in parts}
    assert len(corners) == len(parts)
    ends = {(r.start, c.stop) for r, c in parts if c.stop < columns} | {
        (r.stop, c.start) for r, c in parts if r.stop < rows
    }
    assert ends <= corners


def ignore(text: str) -> None:
    raise AssertionError(text)


@pytest.fixture(scope="module")
def by_threads(tmp_path_factory: pytest.TempPathFactory) -> TileFolder:
    folder = TileFolder(tmp_path_factory.mktemp("threads"), small_map())
    run_study(folder, Threads())
    return folder


def test_processes_give_the_bytes_that_threads_give(by_threads: TileFolder, tmp_path: Path) -> None:
    folder = TileFolder(tmp_path, small_map())
    calls: list[tuple[int, int]] = []
    assert run_study(folder, Processes(2, ignore), lambda done, total: calls.append((done, total))) == 0
    assert calls == [(done, 6) for done in range(7)]
    for name in sorted(path.name for path in by_threads.path.glob("*.npz")):
        assert (folder.path / name).read_bytes() == (by_threads.path / name).read_bytes()


def test_the_whole_is_the_map_within_its_bounds(by_threads: TileFolder) -> None:
    question, whole = assembled(by_threads)
    assert whole.multiplier_max.shape == (420, 1000)
    assert sum(whole.counts) == 420_000
    x, y = question.x.values[::37], question.y.values[::29]
    fresh = stability_map_over(question.plane(), x, y, 1e-10)
    away = np.abs(whole.multiplier_max[::29, ::37] - fresh.multiplier_max)
    assert np.all(away <= whole.error_estimate[::29, ::37] + fresh.error_estimate)
    assert np.all(whole.error_estimate <= 1e-8 * np.maximum(1, whole.multiplier_max))


def test_what_is_there_is_not_worked_out_again(by_threads: TileFolder, tmp_path: Path) -> None:
    folder = TileFolder(tmp_path, small_map())
    for tile in (0, 2, 3, 5):
        folder.keep(tile, next(by_threads.path.glob(f"*-00000{tile}.npz")).read_bytes())
    before = {path.name: path.stat().st_mtime_ns for path in folder.path.glob("*.npz")}
    requested: list[int] = []

    class Watched(Threads):
        def answers(self, study: Study, tiles: list[int]) -> Iterator[tuple[int, bytes]]:
            requested.extend(tiles)
            return super().answers(study, tiles)

    assert run_study(folder, Watched()) == 4
    assert requested == [1, 4]
    assert {name: (folder.path / name).stat().st_mtime_ns for name in before} == before
    assert folder.finished() == set(range(6))


def test_a_process_that_dies_loses_its_tiles_in_hand_only(by_threads: TileFolder, tmp_path: Path) -> None:
    folder, messages = TileFolder(tmp_path, small_map()), list[str]()
    engine = Processes(2, messages.append)

    def kill_one(done: int, total: int) -> None:
        if done == 2 and not messages:
            assert engine._pool is not None
            next(iter(engine._pool._processes.values())).kill()

    run_study(folder, engine, kill_one)
    assert messages
    assert "has died" in messages[0]
    for path in by_threads.path.glob("*.npz"):
        assert (folder.path / path.name).read_bytes() == path.read_bytes()


def test_a_tile_that_kills_every_process_is_given_up(tmp_path: Path) -> None:
    folder, messages = TileFolder(tmp_path, small_map()), list[str]()

    class Deadly(Processes):
        def _open(self) -> ProcessPoolExecutor:
            pool = super()._open()
            pool.submit(os._exit, 9)
            return pool

    with Deadly(1, messages.append) as engine, pytest.raises(TileFailed, match="What is done is kept"):
        list(engine.answers(folder.study, [0]))
    assert len(messages) == 4


def test_other_sources_are_refused(tmp_path: Path) -> None:
    study = small_map()
    with pytest.raises(OtherSoftware, match="install the same version on all hosts"):
        answer_tile("map", study.text, "0123456789abcdef", 0)


def test_a_question_differs_by_all_that_decides_its_answer() -> None:
    question = MapQuestion.of_json(json.loads(small_map().text))
    digests = {map_study(question).digest}
    for change in ({"accuracy": 1e-9}, {"settings": ("suspension.zeta1=0.02",)}, {"speed_rad_s": 3.0}):
        digests.add(map_study(replace(question, **change)).digest)
    assert len(digests) == 4
    shown = replace(question, quantity="decay-rate", borders=True)
    assert map_study(shown).digest == map_study(question).digest


@pytest.mark.parametrize("text", ["local", "local:0", "local:x", "local:-1", "10.0.0.1:8786", "http://a:1", ""])
def test_an_unknown_engine_is_refused_with_what_was_expected(text: str) -> None:
    with pytest.raises(StudyInputError, match=r"expected local:N .* or a scheduler's address"):
        engine_of(text, ignore)

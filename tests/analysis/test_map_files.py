"""Maps in files: what is written comes back, in every format, from the question alone."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import zarr

from analysis.errors import NoMapFile
from analysis.maps.answers import MapAnswer, answer
from analysis.maps.axes import MapAxis
from analysis.maps.families import BorderFamily
from analysis.maps.files import load_map, need_map_suffix, write_map
from analysis.maps.question import MapQuestion, rig_source
from analysis.maps.records import MapRecord, record

ZETAS = ("suspension.zeta1", "suspension.zeta2")


@pytest.fixture(scope="module")
def found() -> MapAnswer:
    x, y = MapAxis(("speed_ratio",), 1.0, 2.0, 7), MapAxis(ZETAS, 0.01, 0.04, 5, True)
    family = BorderFamily(("pendulums.a.damping_Nms_per_rad", "pendulums.b.damping_Nms_per_rad"), (2e-3,))
    settings = ("suspension.k2_N_per_m=3e4",)
    return answer(MapQuestion(rig_source("virtual"), x, y, settings=settings, borders=True, family=family))


@pytest.fixture(scope="module")
def kept(found: MapAnswer) -> MapRecord:
    return record(found, {"stable_share": 0.5})


@pytest.mark.parametrize("name", ["map.npz", "map.parquet", "map.zarr"])
def test_what_is_written_comes_back(tmp_path: Path, kept: MapRecord, found: MapAnswer, name: str) -> None:
    write_map(tmp_path / name, kept)
    written = write_map(tmp_path / name, kept)  # over the first
    assert written[0] == tmp_path / name
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(path.name for path in written)
    back = load_map(tmp_path / name)
    assert back.provenance == kept.provenance
    assert back.question == found.question
    assert np.array_equal(back.x, found.grid.x)
    assert np.array_equal(back.y, found.grid.y)
    assert set(back.grid) == set(kept.grid)
    for key, values in kept.grid.items():
        assert np.array_equal(back.grid[key], values)
        assert back.grid[key].dtype == values.dtype
    assert len(back.borders) == len(kept.borders)
    assert {line.value for line in back.borders} == {None, 2e-3}
    for line, branch in zip(back.borders, kept.borders, strict=True):
        assert (line.closed, line.value) == (branch.closed, branch.value)
        assert np.array_equal(line.x, branch.x)
        assert np.array_equal(line.y, branch.y)
        assert np.array_equal(line.multiplier, branch.multiplier)


def test_the_question_in_a_file_makes_the_map_again(tmp_path: Path, kept: MapRecord, found: MapAnswer) -> None:
    write_map(tmp_path / "map.npz", kept)
    question = load_map(tmp_path / "map.npz").question
    assert question.rig.text == found.question.rig.text
    assert json.loads(json.dumps(question.as_json())) == question.as_json()
    assert np.array_equal(answer(question).grid.multiplier_max, found.grid.multiplier_max)


def test_a_table_has_a_row_a_point_under_the_keys(tmp_path: Path, kept: MapRecord, found: MapAnswer) -> None:
    table_file, lines_file = write_map(tmp_path / "map.parquet", kept)
    table = pq.read_table(table_file).to_pydict()
    assert len(table["speed_ratio"]) == 35
    assert table[ZETAS[0]] == table[ZETAS[1]]
    row = [i for i, x in enumerate(table["speed_ratio"]) if x == 2.0][3]
    assert table[ZETAS[0]][row] == found.question.y.values[3]
    assert table["multiplier_max"][row] == found.grid.multiplier_max[3, 6]
    lines = pq.read_table(lines_file).to_pydict()
    assert lines["speed_ratio"][0] == kept.borders[0].x[0]
    assert np.abs(np.array(lines["multiplier_real"]) + 1j * np.array(lines["multiplier_imag"])) == pytest.approx(1)


def test_borders_of_an_older_map_do_not_stay_next_to_a_new_one(tmp_path: Path, kept: MapRecord) -> None:
    write_map(tmp_path / "map.parquet", kept)
    assert write_map(tmp_path / "map.parquet", MapRecord(kept.provenance, kept.x, kept.y, kept.grid)) == [
        tmp_path / "map.parquet"
    ]
    assert load_map(tmp_path / "map.parquet").borders == ()
    write_map(tmp_path / "map.parquet", kept)
    (tmp_path / "map.borders.parquet").unlink()
    with pytest.raises(FileNotFoundError, match=r"map\.borders\.parquet"):
        load_map(tmp_path / "map.parquet")


def test_a_store_names_its_dimensions(tmp_path: Path, kept: MapRecord) -> None:
    write_map(tmp_path / "map.zarr", kept)
    group: Any = zarr.open_group(str(tmp_path / "map.zarr"), mode="r")
    assert group["multiplier_max"].metadata.dimension_names == (ZETAS[0], "speed_ratio")
    assert group.attrs["rig map"]["rig"] == kept.provenance["rig"]


@pytest.mark.parametrize("key", ["software_version", "date", "rig", "rig_digest", "settings", "method", "accuracy"])
def test_provenance_is_there(kept: MapRecord, key: str) -> None:
    assert kept.provenance[key]


def test_names_that_cannot_hold_a_map_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(NoMapFile, match=r"\.npz, \.parquet, \.zarr"):
        need_map_suffix(tmp_path / "map.csv")
    (tmp_path / "other.zarr").mkdir()
    (tmp_path / "other.zarr" / "letter.txt").write_text("dear")
    with pytest.raises(NoMapFile, match="something else"):
        need_map_suffix(tmp_path / "other.zarr")
    find = importlib.util.find_spec
    monkeypatch.setattr("analysis.maps.zarr_store.find_spec", lambda name: None if name == "zarr" else find(name))
    with pytest.raises(NoMapFile, match=r"pendulum-balancer-rig\[studies\]"):
        need_map_suffix(tmp_path / "map.zarr")


@pytest.mark.parametrize("name", ["map.npz", "map.parquet", "map.zarr"])
def test_what_holds_no_map_is_refused(tmp_path: Path, kept: MapRecord, name: str) -> None:
    strange = MapRecord({**kept.provenance, "format": "rig map 99"}, kept.x, kept.y, kept.grid)
    with pytest.raises(ValueError, match="rig map 99"):
        write_map(tmp_path / name, strange)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises((FileNotFoundError, NoMapFile)):
        load_map(tmp_path / name)

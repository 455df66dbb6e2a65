"""One finished file per tile: whole or not there, the same bytes for the same arrays, damage found and named."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as arrays

from studies.errors import FolderFault
from studies.study import Study
from studies.tile_files import TileFolder, packed
from tests.studies.small_maps import small_map

VALUES = st.dictionaries(
    st.from_regex(r"[a-z_]{1,8}", fullmatch=True),
    arrays.arrays(st.sampled_from([np.float64, np.int32, np.bool_, "U7"]), arrays.array_shapes(min_dims=0, max_dims=2)),
    max_size=4,
)


@pytest.fixture
def folder(tmp_path: Path) -> TileFolder:
    return TileFolder(tmp_path / "tiles", small_map())


@given(VALUES)
def test_what_is_kept_is_read_and_the_same_arrays_are_the_same_bytes(
    tmp_path_factory: pytest.TempPathFactory, answer: dict[str, np.ndarray]
) -> None:
    folder = TileFolder(tmp_path_factory.mktemp("tiles"), Study("map", small_map().text, "0"))
    content = packed(answer)
    folder.keep(3, content)
    found = folder.read(3)
    assert list(found) == list(answer)
    for name, values in answer.items():
        np.testing.assert_array_equal(found[name], values)
        assert found[name].dtype == values.dtype
    assert packed({name: values.copy() for name, values in answer.items()}) == content
    assert folder.finished() == {3}


def test_another_question_has_tiles_of_its_own(tmp_path: Path) -> None:
    study = small_map()
    mine = TileFolder(tmp_path, study)
    mine.keep(0, packed({"a": np.ones(3)}))
    for other in (Study("map", study.text.replace("1000", "1001"), study.software), Study("map", study.text, "f" * 16)):
        assert TileFolder(tmp_path, other).finished() == set()
    assert TileFolder(tmp_path, study).finished() == {0}


def test_a_part_of_a_file_is_no_tile(folder: TileFolder) -> None:
    content = packed({"a": np.arange(1000.0)})
    (folder.path / f".{folder.study.digest}-000001.npz.77.part").write_bytes(content[:100])
    assert folder.finished() == set()


@pytest.mark.parametrize("cut", [0, 10, 0.5, 0.99])
def test_a_damaged_tile_is_named_with_what_to_do(folder: TileFolder, cut: float) -> None:
    content = packed({"a": np.random.default_rng(1).normal(size=1000)})
    folder.keep(2, content)
    path = next(folder.path.glob("*-000002.npz"))
    path.write_bytes(content[: int(cut * len(content)) if cut < 1 else int(cut)])
    with pytest.raises(FolderFault, match="delete it and give the same command again"):
        folder.read(2)


def test_one_wrong_bit_anywhere_is_found(folder: TileFolder) -> None:
    answer = {"a": np.random.default_rng(1).normal(size=20), "b": np.arange(3)}
    content = packed(answer)
    for place in range(len(content)):
        damaged = bytearray(content)
        damaged[place] ^= 1 << place % 8
        folder.keep(2, bytes(damaged))
        if place in (len(content) - 66, len(content) - 65):  # the length of the seal is known without them
            found = folder.read(2)
            assert all(np.array_equal(found[name], values) for name, values in answer.items())
        else:
            with pytest.raises(FolderFault, match="000002"):
                folder.read(2)


def test_a_tile_is_an_npz(folder: TileFolder) -> None:
    folder.keep(1, packed({"a": np.arange(4.0)}))
    with np.load(next(folder.path.glob("*-000001.npz"))) as found:
        np.testing.assert_array_equal(found["a"], np.arange(4.0))


def test_a_full_disk_is_an_error_and_leaves_nothing_behind(folder: TileFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    folder.keep(0, packed({"a": np.ones(3)}))

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FolderFault, match=r"No space left on device.*same command again"):
        folder.keep(1, packed({"a": np.ones(3)}))
    assert folder.finished() == {0}
    assert not list(folder.path.glob(".*"))


def test_a_folder_is_removed_with_its_tiles_unless_something_else_is_in_it(folder: TileFolder) -> None:
    folder.keep(0, packed({"a": np.ones(3)}))
    stranger = folder.path / "notes.txt"
    stranger.write_text("mine")
    folder.remove()
    assert [path.name for path in folder.path.iterdir()] == ["notes.txt"]
    stranger.unlink()
    folder.remove()
    assert not folder.path.exists()

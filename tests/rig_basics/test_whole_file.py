"""A file is complete or as it was: after an error, on a full disk, through a link."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from rig_basics.whole_file import write_whole_text, written_whole


def test_a_file_gets_its_name_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("old", encoding="utf-8")
    path.chmod(0o640)
    with written_whole(path) as part:
        part.write_text("new", encoding="utf-8")
        assert (part.parent, part.suffix) == (tmp_path, ".toml")
        assert path.read_text(encoding="utf-8") == "old"
    assert path.read_text(encoding="utf-8") == "new"
    assert path.stat().st_mode & 0o777 == 0o640
    assert list(tmp_path.iterdir()) == [path]


def _half_written(path: Path) -> None:
    with written_whole(path) as part:
        part.write_text("half", encoding="utf-8")
        raise KeyboardInterrupt


def test_an_interrupted_file_leaves_the_old_one_alone(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("old", encoding="utf-8")
    with pytest.raises(KeyboardInterrupt):
        _half_written(path)
    assert path.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(sys.platform == "win32", reason="needs links and devices of POSIX")
def test_links_stay_links_and_devices_are_written_directly(tmp_path: Path) -> None:
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_text("old", encoding="utf-8")
    link.symlink_to(target)
    write_whole_text(link, "new")
    assert link.is_symlink()
    assert target.read_text(encoding="utf-8") == "new"
    write_whole_text(os.devnull, "gone")
    assert not Path(os.devnull).is_file()

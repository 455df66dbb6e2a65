"""Folders are accepted wherever logs are: which of their logs a command takes, and what it reports of the others."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig_cli.log_places import logs_of
from rig_cli.main import run
from rig_configs import RigFileError
from tests.daq.small_log import write_small_log
from tests.rig_cli.test_exchange import BALANCED_COLUMNS, balanced_point
from tests.rig_cli.test_validate import known


def resting_rotor(out: Path) -> Path:
    """A ring-down recorded elsewhere: one displacement, no marks, no angles."""
    time_s, table = np.arange(0, 5, 1e-3), out.with_suffix(".csv")
    x_mm = np.exp(-0.4 * time_s) * np.cos(19.2 * time_s)
    np.savetxt(table, np.column_stack([time_s, x_mm]), "%.9g", delimiter=",", header="t,x", comments="")
    words = ["--rig", "virtual", "--test", "ring-down-x", "--time", "t:s", "--x", "x:mm"]
    assert run(["import", str(table), "-o", str(out), *words]) == 0
    return out


def touched(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    return path


def test_a_folder_means_its_logs_and_those_one_level_below(tmp_path: Path) -> None:
    a, b, c = (touched(tmp_path / name) for name in ("a.mcap", "logs/b.mcap", "c.mcap"))
    touched(tmp_path / "a.mcap.verdict.json")
    touched(tmp_path / "cut.mcap.part")
    found = logs_of("rig x", [c, tmp_path, tmp_path / "a.mcap.verdict.json"])
    assert found.logs == (c, a, b)
    assert found.of_folders == {a, b}  # c was named
    assert logs_of("rig x", [tmp_path, c]).of_folders == {a, b}


def test_places_without_logs_are_refused(tmp_path: Path) -> None:
    for places, words in (([], "usage: rig x LOG"), ([tmp_path], "found none"), ([tmp_path / "no"], "no file of this")):
        with pytest.raises(RigFileError, match=words):
            logs_of("rig x", places)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a point, a log that the analysis cannot use, and a file that is not a log."""
    folder = tmp_path_factory.mktemp("campaign")
    table, logs = balanced_point(folder / "b.csv"), folder / "logs"
    logs.mkdir()
    out = str(logs / "b.mcap")
    assert run(["import", str(table), "--rig", "virtual", "--point", "B", "-o", out, *BALANCED_COLUMNS]) == 0
    (logs / "a-broken.mcap").write_bytes(b"not a log")
    return folder


def answer(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, dict[str, Any]]:
    capsys.readouterr()
    code = run([*map(str, words), "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_identify_takes_a_folder(capsys: pytest.CaptureFixture[str], campaign: Path, tmp_path: Path) -> None:
    code, of_folder = answer(capsys, "identify", campaign, "-o", tmp_path / "folder.toml")
    assert code == 0
    assert any("a-broken.mcap" in text for text in of_folder["warnings"])
    code, named = answer(capsys, "identify", campaign / "logs/b.mcap", "-o", tmp_path / "named.toml")
    assert (code, named["parameters"]) == (0, of_folder["parameters"])
    capsys.readouterr()
    small = write_small_log(tmp_path / "small.mcap")  # of no kind of test
    assert run(["identify", str(campaign), str(small), "-o", str(tmp_path / "two.toml")]) == 0
    assert "identified from 1 log," in capsys.readouterr().out.splitlines()[-1]
    broken = campaign / "logs/a-broken.mcap"
    assert (
        answer(capsys, "identify", campaign, broken, "-o", tmp_path / "no.toml")[0] == 2
    )  # named: it must be readable


def test_validate_takes_a_folder(capsys: pytest.CaptureFixture[str], campaign: Path, tmp_path: Path) -> None:
    parameters = known(tmp_path / "p.toml")
    whole = tmp_path / "whole"
    whole.mkdir()
    shutil.copy(campaign / "logs/b.mcap", whole)
    code, found = answer(capsys, "validate", "virtual", whole, "--parameters", parameters)
    assert (code, list(found["points"])) == (0, ["B"])


@pytest.mark.parametrize("command", [("validate", "virtual"), ("report",)])
def test_no_verdict_is_given_without_a_log_of_its_folder(
    capsys: pytest.CaptureFixture[str], campaign: Path, tmp_path: Path, command: tuple[str, ...]
) -> None:
    code, found = answer(capsys, *command, campaign, "--parameters", known(tmp_path / "p.toml"))
    assert code == 2
    assert "a-broken.mcap" in found["error"]
    assert not (campaign / "report.html").exists()


def test_track_takes_those_logs_of_a_folder_in_which_pendulums_swing(
    capsys: pytest.CaptureFixture[str], campaign: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "logs"
    shutil.copytree(campaign / "logs", folder)
    resting_rotor(folder / "c-ring-down.mcap")
    code, found = answer(capsys, "track", folder)
    assert (code, len(found["logs"])) == (0, 1)
    (folder / "b.mcap").unlink()
    code, found = answer(capsys, "track", folder)
    assert code == 2

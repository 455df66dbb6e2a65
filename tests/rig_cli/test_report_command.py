"""`rig report`: a campaign's page and its numbers from logs alone, at any time."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rig_cli.main import run
from tests.rig_cli.test_exchange import BALANCED_COLUMNS, balanced_point
from tests.rig_cli.test_validate import known


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("campaign")
    assert run(["demo", "--rig", "one_laser", "--seed", "3", "--out", str(folder / "d"), "--json"]) == 0
    return folder / "d"


def answered(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, dict]:
    capsys.readouterr()
    code = run(["report", *map(str, words), "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_a_folder_gives_the_report_that_the_demo_gave(
    capsys: pytest.CaptureFixture[str], logs: Path, tmp_path: Path
) -> None:
    page = tmp_path / "again.html"
    code, answer = answered(capsys, logs, "-o", page)
    assert (code, answer["passed"], answer["points"]) == (0, True, {})
    numbers = json.loads(page.with_suffix(".json").read_text(encoding="utf-8"))
    first = json.loads((logs / "report.json").read_text(encoding="utf-8"))
    assert numbers["parameters"] == first["parameters"]
    assert [row["log"] for row in numbers["runs"]] == [row["log"] for row in first["runs"]]
    assert "Identified parameters" in page.read_text(encoding="utf-8")


def test_what_changed_since_an_earlier_file(capsys: pytest.CaptureFixture[str], logs: Path, tmp_path: Path) -> None:
    page = tmp_path / "since.html"
    older = known(tmp_path / "older.toml")  # of the rig file, which the simulated rig is not
    code, _ = answered(capsys, logs, "-o", page, "--since", older)
    numbers = json.loads(page.with_suffix(".json").read_text(encoding="utf-8"))
    assert code == 0
    assert numbers["changes"]["since"] == "older.toml"
    assert "k1 grew by" in numbers["changes"]["words"]
    assert numbers["changes"]["words"][1:] in page.read_text(encoding="utf-8")


def test_points_alone_need_parameters(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    table, log = balanced_point(tmp_path / "b.csv"), tmp_path / "b.mcap"
    assert run(["import", str(table), "--rig", "virtual", "--point", "B", "-o", str(log), *BALANCED_COLUMNS]) == 0
    code, answer = answered(capsys, log, "-o", tmp_path / "r.html")
    assert code == 2
    assert "expected tests to identify from" in answer["error"]
    code, answer = answered(capsys, log, "-o", tmp_path / "r.html", "--parameters", known(tmp_path / "p.toml"))
    assert (code, answer["points"]) == (0, {"B": "pass"})


@pytest.mark.parametrize(
    ("words", "part"),
    [
        ([], "usage: rig report FOLDER|LOG"),
        (["nowhere"], "found no file of this name"),
        (["{empty}"], "expected logs (*.mcap) in this folder"),
        (["{logs}", "-o", "{empty}/r.txt"], "expected a name ending in .html"),
        (["{logs}"], "exists; give --force"),
    ],
)
def test_wrong_uses_are_refused_before_the_work(
    capsys: pytest.CaptureFixture[str], logs: Path, tmp_path: Path, words: list[str], part: str
) -> None:
    code, answer = answered(capsys, *(word.format(logs=logs, empty=tmp_path) for word in words))
    assert code == 2
    assert part in answer["error"]

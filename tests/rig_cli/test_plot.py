"""`rig plot`: figures of imported and recorded logs, in every format; what is refused, and when."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.figures.kinds import KINDS
from rig_cli.main import run
from rig_cli.plot import Kind
from rig_configs import IdentifiedParameters
from tests.daq.small_log import write_small_log
from tests.figures.figure_runs import run_up
from tests.rig_cli.test_exchange import BALANCED_COLUMNS, balanced_point
from tests.rig_cli.test_log_places import resting_rotor


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run-up recorded elsewhere."""
    folder = tmp_path_factory.mktemp("plot")
    found, table, out = run_up(), folder / "up.csv", folder / "up.mcap"
    psi = np.interp(found.x_time_s, found.mark_time_s, found.mark_phase_rad)
    inside = (found.x_time_s > found.mark_time_s[0]) & (found.x_time_s < found.mark_time_s[-1])
    rows = np.column_stack([found.x_time_s, 1e3 * found.x_m, 1e3 * found.y_m, psi])[inside]
    np.savetxt(table, rows, "%.9g", delimiter=",", header="t,x,y,psi", comments="")
    words = ["--time", "t:s", "--x", "x:mm", "--y", "y:mm", "--phase", "psi:rad"]
    assert run(["import", str(table), "--rig", "virtual", "--test", "run-up", "-o", str(out), *words]) == 0
    return out


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("known") / "parameters.toml"
    IdentifiedParameters({"zeta1": 0.02}, np.array([[1e-8]]), {"tests": []}).save(path)
    return path


def plotted(capsys: pytest.CaptureFixture[str], *words: object, code: int = 0) -> dict[str, Any]:
    capsys.readouterr()
    assert run(["plot", *map(str, words), "--json"]) == code
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("suffix", [".svg", ".png", ".pdf", ".html"])
def test_a_figure_in_each_format(
    suffix: str, log: Path, known: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / f"bode{suffix}"
    answer = plotted(capsys, "bode", log, "--model", known, "-o", out)
    assert answer["figures"][0]["file"] == str(out)
    assert answer["figures"][0]["beside"] == "parameters.toml"
    begins = {".svg": b"<?xml", ".png": b"\x89PNG", ".pdf": b"%PDF", ".html": b"<!doctype html>"}
    assert out.read_bytes().startswith(begins[suffix])
    assert list(tmp_path.iterdir()) == [out]  # no other file


def test_a_page_needs_no_network(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plotted(capsys, "polar", log, "-o", tmp_path / "polar.html")
    text = (tmp_path / "polar.html").read_text(encoding="utf-8")
    assert "default-src 'none'" in text
    fetched = [link for link in re.findall(r"""(?:src|href)=["']([^"']+)""", text) if not link.startswith("#")]
    assert fetched == []
    assert "steady response, rig file" in text


def test_every_figure_of_a_run_up_is_named_after_its_log(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    answer = plotted(capsys, "orbit", log, "-o", tmp_path / "figures")
    assert [figure["file"] for figure in answer["figures"]] == [str(tmp_path / "figures" / "up.orbit.svg")]
    assert answer["figures"][0]["test"] == "run-up"


def test_health_of_a_recorded_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small = write_small_log(tmp_path / "small.mcap")
    plotted(capsys, "health", small, "-o", tmp_path / "health.svg")
    text = (tmp_path / "health.svg").read_text(encoding="utf-8")
    assert "age, ms" in text
    assert "laser/x" in text


def test_a_figure_is_not_replaced_unasked(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "time.svg"
    out.write_text("mine", encoding="utf-8")
    assert "(force)" in plotted(capsys, "time", log, "-o", out, code=2)["error"]
    assert out.read_text(encoding="utf-8") == "mine"
    plotted(capsys, "time", log, "-o", out, "--force")
    assert out.read_text(encoding="utf-8").startswith("<?xml")


def folder_of(tmp_path: Path, *logs: Path) -> Path:
    """A folder with these logs in it."""
    folder = tmp_path / "campaign"
    folder.mkdir(parents=True)
    for log in logs:
        shutil.copy(log, folder / log.name)
    return folder


def test_of_a_folder_those_logs_are_drawn_that_can_be(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = folder_of(tmp_path, write_small_log(tmp_path / "a-small.mcap"), log)
    answer = plotted(capsys, "bode", folder, "-o", tmp_path / "out")
    assert [Path(figure["file"]).name for figure in answer["figures"]] == ["up.bode.svg"]
    (left,) = answer["not_drawn"]
    assert left["log"] == str(folder / "a-small.mcap")
    assert "expected a run through speeds" in left["reason"]
    capsys.readouterr()
    assert run(["plot", "bode", str(folder), "-o", str(tmp_path / "again")]) == 0
    assert "not drawn:" in capsys.readouterr().err


def test_a_log_that_was_named_and_is_not_drawn_is_bad_input(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    small = write_small_log(tmp_path / "a-small.mcap")
    answer = plotted(capsys, "bode", small, log, "-o", tmp_path / "out", code=2)
    assert [Path(figure["file"]).name for figure in answer["figures"]] == ["up.bode.svg"]
    assert answer["not_drawn"][0]["log"] == str(small)


def test_an_unreadable_log_of_a_folder_keeps_no_other_from_being_drawn(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = folder_of(tmp_path, log)
    (folder / "a-broken.mcap").write_bytes(b"no log")
    answer = plotted(capsys, "bode", folder, "-o", tmp_path / "out")
    assert len(answer["figures"]) == 1
    assert "a-broken.mcap" in answer["not_drawn"][0]["reason"]
    named = plotted(capsys, "bode", folder / "a-broken.mcap", log, "-o", tmp_path / "named", code=2)
    assert len(named["figures"]) == 1


def test_a_folder_without_a_figure_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small = write_small_log(tmp_path / "a-small.mcap")
    folder = folder_of(tmp_path, small)
    shutil.copy(small, folder / "b-small.mcap")
    answer = plotted(capsys, "bode", folder, "-o", tmp_path / "out", code=2)
    assert answer["figures"] == []
    assert len(answer["not_drawn"]) == 2


@pytest.fixture(scope="module")
def point(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A point with free pendulums, recorded elsewhere."""
    folder = tmp_path_factory.mktemp("point")
    table, out = balanced_point(folder / "b.csv"), folder / "b.mcap"
    assert run(["import", str(table), "--rig", "virtual", "--point", "B", "-o", str(out), *BALANCED_COLUMNS]) == 0
    return out


@pytest.mark.parametrize("kind", ["slip", "multipliers", "map"])
def test_a_figure_of_all_logs_shows_those_of_a_folder_that_it_can(
    kind: str, point: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pluck = resting_rotor(tmp_path / "a-pluck.mcap")
    folder = folder_of(tmp_path, pluck, point)
    answer = plotted(capsys, kind, folder, "-o", tmp_path / "out")
    assert [Path(log).name for log in answer["figures"][0]["logs"]] == ["b.mcap"]
    assert [each["log"] for each in answer["not_drawn"]] == [str(folder / "a-pluck.mcap")]
    named = plotted(capsys, kind, pluck, point, "-o", tmp_path / "named", code=2)
    assert [Path(log).name for log in named["figures"][0]["logs"]] == ["b.mcap"]
    nothing = plotted(capsys, kind, folder_of(tmp_path / "x", pluck), "-o", tmp_path / "no", code=2)
    assert "a-pluck.mcap" in nothing["error"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["bode"], "no log given"),
        (["bode", "."], "found none"),
        (["bode", "LOG", "-o", "bode.jpeg"], ".svg, .png, .pdf, .html"),
        (["bode", "LOG", "SAME-NAME", "-o", "bode.svg"], "give a folder"),
        (["bode", "LOG", "SAME-NAME"], "several logs would be drawn to"),
        (["health", "LOG", "--over", "LOG"], "which take a second log"),
        (["dial", "LOG"], "expected pendulum angles"),
    ],
)
def test_what_is_refused(
    words: list[str],
    expected: str,
    log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    other = log.parent / "other" / log.name
    other.parent.mkdir(exist_ok=True)
    shutil.copy(log, other)
    places = {"LOG": str(log), "SAME-NAME": str(other)}
    answer = plotted(capsys, *[places.get(word, word) for word in words], code=2)
    assert expected in answer["error"]
    assert list(tmp_path.iterdir()) == []


def test_the_command_takes_the_kinds_there_are() -> None:
    assert set(Kind.__args__) == set(KINDS)

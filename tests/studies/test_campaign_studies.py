"""Campaigns as tiles, and archives identified again: real wire bytes and logs, the same bytes from another process."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import tomlkit

from analysis.maps.question import rig_source
from daq.lockstep.rehearsal import Rehearsal
from rig_cli.main import run
from studies.archive import Reidentified, archive_study, campaigns_in
from studies.campaigns import CampaignResults, campaign_study
from studies.engines.processes import Processes
from studies.engines.threads import Threads
from studies.errors import StudyInputError
from studies.running import run_study
from studies.study import Study
from studies.tile_files import TileFolder, packed

QUICK = ["virtual.seed=1"]


def with_one_point() -> str:
    """The shipped virtual rig with the point B alone."""
    document = tomlkit.parse(rig_source("virtual").text).unwrap()
    document["points"] = {"B": document["points"]["B"]}
    return tomlkit.dumps(document)


def ignore(text: str) -> None:
    raise AssertionError(text)


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory: pytest.TempPathFactory) -> TileFolder:
    folder = TileFolder(tmp_path_factory.mktemp("campaigns"), campaign_study(with_one_point(), [], 4, 1))
    run_study(folder, Threads())
    return folder


@pytest.mark.lengthy
def test_a_campaign_contains_what_it_found_and_what_is_true(campaigns: TileFolder) -> None:
    found = CampaignResults.of(campaigns)
    assert found.failed == {}
    z = found.parameter_z()
    assert set(z) == {"k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2", "c3_Nms_per_rad", "c4_Nms_per_rad", "SP_kg_m"}
    assert all(0 < abs(float(values[0])) < 4.5 for values in z.values()), "found is near the truth, and not it"
    assert list(found.verdicts()) == ["B"]
    assert found.passed == 1
    assert len(found.point_z()) >= 2


@pytest.mark.lengthy
def test_another_process_gives_the_same_campaign(campaigns: TileFolder, tmp_path: Path) -> None:
    folder = TileFolder(tmp_path, campaigns.study)
    run_study(folder, Processes(1, ignore))
    for path in campaigns.path.glob("*.npz"):
        assert (tmp_path / path.name).read_bytes() == path.read_bytes()


@pytest.mark.lengthy
def test_more_campaigns_go_on_from_those_there_are(campaigns: TileFolder) -> None:
    text = with_one_point()
    more, before = campaign_study(text, [], 3, 2), campaigns.study
    assert more.digest != before.digest
    assert more.name_of(1) == before.name_of(0), "seed 4 is seed 4"
    assert TileFolder(campaigns.path, more).finished() == {1}
    assert TileFolder(campaigns.path, before).finished() == {0}
    other = campaign_study(text, ["virtual.truth.imbalance.radius_m=*1.1"], 4, 1)
    assert other.name_of(0) != before.name_of(0)


@pytest.mark.lengthy
def test_a_campaign_that_cannot_be_run_contains_why_and_the_others_count(campaigns: TileFolder, tmp_path: Path) -> None:
    study = campaign_study(with_one_point(), ["limits.speed_rpm=100"], 4, 1)
    folder = TileFolder(tmp_path, study)
    run_study(folder, Threads())
    found = CampaignResults.of(folder)
    assert found.done == []
    assert "speed" in found.failed[4]
    both = CampaignResults([*found.rows, *CampaignResults.of(campaigns).rows])
    assert (len(both.done), len(both.failed), both.passed) == (1, 1, 1)


def test_counts_of_rows_are_what_was_counted() -> None:
    def row(values: list[float], verdict: str) -> dict[str, np.ndarray]:
        return {
            "seed": np.array(0),
            "names": np.array(["k1_N_per_m", "zeta1"]),
            "values": np.array(values),
            "std": np.array([2.0, 0.0]),
            "truth": np.array([10.0, 0.1]),
            "points": np.array(["A"]),
            "verdicts": np.array([verdict]),
            "quantities": np.array(["A theta3"]),
            "z": np.array([1.5]),
            "passed": np.array(verdict == "pass"),
            "warnings": np.array([], dtype=str),
        }

    found = CampaignResults([row([12.0, 0.1], "pass"), row([5.0, 0.2], "fail")])
    assert {name: list(z) for name, z in found.parameter_z().items()} == {"k1_N_per_m": [1.0, -2.5]}
    assert found.verdicts() == {"A": {"pass": 1, "fail": 1}}
    assert found.passed == 1


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two campaigns of a ring-down each, and a folder whose log is not a log."""
    place = tmp_path_factory.mktemp("archive")
    for name, seed in (("spring", 1), ("autumn", 2)):
        with Rehearsal("virtual", place / name, [f"virtual.seed={seed}"]) as rehearsal:
            rehearsal.record("ring-down-x")
    (place / "broken").mkdir()
    (place / "broken" / "01-ring-down-x.mcap").write_bytes(b"no log at all")
    return place


def test_an_archive_is_identified_campaign_by_campaign(archive: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run(["study", "archive", str(archive), "-o", str(out), "--scheduler", "local:1"]) == 0
    result = json.loads((out / "archive.json").read_text(encoding="utf-8"))
    by_name = {row["name"].split("/")[-1]: row for row in result["campaigns"]}
    assert set(by_name) == {"spring", "autumn", "broken"}
    assert "error" in by_name["broken"]
    values = [by_name[name]["parameters"]["k1_N_per_m"]["value"] for name in ("spring", "autumn")]
    assert values[0] != values[1]
    for name in ("spring", "autumn"):
        alone = tmp_path / f"{name}.toml"
        logs = [str(path) for path in (archive / name).glob("*.mcap")]
        assert run(["identify", *logs, "-o", str(alone)]) == 0
        ours = tomlkit.parse(Path(by_name[name]["file"]).read_text(encoding="utf-8")).unwrap()
        theirs = tomlkit.parse(alone.read_text(encoding="utf-8")).unwrap()
        assert ours["k1_N_per_m"] == theirs["k1_N_per_m"]
        assert ours["covariance"] == theirs["covariance"]


def test_an_archive_with_more_campaigns_goes_on(archive: Path) -> None:
    rig = rig_source("virtual")
    found = campaigns_in([archive])
    few, all_of_them = (archive_study((rig.source, rig.text), [], part) for part in (found[1:], found))
    assert [few.name_of(0), few.name_of(1)] == [all_of_them.name_of(1), all_of_them.name_of(2)]
    assert len({all_of_them.name_of(tile) for tile in range(3)}) == 3


def test_a_log_that_another_host_has_otherwise_is_refused(archive: Path) -> None:
    rig = rig_source("virtual")
    study = archive_study((rig.source, rig.text), [], [one for one in campaigns_in([archive]) if "spring" in one.name])
    other = Study(study.kind, study.text.replace("sha256:", "sha256:0")[:-1] + "}", study.software)
    from studies.worker import answer_tile

    with pytest.raises(StudyInputError, match="give all hosts access to the same archive"):
        answer_tile(other.kind, other.text, other.software, 0)


def test_an_archive_without_logs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StudyInputError, match=r"expected folders with NAME\.mcap files"):
        campaigns_in([tmp_path])


def test_what_identifies_nothing_is_listed_with_its_reason(tmp_path: Path) -> None:
    study = Study("archive", json.dumps({"campaigns": [{}]}), "0" * 16)
    folder = TileFolder(tmp_path, study)
    folder.keep(0, packed({"name": np.array("x"), "error": np.array("NotIdentifiable: no run-up")}))
    (row,) = Reidentified.all_of(folder)
    assert (row.name, row.parameters, row.text) == ("x", None, "NotIdentifiable: no run-up")

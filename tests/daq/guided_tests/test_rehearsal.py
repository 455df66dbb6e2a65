"""Guided tests on the virtual rig from Python."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest

from daq import open_log
from daq.errors import OperatorStop
from daq.lockstep import Rehearsal
from rig_configs import RigFileError
from tests.effort import thorough


@pytest.mark.parametrize(
    ("test", "numbers"),
    [("run-up", {"top_rpm": 600.0, "duration_s": 5.0}), pytest.param("ring-down-x", {}, marks=thorough)],
)
def test_a_seed_gives_the_same_bytes_and_another_seed_others(
    test: str, numbers: dict[str, float], tmp_path: Path
) -> None:
    logs = []
    for folder, seed in (("first", 3), ("second", 3), ("third", 4)):
        with Rehearsal("virtual", tmp_path / folder, [f"virtual.seed={seed}"]) as rehearsal:
            done = rehearsal.record(test, **numbers)
            assert (done.test, done.missed) == (test, "")
            logs.append(done.log.read_bytes())
    assert logs[0] == logs[1]
    assert logs[0] != logs[2]


def test_hardware_is_changed_between_two_tests(tmp_path: Path) -> None:
    rehearsal = Rehearsal("virtual", tmp_path)
    before = rehearsal.truth
    rehearsal.change("suspension.k2_N_per_m=+7%")
    after = rehearsal.truth
    rehearsal.close()
    assert after["k2_N_per_m"] == pytest.approx(1.07 * before["k2_N_per_m"])
    assert {n: v for n, v in after.items() if n != "k2_N_per_m"} == {n: before[n] for n in before if n != "k2_N_per_m"}


def test_a_number_of_the_test_goes_into_its_log(tmp_path: Path) -> None:
    with Rehearsal("virtual", tmp_path) as rehearsal:
        done = rehearsal.record("ring-down-y", pre_trigger_s=1.5)
    with open_log(done.log) as log:
        assert float(log.metadata["run"]["pre_trigger_s"]) == 1.5
        assert log.complete


def test_a_change_that_cannot_be_is_refused_before_the_rig_is_touched(tmp_path: Path) -> None:
    with Rehearsal("virtual", tmp_path) as rehearsal:
        before = rehearsal.truth
        with pytest.raises(RigFileError, match=r"suspension\.k3_N_per_m"):
            rehearsal.change("suspension.k3_N_per_m=1")
        assert rehearsal.truth == before


def test_a_rig_that_is_not_virtual_is_refused(tmp_path: Path) -> None:
    shipped = resources.files("rig_configs").joinpath("virtual.toml").read_text(encoding="utf-8")
    own = tmp_path / "own.toml"
    own.write_text(shipped[: shipped.index("[virtual]")].replace("printed by `rig virtual`", "/dev/ttyUSB0", 1))
    with pytest.raises(RigFileError, match=r"own\.toml: expected a rig file with a \[virtual\] table"):
        Rehearsal(own, tmp_path / "logs")
    assert not (tmp_path / "logs").exists()


def test_a_session_that_ends_early_leaves_its_log_and_the_rig_closed(tmp_path: Path) -> None:
    def gives_up(text: str, share: float | None) -> None:
        if share is not None and share > 0.3:
            raise OperatorStop("enough")

    with pytest.raises(OperatorStop), Rehearsal("virtual", tmp_path, progress=gives_up) as rehearsal:
        rehearsal.record("ring-down-x")
    (log,) = tmp_path.glob("*.mcap")
    with open_log(log) as opened:
        assert opened.complete

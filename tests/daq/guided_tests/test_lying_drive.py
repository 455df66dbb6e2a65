"""Guided tests with a drive whose settings are wrong, so that command and report are scaled alike."""

from __future__ import annotations

from pathlib import Path

import pytest

from daq.errors import ProcedureError
from daq.guided_tests.runner import NotReached
from daq.lockstep import Rehearsal
from daq.signals.run import disagreements, load_run
from identification import NotIdentifiable, identify
from rig_configs import load_rig
from tests.effort import thorough


class LyingDrive(Rehearsal):
    """The virtual rig whose drive turns the rotor `ratio` times as fast as commanded and as reported."""

    def __init__(self, folder: Path, ratio: float) -> None:
        super().__init__("virtual", folder)
        self._far.far.motion._slip = 1.0 - ratio
        self._far.ask("fail", device="drive", what="reported share", value=1.0 / ratio)


@pytest.mark.parametrize(
    ("pole_pairs", "set_", "named"), [(7, 8, "likely 8:7"), (7, 6, "likely 6:7")], ids=["fast", "slow"]
)
@pytest.mark.parametrize("test", ["point-C", "run-up"])
def test_a_wrong_number_of_pole_pairs_stops_a_test_and_is_named(
    test: str, pole_pairs: int, set_: int, named: str, tmp_path: Path
) -> None:
    with (
        pytest.raises(ProcedureError, match=f"the index marks come at .* {named}. Look at the drive's number of pole"),
        LyingDrive(tmp_path, set_ / pole_pairs) as rig,
    ):
        rig.record(test, **({"top_rpm": 500.0, "duration_s": 8.0} if test == "run-up" else {}))


@thorough  # waits until the time limit of the spin-up
@pytest.mark.parametrize("ratio", [0.96, 1.04])
def test_a_drive_off_by_less_than_the_interlock_does_not_reach_a_point(ratio: float, tmp_path: Path) -> None:
    with LyingDrive(tmp_path, ratio) as rig, pytest.raises(NotReached, match=r"the index marks come at .* no simple"):
        rig.record("point-C")


@pytest.mark.parametrize("ratio", [0.97, 1.03])
def test_a_run_up_is_judged_by_the_index_marks(ratio: float, tmp_path: Path) -> None:
    with LyingDrive(tmp_path, ratio) as rig:
        done = rig.record("run-up", top_rpm=400.0, duration_s=6.0)
    assert done.summary["reached_top"] is False
    assert f"{400 * ratio:.0f} of 400 rpm" in done.missed
    run = load_run(done.log)
    assert run.speed.ratio == pytest.approx(ratio, abs=2e-3)
    assert disagreements(run) == [run.speed.words] != [""]
    try:  # such a short run-up may determine nothing
        words = "; ".join(identify([run], load_rig("virtual")).warnings)
    except NotIdentifiable as error:
        words = str(error)
    assert run.speed.words in words


def test_an_honest_drive_passes(tmp_path: Path) -> None:
    with LyingDrive(tmp_path, 0.998) as rig:
        done = rig.record("run-up", top_rpm=400.0, duration_s=6.0)
    assert (done.missed, done.summary["reached_top"]) == ("", True)
    run = load_run(done.log)
    assert run.speed.agrees
    assert disagreements(run) == []

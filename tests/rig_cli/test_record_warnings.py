"""`rig record` ends with a line that names more than the losses if the run is not clean."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from daq.lockstep.rig import LockstepRig
from rig_cli.acquire import warning_words
from rig_cli.main import run
from rig_configs import load_rig
from tests.conftest import join


def test_a_sensor_that_loses_power_at_rest_makes_the_run_not_clean(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    far = LockstepRig(load_rig("virtual", settings=["virtual.seed=5"]))
    join(monkeypatch, "rig_cli.acquire", far)

    def cut() -> None:
        far.ask("fail", device="laser_y", what="power", value=1, seconds=0.5)

    far.clock.after(4.0, cut, world=True)
    ports = [word for setting in far.port_settings() for word in ("--set", setting)]
    code = run(["record", "virtual", "--duration", "15", "-o", str(tmp_path / "a.mcap"), *ports])
    err = capsys.readouterr().err
    assert code == 3
    restarted = "laser_y: counter and timestamp do not continue: the sensor restarted. Its clock is not continuous"
    assert f"warning: {restarted}" in " ".join(err.split())
    assert err.rstrip().endswith(" (above): the run is not clean")


@pytest.mark.parametrize(
    ("place_mm", "code", "warning"), [(50.0, 3, "laser/y: most samples of the last"), (2.0, 0, "")]
)
def test_a_recording_is_clean_if_the_target_is_in_range(
    place_mm: float,
    code: int,
    warning: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    far = LockstepRig(load_rig("virtual"))
    join(monkeypatch, "rig_cli.acquire", far)
    far.ask("place", device="laser_y", mm=place_mm)
    ports = [word for setting in far.port_settings() for word in ("--set", setting)]
    assert run(["record", "virtual", "--duration", "1", "-o", str(tmp_path / "a.mcap"), "--json", *ports]) == code
    warnings = json.loads(capsys.readouterr().out)["warnings"]
    assert [bool(warning and text.startswith(warning)) for text in warnings] == [True] * bool(warning)


@pytest.mark.parametrize(
    ("number", "listen", "words"),
    [
        (0, False, ""),
        (1, False, "; 1 warning (above): the run is not clean"),
        (2, False, "; 2 warnings (above): the run is not clean"),
        (1, True, "; 1 warning (above)"),  # a program that only receives ends with 0
    ],
)
def test_the_last_line_counts_the_warnings(number: int, listen: bool, words: str) -> None:
    assert warning_words(number, listen) == words

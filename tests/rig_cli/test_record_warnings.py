"""`rig record` ends with a line that names more than the losses if the run is not clean."""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path
from unittest.mock import patch

import pytest

from rig_cli.acquire import warning_words
from rig_cli.main import run
from rig_cli.simulated import VirtualRigProcess

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="ptys need POSIX")


def test_a_sensor_that_loses_power_at_rest_makes_the_run_not_clean(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "a.mcap"
    with VirtualRigProcess("virtual", ["virtual.seed=5"], 4.0, waits=True) as far:

        def cut() -> None:
            part = log.with_name("a.mcap.part")
            while not (part.exists() and part.stat().st_size > 100_000) and not ended.wait(0.05):
                pass
            far.line.ask("fail", device="laser_y", what="power", value=1, seconds=0.5)

        ended = threading.Event()
        cutting = threading.Thread(target=cut)
        cutting.start()
        ports = [word for setting in far.port_settings() for word in ("--set", setting)]
        with patch("rig_cli.acquire.HostClock", lambda scale: far.clock):  # its time waits for a busy machine
            code = run(["record", "virtual", "--duration", "15", "-o", str(log), *ports])
        ended.set()
        cutting.join()
    err = capsys.readouterr().err
    assert code == 3
    restarted = "laser_y: counter and timestamp do not continue: the sensor restarted. Its clock is not continuous"
    assert f"warning: {restarted}" in " ".join(err.split())
    assert err.rstrip().endswith(" (above): the run is not clean")


def recorded(folder: Path, place_mm: float | None) -> int:
    """Record a second of the virtual rig, with a target that is held before one of its sensors."""
    with VirtualRigProcess("virtual", [], 4.0, waits=True) as far:
        far.line.ask("place", device="laser_y", mm=place_mm)
        ports = [word for setting in far.port_settings() for word in ("--set", setting)]
        with patch("rig_cli.acquire.HostClock", lambda scale: far.clock):
            return run(["record", "virtual", "--duration", "1", "-o", str(folder / "a.mcap"), "--json", *ports])


def test_a_recording_of_a_sensor_without_a_target_is_not_clean(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert recorded(tmp_path, 50.0) == 3
    (warning,) = json.loads(capsys.readouterr().out)["warnings"]
    assert warning.startswith("laser/y: most samples of the last")


def test_a_recording_of_a_held_column_in_range_is_clean(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert recorded(tmp_path, 2.0) == 0
    assert json.loads(capsys.readouterr().out)["warnings"] == []


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

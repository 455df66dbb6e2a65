"""The example of a guided test from its wheel, in a fresh virtual environment: found, planned, run, shown as any other.

The environment sees this one's libraries, so that nothing is downloaded; the test itself is installed only there.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from daq import open_log
from daq.log.outcome import not_reached_of
from tests.example_wheel import python_with

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "examples" / "rig_test_slow_roll"

ROLL = """
import sys
from rig_cli.main import run
from rig_cli.simulated import VirtualRigProcess

with VirtualRigProcess("virtual", []) as far:
    ports = [word for setting in far.port_settings() for word in ("--set", setting)]
    words = ["test", "virtual", "slow-roll", "--number", "turns=5", "--out", "logs", "--json"]
    sys.exit(run([*words, *ports]))
"""


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Of a fresh virtual environment with the example's wheel in it."""
    return python_with("rig_test_slow_roll", tmp_path_factory.mktemp("example"))


def ran(python: str, folder: Path, *arguments: str) -> str:
    done = subprocess.run([python, *arguments], capture_output=True, text=True, check=False, cwd=folder)
    assert done.returncode == 0, done.stderr[-3000:] + done.stdout[-2000:]
    return done.stdout


def test_it_is_found_planned_and_passes_its_own_tests(python: str, tmp_path: Path) -> None:
    listed = json.loads(ran(python, tmp_path, "-m", "rig_cli.main", "test", "virtual", "--json"))["tests"]
    assert [row["state"] for row in listed if row["test"] == "slow-roll"] == ["missing"]
    planned = ran(python, tmp_path, "-m", "rig_cli.main", "test", "virtual", "slow-roll", "--plan", "--json")
    assert json.loads(planned)["numbers"] == {"speed_rpm": 40.0, "turns": 10.0}
    ran(python, tmp_path, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(EXAMPLE / "tests"))


def test_it_is_run_and_its_log_holds_the_runout(python: str, tmp_path: Path) -> None:
    (tmp_path / "roll.py").write_text(ROLL)
    result = json.loads(ran(python, tmp_path, "roll.py"))
    assert result["reached"] is True
    with open_log(tmp_path / result["log"]) as log:  # here, where the test is not installed
        assert log.metadata["run"]["test"] == "slow-roll"
        assert not_reached_of(log) == ""
        assert len(log["tacho"]["revolutions"]) >= 5
        for axis in "xy":
            assert 0.005 < result[f"runout_{axis}_mm"] < 1.0


def test_what_the_how_to_shows_is_the_example() -> None:
    page = (ROOT / "docs" / "how-to" / "developer" / "add_a_test.md").read_text(encoding="utf-8")
    shown = [block.split("```")[0].strip("\n") for block in page.split("```py\n")[1:]]
    files = [
        path.read_text(encoding="utf-8") for path in sorted(EXAMPLE.rglob("*.*")) if path.suffix in (".py", ".toml")
    ]
    assert len(shown) >= 3
    for block in shown:
        assert any(block in text for text in files), block

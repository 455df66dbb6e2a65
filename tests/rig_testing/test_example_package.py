"""The example driver from its wheel, in a fresh virtual environment: found, passed, recorded, replayed; a twin fails.

The environment has this one's libraries, so that nothing is downloaded; the driver itself is installed only there.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from daq import open_log
from tests.example_wheel import python_with

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "rig_driver_tilt"

TWINS = """
from dataclasses import replace
from functools import partial
from daq.drivers.line_sensor import LinePipeline
from rig_driver_tilt import DRIVER, SAMPLE, SENSOR, UNIT_RAD, Reading, Tilt, parse

def unchecked(line):
    found = SAMPLE.match(line.decode("ascii", "replace"))
    if found is None:
        return parse(line)
    number, ms, x, y = map(int, found.groups())
    return Reading(number, (x * UNIT_RAD, y * UNIT_RAD), ms)

class Forgetful(LinePipeline):
    def feed(self, direction, data, host_ns):
        out = super().feed(direction, data, host_ns)
        self.losses["samples"] = 0
        return [item for item in out if getattr(item, "kind", "") != "gap"]

UNCHECKED = replace(SENSOR, parse=unchecked).driver("tilt", Tilt, claims=DRIVER.claims)
FORGETFUL = replace(DRIVER, pipeline=partial(Forgetful, SENSOR))
"""

RECORD = """
import sys
import threading
from rig_cli.main import run
from rig_cli.simulated import VirtualRigProcess

rig, log = sys.argv[1:]
over = threading.Event()

def pluck(line):
    while not over.wait(1.2):
        line.ask("pluck", x_mm=2.0, y_mm=1.0, hold_s=0.3)

with VirtualRigProcess(rig, []) as far:
    hand = threading.Thread(target=pluck, args=(far.line,))
    hand.start()
    ports = [word for setting in far.port_settings() for word in ("--set", setting)]
    code = run(["record", rig, "--duration", "4", "-o", log, *ports])
    over.set()
    hand.join()
sys.exit(code or run(["replay", log, "--check", "--json"]))
"""


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Of a fresh virtual environment with the example's wheel in it."""
    return python_with("rig_driver_tilt", tmp_path_factory.mktemp("example"))


def ran(python: str, folder: Path, *arguments: str, code: int = 0) -> str:
    done = subprocess.run(
        [python, *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
    )
    assert done.returncode == code, done.stderr[-3000:] + done.stdout[-2000:]
    return done.stdout


def rig(*arguments: str) -> list[str]:
    return ["-m", "rig_cli.main", *arguments]


def test_it_is_found_and_passes(python: str, tmp_path: Path) -> None:
    listed = json.loads(ran(python, tmp_path, *rig("driver", "list", "--json")))["drivers"]
    assert {"name": "tilt", "package": "rig-driver-tilt", "roles": ["other quantity"], "verified": False} in listed
    passed = json.loads(ran(python, tmp_path, *rig("driver", "check", "rig-driver-tilt", "--json")))
    assert passed == {"driver": "tilt", "passed": True, "failed": []}
    ran(python, tmp_path, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(EXAMPLE / "tests"))


def test_broken_twins_fail_for_the_right_reason(python: str, tmp_path: Path) -> None:
    (tmp_path / "twins.py").write_text(TWINS)
    for name, reasons in (
        ("UNCHECKED", {"mutations": "claims a checksum"}),
        ("FORGETFUL", {"damage": "claims to count exactly", "lost reads": "no loss was counted", "end": "0 counted"}),
    ):
        out = ran(python, tmp_path, *rig("driver", "check", f"twins:{name}", "--json"), code=1)
        failed = {each["test"]: each["why"] for each in json.loads(out)["failed"]}
        for test, why in reasons.items():
            assert why in failed[test]
        assert set(failed) <= {*reasons, "garbage", "damage"}


def test_its_channel_is_recorded_and_replayed_bit_for_bit(python: str, tmp_path: Path) -> None:
    text = (ROOT / "rig_configs" / "virtual.toml").read_text(encoding="utf-8")
    (tmp_path / "rig.toml").write_text(text + '\n[devices.tilt]\ndriver = "tilt"\nport = "simulated"\n')
    (tmp_path / "record.py").write_text(RECORD)
    checked = json.loads(ran(python, tmp_path, "record.py", "rig.toml", "a.mcap"))
    assert checked["identical"] is True
    (row,) = [row for row in checked["channels"] if row["topic"] == "tilt"]
    assert row["compared"] == row["live"] > 300
    with open_log(tmp_path / "a.mcap") as log:  # here, where the driver is not installed
        tilt, laser = log["tilt"], log["laser/x"]
        late_s = np.linspace(-0.2, 0.2, 81)  # both clocks are mapped as they run, by a host that may be busy
        expected = [np.interp(tilt.time_s + s, laser.time_s, laser["displacement_m"]) / 0.5 for s in late_s]
        off = [float(np.std(tilt["tilt_x_rad"] - each)) for each in expected]
    assert len(tilt.time_s) > 300
    assert np.ptp(expected[40]) > 2e-3
    assert min(off) < 0.25 * float(np.std(expected[40]))


def test_what_the_how_to_shows_is_the_example() -> None:
    page = (ROOT / "docs" / "how-to" / "developer" / "add_a_device.md").read_text(encoding="utf-8")
    shown = [block.split("```")[0].strip("\n") for block in page.split("```py\n")[1:]]
    files = [
        path.read_text(encoding="utf-8") for path in sorted(EXAMPLE.rglob("*.*")) if path.suffix in (".py", ".toml")
    ]
    assert len(shown) >= 4
    for block in shown:
        assert any(block in text for text in files), block

"""The calibration in the rig file: applied once to every driver's displacements, and part of every log."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from daq.acquisition.session import Session
from daq.drivers.calibrated import Calibration, calibrations_of
from daq.drivers.devices import make_pipelines
from daq.items import RX
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.replay import check
from rig_configs import load_rig
from rig_configs.device import DisplacementSettings
from tests.daq.small_log import device_bytes

X = "devices.laser_x"
CORRECTION = [f"{X}.gain_factor=1.25", f"{X}.offset_m=0.0005", f'{X}.calibrated="2026-11-26T18:00:00Z"']
EXACT = ["virtual.sensors.draw_calibration=false", "virtual.sensors.laser_noise_m=0.0"]


def record(rig: str, folder: Path, sensor: str, *settings: str, host: tuple[str, ...] = ()) -> tuple[Path, float]:
    """Record a target at 2 mm; return the log and the mean displacement, mm."""
    far = LockstepRig(load_rig(rig, settings=[*EXACT, *settings]))
    loaded = load_rig(rig, settings=[*EXACT, *settings, *host, *far.port_settings()])
    path = folder / "held.mcap"
    with Session(loaded, far.clock, edge=far.edge) as session:
        far.ask("place", device=sensor, mm=2.0)
        session.clock.wait(0.2)
        session.start_recording(path, {"test": "record"})
        session.clock.wait(0.5)
        settings_of = loaded.devices[sensor]
        assert isinstance(settings_of, DisplacementSettings)
        _, columns = session.channels.newest(settings_of.topic, ("displacement_m",), 0.3)
        mean_m = float(np.mean(np.asarray(columns[0], np.float64)))
        session.stop_recording({})
    return path, 1e3 * mean_m


def test_the_gain_and_the_offset_are_applied_once_live_and_in_replay(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    _, plain = record("virtual", tmp_path / "a", "laser_x")
    log, corrected = record("virtual", tmp_path / "b", "laser_x", host=tuple(CORRECTION))
    assert corrected == pytest.approx(1.25 * plain + 0.5, abs=2e-3)
    assert [row.topic for row in check(log) if row.difference] == []
    with open_log(log) as found:
        facts = json.loads(found.metadata["run"]["calibrations"])
    assert facts == {"laser_x": {"calibrated": "2026-11-26T18:00:00Z", "record": ""}}


@pytest.mark.parametrize(("rig", "sensor"), [("virtual", "laser_x"), ("other_devices", "east")])
def test_a_calibrated_virtual_sensor_measures_the_truth(rig: str, sensor: str, tmp_path: Path) -> None:
    place = f"devices.{sensor}"
    _, found = record(rig, tmp_path, sensor, f"{place}.gain_factor=0.97", f"{place}.offset_m=0.0002")
    own = 0.05  # mm, standard deviation of the sensor's mounting
    assert found == pytest.approx(2.0, abs=5 * own)


def test_a_device_without_a_calibration_is_not_changed() -> None:
    settings = load_rig("virtual").devices["laser_x"]
    data = device_bytes(1)[0][1]
    plain, again = (make_pipelines(load_rig("virtual").devices, {})["laser_x"] for _ in range(2))
    expected = plain.feed(RX, data, 10**18)
    assert len(expected) > 0
    assert repr(Calibration.of(settings).decode(again, RX, data, 10**18)) == repr(expected)
    assert calibrations_of(load_rig("virtual").devices) == {}

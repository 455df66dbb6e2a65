"""A log stores the roles of its devices, so that it can be read without their drivers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq.drivers.devices import make_pipelines
from daq.errors import LogError
from daq.log import open_log, snapshot
from daq.log.file import LogFile
from daq.log.snapshot import rig_of
from daq.playback.outlets import played_devices
from daq.replay.stream import pipelines_of
from daq.signals.run import load_run
from rig_configs import load_rig
from rig_configs.drivers import installed
from rig_configs.roles import (
    DisplacementSensor,
    OtherQuantity,
    PendulumAngles,
    PendulumLocks,
    Role,
    Roles,
    RotorPhase,
    read_role,
    role_table,
)
from tests.daq.replayed_log import START_NS
from tests.daq.small_log import write_small_log

OTHER = load_rig("other_devices")


def without(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    left = {name: point for name, point in installed().items() if name not in names}
    monkeypatch.setattr(snapshot, "installed", lambda: left)


def test_a_log_is_read_without_the_drivers_of_its_devices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_small_log(tmp_path / "a.mcap")
    with open_log(path) as log:
        before, roles = load_run(path), rig_of(log).roles
    without(monkeypatch, "optoncdt", "cia402")
    with open_log(path) as log:
        assert rig_of(log).roles == roles
        assert list(pipelines_of(log)) == ["encoder"]
        assert set(played_devices(log)) == set(log.devices)
    after = load_run(path)
    assert np.array_equal(before.x_time_s, after.x_time_s)
    assert np.array_equal(before.x_m, after.x_m, equal_nan=True)
    assert before.clock_rate_std == after.clock_rate_std


def test_a_log_of_before_roles_were_kept_names_the_driver_that_is_missing(tmp_path: Path) -> None:
    rig = OTHER.snapshot_json().replace(b'"driver":"riftek"', b'"driver":"acme"')
    with LogFile(tmp_path / "a.mcap", {"test": "record"}, {"rig.json": rig}, (), START_NS) as log:
        path = log.finish({"losses": {}})
    with open_log(path) as opened, pytest.raises(LogError, match="no driver 'acme' is installed"):
        rig_of(opened)


@pytest.mark.parametrize("stored", [b"[]", b'{"east": 3}', b'{"east": [{"role": "dance"}]}', b'{"east": [{}]}'])
def test_invalid_roles_are_refused(tmp_path: Path, stored: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    attachments = {"rig.json": OTHER.snapshot_json(), "roles.json": stored}
    with LogFile(tmp_path / "a.mcap", {"test": "record"}, attachments, (), START_NS) as log:
        path = log.finish({"losses": {}})
    without(monkeypatch, "riftek")
    with open_log(path) as opened, pytest.raises(LogError, match=r"roles\.json"):
        rig_of(opened)


@pytest.mark.parametrize(
    "role",
    [
        DisplacementSensor(device="a", topic="laser/x", axis="x", rate_Hz=10.0, range_m=0.1, clock_tolerance_ppm=1.0),
        PendulumAngles(
            device="a", topic="t", rate_Hz=1.0, counts_per_revolution=64, zero_std_deg=0.0, clock_tolerance_ppm=1.0
        ),
        RotorPhase(device="a", topic="t", index_angle_deg=3.0, clock_tolerance_ppm=1.0),
        PendulumLocks(device="a"),
        OtherQuantity(device="a", topic="t", fields=("temperature_degC",)),
    ],
)
def test_every_role_comes_back_from_json(role: Role) -> None:
    assert read_role(json.loads(json.dumps(role_table(role)))) == role


def test_a_role_with_a_number_it_cannot_have_is_refused() -> None:
    table = role_table(RotorPhase(device="a", topic="t", index_angle_deg=3.0, clock_tolerance_ppm=1.0))
    for wrong in ({"clock_tolerance_ppm": -1.0}, {"index_angle_deg": float("nan")}, {"device": 3}, {"role": "dance"}):
        with pytest.raises(ValueError, match=r"."):
            read_role({**table, **wrong})


def test_two_devices_cannot_be_one_role_nor_fill_one_channel() -> None:
    first = OtherQuantity(device="a", topic="t", fields=("x_m",))
    with pytest.raises(ValueError, match="a and b fill the same channel 't'"):
        Roles.of([first, replace(first, device="b")])
    with pytest.raises(ValueError, match="a and b are both the rig's pendulum locks: expected one"):
        Roles.of([PendulumLocks(device="a"), PendulumLocks(device="b")])


def test_pipelines_of_a_rig_file_need_all_drivers() -> None:
    assert list(make_pipelines(OTHER.devices, {})) == ["east", "north", "rotor", "motor"]

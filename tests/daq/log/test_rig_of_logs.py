"""The rig of logs that are taken together: their own, or a given file that agrees with it in what is taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daq.exchange import import_recording, make_recipe
from daq.log.rig_of_logs import RigUse, rig_of_logs
from rig_configs import PARAMETER_UNITS, IdentifiedParameters, RigFileError, load_rig
from rig_configs.load import rig_from_text, rig_text

IDENTIFIES = RigUse("rig identify")


def made(folder: Path, name: str, *settings: str, start: str = "2026-03-01T10:00:00") -> Path:
    """A log of the shipped rig with some numbers changed."""
    table = folder / f"{name}.csv"
    table.write_text("t,x\n" + "".join(f"{i / 1000:.3f},{0.1 * (i % 7)}\n" for i in range(50)), encoding="utf-8")
    recipe = make_recipe(test="ring-down-x", time="t:s", x="x:mm", start=start)
    return import_recording(table, folder / f"{name}.mcap", load_rig("virtual", settings=settings), recipe).path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("logs")


@pytest.fixture(scope="module")
def heavy(folder: Path) -> Path:
    return made(folder, "heavy", "rotor.mass_kg=9.0")


def test_without_a_file_the_rig_is_the_logs_own(heavy: Path) -> None:
    assert rig_of_logs([heavy], IDENTIFIES).rotor.mass_kg == 9.0


def test_uncertainties_limits_and_estimates_are_those_of_the_log_recorded_last(folder: Path, heavy: Path) -> None:
    later = made(
        folder,
        "later",
        "rotor.mass_kg=9.0",
        "rotor.mass_std_kg=0.01",
        "limits.speed_rpm=900",
        "suspension.k1_N_per_m=*1.1",
        start="2026-03-02T10:00:00",
    )
    for logs in ([heavy, later], [later, heavy]):
        found = rig_of_logs(logs, IDENTIFIES)
        assert (found.rotor.mass_std_kg, found.limits.speed_rpm) == (0.01, 900)


@pytest.mark.parametrize(
    ("setting", "place"),
    [
        ("imbalance.mass_kg=0.2", "imbalance.mass_kg"),
        ("pendulums.b.length_m=0.123", "pendulums.b.length_m"),
        ("pendulums.pivot_shift_m=0.002", "pendulums.pivot_shift_m"),
        ("suspension.gravity_m_per_s2=9.81", "suspension.gravity_m_per_s2"),
        ("pendulums.a.friction_arm_m=1e-4", "pendulums.a.friction_arm_m"),
        ("devices.laser_x.range_m=0.05", "range_m of laser/x"),
        ("devices.laser_x.lever_ratio=0.8", "lever_ratio of laser/x"),
        ("devices.laser_x.gain_factor=1.02", "gain_factor of laser/x"),
        ("devices.encoder.counts_per_revolution=1024", "counts_per_revolution of pendulums"),
        ("devices.encoder.index_angle_deg=33", "index_angle_deg of tacho"),
    ],
)
def test_logs_of_different_rigs_are_refused_with_both_values(folder: Path, setting: str, place: str) -> None:
    name = place.replace(" ", "-").replace("/", "-")
    own, other = made(folder, f"own-{name}"), made(folder, f"other-{name}", setting, start="2026-03-02T10:00:00")
    value = setting.partition("=")[2]
    with pytest.raises(RigFileError) as refused:
        rig_of_logs([own, other], IDENTIFIES)
    (line,) = (line for line in str(refused.value).splitlines() if f"  {place}: " in line)
    assert own.name in line
    assert other.name in line
    assert float(line.partition(": ")[2].split()[0]) == float(value)


def test_a_given_file_of_another_rig_is_refused_unless_the_number_is_stated(heavy: Path) -> None:
    with pytest.raises(RigFileError, match=r"rotor\.mass_kg: .* in virtual, 9\.0 in heavy\.mcap"):
        rig_of_logs([heavy], IDENTIFIES, "virtual")
    with pytest.raises(RigFileError, match=r"a setting, for example rotor\.mass_kg="):
        rig_of_logs([heavy], IDENTIFIES, rig_text("virtual"))
    assert rig_of_logs([heavy], IDENTIFIES, "virtual", settings=["rotor.mass_kg=9.1"]).rotor.mass_kg == 9.1
    assert rig_of_logs([heavy], IDENTIFIES, settings=["rotor.mass_kg=9.1"]).rotor.mass_kg == 9.1
    assert rig_of_logs([heavy], RigUse("rig plan", facts=False), "virtual").name == "virtual"


def test_a_calibration_that_is_set_does_not_change_samples_and_is_refused(heavy: Path) -> None:
    with pytest.raises(RigFileError, match=r"(?s)laser/x: 0\.05 in .*rig replay"):
        rig_of_logs([heavy], IDENTIFIES, settings=["devices.laser_x.range_m=0.05"])


def test_a_sensor_that_the_given_file_lacks_is_a_difference(heavy: Path) -> None:
    name, text = rig_text("virtual")
    without = text.replace("[devices.encoder]", "[devices.encoder]\nangles = false\nlocks = false")
    assert rig_from_text(name, without).roles.angles is None
    with pytest.raises(RigFileError, match=r"pendulums: no such sensor in .*, a sensor in heavy\.mcap"):
        rig_of_logs([heavy], IDENTIFIES, (name, without), settings=["rotor.mass_kg=9"])


def identified(*left_out: str) -> IdentifiedParameters:
    values = {n: v for n, v in load_rig("virtual").physics.identified().items() if n not in left_out}
    return IdentifiedParameters(values, np.zeros((len(values), len(values))))


def test_estimates_are_compared_where_a_command_relies_on_them(folder: Path) -> None:
    stiff = made(folder, "stiff", "suspension.k2_N_per_m=*2")
    assert rig_of_logs([stiff], IDENTIFIES, "virtual").suspension.k2_N_per_m > 0
    whole, without_k2 = identified(), identified("k2_N_per_m")
    rig = rig_of_logs([stiff], RigUse.relying_on_estimates("rig validate", whole), "virtual", whole)
    assert rig.suspension.k2_N_per_m == whole.values["k2_N_per_m"]
    assert set(whole.values) == set(PARAMETER_UNITS)
    with pytest.raises(RigFileError, match=r"suspension\.k2_N_per_m"):
        rig_of_logs([stiff], RigUse.relying_on_estimates("rig validate", without_k2), "virtual", without_k2)

"""Slips of a unit in a rig file: each is named with its number, the likely unit and the usual range."""

from __future__ import annotations

import pytest

from rig_configs import load_rig
from rig_configs.load import shipped_rigs
from rig_configs.usual_numbers import doubts


@pytest.mark.parametrize("name", shipped_rigs())
def test_nothing_is_odd_about_a_shipped_rig(name: str) -> None:
    assert doubts(load_rig(name)) == []


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        ("suspension.zeta1=2.0", "suspension.zeta1 is 2: per cent? Usual is 0 to 0.5"),
        ("pendulums.a.mass_kg=75", "pendulums.a.mass_kg is 75 kg: grams? Usual is 0.001 to 5 kg, or 0 for no pendulum"),
        ("pendulums.b.length_m=0.9", "pendulums.b.length_m is 0.9 m: centimetres? Usual is 0.003 to 0.3 m"),
        ("pendulums.a.length_m=5.4e-5", "pendulums.a.length_m is 5.4e-05 m. Usual is"),
        ("pendulums.a.damping_Nms_per_rad=1.0", "mN m s"),
        ("rotor.mass_kg=7000", "rotor.mass_kg is 7000 kg: grams?"),
        ("imbalance.mass_kg=100", "imbalance.mass_kg is 100 kg: grams?"),
        ("suspension.k1_N_per_m=2.58", "suspension.k1_N_per_m is 2.58 N/m: N/mm? Usual is 20 to 1e+08 N/m"),
        ("suspension.gravity_m_per_s2=1", "suspension.gravity_m_per_s2 is 1 m/s²: g? Usual is 9.7 to 9.9"),
        ("pendulums.pivot_shift_m=0.05", "pendulums.pivot_shift_m is 0.05 m: millimetres"),
        ("limits.speed_rpm=20", "limits.speed_rpm is 20 rpm: Hz or rad/s?"),
        ("devices.laser_x.range_m=25", "devices.laser_x.range_m is 25 m: millimetres or centimetres?"),
        ("devices.laser_x.gain_std=0.1", "devices.laser_x.gain_std is 0.1: per cent?"),
        ("devices.laser_x.port=/dev/ttyUSB?", "devices.laser_x.port is '/dev/ttyUSB?': a placeholder?"),
        ("devices.laser_x.port=to be found", "a placeholder?"),
    ],
)
def test_a_slip_is_named_with_its_number_its_unit_and_the_usual_range(setting: str, text: str) -> None:
    (doubt,) = doubts(load_rig("virtual", settings=[setting]))
    assert doubt.startswith(setting.partition("=")[0])
    assert text in doubt


@pytest.mark.parametrize(
    "setting",
    [
        "pendulums.a.mass_kg=0",
        "imbalance.mass_kg=0",
        "suspension.zeta1=0",
        "suspension.gravity_m_per_s2=9.81",
        "pendulums.a.friction_arm_m=1e-4",
        "devices.drive.port=can:can0",
        "devices.laser_x.port=COM3",
    ],
)
def test_usual_numbers_and_none_at_all_are_no_slip(setting: str) -> None:
    settings = [setting, "imbalance.radius_m=0"] if setting == "imbalance.mass_kg=0" else [setting]
    assert doubts(load_rig("virtual", settings=settings)) == []

"""What a rig file takes as known: standard uncertainties, instruments, numbers that are exact."""

from __future__ import annotations

import math
import re
from importlib import resources

import pytest
from hypothesis import given, strategies as st

from rig_configs import RigFileError, load_rig
from rig_configs.known import INDEX, PHYSICAL, ZERO_A, ZERO_B, assumed_remarks, physical_numbers, with_number
from rig_configs.load import rig_from_text

BALANCE = [
    "instruments.balance.measures=['rotor.mass_kg', 'pendulums.a.mass_kg']",
    "instruments.balance.relative_std=1e-4",
    "instruments.balance.distribution='rectangular'",
    "instruments.balance.degrees_of_freedom=12.0",
]


def test_numbers_stated_without_error_are_exact_and_zeros_are_as_they_are_given() -> None:
    known = load_rig("virtual").known
    assert known.assumed == ()
    assert {source.name for source in known.sources} == {ZERO_A, ZERO_B}
    assert known.std(ZERO_A) == pytest.approx(math.radians(0.05))
    assert known.exact == tuple(name for name in PHYSICAL if name != "pendulums.pivot_shift_m")


def test_every_number_may_carry_its_standard_uncertainty() -> None:
    stated = {
        "rotor.mass_std_kg": ("rotor.mass_kg", 0.003),
        "imbalance.mass_std_kg": ("imbalance.mass_kg", 1e-5),
        "pendulums.a.mass_std_kg": ("pendulums.a.mass_kg", 2e-5),
        "pendulums.a.length_std_m": ("pendulums.a.length_m", 3e-5),
        "pendulums.b.mass_std_kg": ("pendulums.b.mass_kg", 4e-5),
        "pendulums.b.length_std_m": ("pendulums.b.length_m", 5e-5),
        "pendulums.pivot_shift_std_m": ("pendulums.pivot_shift_m", 1e-5),
    }
    settings = [f"{key}={std}" for key, (_, std) in stated.items()]
    known = load_rig("virtual", settings=[*settings, "devices.encoder.index_angle_std_deg=0.1"]).known
    for number, std in stated.values():
        assert known.std(number) == std
    assert known.std(INDEX) == pytest.approx(math.radians(0.1))
    assert known.exact == ()


def test_a_number_without_a_stated_uncertainty_is_not_exact() -> None:
    text = (resources.files("rig_configs") / "virtual.toml").read_text(encoding="utf-8")
    bare = re.sub(r"(?m)^(mass_std_kg|length_std_m|radius_std_m) = .*\n", "", text)
    rig = rig_from_text("bare.toml", bare)
    stated = [name for name in PHYSICAL if name != "pendulums.pivot_shift_m"]  # the rig has no pivot shift
    assert list(rig.known.assumed) == stated
    assert rig.known.exact == ()
    for name in stated:
        assert rig.known.std(name) == pytest.approx(1e-3 * rig.known.values[name])
    assert rig.imbalance.assumed_radius_std_m == pytest.approx(1e-3 * rig.imbalance.radius_m)
    (sentence,) = assumed_remarks(rig.known.assumed)
    assert "rotor.mass_kg" in sentence
    assert "0.1 % of each" in sentence
    weighed = rig_from_text("bare.toml", bare, settings=BALANCE).known
    assert set(weighed.assumed) == set(stated) - {"rotor.mass_kg", "pendulums.a.mass_kg"}
    assert rig_from_text("bare.toml", bare, settings=["rotor.mass_std_kg=0.0"]).known.std("rotor.mass_kg") == 0.0


def test_range_and_lever_add_to_a_laser_s_gain() -> None:
    rig = load_rig("virtual", settings=["devices.laser_x.range_std_m=5e-5", "devices.laser_x.lever_ratio_std=0.003"])
    assert rig.roles.gain_stds == pytest.approx((math.hypot(0.001, 0.002, 0.003), 0.001))


def test_an_instrument_is_one_error_in_all_that_it_measured_and_gives_its_kind_to_their_own() -> None:
    known = load_rig("virtual", settings=[*BALANCE, "rotor.mass_std_kg=0.002"]).known
    by_name = {source.name: source for source in known.sources}
    assert by_name["balance"].effects == pytest.approx({"rotor.mass_kg": 7e-4, "pendulums.a.mass_kg": 7.5e-6})
    for name in ("balance", "rotor.mass_kg"):
        assert (by_name[name].distribution, by_name[name].degrees_of_freedom) == ("rectangular", 12.0)
    assert known.std("rotor.mass_kg") == pytest.approx(math.hypot(0.002, 7e-4))
    assert "pendulums.a.mass_kg" not in known.exact


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (["instruments.balance.measures=['rotor.weight']"], "expected rotor.mass_kg, .*got 'rotor.weight'"),
        (
            [*BALANCE, "instruments.scales.measures=['rotor.mass_kg']"],
            "rotor.mass_kg is measured by balance and sc",
        ),
        (["rotor.mass_std_kg=-1.0"], "rotor.mass_std_kg"),
        (["instruments.balance.measures=[]"], "instruments.balance.measures"),
    ],
)
def test_what_cannot_be_is_refused_by_name(settings: list[str], message: str) -> None:
    with pytest.raises(RigFileError, match=message):
        load_rig("virtual", settings=settings)


@given(
    name=st.sampled_from([name for name in PHYSICAL if name != "pendulums.pivot_shift_m"]), share=st.floats(0.9, 1.1)
)
def test_a_changed_number_changes_nothing_that_tests_find(name: str, share: float) -> None:
    physics = load_rig("virtual").physics
    value = share * physical_numbers(physics)[name]
    changed = with_number(physics, name, value)
    assert physical_numbers(changed) == pytest.approx(physical_numbers(physics) | {name: value})
    assert changed.identified() == pytest.approx(physics.identified(), rel=1e-12)


def test_a_rig_with_another_number_is_the_same_rig_otherwise() -> None:
    rig = load_rig("virtual")
    other = rig.with_number("pendulums.b.length_m", 0.06)
    assert other.pendulums.b.length_m == 0.06
    assert other.with_number("pendulums.b.length_m", rig.pendulums.b.length_m) == rig

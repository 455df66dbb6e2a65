"""Rig files: every error contains file, key, expected and actual value, and the nearest known name."""

from __future__ import annotations

import pickle
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from rig_configs import (
    IdentifiedParameters,
    ParametersFileError,
    RigFileError,
    load_rig,
    overridden,
    parse_setting,
    shipped_rigs,
    with_parameters,
)
from rig_configs.known import INDEX


def test_shipped_rigs_load_and_hold_the_points() -> None:
    assert {"virtual", "isotropic"} <= set(shipped_rigs())
    rig = load_rig("virtual")
    assert {n: p.speed_ratio for n, p in rig.points.items()} == {"A": 0.83, "B": 1.6, "C": 2.6, "D": 3.3, "E": 5.8}
    assert rig.suspension.k2_N_per_m / rig.suspension.k1_N_per_m == pytest.approx(14.9, rel=1e-5)
    assert load_rig("isotropic").physics.is_isotropic


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("rotor.mass=7", ["virtual.toml", "rotor.mass", "did you mean rotor.mass_kg"]),
        ("suspension.zetta1=0.1", ["did you mean suspension.zeta1"]),
        ("suspension.zeta1=-0.1", ["suspension.zeta1", "greater than or equal to 0", "-0.1"]),
        ("suspension.k1_N_per_m=inf", ["suspension.k1_N_per_m", "inf"]),
        ("points.A.speed_ration=1", ["did you mean points.A.speed_ratio"]),
        ("pointss.A=1", ["did you mean points"]),
        ("devices.laser_x.axis=y", ["laser_x and laser_y are both the rig's displacement along y"]),
        ("devices.drive.heartbeat_timeout_ms=120", ["at least twice heartbeat_ms"]),
        ("virtual.truth.suspension.k2=1", ["did you mean virtual.truth.suspension.k2_N_per_m"]),
        ("suspension.q=+5%", ["expected a number at suspension.q"]),
        ("suspension", ["expected key=value"]),
        ("name.first=1", ["name is a value, not a table"]),
    ],
)
def test_a_fault_is_explained(setting: str, words: list[str]) -> None:
    with pytest.raises(RigFileError) as caught:
        load_rig("virtual", settings=[setting])
    for word in words:
        assert word in str(caught.value)


def test_a_missing_device_and_a_missing_value_are_named(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "rig_configs" / "virtual.toml").read_text()
    broken = tmp_path / "broken.toml"
    broken.write_text(text.replace("mass_kg = 7.0", "").replace('driver = "cia402"', ""))
    with pytest.raises(RigFileError) as caught:
        load_rig(broken)
    lines = str(caught.value).splitlines()
    assert len(lines) == 2
    assert lines[0].endswith("broken.toml: rotor.mass_kg: missing; expected a float") or "rotor.mass_kg" in lines[0]
    assert "devices.drive: no driver; expected driver = one of cia402, cia406, " in lines[1]


def test_a_driver_that_is_not_installed_is_named_with_the_nearest() -> None:
    with pytest.raises(RigFileError, match=r"devices\.drive.*no driver 'cia42' is installed.*Did you mean 'cia402'"):
        load_rig("virtual", settings=["devices.drive.driver=cia42"])
    with pytest.raises(RigFileError, match=r"devices\.drive.*expected one of .*got 7"):
        load_rig("virtual", settings=["devices.drive.driver=7"])


def test_devices_have_any_name_and_any_of_them_may_be_missing(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "rig_configs" / "virtual.toml").read_text()
    start, end = text.index("[devices.laser_x]"), text.index("[limits]")
    one = tmp_path / "one.toml"
    device = '[devices.probe_7]\ndriver = "optoncdt"\nport = "p"\naxis = "y"\nlever_ratio = 0.5\n\n'
    one.write_text(text[:start] + device + text[end:])
    roles = load_rig(one).roles
    assert roles.along("x") is roles.angles is roles.phase is roles.speed is roles.locks is None
    found = roles.along("y")
    assert found is not None
    assert load_rig(one).known.std(INDEX) == 0.0
    assert (found.device, found.topic, found.reach_m, roles.gain_stds) == ("probe_7", "laser/y", 0.025, (0.001, 0.001))
    for name in ("Probe", "7probe", "host", "a b"):
        one.write_text(text[:start] + device.replace("probe_7", f'"{name}"') + text[end:])
        with pytest.raises(RigFileError, match="devices"):
            load_rig(one)


def test_a_file_that_is_not_there_names_the_shipped_ones() -> None:
    with pytest.raises(RigFileError, match="did you mean the shipped rig 'virtual'"):
        load_rig("virtal")
    with pytest.raises(RigFileError, match="not a TOML file"):
        load_rig(__file__)


def test_settings_are_absolute_or_relative() -> None:
    base = load_rig("virtual")
    raised = load_rig("virtual", settings=["suspension.k2_N_per_m=+7%", "virtual.truth.suspension.zeta1=*2"])
    assert raised.suspension.k2_N_per_m == pytest.approx(1.07 * base.suspension.k2_N_per_m)
    assert raised.true_physics.zeta1 == pytest.approx(2 * base.true_physics.zeta1)
    assert parse_setting("a.b=3") == ("a.b", 3)
    assert parse_setting("a.b=text here") == ("a.b", "text here")


def test_truth_follows_the_rig_file_where_it_states_nothing() -> None:
    rig = load_rig("virtual", settings=["pendulums.b.mass_kg=0.070"])
    assert rig.true_physics.b.mass_kg == 0.070
    assert rig.true_physics.k1_N_per_m != rig.physics.k1_N_per_m


def test_a_snapshot_contains_no_simulation() -> None:
    snapshot = load_rig("virtual").snapshot_json()
    assert b"truth" not in snapshot
    assert b"0.0208" not in snapshot


def test_parameters_file_round_trip_and_overlay(tmp_path: Path) -> None:
    values = {"k1_N_per_m": 2600.0, "k2_N_per_m": 38000.0, "zeta1": 0.021, "c4_Nms_per_rad": 9e-4, "SP_kg_m": 2.5e-3}
    root = np.random.default_rng(1).normal(size=(5, 5)) * 1e-6
    known = IdentifiedParameters(values, root @ root.T, {"software": "1"})
    path = tmp_path / "parameters.toml"
    known.save(path)
    again = IdentifiedParameters.load(path)
    assert again.values == values
    assert np.allclose(again.covariance, known.covariance, rtol=1e-12, atol=0)
    rig = load_rig("virtual", path)
    assert rig.physics.identified() == pytest.approx({**load_rig("virtual").physics.identified(), **values})


@pytest.mark.parametrize("text", ["", "x = [", "[covariance]\norder=['k1_N_per_m']\nmatrix=[[1.0]]"])
def test_a_damaged_parameters_file_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "parameters.toml"
    path.write_text(text)
    with pytest.raises(ParametersFileError, match=r"parameters\.toml"):
        IdentifiedParameters.load(path)
    with pytest.raises(ParametersFileError, match="cannot be read"):
        IdentifiedParameters.load(tmp_path / "absent.toml")


IDENTIFIED = IdentifiedParameters({"k1_N_per_m": 2600.0, "SP_kg_m": 2.5e-3}, np.diag([1.0, 1e-10]))


def test_an_identified_moment_needs_an_imbalance_mass_in_the_rig_file(tmp_path: Path) -> None:
    with pytest.raises(RigFileError, match=r"imbalance\.mass_kg above 0"):
        load_rig(without_imbalance(tmp_path, "mass_kg = 0.0\nradius_m = 0.02"), IDENTIFIED)
    for body, word in (
        ("", "imbalance"),
        ("radius_m = 0.02", "imbalance.mass_kg: missing"),
        ('mass_kg = "x"', "mass_kg"),
        ("mass_kg = -0.5\nradius_m = 0.02", "imbalance.mass_kg: Input should be greater than or equal to 0"),
    ):
        with pytest.raises(RigFileError, match=word):
            load_rig(without_imbalance(tmp_path, body), IDENTIFIED)
    assert load_rig("virtual", IDENTIFIED).physics.imbalance_moment_kg_m == pytest.approx(2.5e-3)


def without_imbalance(folder: Path, body: str) -> Path:
    """The shipped rig file with its [imbalance] table replaced; left out when the body is empty."""
    text = (resources.files("rig_configs") / "virtual.toml").read_text(encoding="utf-8")
    start = text.index("[imbalance]")
    end = text.index("\n[", start)
    path = folder / "rig.toml"
    path.write_text(text[:start] + (f"[imbalance]\n{body}\n" if body else "") + text[end:], encoding="utf-8")
    return path


@pytest.mark.parametrize("key", ["suspension.k1_N_per_m", "rotor.mass_kg", "pendulums.a.length_m"])
def test_numbers_no_equation_can_take_are_refused_on_loading(key: str) -> None:
    with pytest.raises(RigFileError, match="must lie in"):
        load_rig("virtual", settings={key: 1e-300})


def test_the_axis_angle_is_kept_and_older_files_have_none(tmp_path: Path) -> None:
    path = tmp_path / "parameters.toml"
    known = IdentifiedParameters({"k1_N_per_m": 2600.0}, np.array([[0.04]]), {"software": "1"}, (1.0005, 0.0004))
    known.save(path)
    assert IdentifiedParameters.load(path).axis_angle_deg == (1.0005, 0.0004)
    older = "\n".join(line for line in path.read_text().splitlines() if "_deg" not in line and "axis" not in line)
    path.write_text(older)
    assert IdentifiedParameters.load(path).axis_angle_deg is None
    for bad in ("value_deg = nan\nstd_deg = 1.0", "value_deg = 1.0\nstd_deg = -1.0", "value_deg = 1.0"):
        path.write_text(f"{older}\n[axis_angle]\n{bad}\n")
        with pytest.raises(ParametersFileError):
            IdentifiedParameters.load(path)


def test_a_setting_over_a_parameter_takes_its_covariance_with_it() -> None:
    values = {"k1_N_per_m": 2600.0, "k2_N_per_m": 38000.0, "SP_kg_m": 2.5e-3}
    covariance = np.diag([1.0, 4.0, 9.0]) + 0.5
    known = IdentifiedParameters(values, covariance, {}, (1.0, 0.1))
    assert overridden(known, ["suspension.k2_N_per_m=+5%", "rotor.mass_kg=*1.01"]) == {"k2_N_per_m"}
    assert overridden(known, ["imbalance.radius_m=0.02"]) == overridden(known, ["imbalance.mass_kg=0.1"]) == {"SP_kg_m"}
    assert overridden(known, ["suspension={k1_N_per_m=2000.0}"]) == {"k1_N_per_m", "k2_N_per_m"}
    rest = known.without({"k2_N_per_m"})
    assert list(rest.values) == ["k1_N_per_m", "SP_kg_m"]
    assert np.array_equal(rest.covariance, covariance[np.ix_([0, 2], [0, 2])])
    assert rest.axis_angle_deg == (1.0, 0.1)
    loaded = load_rig("virtual", known, ["suspension.k2_N_per_m=+5%"])
    assert loaded.physics.k2_N_per_m == pytest.approx(1.05 * 38000.0)


def test_identified_values_lie_over_a_rig_that_was_loaded_with_relative_settings() -> None:
    """A campaign on a rig that was changed by 5 %: what was then found of it is not changed by 5 % again."""
    known = IdentifiedParameters({"k2_N_per_m": 40000.0, "SP_kg_m": 2.6e-3}, np.diag([4.0, 1e-12]))
    changed = load_rig("virtual", settings=["suspension.k2_N_per_m=+5%", "imbalance.mass_kg=+5%"])
    physics = with_parameters(changed, known).physics
    assert physics.k2_N_per_m == pytest.approx(40000.0)
    assert physics.imbalance_moment_kg_m == pytest.approx(2.6e-3)


def test_a_fault_of_the_whole_rig_is_reported_in_its_own_words() -> None:
    with pytest.raises(RigFileError) as refused:
        load_rig("virtual", settings=["suspension.k1_N_per_m=1e-300"])
    assert str(refused.value) == "virtual.toml: k1_N_per_m must lie in 1e-15 … 1e+15, got 1e-300"


def test_rolling_resistance_is_a_balls_and_goes_into_its_friction_arm() -> None:
    balls = load_rig("ball_balancer")
    assert balls.physics.a.friction_arm_m == pytest.approx(1e-5 * 0.114 / 0.0075)
    both = load_rig("ball_balancer", settings=["pendulums.a.friction_arm_m=8e-5"])
    assert both.physics.a.friction_arm_m == pytest.approx(8e-5 + 1.52e-4)
    s = balls.physics.imbalance_moment_kg_m
    assert s == pytest.approx(2 * balls.physics.a.first_moment_kg_m * np.cos(np.pi / 6), rel=1e-4)
    with pytest.raises(RigFileError, match=r"needs a ball: expected ball_radius_m above 0"):
        load_rig("isotropic", settings=["pendulums.a.rolling_resistance_m=1e-5"])


def test_true_friction_may_differ_from_the_files() -> None:
    rig = load_rig("ball_balancer", settings=["virtual.truth.pendulums.a.friction_arm_m=1e-6"])
    assert rig.true_physics.a.friction_arm_m == 1e-6
    assert rig.true_physics.b.friction_arm_m == pytest.approx(1.52e-4)


def test_a_rig_with_its_truth_is_sent_to_other_processes() -> None:
    rig = load_rig("virtual", settings=["virtual.truth.suspension.zeta1=*2", "virtual.truth.rotor.mass_kg=9.5"])
    sent = pickle.loads(pickle.dumps(rig))
    assert sent == rig
    assert sent.model_dump(exclude_unset=True) == rig.model_dump(exclude_unset=True)

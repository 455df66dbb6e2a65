"""Limits, defaults and messages of a rig file, and the settings and parameters that are laid over it."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from rig_configs import IdentifiedParameters, ParametersFileError, RigFileError, load_rig, parse_setting
from rig_configs.drag import Drag
from rig_configs.error_label import ErrorLabel
from rig_configs.known import INDEX, ZERO_A, ZERO_B
from rig_configs.load import _relative, apply_setting, refusal, validate, with_truth
from rig_configs.schema import (
    Point,
    Radio,
    Rotor,
    SimulatedSensors,
    ValidationTable,
    Virtual,
    VirtualDrive,
)
from rig_configs.slow_roll import SlowRoll
from rig_configs.suspension_terms import SuspensionTerms
from rig_configs.table import RigTable
from rig_configs.toml_text import parse_toml

GAIN_X, ROTOR_MASS = ErrorLabel("gain", "x"), ErrorLabel("known", "rotor.mass_kg")
ROTOR = {"mass_kg": 7.0}
POINT = {"speed_ratio": 1.6, "expected": "I"}
OPEN, CLOSED = False, True  # whether the lower limit itself is accepted
RANGES: list[tuple[type[RigTable], dict[str, Any], str, bool, float, float]] = [
    (Rotor, ROTOR, "mass_std_kg", CLOSED, 0, math.inf),
    (Point, POINT, "speed_ratio", OPEN, 0, 100),
    (ValidationTable, {}, "model_std_deg", CLOSED, 0, math.inf),
    (ValidationTable, {}, "model_std_mm", CLOSED, 0, math.inf),
    (SimulatedSensors, {}, "axis_angle_deg", CLOSED, -math.inf, math.inf),
    (SimulatedSensors, {}, "clock_drift_ppm", CLOSED, 0, math.inf),
    (Radio, {}, "burst_stop", OPEN, 0, 1),
    (Radio, {}, "loss_in_burst", CLOSED, 0, 1),
    (VirtualDrive, {}, "slip", CLOSED, -0.05, 0.05),
    (VirtualDrive, {}, "report_s", CLOSED, 0.001, 1),
]


@pytest.mark.parametrize(
    ("table", "rest", "key", "lowest_too", "low", "high"), RANGES, ids=[f"{r[0].__name__}.{r[2]}" for r in RANGES]
)
def test_a_number_is_accepted_up_to_its_limits_and_not_beyond(
    table: type[RigTable], rest: dict[str, Any], key: str, lowest_too: bool, low: float, high: float
) -> None:
    """A limit may be used. The next number outside it is refused, as are numbers that are not finite."""
    lowest = low if lowest_too else math.nextafter(low, 1)
    for value in (lowest, high):
        if math.isfinite(value):
            assert getattr(table.model_validate(rest | {key: float(value)}), key) == value
    for value in (math.nextafter(lowest, -math.inf), math.nextafter(high, math.inf), -math.inf, math.inf, math.nan):
        with pytest.raises(ValidationError, match=key):
            table.model_validate(rest | {key: value})


def test_a_share_is_below_one_and_a_seed_is_not_negative() -> None:
    assert Radio(burst_start=0.0).burst_start == 0
    assert Virtual(seed=0).seed == 0
    for key, value in (("burst_start", 1.0), ("burst_start", -1e-9)):
        with pytest.raises(ValidationError, match=key):
            Radio.model_validate({key: value})
    with pytest.raises(ValidationError, match="seed"):
        Virtual(seed=-1)


def test_values_that_the_shipped_rig_states_are_the_defaults() -> None:
    """Without the lines of its optional tables, the shipped rig is the same rig."""
    text = (resources.files("rig_configs") / "virtual.toml").read_text(encoding="utf-8")
    for table in ("limits", "virtual.sensors", "virtual.radio", "virtual.drive"):
        start = text.index(f"[{table}]")
        text = text[:start] + text[text.index("\n[", start) + 1 :]
    text = text.replace("seed = 0\nlock_play_deg = 0.2\n", "").replace("pivot_shift_m = 0.0\n", "")
    text = re.sub(r"# Where the simulated rig.*\n", "", text)
    whole = load_rig("virtual")
    short = validate(parse_toml(text, "a.toml"), "virtual.toml")
    assert short == whole
    assert whole.virtual is not None
    assert whole.virtual.drive.report_s == 0.01
    assert whole.validation == ValidationTable(model_std_deg=0.0, model_std_mm=0.0, releases=True)


def test_simulated_sensors_are_linear_and_quiet_unless_the_rig_file_states_otherwise() -> None:
    sensors = SimulatedSensors()
    assert (sensors.hum_m, sensors.laser_nonlinearity_m, sensors.laser_hysteresis_m) == (0.0, 0.0, 0.0)


def test_what_a_rig_file_omits_is_absent_from_the_physics() -> None:
    """A pendulum is not a ball and has neither drag nor dry friction; a shaft is vertical; numbers are exact."""
    rig = load_rig("virtual")
    for part in (rig.physics.a, rig.physics.b):
        assert (part.drag_Nms2_per_rad2, part.friction_arm_m, part.ball_radius_m) == (0, 0, 0)
        assert part.ball_inertia_ratio == 2 / 5  # a sphere, if it gets a radius
    assert (rig.physics.gravity_m_per_s2, rig.physics.pivot_shift_m, rig.physics.pivot_shift_compensated) == (
        0,
        0,
        True,
    )
    assert not [source for source in rig.known.sources if source.name.endswith(("_kg", "_m"))]


def test_an_amplitude_limit_must_be_below_a_sensor_s_reach() -> None:
    """A range of 25 mm is ± 12.5 mm about its middle: the limit itself must still be measured."""
    reach = min(sensor.reach_m for sensor in load_rig("virtual").roles.displacements)
    load_rig("virtual", settings={"limits.amplitude_m": math.nextafter(reach, 0)})
    for beyond in (reach, 2 * reach):
        with pytest.raises(RigFileError, match=r"cannot be measured: laser_[xy] reaches"):
            load_rig("virtual", settings={"limits.amplitude_m": beyond})


@pytest.mark.parametrize("name", ["host", "log"])
def test_names_of_the_suite_s_own_events_are_not_free_for_a_device(name: str) -> None:
    text = (resources.files("rig_configs") / "virtual.toml").read_text(encoding="utf-8")
    raw = parse_toml(text.replace("[devices.encoder]", f"[devices.{name}]"), "a.toml")
    with pytest.raises(RigFileError, match=f"'{name}' cannot be a device's name"):
        validate(raw, "a.toml")


def test_a_device_s_name_has_at_most_31_letters() -> None:
    text = (resources.files("rig_configs") / "virtual.toml").read_text(encoding="utf-8")
    for letters, accepted in ((31, True), (32, False)):
        raw = parse_toml(text.replace("[devices.encoder]", f"[devices.{'e' * letters}]"), "a.toml")
        if accepted:
            assert "e" * letters in validate(raw, "a.toml").devices
        else:
            with pytest.raises(RigFileError, match="devices"):
                validate(raw, "a.toml")


def test_the_truth_of_every_part_is_laid_over_the_physics() -> None:
    values = {
        "rotor.mass_kg": 7.5,
        "imbalance.mass_kg": 0.13,
        "imbalance.radius_m": 0.022,
        "pendulums.a.mass_kg": 0.076,
        "pendulums.a.length_m": 0.055,
        "pendulums.b.damping_Nms_per_rad": 0.0012,
        "pendulums.b.friction_arm_m": 1e-5,
        "pendulums.pivot_shift_m": 0.0003,
        "suspension.k1_N_per_m": 2700.0,
        "suspension.zeta2": 0.03,
    }
    rig = load_rig("virtual", settings={f"virtual.truth.{key}": value for key, value in values.items()})
    physics = rig.true_physics
    assert (physics.rotor_mass_kg, physics.imbalance_mass_kg, physics.imbalance_radius_m) == (7.5, 0.13, 0.022)
    assert (physics.a.mass_kg, physics.a.length_m, physics.b.damping_Nms_per_rad) == (0.076, 0.055, 0.0012)
    assert (physics.b.friction_arm_m, physics.pivot_shift_m) == (1e-5, 0.0003)
    assert (physics.k1_N_per_m, physics.zeta2) == (2700.0, 0.03)
    assert physics.b.mass_kg == rig.physics.b.mass_kg
    zeros = load_rig(
        "virtual", settings={"pendulums.pivot_shift_m": 1e-3, "virtual.truth.pendulums.pivot_shift_m": 0.0}
    )
    assert (zeros.physics.pivot_shift_m, zeros.true_physics.pivot_shift_m) == (1e-3, 0.0)


def test_only_a_simulated_rig_has_a_truth() -> None:
    rig = load_rig("virtual").model_copy(update={"virtual": None})
    with pytest.raises(ValueError, match=r"not simulated: it has no \[virtual\] table"):
        _ = rig.true_physics
    with pytest.raises(RigFileError, match="no truth to change"):
        with_truth(rig, "rotor.mass_kg", 7.1)


def test_a_relative_truth_starts_from_the_truth_or_else_from_the_rig_file() -> None:
    rig = load_rig("virtual")
    assert with_truth(rig, "imbalance.radius_m", "*2").true_physics.imbalance_radius_m == pytest.approx(2 * 0.02125)
    assert with_truth(rig, "pendulums.a.length_m", "+10%").true_physics.a.length_m == pytest.approx(1.1 * 0.054)
    assert with_truth(rig, "rotor.mass_kg", "-50%").true_physics.rotor_mass_kg == pytest.approx(3.5)
    with pytest.raises(RigFileError, match=r"expected a number at rotor\.mass to change, found none"):
        with_truth(rig, "rotor.mass", "*2")
    with pytest.raises(RigFileError, match="mass_kg is a value, not a table"):
        with_truth(with_truth(rig, "rotor.mass_kg", 7.0), "rotor.mass_kg.x", 1.0)


@pytest.mark.parametrize(
    ("text", "key", "value"),
    [
        (" a.b = 3 ", "a.b", 3),
        ("a=b=c", "a", "b=c"),
        ("a=1\nb = 2", "a", "1\nb = 2"),
        ("a=[1, 2.5]", "a", [1, 2.5]),
        ("a=+5", "a", 5),
        ("a=5%", "a", "5%"),
        ("a= +5% ", "a", "+5%"),
        ("a=- 5 %", "a", "- 5 %"),
        ("a= *2 ", "a", "*2"),
        ("a=", "a", ""),
        ("a='*2'", "a", "*2"),
    ],
)
def test_a_setting_is_split_at_its_first_equals_sign(text: str, key: str, value: object) -> None:
    assert parse_setting(text) == (key, value)


@pytest.mark.parametrize("text", ["a", "", "=3", "  =3"])
def test_a_setting_without_a_key_or_a_value_is_refused(text: str) -> None:
    with pytest.raises(RigFileError, match="expected key=value"):
        parse_setting(text)


@pytest.mark.parametrize(
    ("change", "value"),
    [
        ("*1.05", 1260.0),
        ("* .5", 600.0),
        ("*5.", 6000.0),
        ("*+2e-1", 240.0),
        ("+5%", 1260.0),
        ("-25%", 900.0),
        ("+ 1e1 %", 1320.0),
        ("-.5%", 1194.0),
    ],
)
def test_relative_changes_of_a_number(change: str, value: float) -> None:
    raw = {"limits": {"speed_rpm": 1200.0, "count": 1200}}
    from_text = dict(raw["limits"])
    for key in from_text:
        apply_setting(raw, f"limits.{key}", change)
    assert raw["limits"]["speed_rpm"] == pytest.approx(value)
    assert raw["limits"]["count"] == value
    assert type(raw["limits"]["speed_rpm"]) is float
    assert type(raw["limits"]["count"]) is int


def test_a_whole_number_is_not_rounded_by_a_relative_change() -> None:
    raw: dict[str, Any] = {"a": 3}
    apply_setting(raw, "a", "*0.5")
    assert raw == {"a": 1.5}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"points.A.expected": "y" * 61}, "'I', 'II', 'III' or 'slipping', got '" + "y" * 60 + "'"),
        ({"points.A.expected": {"a": 1}}, "'I', 'II', 'III' or 'slipping', got a table"),
        ({"points.A.expected": 10**119}, f"'slipping', got {10**119}"),
        ({"points.A.expected": 10**120}, f"'slipping', got {10**119}…"),
        ({"points.F.expected": "I"}, "points.F.speed_ratio: missing; expected a float"),
        ({"rotor": {}}, "rotor.mass_kg: missing; expected a float"),
        (
            {"suspension.zzz": 1},
            "suspension.zzz: unknown key (units are part of a name). "
            "Known here: k1_N_per_m, k2_N_per_m, zeta1, zeta2, gravity_m_per_s2",
        ),
        ({"suspension.k1": 1}, "suspension.k1: unknown key; did you mean suspension.k1_N_per_m? (units"),
        ({"points.A.speed_ratoi": 1}, "unknown key; did you mean points.A.speed_ratio? (units"),
        ({"points.A.zzz": 1}, "unknown key (units are part of a name). Known here: speed_ratio, expected"),
        ({"devices.laser_x.rate_H": 1}, "unknown key; did you mean devices.laser_x.rate_Hz? (units"),
        ({"devices.laserx.rate_Hz": 5}, "devices.laserx: a device without a driver; did you mean devices.laser_x?"),
        ({"devices.laser_x.driver": 7}, "devices.laser_x: driver: expected one of cia402, cia406, "),
        ({"devices.zz.rate_Hz": 5}, "devices.zz: no driver; expected driver = one of cia402, cia406, "),
        (
            {"devices.laser_x": 3},
            "devices.laser_x: Input should be a valid dictionary or instance of DeviceSettings, got 3",
        ),
        ({"limits": 3}, "limits: Input should be a valid dictionary or instance of Limits, got 3"),
    ],
)
def test_a_message_has_the_key_what_was_expected_and_what_was_found(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(RigFileError) as refused:
        load_rig("virtual", settings=settings)
    text = str(refused.value)
    assert f"virtual.toml: {message}" in text or (message in text and text.startswith("virtual.toml: "))
    if not message.endswith(("(units", "cia406, ")) and "Known here" not in message:
        assert text.endswith(message)


def test_a_file_that_a_device_names_is_read_from_the_folder_of_the_rig_file(tmp_path: Path) -> None:
    text = (resources.files("rig_configs") / "can_lasers.toml").read_text(encoding="utf-8")
    start, end = text.index("dbc_text = '''") + len("dbc_text = '''"), text.index("'''\n\n[devices.sensor_bus.x]")
    rig = tmp_path / "rig.toml"
    rig.write_text(f'{text[: start - len("dbc_text = ") - 3]}dbc = "bus.dbc"{text[end + 3 :]}', encoding="utf-8")
    with pytest.raises(RigFileError, match=r"rig\.toml: devices\.sensor_bus\.dbc: 'bus\.dbc' cannot be read as a text"):
        load_rig(rig)
    (tmp_path / "bus.dbc").write_text(text[start:end].lstrip("\n"), encoding="utf-8")
    assert load_rig(rig).devices["sensor_bus"].dbc_text == load_rig("can_lasers").devices["sensor_bus"].dbc_text
    for value in (7, ["bus.dbc"]):
        with pytest.raises(RigFileError, match=r"devices\.sensor_bus\.dbc: Input should be a valid string"):
            load_rig(rig, settings={"devices.sensor_bus.dbc": value})
    assert load_rig("can_lasers", settings={"devices.sensor_bus.dbc": ""}) == load_rig("can_lasers")
    with pytest.raises(RigFileError, match="expected either a file or its text"):
        load_rig(rig, settings={"devices.sensor_bus.dbc_text": "VERSION"})


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("points", r"tables \[points\.NAME\], each with speed_ratio, expected"),
        ("devices", r"tables \[devices\.NAME\], each with driver, port, .*"),
    ],
)
def test_missing_tables_of_free_names_are_described_by_their_keys(name: str, expected: str) -> None:
    raw = parse_toml((resources.files("rig_configs") / "virtual.toml").read_text(encoding="utf-8"), "a.toml")
    del raw[name]
    with pytest.raises(RigFileError, match=rf"^a\.toml: {name}: missing; expected {expected}$"):
        validate(raw, "a.toml")


def test_a_missing_table_is_described_by_its_keys() -> None:
    raw = parse_toml((resources.files("rig_configs") / "virtual.toml").read_text(encoding="utf-8"), "a.toml")
    del raw["rotor"]
    with pytest.raises(RigFileError, match=r"^a\.toml: rotor: missing; expected a table with mass_kg, mass_std_kg$"):
        validate(raw, "a.toml")


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("k1_N_per_m", -1.0, "expected greater than 0"),
        ("zeta1", 2.5, "expected less than or equal to 2"),
        ("c3_Nms_per_rad", -1e-9, "expected greater than or equal to 0"),
        ("SP_kg_m", -1e-9, "expected greater than or equal to 0"),
        ("SP_kg_m", 0.2, "expected less than or equal to 1"),
        ("SP_kg_m", 0.0, None),
        ("SP_kg_m", 0.12, None),
        ("zeta2", 0.0, None),
        ("c4_Nms_per_rad", 0.0, None),
    ],
)
def test_values_that_a_rig_cannot_have_are_explained(name: str, value: float, reason: str | None) -> None:
    assert refusal(load_rig("virtual"), name, value) == reason


def test_a_rig_without_an_imbalance_mass_may_have_any_moment_that_is_not_negative() -> None:
    bare = load_rig("virtual", settings={"imbalance.mass_kg": 0.0})
    assert refusal(bare, "SP_kg_m", -0.5) == "expected at least 0, got -0.5"
    assert refusal(bare, "SP_kg_m", 0.0) is refusal(bare, "SP_kg_m", 5.0) is None


def test_a_file_with_the_name_of_a_shipped_rig_and_a_suffix_is_read_from_the_disk(tmp_path: Path) -> None:
    text = (resources.files("rig_configs") / "virtual.toml").read_text(encoding="utf-8")
    path = tmp_path / "virtual.toml"
    path.write_text(text.replace("mass_kg = 7.0", "mass_kg = 6.5"), encoding="utf-8")
    assert load_rig(path).rotor.mass_kg == 6.5
    assert load_rig(str(path)).rotor.mass_kg == 6.5
    with pytest.raises(RigFileError) as refused:
        load_rig("xyz")
    assert "did you mean" not in str(refused.value)
    assert "'virtual'" in str(refused.value)


def parameters(**others: Any) -> IdentifiedParameters:
    values = {"k1_N_per_m": 2600.0, "zeta1": 0.02}
    return IdentifiedParameters(**({"values": values, "covariance": np.diag([4.0, 1e-8])} | others))


@pytest.mark.parametrize(("excess", "accepted"), [(0.9e-9, True), (1.1e-9, False)])
def test_a_covariance_is_symmetric_to_a_billionth_of_its_deviations(excess: float, accepted: bool) -> None:
    covariance = np.array([[4.0, 1e-4], [1e-4 + 2e-4 * excess, 1e-8]])
    if accepted:
        parameters(covariance=covariance)
    else:
        with pytest.raises(ParametersFileError, match="symmetric"):
            parameters(covariance=covariance)


@pytest.mark.parametrize(("excess", "accepted"), [(0.9e-6, True), (1.1e-6, False)])
def test_a_correlation_exceeds_one_by_rounding_at_most(excess: float, accepted: bool) -> None:
    cross = 2e-4 * (1 + excess)
    covariance = np.array([[4.0, cross], [cross, 1e-8]])
    if accepted:
        parameters(covariance=covariance)
    else:
        with pytest.raises(ParametersFileError, match="positive semidefinite"):
            parameters(covariance=covariance)


@pytest.mark.parametrize(("excess", "accepted"), [(0.9e-6, True), (1.1e-6, False)])
def test_no_direction_has_a_negative_variance(excess: float, accepted: bool) -> None:
    """Three values with the same correlation −1/2 have one direction without variance; a little more is refused."""
    rho = -0.5 * (1 + excess)
    covariance = np.full((3, 3), rho) + (1 - rho) * np.eye(3)
    values = {"k1_N_per_m": 1.0, "k2_N_per_m": 1.0, "zeta1": 1.0}
    if accepted:
        parameters(values=values, covariance=covariance)
    else:
        with pytest.raises(ParametersFileError, match="positive semidefinite"):
            parameters(values=values, covariance=covariance)


@pytest.mark.parametrize(
    ("others", "message"),
    [
        ({"values": {"k1_N_per_m": 1.0, "k9": 1.0}}, "unknown parameters ['k9']; known: ['k1_N_per_m'"),
        ({"covariance": np.eye(3)}, "finite 2 × 2 matrix, got shape (3, 3)"),
        ({"covariance": np.diag([1.0, -1e-300])}, "no negative variance"),
        ({"covariance": np.array([[0.0, 0.1], [0.1, 1.0]])}, "positive semidefinite"),
        ({"shared": {GAIN_X: np.zeros(3)}}, "'gain x': expected 2 finite numbers, got shape (3,)"),
        ({"by_number": {"rotor.mass_kg": np.array([1.0, math.inf])}}, "'rotor.mass_kg': expected 2 finite numbers"),
        ({"axis_angle_deg": (1.0, -0.1)}, "axis_angle: expected finite value_deg and std_deg, not negative"),
        ({"axis_angle_deg": (math.inf, 0.1)}, "axis_angle"),
        ({"axis_angle_deg": (1.0, math.nan)}, "axis_angle"),
    ],
)
def test_parameters_that_cannot_be_are_refused(others: dict[str, Any], message: str) -> None:
    with pytest.raises(ParametersFileError, match=re.escape(message)):
        parameters(**others)


def test_exact_values_have_no_correlation_and_an_angle_may_be_exact() -> None:
    found = parameters(covariance=np.diag([0.0, 1e-8]), axis_angle_deg=(1.0, 0.0))
    assert found.std == {"k1_N_per_m": 0.0, "zeta1": pytest.approx(1e-4)}
    assert np.array_equal(found.correlation, np.eye(2))
    half = parameters(covariance=np.array([[4.0, -1e-4], [-1e-4, 1e-8]]))
    assert half.correlation == pytest.approx(np.array([[1.0, -0.5], [-0.5, 1.0]]))


def test_completed_parameters_take_the_rest_from_the_rig_with_the_uncertainty_of_a_design() -> None:
    physics = load_rig("virtual").physics
    covariance = np.array([[4.0, 1e-4], [1e-4, 1e-8]])
    short = parameters(covariance=covariance, shared={GAIN_X: np.array([1.0, 2e-5])})
    whole = short.completed(physics, exact=["zeta2"])
    assert whole.values == {**physics.identified(), **short.values}
    assert list(whole.values)[:2] == ["k1_N_per_m", "zeta1"]
    assert np.array_equal(whole.covariance[:2, :2], covariance)
    assert not whole.covariance[2:, :2].any()
    assert whole.std["zeta2"] == 0.0
    for name in set(physics.identified()) - {"k1_N_per_m", "zeta1", "zeta2"}:
        assert 0.04 * whole.values[name] < whole.std[name] < whole.values[name]
    assert whole.shared[GAIN_X].tolist() == [1.0, 2e-5, 0, 0, 0, 0, 0]
    assert whole.without(set(physics.identified()) - set(short.values)).shared[GAIN_X].tolist() == [1.0, 2e-5]


def test_identified_effects_are_part_of_the_rig_s_physics() -> None:
    physics = load_rig("virtual").physics
    assert parameters().with_effects(physics) == physics
    terms = SuspensionTerms(np.array([3.0, 5.0, 0.1, 0.2]), np.zeros((4, 4)), ())
    roll = SlowRoll(0j, 0j, 2e-5 - 3e-5j, np.zeros((6, 6)))
    drag = Drag(np.array([4e-7, -1e-7]), np.zeros((2, 2)))
    found = parameters(terms=terms, slow_roll=roll, provenance=drag.table)
    of = found.with_effects(physics)
    assert (of.hardening_per_m2, of.damping_growth_s_per_m) == ((3.0, 5.0), (0.1, 0.2))
    assert (of.bow_x_m, of.bow_y_m) == (2e-5, -3e-5)
    assert (of.a.drag_Nms2_per_rad2, of.b.drag_Nms2_per_rad2) == (4e-7, 0.0)
    assert of.k1_N_per_m == physics.k1_N_per_m
    whole = found.applied_to(physics)
    assert (whole.k1_N_per_m, whole.bow_x_m) == (found.values["k1_N_per_m"], 2e-5)
    bowed = replace(physics, bow_x_m=1e-5)
    assert parameters(slow_roll=SlowRoll(1e-6j, 0j, 0j, np.zeros((6, 6)))).with_effects(bowed) == bowed


def test_an_identified_drag_below_zero_is_no_drag_of_the_rig() -> None:
    drag = Drag(np.array([4e-7, -1e-7]), np.zeros((2, 2)))
    rig = load_rig("virtual", parameters(provenance=drag.table))
    assert (rig.pendulums.a.drag_Nms2_per_rad2, rig.pendulums.b.drag_Nms2_per_rad2) == (4e-7, 0.0)


def test_numbers_that_no_equation_takes_are_refused_in_the_file_and_in_the_truth() -> None:
    raw = parse_toml((resources.files("rig_configs") / "virtual.toml").read_text(encoding="utf-8"), "a.toml")
    del raw["virtual"]
    assert validate(raw, "a.toml").virtual is None
    apply_setting(raw, "suspension.k1_N_per_m", 1e-300, "a.toml")
    with pytest.raises(RigFileError, match="k1_N_per_m must lie in"):
        validate(raw, "a.toml")
    with pytest.raises(RigFileError, match="k1_N_per_m must lie in"):
        load_rig("virtual", settings={"virtual.truth.suspension.k1_N_per_m": 1e-300})


def test_the_own_covariance_is_without_the_shared_errors_and_never_indefinite() -> None:
    shift = np.array([1.0, 5e-5])
    shared = parameters(covariance=np.diag([3.0, 1e-8]) + np.outer(shift, shift), shared={GAIN_X: shift})
    assert shared.own_covariance == pytest.approx(np.diag([3.0, 1e-8]), rel=1e-12, abs=1e-16)
    assert np.array_equal(parameters().own_covariance, parameters().covariance)
    excessive = parameters(shared={GAIN_X: np.array([3.0, 0.0])})  # a variance of 9, of 4
    assert excessive.own_covariance == pytest.approx(np.diag([0.0, 1e-8]), abs=1e-16)


def test_errors_of_known_numbers_follow_the_rig_file() -> None:
    rig = load_rig("virtual", settings={"rotor.mass_std_kg": 0.002})
    found = parameters(
        shared={GAIN_X: np.array([1.0, 0.0]), ROTOR_MASS: np.array([5.0, 0.0])},
        by_number={"rotor.mass_kg": np.array([360.0, 0.001])},
    )
    shared = found.shared_with(rig.known)
    assert shared[GAIN_X].tolist() == [1.0, 0.0]
    assert shared[ROTOR_MASS] == pytest.approx([0.72, 2e-6])
    without = parameters(shared={ROTOR_MASS: np.array([5.0, 0.0])})
    assert without.shared_with(rig.known)[ROTOR_MASS].tolist() == [5.0, 0.0]


def test_a_parameters_file_holds_every_fact_and_a_label_of_its_content(tmp_path: Path) -> None:
    path = tmp_path / "parameters.toml"
    found = parameters(
        provenance={"method": "by hand"},
        axis_angle_deg=(1.0, 0.0),
        shared={GAIN_X: np.array([1.0, 2e-5])},
        by_number={"rotor.mass_kg": np.array([360.0, 0.001])},
    )
    found.save(path)
    again = IdentifiedParameters.load(path)
    assert (again.values, again.provenance, again.axis_angle_deg) == (found.values, found.provenance, (1.0, 0.0))
    assert np.array_equal(again.covariance, found.covariance)
    assert again.shared[GAIN_X].tolist() == [1.0, 2e-5]
    assert again.by_number["rotor.mass_kg"].tolist() == [360.0, 0.001]
    assert (again.slow_roll, again.terms) == (None, None)
    assert '"N/m"' in path.read_text(encoding="utf-8")
    path.write_bytes(b"abc")
    assert IdentifiedParameters.label(path) == "parameters.toml sha256:ba7816bf8f01"
    with pytest.raises(ParametersFileError, match="this is a log; `rig identify` makes parameters of it"):
        IdentifiedParameters.from_text("not TOML", "a.mcap.part")
    with pytest.raises(ParametersFileError, match="not a TOML file"):
        IdentifiedParameters.from_text("not TOML", "a.toml")


def test_the_own_covariance_of_exact_values_is_zero_for_them() -> None:
    exact = parameters(covariance=np.diag([0.0, 1e-8]))
    assert exact.own_covariance == pytest.approx(np.diag([0.0, 1e-8]), abs=1e-16)


def test_a_relative_setting_of_a_negative_whole_number_keeps_its_fraction() -> None:
    assert _relative(-3, "*1.5", "a.b", "SETTINGS") == -4.5
    changed = _relative(-3, "*2", "a.b", "SETTINGS")
    assert (changed, type(changed)) == (-6, int)


def test_errors_of_zeros_and_index_are_zero_until_they_are_known() -> None:
    values = load_rig("virtual").known.values
    assert [values[name] for name in (ZERO_A, ZERO_B, INDEX)] == [0.0, 0.0, 0.0]

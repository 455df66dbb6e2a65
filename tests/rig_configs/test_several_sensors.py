"""Which sensor measures for the rig where several look along an axis, and sensors that do not look along one."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import pytest
from pydantic import ValidationError

from rig_configs import RigFileError, load_rig
from rig_configs.device import DisplacementSettings
from rig_configs.roles import DisplacementSensor, Roles

LOW = DisplacementSensor("low", "laser/x", "x", 4000.0, 0.025, 30.0, gain_std=0.001)
TOP = replace(LOW, device="top", topic="laser/top", lever_ratio=1.3, gain_std=0.002, witness=True)
NORTH = replace(LOW, device="north", topic="laser/y", axis="y")


def test_a_witness_leaves_the_axis_to_its_sensor() -> None:
    roles = Roles.of([TOP, NORTH, LOW])
    assert roles.along("x") is LOW
    assert roles.displacements == (LOW, NORTH)
    assert roles.witnesses == (TOP,)
    assert roles.measuring_sensor(TOP) is LOW
    assert roles.gain_stds == (0.001, 0.001)
    assert roles.device_of == {"laser/x": "low", "laser/y": "north", "laser/top": "top"}
    assert roles.duties == {"low": "x", "north": "y", "top": "witness of x, compared with low"}
    assert roles.turn_deg == 0.0


def test_two_sensors_of_an_axis_need_a_choice() -> None:
    with pytest.raises(ValueError, match=r'low and top are both the rig.s displacement along x.*witness = "NAME"'):
        Roles.of([LOW, replace(TOP, witness=False)])
    with pytest.raises(ValueError, match="low and top fill the same channel 'laser/x'"):
        Roles.of([LOW, replace(TOP, topic="laser/x")])


def test_a_witness_that_looks_elsewhere_is_held_against_nothing() -> None:
    askew = replace(TOP, direction_deg=30.0)
    roles = Roles.of([LOW, NORTH, askew])
    assert roles.measuring_sensor(askew) is None
    assert "compared with no other" in roles.duties["top"]
    assert (
        Roles.of([replace(LOW, direction_deg=30.0), replace(NORTH, direction_deg=120.0)]).measuring_sensor(askew)
        is not None
    )


@pytest.mark.parametrize(
    ("x", "y", "turn"),
    [
        (45.0, 135.0, 45.0),
        (-45.0, 45.0, -45.0),
        (2.0, 91.0, 1.5),
        (None, None, 0.0),
        (-170.0, -80.0, -170.0),
        (315.0, 45.0, -45.0),
    ],
)
def test_two_sensors_at_right_angles_may_stand_turned(x: float | None, y: float | None, turn: float) -> None:
    roles = Roles.of([replace(LOW, direction_deg=x), replace(NORTH, direction_deg=y)])
    assert roles.turn_deg == pytest.approx(turn)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["devices.laser_x.direction_deg=45", "devices.laser_y.direction_deg=-45"], "got -90°. Where it is about 270°"),
        (["devices.laser_x.direction_deg=45"], "90° beyond that of x, within 3°, got 45°"),
        (["devices.laser_x.witness=y"], "that is an axis' channel"),
        (["devices.laser_x.witness=Up"], "devices.laser_x.witness"),
        (["devices.laser_x.direction_deg=nan"], "devices.laser_x.direction_deg"),
    ],
)
def test_what_cannot_be_is_refused_with_the_reason(settings: list[str], words: str) -> None:
    with pytest.raises(RigFileError) as caught:
        load_rig("virtual", settings=settings)
    assert words in str(caught.value)


def test_one_sensor_alone_looks_along_its_axis() -> None:
    assert load_rig("one_laser", settings=["devices.probe.direction_deg=8"]).roles.turn_deg == 8.0
    with pytest.raises(RigFileError, match=r"a single sensor must look along its axis within 10°"):
        load_rig("one_laser", settings=["devices.probe.direction_deg=45"])


class Named(DisplacementSettings):
    """Settings of a driver that records in the named channel."""

    names_its_channel: ClassVar[bool] = True


def test_settings_name_the_channel_and_the_role() -> None:
    table = {"driver": "acme", "port": "p", "axis": "x", "rate_Hz": 1000}
    (main,) = Named.model_validate(table).roles("low")
    (witness,) = Named.model_validate({**table, "witness": "top", "direction_deg": 2.0}).roles("upper")
    assert isinstance(main, DisplacementSensor)
    assert isinstance(witness, DisplacementSensor)
    assert (main.topic, main.witness, main.direction_deg) == ("laser/x", False, None)
    assert (witness.topic, witness.witness, witness.direction_deg) == ("laser/top", True, 2.0)
    with pytest.raises(ValidationError, match="cannot be a witness"):
        DisplacementSettings.model_validate({**table, "witness": "top"})

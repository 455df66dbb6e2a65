"""The table of physical numbers: its limits are the schema's, its numbers those of the equations."""

from __future__ import annotations

import dataclasses
import math
from typing import Annotated

import pytest
from pydantic import TypeAdapter

from rig_configs import RigFileError, load_rig
from rig_configs.physical_numbers import (
    PARAMETERS,
    PHYSICAL_KEYS,
    PHYSICAL_NUMBERS,
    PhysicalNumber,
    need_physical_key,
)

RIG = load_rig("virtual")
IN_THE_FILE = [number for key, number in PHYSICAL_NUMBERS.items() if number.is_physics or key.startswith("limits.")]


@pytest.mark.parametrize("number", IN_THE_FILE, ids=lambda number: number.key)
def test_a_rig_file_refuses_a_number_just_beyond_its_limits(number: PhysicalNumber) -> None:
    """The message names the number. Limits themselves are accepted unless they are excluded."""
    for limit in (number.least, number.most):
        if limit is not None:
            assert TypeAdapter(Annotated[float, number]).validate_python(limit) == limit
    beyond = [
        *([] if number.above is None else [number.above]),
        *([] if number.least is None else [math.nextafter(number.least, -math.inf)]),
        *([] if number.most is None else [math.nextafter(number.most, math.inf)]),
    ]
    for value in (*beyond, math.inf, math.nan):
        with pytest.raises(RigFileError, match=number.key):
            load_rig("virtual", settings={number.key: value})


def test_every_number_is_changed_as_the_rig_file_would() -> None:
    for key in PHYSICAL_KEYS:
        by_file = load_rig("virtual", None, [f"{key}=0.0123"]).physics
        assert PHYSICAL_NUMBERS[key].of(by_file) == 0.0123
        assert PHYSICAL_NUMBERS[key].changed(RIG.physics, 0.0123) == by_file
        simulated = load_rig("virtual", None, [f"virtual.truth.{key}=0.0123"])
        assert PHYSICAL_NUMBERS[key].of(simulated.true_physics) == 0.0123


def test_every_number_of_the_equations_is_in_the_table() -> None:
    """A bow and terms of the suspension come from tests, not from the rig file."""
    p = RIG.physics
    shared = {"bow_x_m", "bow_y_m", "hardening_per_m2", "damping_growth_s_per_m", "pivot_shift_compensated", "a", "b"}
    fields = {f.name for f in dataclasses.fields(p)} - shared
    fields |= {f"{part}.{f.name}" for part in "ab" for f in dataclasses.fields(p.a)}
    named = {key.replace("pendulums.", "").removeprefix("suspension.") for key in PHYSICAL_KEYS}
    assert {key.replace("rotor.", "rotor_").replace("imbalance.", "imbalance_") for key in named} == fields


def test_identified_parameters_are_those_of_the_equations() -> None:
    assert list(PARAMETERS) == list(RIG.physics.identified())
    for name, number in PARAMETERS.items():
        assert number.symbol
        assert 0 < number.design_share < 1
        if number.is_physics:
            assert number.of(RIG.physics) == RIG.physics.identified()[name]


def test_a_wrong_key_names_the_nearest() -> None:
    with pytest.raises(RigFileError, match=r"did you mean imbalance\.radius_m"):
        need_physical_key("imbalance.radus_m")
    need_physical_key("suspension.k2_N_per_m")

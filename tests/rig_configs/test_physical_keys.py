"""Numbers of the rig file changed in the physics are what the file with that number gives."""

from __future__ import annotations

import pytest

from rig_configs import RigFileError, load_rig
from rig_configs.physical_keys import PHYSICAL_KEYS, need_physical_key, with_physical


def test_every_number_is_changed_as_the_rig_file_would() -> None:
    physics = load_rig("virtual").physics
    assert len(PHYSICAL_KEYS) > 20
    for key in PHYSICAL_KEYS:
        by_file = load_rig("virtual", None, [f"{key}=0.0123"]).physics
        assert with_physical(physics, key, 0.0123) == by_file
        if not key.endswith("ball_inertia_ratio"):  # of no ball
            assert by_file != physics


def test_no_uncertainty_is_a_number_of_the_physics() -> None:
    assert not [key for key in PHYSICAL_KEYS if "std" in key]


def test_a_wrong_key_names_the_nearest() -> None:
    with pytest.raises(RigFileError, match=r"did you mean imbalance\.radius_m"):
        need_physical_key("imbalance.radus_m")
    need_physical_key("suspension.k2_N_per_m")

"""Air drag in identified parameters: stored, applied to a rig, and decided in either way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rig_configs import IdentifiedParameters, load_rig
from rig_configs.drag import Drag, read_as, with_undecided_spread
from rig_configs.known import DRAG, KEPT_FRICTION, KnownSource

FOUND = Drag(
    np.array([1.6e-6, 1.8e-6]),
    np.array([[4e-14, 1e-14], [1e-14, 9e-14]]),
    undecided=True,
    by_number={"pendulums.a.length_m": np.array([6e-5, 0.0])},
)


def kept(drag: Drag = FOUND) -> IdentifiedParameters:
    return IdentifiedParameters({"k1_N_per_m": 2500.0}, np.array([[1.0]]), provenance=drag.table)


def friction(provenance: dict[str, object]) -> list[float]:
    table = provenance["friction"]
    assert isinstance(table, dict)
    return [table["values"][name] for name in KEPT_FRICTION]


def test_a_parameters_file_keeps_it(tmp_path: Path) -> None:
    kept().save(tmp_path / "parameters.toml")
    found = Drag.of(IdentifiedParameters.load(tmp_path / "parameters.toml").provenance)
    assert found is not None
    assert found.undecided
    assert np.array_equal(found.values, FOUND.values)
    assert np.array_equal(found.covariance, FOUND.covariance)
    assert Drag.of({}) is None
    assert np.array_equal(found.by_number["pendulums.a.length_m"], FOUND.by_number["pendulums.a.length_m"])


@pytest.mark.parametrize("by", [np.array([1e-5]), np.array([1e-5, np.nan])])
def test_derivatives_that_a_damaged_file_has_are_refused(by: np.ndarray) -> None:
    with pytest.raises(ValueError, match="drag: expected"):
        replace(FOUND, by_number={"pendulums.a.length_m": by})


def test_an_error_of_a_length_moves_the_drag_that_was_found_with_it() -> None:
    length = KnownSource("caliper", 2e-5, "m", {"pendulums.a.length_m": 2e-5, "pendulums.b.length_m": 2e-5})
    mass = KnownSource("rotor.mass_kg", 1e-3, "kg", {"rotor.mass_kg": 1e-3})
    moved, kept_as_it_was = FOUND.moved_with((length, mass))
    assert moved.effects == {**length.effects, DRAG[0]: pytest.approx(2e-5 * 6e-5), DRAG[1]: 0.0}
    assert kept_as_it_was is mass


def test_it_acts_on_the_rig_and_a_value_below_zero_does_not() -> None:
    rig = load_rig("virtual", kept())
    assert (rig.physics.a.drag_Nms2_per_rad2, rig.physics.b.drag_Nms2_per_rad2) == (1.6e-6, 1.8e-6)
    applied = kept(replace(FOUND, values=np.array([-1e-7, 1.8e-6]))).applied_to(load_rig("virtual").physics)
    assert (applied.a.drag_Nms2_per_rad2, applied.b.drag_Nms2_per_rad2) == (0.0, 1.8e-6)


def test_its_root_is_that_of_its_covariance() -> None:
    assert 1e14 * FOUND.root @ FOUND.root.T == pytest.approx(1e14 * FOUND.covariance)
    assert replace(FOUND, covariance=np.zeros((2, 2))).root == pytest.approx(np.zeros((2, 2)))


def test_read_as_drag_it_is_settled() -> None:
    settled = Drag.of(read_as(FOUND.table, "drag"))
    assert settled is not None
    assert not settled.undecided
    assert "friction" not in with_undecided_spread(read_as(FOUND.table, "drag"))


def test_read_as_contact_friction_it_adds_to_what_was_found_of_that_and_drags_no_more() -> None:
    other = {
        "friction": {
            "values": dict(zip(KEPT_FRICTION, [1e-6, 0.0, 1e-7, 0.0], strict=True)),
            "covariance": np.zeros((4, 4)).tolist(),
        }
    }
    provenance = read_as({**FOUND.table, **other}, "contact")
    assert friction(provenance) == pytest.approx([1e-6, 0.0, 1.7e-6, 1.8e-6])
    covariance = np.array(provenance["friction"]["covariance"])
    assert 1e14 * covariance[2:, 2:] == pytest.approx(1e14 * FOUND.covariance)
    drag = Drag.of(provenance)
    assert drag is not None
    assert not np.any(drag.values)
    assert not drag.undecided


def test_undecided_the_contact_force_may_have_all_of_it_or_none() -> None:
    provenance = with_undecided_spread(FOUND.table)
    half = 0.5 * FOUND.values
    assert friction(provenance)[2:] == pytest.approx(half.tolist())
    assert np.sqrt(np.diag(provenance["friction"]["covariance"]))[2:] == pytest.approx(half)

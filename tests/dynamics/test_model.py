"""The smallest model of each scene, and its reason."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dynamics import choose_model
from dynamics.equations.model import AUTONOMOUS, CLOSED_FORM, HALF_REVOLUTION, NONLINEAR, WHOLE_REVOLUTION
from dynamics.equations.parameters import Pendulum
from dynamics.errors import OutsideDomain
from tests.dynamics.nominal import rig

NONE = Pendulum.absent()


@pytest.mark.parametrize(
    ("parameters", "released", "steady", "name", "word"),
    [
        (rig(1.0), (True, True), True, AUTONOMOUS, "isotropic"),
        (rig(), (True, True), True, HALF_REVOLUTION, "k1 ≠ k2"),
        (replace(rig(1.0), zeta2=0.03), (True, True), True, HALF_REVOLUTION, "ζ1 ≠ ζ2"),
        (rig(), (True, False), True, HALF_REVOLUTION, "pendulum A"),
        (rig(), (False, False), True, CLOSED_FORM, "no pendulum is free"),
        (replace(rig(), a=NONE, b=NONE), (True, True), True, CLOSED_FORM, "no pendulum, so"),
        (rig(gravity_m_per_s2=9.81), (True, True), True, WHOLE_REVOLUTION, "gravity"),
        (rig(1.0), (True, True), False, NONLINEAR, "does not repeat"),
    ],
)
def test_the_smallest_exact_model(parameters, released, steady, name, word) -> None:
    found = choose_model(parameters, released, steady=steady)
    assert found.name == name
    assert word in found.why
    assert str(found) == f"{found.name}: {found.why}"


def test_a_bigger_model_can_be_asked_for_and_a_smaller_cannot() -> None:
    assert choose_model(rig(1.0), at_least=HALF_REVOLUTION).name == HALF_REVOLUTION
    assert "requested" in choose_model(rig(1.0), at_least=HALF_REVOLUTION).why
    assert choose_model(rig(), at_least=AUTONOMOUS).name == HALF_REVOLUTION
    with pytest.raises(OutsideDomain, match="expected one of"):
        choose_model(rig(), at_least="small")

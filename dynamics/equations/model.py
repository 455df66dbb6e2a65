"""Selection of the smallest model that is exact for a scene, with its reason."""

from __future__ import annotations

from dataclasses import dataclass

from dynamics.equations.parameters import RigOrParameters, RotorParameters, physics_of
from dynamics.errors import OutsideDomain

CLOSED_FORM = "linear, closed form"
AUTONOMOUS = "rotating frame, autonomous"
HALF_REVOLUTION = "periodic over half a revolution"
WHOLE_REVOLUTION = "periodic over a whole revolution"
NONLINEAR = "full nonlinear motion"
_AMPLITUDE_DEPENDENT = "the suspension's stiffness or damping depends on the motion"
_BY_SIZE = (CLOSED_FORM, AUTONOMOUS, HALF_REVOLUTION, WHOLE_REVOLUTION, NONLINEAR)


@dataclass(frozen=True)
class ChosenModel:
    """A model and the reason for its selection.

    Attributes:
        name: one of the names of this module, smallest first: CLOSED_FORM, AUTONOMOUS, HALF_REVOLUTION,
            WHOLE_REVOLUTION, NONLINEAR.
        why: property of the scene that requires the model, one line.
    """

    name: str
    why: str

    def __str__(self) -> str:
        return f"{self.name}: {self.why}"


def choose_model(
    rig: RigOrParameters,
    released: tuple[bool, bool] = (True, True),
    *,
    steady: bool = True,
    at_least: str | None = None,
) -> ChosenModel:
    """Select the smallest exact model of a scene.

    Args:
        rig: RotorParameters, or an object whose `.physics` is one.
        released: which pendulums are free.
        steady: True for constant speed and a periodic motion, False for a transient, a ramp or a measured speed.
        at_least: name of the smallest permitted model.
    Raises:
        OutsideDomain: `at_least` is not the name of a model.
    """
    smallest = _smallest(physics_of(rig), released, steady)
    if at_least is None:
        return smallest
    if at_least not in _BY_SIZE:
        raise OutsideDomain(f"model: expected one of {', '.join(map(repr, _BY_SIZE))}, got {at_least!r}")
    if _BY_SIZE.index(at_least) <= _BY_SIZE.index(smallest.name):
        too_small = "" if at_least == smallest.name else f" ({at_least} was requested and would not be exact)"
        return ChosenModel(smallest.name, smallest.why + too_small)
    return ChosenModel(at_least, f"requested ({smallest.name} would suffice)")


def _smallest(p: RotorParameters, released: tuple[bool, bool], steady: bool) -> ChosenModel:
    free = [name for name, r, q in zip("AB", released, (p.a, p.b), strict=True) if r and q.present]
    if not free:
        what = "no pendulum is free" if p.a.present or p.b.present else "no pendulum"
        if steady:
            return _with_nothing_free(p, what)
        return ChosenModel(NONLINEAR, f"{what}, but the speed changes: integrated over time")
    if not steady:
        return ChosenModel(NONLINEAR, "the motion does not repeat: integrated over time")
    who = "pendulums are" if len(free) == 2 else f"pendulum {free[0]} is"
    if p.gravity_m_per_s2 > 0:
        return ChosenModel(
            WHOLE_REVOLUTION, f"{who} free and gravity lies in the disk plane, which repeats once a revolution"
        )
    if p.bow_m or not p.is_isotropic:
        unequal = (
            "k1 ≠ k2" if p.k1_N_per_m != p.k2_N_per_m else "ζ1 ≠ ζ2" if p.zeta1 != p.zeta2 else _AMPLITUDE_DEPENDENT
        )
        why = "the shaft is bent" if p.is_isotropic else f"{unequal}, which acts on the rotor twice a revolution"
        return ChosenModel(HALF_REVOLUTION, f"{who} free and {why}")
    return ChosenModel(
        AUTONOMOUS, f"{who} free on an isotropic suspension: steady motions are rest points of the rotating frame"
    )


def _with_nothing_free(p: RotorParameters, what: str) -> ChosenModel:
    if p.suspension_is_linear:
        return ChosenModel(CLOSED_FORM, f"{what}, so disk and column are two forced linear oscillators")
    name = WHOLE_REVOLUTION if p.gravity_m_per_s2 > 0 else HALF_REVOLUTION
    return ChosenModel(name, f"{what}, but {_AMPLITUDE_DEPENDENT}: two forced oscillators by harmonic balance")

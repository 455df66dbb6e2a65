"""Steady motions at constant speed and their stability.

Type I (balanced), II (pendulums opposed), III (together). On an isotropic suspension they are rest points of the
rotating frame in closed form (dynamics.steady.singular_points). Otherwise Types II and III are periodic orbits
(dynamics.steady.orbits), found from the mean torque's singular points. The stability of each is determined by the
multipliers of its own linearised equations (dynamics.equations.linearised, dynamics.stability.floquet).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeAlias

import numpy as np

from dynamics.arguments import check_number, check_pair, check_speed
from dynamics.arrays import Array
from dynamics.equations.balancing import balanced_angles, balancing_region
from dynamics.equations.linearised import along, rotating_frame, type_one
from dynamics.equations.model import AUTONOMOUS, CLOSED_FORM, ChosenModel, choose_model
from dynamics.equations.parameters import RigOrParameters, RotorParameters, physics_of
from dynamics.errors import NoBalancedState, NotConverged, OutsideDomain
from dynamics.stability.floquet import Multipliers, floquet_multipliers
from dynamics.steady.orbits import Orbit, coarse_orbit, periodic_orbit
from dynamics.steady.singular_points import SingularPoint, singular_points
from dynamics.steady.steady_state import SteadyState, SteadyStates
from dynamics.steady.stick_band import stick_half_width
from dynamics.steady.whirl import PHASES, circular_whirl, locked_whirl

_SAME_RAD = 1e-4  # difference of mean angles below which two orbits are the same
_MAX_HARMONICS = 32  # of the matrix along a motion whose damping has kinks; half as many give the error
_KINKED_ACCURACY = 0.3  # relative accuracy of such an orbit, because its orders decrease as 1/k⁵
_Angles: TypeAlias = tuple[float, float]
_FURTHER_ANGLES = np.arange(8) * math.pi / 4  # additional starts, where the mean torque is not sufficient


def steady_states(
    rig: RigOrParameters,
    speed_rad_s: float,
    accuracy: float = 1e-8,
    released: tuple[bool, bool] = (True, True),
    locked_at_rad: tuple[float, float] = (0.0, math.pi),
    *,
    at_least: str | None = None,
) -> SteadyStates:
    """Compute every steady motion of Types I, II, III at a constant speed, stable ones first.

    Args:
        rig: RotorParameters, or an object whose `.physics` is one.
        speed_rad_s: running speed, rad/s, above 0.
        accuracy: permitted error of the largest multiplier (relative to max(1, its modulus)), of the angles (rad) and
            of the amplitude (relative to the orbit's size).
        released, locked_at_rad: which pendulums are free, and the angles of the others.
        at_least: name of the smallest permitted model (dynamics.equations.model), for comparisons.
    Raises:
        OutsideDomain: a speed or accuracy outside the domain.
        NotConverged: the accuracy cannot be guaranteed for any of the states. If it can for some of them, the others
            are listed in `unresolved`.
    Source: docs/theory/steady_states.md.

    Example:
        >>> from dynamics import steady_states
        >>> from rig_configs import load_rig
        >>> states = steady_states(load_rig("virtual"), speed_rad_s=40.0)
        >>> [(state.type, state.stability) for state in states[:3]]
        [('I', 'stable'), ('I', 'stable'), ('II', 'unstable')]
        >>> print(states)
        SteadyStates
        type   theta3_rad   theta4_rad    amplitude_m  multiplier_max  stability
        I       1.8898...    4.3933...  ...
    """
    parameters = physics_of(rig)
    check_request(parameters, speed_rad_s, accuracy)
    check_pair(released=released, locked_at_rad=locked_at_rad)
    model = choose_model(parameters, released, at_least=at_least)
    points = singular_points(parameters, speed_rad_s, released, locked_at_rad)
    search = _Search()
    if model.name in (CLOSED_FORM, AUTONOMOUS):
        # a suspension that is not linear is excluded here: choose_model selects a larger model
        for point in points:
            search.judge(point.type, lambda p=point: _from_point(parameters, speed_rad_s, p, accuracy, released, model))
    else:
        _search_orbits(search, parameters, speed_rad_s, points, accuracy, released, model)
    return search.outcome()


class _Search:
    """States found by a search, and states that could not be evaluated."""

    def __init__(self) -> None:
        self.found: list[SteadyState] = []
        self.unresolved: list[str] = []
        self._refused: NotConverged | None = None
        self._places: list[_Angles] = []  # mean angles of every motion found, evaluated or not

    def judge(self, kind: str, make: Callable[[], SteadyState], theta: _Angles | None = None) -> None:
        """Add a state. If its multipliers cannot be computed, it is added to `unresolved`."""
        if theta is not None:
            self._places.append(theta)
        try:
            self.found.append(make())
        except NotConverged as refusal:
            self._refused = refusal
            self.unresolved.append(f"{kind}: {refusal}")

    def contains(self, theta: _Angles) -> bool:
        """Whether a motion with these mean angles has been found."""
        return any(_apart(theta, place) < _SAME_RAD for place in self._places)

    def outcome(self) -> SteadyStates:
        """All states found.

        Raises:
            NotConverged: there are motions, and none of them could be evaluated.
        """
        if self._refused is not None and not self.found:
            raise self._refused
        met: set[str] = set()
        found: list[SteadyState] = []
        for s in self.found:
            if not (s.any_angle and s.type in met):  # a circle of states is listed once
                found.append(s)
                met.add(s.type if s.any_angle else "")
        return SteadyStates(found, self.unresolved)


def _search_orbits(
    search: _Search,
    p: RotorParameters,
    speed: float,
    points: list[SingularPoint],
    accuracy: float,
    released: tuple[bool, bool],
    model: ChosenModel,
) -> None:
    """Search orbits from the singular points of the mean torque and from additional angles."""
    further: list[SingularPoint] = []
    if all(released) and p.a.present and p.b.present:
        for angle in _FURTHER_ANGLES:
            further += [SingularPoint("II", (angle, angle + math.pi), 0j), SingularPoint("III", (angle, angle), 0j)]
    linear = p if p.suspension_is_linear else replace(p, hardening_per_m2=(0.0, 0.0), damping_growth_s_per_m=(0.0, 0.0))
    for point in points + further:
        theta = point.theta_rad
        twin = _exchanged(p, search, theta)
        if twin is not None:
            search.judge(point.type, lambda t=twin: t, twin.theta_rad)
        elif point.type == "I" and _rests(p):
            search.judge("I", lambda t=theta: _balanced(p, speed, t, accuracy, model), theta)
        else:
            coarse = coarse_orbit(p, speed, _first_guess(linear, speed, theta), released)
            if coarse is not None and search.contains(_mean_angles(coarse)):
                continue
            share = _KINKED_ACCURACY if _is_kinked(p) else 0.01
            orbit = None if coarse is None else periodic_orbit(p, speed, coarse[:, :4], share * accuracy, released)
            if orbit is None:
                search.unresolved += (
                    [f"{point.type}: no orbit found near its singular point"] if point in points else []
                )
                continue
            mean = _mean_angles(orbit.states)
            if not search.contains(mean):
                kind = point.type if point.type in ("one", "none") else _kind(mean, points)
                search.judge(kind, partial(_from_orbit, p, speed, kind, orbit, accuracy, released, model), mean)


def _first_guess(linear: RotorParameters, speed: float, theta: _Angles) -> Array:
    """Positions (n, 4) of the linear orbit; in an undamped resonance, where it does not exist, of the rotor at rest."""
    try:
        return locked_whirl(linear, speed, theta)[:, :4]
    except OutsideDomain:  # usual: an undamped resonance
        return circular_whirl(speed, SingularPoint("none", theta, 0j))[:, :4]


def multipliers(rig: RigOrParameters, speed_rad_s: float, accuracy: float = 1e-8) -> SteadyState:
    """Compute the balanced state (Type I) at a speed with its multipliers over one revolution.

    Args:
        rig, speed_rad_s, accuracy: as for steady_states.
    Raises:
        NoBalancedState: the pendulums cannot balance this imbalance, or a pivot shift, gravity or a bow prevents rest.

    Example:
        >>> from dynamics import multipliers
        >>> from rig_configs import load_rig
        >>> found = multipliers(load_rig("virtual"), 40.0, accuracy=1e-10)
        >>> found.stability, round(found.multiplier_max, 4)
        ('stable', 0.9498)
    """
    parameters = physics_of(rig)
    check_request(parameters, speed_rad_s, accuracy)
    if not _rests(parameters):
        raise NoBalancedState(
            "a pivot shift, gravity or a bow moves the disk in every state; use steady_states for them"
        )
    angles = balanced_angles(parameters)
    if not angles:
        a, b = parameters.a.first_moment_kg_m, parameters.b.first_moment_kg_m
        s = parameters.imbalance_moment_kg_m
        raise NoBalancedState(
            f"no balanced state: it needs |S_A − S_B| ≤ S_P ≤ S_A + S_B; S_A = {a:.6g}, S_B = {b:.6g}, "
            f"S_P = {s:.6g} kg m: {balancing_region(a, b, s)}"
        )
    return _balanced(parameters, speed_rad_s, angles[0], accuracy, choose_model(parameters))


def check_request(p: RotorParameters, speed_rad_s: float, accuracy: float) -> None:
    """Check the speed and the accuracy of a request.

    Raises:
        OutsideDomain: the speed is not within 1e-8 … 1e8 natural frequencies, or the accuracy not within 1e-12 … 0.1.
    """
    check_speed(speed_rad_s, p.natural_frequencies_rad_s)
    check_number(accuracy=accuracy)
    if not 1e-12 <= accuracy <= 0.1:
        raise OutsideDomain(f"accuracy: expected 1e-12 to 0.1, got {accuracy!r}")


def _rests(parameters: RotorParameters) -> bool:
    """Whether the disk is at rest in the balanced state."""
    return parameters.pivot_shift_m == 0 and parameters.gravity_m_per_s2 == 0 and parameters.bow_m == 0


def _balanced(
    p: RotorParameters, speed: float, theta: tuple[float, float], accuracy: float, model: ChosenModel
) -> SteadyState:
    """The balanced state. The disk is at rest, so only the multipliers are computed."""
    states = np.zeros((PHASES, 8))
    states[:, 2:4] = theta
    judged = floquet_multipliers(type_one(p, *theta, speed), accuracy)
    at = (theta[0] % (2 * math.pi), theta[1] % (2 * math.pi))
    return SteadyState(
        type="I",
        theta_rad=at,
        start=states[0].copy(),
        states=states,
        amplitude_m=0.0,
        x_m=0j,
        y_m=0j,
        multipliers=judged.values,
        error_estimate=judged.error_estimate,
        angle_error_rad=2e-15,
        amplitude_error_m=0.0,
        model=model,
        method=judged.why,
        stick_half_width_rad=stick_half_width(p, speed, at),
        any_angle=p.forcing_moment_kg_m == 0,
    )


def _from_point(
    p: RotorParameters,
    speed: float,
    point: SingularPoint,
    accuracy: float,
    released: tuple[bool, bool],
    model: ChosenModel,
) -> SteadyState:
    """A rest point of the rotating frame, or the linear orbit of a rotor without free pendulums."""
    states = circular_whirl(speed, point) if model.name == AUTONOMOUS else locked_whirl(p, speed, point.theta_rad)
    if model.name == AUTONOMOUS:
        matrix = rotating_frame(p, states[0], speed, released)
    else:
        matrix = along(p, states, speed, (False, False))
    judged = floquet_multipliers(matrix, accuracy)
    size = float(np.max(np.abs(states[:, :2])))
    return _described(p, speed, point.type, states, judged, (1e-14, 1e-14 * size), model)


def _from_orbit(
    p: RotorParameters,
    speed: float,
    kind: str,
    orbit: Orbit,
    accuracy: float,
    released: tuple[bool, bool],
    model: ChosenModel,
) -> SteadyState:
    most = (_MAX_HARMONICS, _MAX_HARMONICS // 2) if _is_kinked(p) else (None, None)
    fine, coarse = (
        floquet_multipliers(along(p, states, speed, released, m), 0.5 * accuracy)
        for states, m in zip((orbit.states, orbit.coarse_states), most, strict=True)
    )
    moved = abs(abs(fine.values[0]) - abs(coarse.values[0]))
    errors = (orbit.angle_error_rad, orbit.position_error_m)
    state = _described(p, speed, kind, orbit.states, fine, errors, model, moved)
    if state.error_estimate > accuracy * max(1.0, state.multiplier_max):
        raise NotConverged(
            f"Type {kind} at {speed:.6g} rad/s: multiplier {state.multiplier_max:.6g} known to "
            f"{state.error_estimate:.2g}, expected {accuracy:.2g}; reduce the accuracy"
        )
    return state


def _is_kinked(p: RotorParameters) -> bool:
    """Whether a damping force has a kink at zero speed."""
    return any((*p.damping_growth_s_per_m, p.a.drag_Nms2_per_rad2, p.b.drag_Nms2_per_rad2))


def _described(
    p: RotorParameters,
    speed: float,
    kind: str,
    states: Array,
    judged: Multipliers,
    errors: tuple[float, float],
    model: ChosenModel,
    moved: float = 0.0,
) -> SteadyState:
    turn = np.exp(-2j * np.pi * np.arange(len(states)) / len(states))
    theta = np.mean(states[:, 2:4], axis=0) % (2 * np.pi)
    return SteadyState(
        type=kind,
        theta_rad=(float(theta[0]), float(theta[1])),
        start=states[0].copy(),
        states=states,
        amplitude_m=float(np.sqrt(np.sum(np.var(states[:, :2], axis=0)))),
        x_m=complex(2 * np.mean(states[:, 0] * turn)),
        y_m=complex(2j * np.mean(states[:, 1] * turn)),
        multipliers=judged.values,
        error_estimate=judged.error_estimate + moved,
        angle_error_rad=errors[0],
        amplitude_error_m=2 * errors[1],
        model=model,
        method=judged.why,
        stick_half_width_rad=stick_half_width(p, speed, (float(theta[0]), float(theta[1]))),
        any_angle=p.forcing_moment_kg_m == 0 and _rests(p) and kind in ("I", "II", "III"),
    )


def _kind(mean: _Angles, points: list[SingularPoint]) -> str:
    """Type of an orbit: I if nearest to such a point, otherwise from the angle between the pendulums."""
    gap = abs((mean[0] - mean[1] + math.pi) % (2 * math.pi) - math.pi)
    aligned = {"III": gap, "II": math.pi - gap}
    balanced = [_apart(mean, p.theta_rad) for p in points if p.type == "I"]
    if balanced and min(balanced) < min(aligned.values()):
        return "I"
    return min(aligned, key=lambda k: aligned[k])


def _exchanged(p: RotorParameters, search: _Search, theta: _Angles) -> SteadyState | None:
    """A motion found with A and B exchanged, if these are equal, near the given angles."""
    if p.a != p.b:
        return None
    for s in search.found:
        own, over = s.theta_rad, (s.theta_rad[1], s.theta_rad[0])
        if _apart(over, theta) < 0.05 and _apart(over, own) > 0.2 and not search.contains(over):
            states = s.states[:, [0, 1, 3, 2, 4, 5, 7, 6]]
            widths = s.stick_half_width_rad[::-1]
            return replace(s, theta_rad=over, states=states, start=states[0].copy(), stick_half_width_rad=widths)
    return None


def _mean_angles(states: Array) -> _Angles:
    """Mean θ3, θ4 of a motion, rad."""
    theta = states[:, 2:4].mean(axis=0)
    return float(theta[0]), float(theta[1])


def _apart(one: _Angles, other: _Angles) -> float:
    """Larger distance |e^{iθ} − e^{iθ'}| of two pairs of angles."""
    return 2 * max(abs(math.sin((one[0] - other[0]) / 2)), abs(math.sin((one[1] - other[1]) / 2)))

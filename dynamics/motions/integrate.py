"""Nonlinear motion of one run to a given accuracy, with a bound on its error.

The motion is computed twice, the second time with a thirty times tighter tolerance per step. The difference over all
instants is the error of the first run, within the much smaller error of the second. It bounds the error of the second
run, which is returned. If the bound exceeds the accuracy, the tolerance is reduced. See docs/theory/integration.md.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from dynamics.arguments import check_number
from dynamics.arrays import Array
from dynamics.equations.parameters import RigOrParameters, physics_of
from dynamics.equations.scene import Scene
from dynamics.errors import NotConverged, OutsideDomain
from dynamics.motions.fixed_steps import integrate
from dynamics.motions.locked_motion import damping_rates, fastest_rate, locked_orbit, locked_state
from dynamics.motions.motion import Motion
from dynamics.motions.motion_problem import Setup, instants, motion_problem
from dynamics.motions.trajectory import Trajectory, run

__all__ = [
    "Motion",
    "damping_rates",
    "fastest_rate",
    "integrate",
    "locked_orbit",
    "locked_state",
    "simulate",
]

WORK_LIMIT = 50_000_000
"""Default limit on the steps of a call: about a minute."""

_RATIO = 30.0  # ratio of the tolerances of the first two runs
_HEADROOM = 120.0  # accuracy over the first run's tolerance at an accuracy of 1e-6; smaller for tighter accuracies
_FINEST = 1e-15  # smallest tolerance per step; below it rounding dominates
_MAX_RUNS = 6
_LONG_RUN_STEPS = 300_000.0  # number of steps above which the beginning of a run is checked first
_PILOTS = (1 / 128, 1 / 32)  # checked fractions of a long run
_COARSE = 5e-9  # tolerance above which errors decrease irregularly, because steps are large
_ROUNDING_TOLERANCE = 1e-13  # tolerance below which rounding dominates both runs
_STRONG_GROWTH = 300.0  # ratio of error to tolerance above which two differences are required


def simulate(
    parameters: RigOrParameters,
    scene: Scene,
    time_s: ArrayLike,
    accuracy: float = 1e-6,
    method: str | None = None,
    *,
    dense: bool = False,
    work_limit: int = WORK_LIMIT,
    resolved: bool = False,
) -> Motion:
    """Simulate the nonlinear motion of one run.

    Args:
        parameters: the rig, or its rotor parameters.
        scene: speed history, releases, start state.
        time_s: output instants, s, shape (n,), ascending. The start state belongs to the first. A number is a duration
            in s from t = 0 with 200 samples a second.
        accuracy: largest permitted error at any instant: of the angles in rad, of the displacements relative to the
            longest pendulum arm. It therefore bounds displacements in m too.
        method: "explicit", "implicit", or None for the method with the lower expected cost.
        dense: keep the polynomials between the instants (Motion.at, Motion.crossings).
        work_limit: largest number of steps of the call.
        resolved: explicit steps also resolve oscillations of negligible amplitude, as derivatives require.
    Raises:
        OutsideDomain: invalid instants, start state, accuracy or method.
        NotConverged: the accuracy cannot be reached (an unstable or chaotic motion over too long a time), or the work
            exceeds work_limit. If this is predictable, the error is raised before the computation.
    Source: docs/theory/integration.md.

    Example:
        >>> from dynamics import Scene, SpeedHistory, simulate
        >>> from rig_configs import load_rig
        >>> run_up = SpeedHistory.ramp(0.0, 40.0, duration_s=2.0)
        >>> motion = simulate(load_rig("virtual"), Scene(run_up, release_time_s=(2.5, 2.5)), 3.0)
        >>> motion.displacement_m.shape, bool(motion.error_estimate < 1e-6)
        ((601, 2), True)
        >>> motion.to_dataframe().columns.tolist()[:5]
        ['time_s', 'x_m', 'y_m', 'theta3_rad', 'theta4_rad']
    """
    physics = physics_of(parameters)
    _check_request(scene, accuracy, method, work_limit)
    times = instants(time_s)
    setup = motion_problem(physics, scene, times, resolved)
    tolerance = max(min(accuracy, 0.1) / _headroom(accuracy), _FINEST * _RATIO)
    cheaper, why = setup.prefers_implicit(tolerance)
    implicit = cheaper if method is None else method == "implicit"
    if method is not None:
        why = "requested"
    if setup.duration_s == 0.0:
        state = np.tile(setup.problem.start, (len(times), 1))
        return Motion(times, state, 0.0, 0.0, "none", "zero duration")
    if implicit and resolved:  # implicit steps damp oscillations that they do not resolve, in the derivatives too
        setup = dataclasses.replace(setup, problem=dataclasses.replace(setup.problem, longest_step_s=np.inf))
    _check_work(setup, tolerance, implicit, work_limit)
    _check_growth(setup, accuracy, tolerance, implicit)
    last, bound, work = _converge(setup, accuracy, tolerance, implicit, work_limit, dense)
    events = tuple(sorted([*last.events, *setup.stop], key=lambda e: e.time_s))
    return Motion(
        times,
        last.states[setup.wanted],
        bound,
        setup.duration_s / max(1, last.steps),
        "implicit" if implicit else "explicit",
        why,
        last.steps,
        work,
        events,
        last.polynomials,
    )


def _check_request(scene: object, accuracy: float, method: str | None, work_limit: int) -> None:
    check_number(accuracy=accuracy, work_limit=work_limit)
    if not isinstance(scene, Scene):
        raise OutsideDomain(f"scene: expected a dynamics.Scene, got {scene!r}")
    if not (np.isfinite(accuracy) and accuracy > 0):
        raise OutsideDomain(f"accuracy must be a finite number above 0, got {accuracy!r}")
    if method not in (None, "explicit", "implicit"):
        raise OutsideDomain(f'method must be "explicit", "implicit" or None, got {method!r}')


def _headroom(accuracy: float) -> float:
    """Ratio of the accuracy to the first run's tolerance per step.

    A release multiplies the tolerance by 100 at 1e-8 and by 15 at 1e-12 (docs/theory/integration.md): the embedded
    estimate is more conservative at tighter tolerances.
    """
    return _HEADROOM * min(1.0, (accuracy / 1e-6) ** (1 / 7))


def _check_work(setup: Setup, tolerance: float, implicit: bool, work_limit: int) -> None:
    expected = setup.expected_steps(tolerance, implicit) + setup.expected_steps(tolerance / _RATIO, implicit)
    if expected > 3 * work_limit:  # the prediction is accurate to a factor of a few
        raise NotConverged(
            f"{setup.duration_s:.3g} s of motion need about {expected:.2g} steps, the limit is {work_limit:.2g}; "
            f"raise work_limit (a million take {6 if implicit else 1.3} s), reduce the accuracy or shorten the run"
        )


def _check_growth(setup: Setup, accuracy: float, tolerance: float, implicit: bool) -> None:
    """Check the beginning of a long run for chaotic growth before the whole run is computed twice.

    Raises:
        NotConverged: errors have grown so much that no tolerance can keep them within the accuracy.
    """
    expected = setup.expected_steps(tolerance, implicit)
    if expected < _LONG_RUN_STEPS:
        return
    times = setup.problem.times
    for share in _PILOTS:
        count = int(np.searchsorted(times, float(times[0] + share * setup.duration_s), "right"))
        if count < 2:
            continue
        problem = dataclasses.replace(setup.problem, times=times[:count])
        coarse, fine = (run(problem, t, implicit, WORK_LIMIT) for t in (tolerance, max(tolerance / _RATIO, _FINEST)))
        growth = _distance(setup, coarse.states, fine.states) / tolerance
        if 5 * growth * _FINEST > accuracy:
            raise NotConverged(
                f"{setup.duration_s:.3g} s of motion, about {expected:.2g} steps: within the first "
                f"{times[count - 1] - times[0]:.2g} s an error has grown {growth:.2g} times, too fast to end within "
                f"{accuracy:.2g}: neighbouring motions diverge; reduce the accuracy or shorten the run"
            )


def _converge(
    setup: Setup, accuracy: float, tolerance: float, implicit: bool, work_limit: int, dense: bool
) -> tuple[Trajectory, float, int]:
    """Repeat the run with decreasing tolerances until the bound holds. Returns last run, bound, number of all steps."""
    coarse = run(setup.problem, tolerance, implicit, work_limit)
    work, ratio, bounds, growths = coarse.tried, _RATIO, list[float](), list[float]()
    for _ in range(_MAX_RUNS):
        fine_tolerance = max(tolerance / ratio, _FINEST)
        fine = run(setup.problem, fine_tolerance, implicit, work_limit - work, dense)
        work += fine.tried
        difference = _distance(setup, coarse.states, fine.states)
        growths.append(difference / tolerance)
        strong = max(growths) > _STRONG_GROWTH
        # with large steps the error may decrease irregularly: the tighter run may not be more accurate
        margin = 5.0 if fine_tolerance > _COARSE else 3.0 if implicit or fine_tolerance < _ROUNDING_TOLERANCE else 1.0
        bounds.append(max(margin * difference, 5 * max(growths) * fine_tolerance) + _rounding(setup, fine))
        if bounds[-1] <= accuracy and not (strong and len(growths) == 1):
            return fine, bounds[-1], work
        left = difference * fine_tolerance / tolerance
        ratio = float(np.clip(3 * left / accuracy, 10.0, 1e3))
        hopeless = 5 * max(growths) * _FINEST > accuracy  # no tolerance reduces the bound sufficiently
        spent = hopeless or work + fine.tried * ratio ** (1 / 8) > work_limit
        if spent or fine_tolerance <= _FINEST or (len(bounds) > 2 and bounds[-1] > 0.5 * bounds[-3]):
            break
        coarse, tolerance = fine, fine_tolerance
    raise NotConverged(
        f"motion over {setup.duration_s:.3g} s: error bound {min(bounds):.2g} at tolerance {tolerance:.2g} per step, "
        f"expected {accuracy:.2g} ({work:.2g} steps done, {work_limit:.2g} allowed): "
        + ("rounding in double precision" if min(bounds) < 1e-9 else "neighbouring motions diverge too fast")
        + "; reduce the accuracy or shorten the run"
    )


def _rounding(setup: Setup, fine: Trajectory) -> float:
    """Error common to both runs: rounding of the phase and of the angles in double precision."""
    phases = [setup.problem.segments.phase(float(t))[0] for t in setup.problem.times[[0, -1]]]
    angles = np.max(np.abs(fine.states[:, 2:4]))
    return 4 * np.finfo(float).eps * (1.0 + max(abs(p) for p in phases) + float(angles))


def _distance(setup: Setup, one: Array, other: Array) -> float:
    gap = np.abs(one[:, :4] - other[:, :4]) / setup.problem.weights[:4]
    return float(np.max(gap)) if np.all(np.isfinite(gap)) else np.inf

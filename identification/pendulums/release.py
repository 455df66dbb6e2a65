"""Pendulum damping from a release at speed.

A release starts near an unstable equilibrium: what the angles do depends on their start to a degree that grows
exponentially, so the fit proceeds over growing horizons (identification.pendulums.release_search), from what an
unscented Kalman filter makes of the first second and, should that end in a side minimum, from a fan of dampings. Where
the residuals of a horizon are not noise the whole run is left out: a model that fails later may be biased before that
shows. Dry friction enters where a spin-down found it or the readings ask for it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from daq.signals import Run
from identification.errors import FitFailed
from identification.least_squares import Minimum
from identification.pendulums.answers import covering
from identification.pendulums.diagnosis import candidates, likely_causes
from identification.pendulums.free_angles import laid_over
from identification.pendulums.friction import Evidence
from identification.pendulums.release_problem import SUSPENSION, Release, Shape
from identification.pendulums.release_search import Effort, NotFollowed, Search, Tell, holding
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import TransientFit
from identification.pendulums.unknown_phase import angles_to_try, race, told
from identification.setting import ModelChoice, Setting, check_setting
from identification.threads import on_one_thread
from identification.tracking.release_start import damping_start

_SHIFTS = (0.0, np.log(3.0), -np.log(3.0), np.log(10.0), -np.log(10.0))
_FAN = sorted(product(_SHIFTS, _SHIFTS), key=lambda s: (abs(s[0]) + abs(s[1]), s))  # of ln c3, ln c4, near ones first
_SHARES = (0.05, 0.2, 0.6)  # of the largest viscous torque: friction to start from where nothing is known of it
_SURELY = 2.0  # standard deviations
_AS_GOOD, _NEGATIVE = 0.9, 0.2  # of what friction mends; of the larger torque
_ALIKE = 8.0  # χ² between two shapes of friction that are as good


class ReleaseLeftOut(FitFailed):
    """A release that no fit follows.

    Attributes:
        causes: what would explain it, the likeliest first; empty where nothing does.
    """

    def __init__(self, message: str, causes: list[str]) -> None:
        super().__init__(message)
        self.causes = causes


@on_one_thread
def fit_release(
    run: Run, knowledge: Knowledge, zero_std_rad: float, *, setting: Setting = "balanced", tell: Tell | None = None,
    effort: Effort | None = None,
) -> TransientFit:  # fmt: skip
    """Both pendulums' damping from the transient after a release at constant speed.

    Args:
        run: a "point-NAME" run with both releases and the locked stretch before.
        knowledge: masses, lengths and what is known of suspension, imbalance, dry friction and (as start values)
            damping.
        zero_std_rad: standard uncertainty of each encoder's zero.
        setting: fast fits the first part of the transient and takes rounding for white noise, balanced all of it with
            the rounding's own effect, reference every sample instead of 4 ms blocks.
        tell: told what is tried.
        effort: what the releases of a campaign may cost together.
    Raises:
        NotIdentifiable: no releases, or too few marks or samples.
        ReleaseLeftOut: the model does not follow the angles over any horizon, or the fit does not settle.
        FitFailed: the release shows no damping.
    Source: docs/theory/pendulum_damping.md.
    """
    check_setting(setting)
    release = Release.of(run, knowledge, zero_std_rad, setting)
    horizons, effort, tell = release.horizons(setting), effort or Effort(), tell or (lambda _: None)
    end = horizons[-1]
    answers, shape, other = _searched(release, horizons, effort, tell)
    problem, best = release.problem(shape), answers[0]
    fit = problem.result(best, end, f"release {run.test}", 2, setting, _model_table(release, best, end, shape))
    if max(fit.std[n] / fit.values[n] for n in fit.values) > 0.2:
        raise FitFailed(
            f"{run.source}: {fit.horizon_s:.2g} s of the release do not show the damping; record a longer one"
        )
    fit = replace(fit, warnings=[*fit.warnings, *other])
    if shape is not None:
        friction = release.friction(best, problem.covariance(best, end, setting, (16, 17)), shape)
        fit = replace(fit, friction=friction, warnings=[*fit.warnings, friction.told(f"release {run.test}")])
    if not run.phase_absolute:
        return told(fit, answers, knowledge.physics)
    return covering(fit, answers, "with friction that goes otherwise with the speed", "A spin-down at rest decides")


def _searched(
    release: Release, horizons: list[float], effort: Effort, tell: Tell
) -> tuple[list[Minimum], Shape | None, list[str]]:
    """The answers, the shape of the dry friction in them, and warnings.

    Raises:
        ReleaseLeftOut: there are none.
    """
    known = release.knowledge.friction
    if known is not None:
        torque = known.torque_at(release.speed_rad_s)
        found = _with_friction(release, horizons, _frictional_starts(release, torque, horizons), effort, tell)
        if found is not None:
            return *found, []
    try:
        answers = _viscous(release, horizons, effort, tell)
    except NotFollowed as stuck:
        rescued = _rescued(release, horizons, stuck, effort, tell) if known is None else None
        if rescued is None:
            raise _left_out(release, stuck) from stuck
        return *rescued, []
    ask = release.friction_evidence(answers[0], horizons[-1])
    dry, other = _dry_or_else(release, answers[0], horizons[-1], ask)
    if dry and known is None:
        starts = [(release.with_torque(answers[0].theta, np.maximum(ask.step, 0.0)), False)]
        found = _with_friction(release, horizons[-1:], starts, effort, tell)
        if found is not None:
            return *found, []
    return answers, None, other


def _frictional_starts(release: Release, torque_Nm: np.ndarray, horizons: list[float]) -> list[tuple[np.ndarray, bool]]:
    """From the damping and the friction that a spin-down found."""
    start = release.problem().prior.copy()
    if release.run.phase_absolute:
        return [(release.with_torque(start, torque_Nm), held) for held in (True, False)]
    turns = [
        np.r_[start[:-1], turn] for turn in angles_to_try(laid_over(release.knowledge, start[:2], start[SUSPENSION]))
    ]
    trials = [release.with_torque(theta, torque_Nm) for theta in turns]
    return [(place, True) for place in race(release.problem("torque"), trials, horizons[:-1], holding)]


def _viscous(release: Release, horizons: list[float], effort: Effort, tell: Tell) -> list[Minimum]:
    """The answers without dry friction."""
    problem = release.problem()
    start = problem.prior.copy()
    if release.run.phase_absolute:
        starts, fewest = _starts(release, start), 1
    else:
        places = race(problem, _turned_starts(release, start), horizons[:-1], holding)
        starts, fewest = _starts_around(places, start), len(places)
    return Search(problem, horizons, fewest, effort, tell).answers(starts, release.run.source)


def _with_friction(
    release: Release, horizons: list[float], starts: list[tuple[np.ndarray, bool]], effort: Effort, tell: Tell
) -> tuple[list[Minimum], Shape] | None:
    """The answers with dry friction of the shape that explains the readings better; None where neither settles."""
    tell("with dry friction")
    found: list[tuple[Minimum, Shape]] = []
    shapes: tuple[Shape, Shape] = ("torque", "contact")
    for shape in shapes:
        try:
            search = Search(release.problem(shape), horizons, 1, effort, tell)
            found.append((search.answers(starts, release.run.source)[0], shape))
            starts = [(found[-1][0].theta, held) for held in (True, False)]
        except NotFollowed:
            continue
    if not found:
        return None
    found.sort(key=lambda f: f[0].cost)
    best = found[0][0]
    unit = max(1.0, best.cost / len(best.residual))
    return [m for m, _ in found if m.cost < best.cost + _ALIKE * unit], found[0][1]


def _rescued(
    release: Release, horizons: list[float], stuck: NotFollowed, effort: Effort, tell: Tell
) -> tuple[list[Minimum], Shape] | None:
    """What dry friction makes of a release that viscous damping alone does not explain."""
    if stuck.doubtful is None:
        return None
    minimum, end = stuck.doubtful
    if likely_causes(release, minimum, end):
        return None
    ask = release.friction_evidence(minimum, end)
    if not ask.found:
        return None
    start, damping = release.problem().prior.copy(), release.knowledge.physics
    starts = [(release.with_torque(minimum.theta, np.maximum(ask.step, 0.0)), False)]
    slip = np.array([_fastest(r.averages.time_s, r.averages.value) for r in release.readings])
    viscous = slip * np.array([damping.a.damping_Nms_per_rad, damping.b.damping_Nms_per_rad])
    if release.run.phase_absolute:
        starts += [(release.with_torque(start, share * viscous), False) for share in _SHARES]
    found = _with_friction(release, horizons, starts, effort, tell)
    if found is None or np.any(found[0][0].theta[16:18] < -_SURELY * np.sqrt(np.diag(found[0][0].covariance))[16:18]):
        return None  # friction below zero is none
    return found


def _fastest(time_s: np.ndarray, angle_rad: np.ndarray) -> float:
    """A pendulum's speed against the rotor at its fastest, rad/s."""
    return float(np.quantile(np.abs(np.gradient(angle_rad, time_s)), 0.95))


def _dry_or_else(release: Release, minimum: Minimum, end_s: float, ask: Evidence) -> tuple[bool, list[str]]:
    """Whether dry friction is the best explanation of what viscous damping leaves, and a warning where it is not."""
    if not ask.found or ask.step.max() <= 0 or ask.step.min() < -_NEGATIVE * ask.step.max():
        return False, []
    causes = candidates(release, minimum, end_s)
    if not causes or causes[0].mended < _AS_GOOD * ask.mended:
        return True, []
    text = f"release {release.run.test}: the residuals are no noise; {causes[0].text} would explain them. Measure it"
    return False, [text]


def _left_out(release: Release, stuck: NotFollowed) -> ReleaseLeftOut:
    causes = likely_causes(release, *stuck.doubtful) if stuck.doubtful is not None else []
    return ReleaseLeftOut(str(stuck), causes)


def _starts(release: Release, start: np.ndarray) -> Iterator[tuple[np.ndarray, bool]]:
    """What the filter finds first, held and free, then a fan around the given damping, near ones first, held."""
    physics = laid_over(release.knowledge, start[:2], start[SUSPENSION])
    tracked = damping_start(release.run, physics, release.rest.history, release.rest.release_s)
    if tracked is not None:
        yield np.r_[tracked, start[2:]], True
        yield np.r_[tracked, start[2:]], False
    for shift in _FAN:
        yield start + np.r_[shift, np.zeros(len(start) - 2)], True


def _turned_starts(release: Release, start: np.ndarray) -> list[np.ndarray]:
    """What the filter finds from several angles of the rotor."""
    nominal, out = laid_over(release.knowledge, start[:2], start[SUSPENSION]), []
    zeros = np.zeros(len(release.speed.modes))
    for turn in angles_to_try(nominal):
        history = release.speed.moved(np.r_[zeros, turn])
        tracked = damping_start(release.run, nominal, history, release.rest.release_s)
        out.append(np.r_[start[:2] if tracked is None else tracked, start[2:-1], turn])
    return out


def _starts_around(places: list[np.ndarray], start: np.ndarray) -> Iterator[tuple[np.ndarray, bool]]:
    """Given places held and free, then a fan around the given damping at the first of them, held."""
    yield from ((place, held) for held in (True, False) for place in places)
    for shift in _FAN:
        yield np.r_[start[:2] + shift, places[0][2:]], True


def _model_table(release: Release, minimum: Minimum, end_s: float, shape: Shape | None) -> list[ModelChoice]:
    """The coupled motion beside pendulums on a rotor that does not move: those would stay where they are."""
    cut = release.problem().cut(end_s)
    held = sum(float(np.sum(((c.value - c.value.mean()) * c.weight) ** 2)) for c in cut)
    n, count = sum(len(c.time_s) for c in cut), len(minimum.theta)
    coupled = float(minimum.residual[:n] @ minimum.residual[:n])
    rows = [
        ModelChoice(
            "pendulums on a rotor that does not move", 4, held + 8, False, "a release has no motion of its own"
        ),
    ]
    name = "coupled motion of disk and pendulums"
    why = "the release moves them"
    if shape is not None:
        name += " with dry friction"
        why = "that is the same at any speed" if shape == "torque" else "that goes with the contact force"
    return [*rows, ModelChoice(name, count, coupled + 2 * count, True, why)]

"""Pendulum damping from a release at speed.

A release starts near an unstable equilibrium: what the angles do depends on their start to a degree that grows
exponentially, so the fit proceeds over growing horizons (identification.pendulums.release_search), from what an
unscented Kalman filter makes of the first second and, should that end in a side minimum, from a fan of dampings. Where
the residuals of a horizon are not noise the whole run is left out: a model that fails later may be biased before that
shows. Dry friction enters where a spin-down found it or the readings ask for it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from daq.signals.run import Run
from daq.signals.threads import on_one_thread
from identification.errors import FitFailed, NotIdentifiable
from identification.least_squares import Minimum
from identification.pendulums.answers import covering, plausible_answers
from identification.pendulums.diagnosis import candidates, likely_causes
from identification.pendulums.free_angles import laid_over
from identification.pendulums.friction import Evidence, Friction
from identification.pendulums.release_problem import SUSPENSION, Release, Shape
from identification.pendulums.release_search import Effort, NotFollowed, Search, Tell, holding
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import UNTOLD, TransientFit, with_open_friction
from identification.pendulums.unknown_phase import angles_to_try, race, told
from identification.rungs import held_back
from identification.setting import ModelChoice, Setting, check_setting
from identification.tracking.release_start import damping_start

_SHIFTS = (0.0, np.log(3.0), -np.log(3.0), np.log(10.0), -np.log(10.0))
_FAN = sorted(product(_SHIFTS, _SHIFTS), key=lambda s: (abs(s[0]) + abs(s[1]), s))  # of ln c3, ln c4, near ones first
_SHARES = (0.01, 0.03, 0.1, 0.3, 0.8)  # of the largest viscous torque: friction to start from
_EARLY = 25  # iterations over a horizon with friction
_RACED = 2  # horizons over which starts with friction race
_SURELY = 2.0  # standard deviations
_AS_GOOD, _NEGATIVE = 0.9, 0.2  # of what friction mends; of the larger torque
_HARDLY_RAD = 0.02  # less is no motion to tell damping from
_HELD = "a lock did not open, or dry friction holds the pendulum: look at the locks and clean the bearings"


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
    run: Run,
    knowledge: Knowledge,
    zero_std_rad: float,
    *,
    setting: Setting = "balanced",
    tell: Tell | None = None,
    effort: Effort | None = None,
    without: Collection[str] = (),
) -> TransientFit:
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
        without: rungs of the ladder that are not taken (identification.rungs.RUNGS).
    Raises:
        ValueError: no such rung.
        NotIdentifiable: no releases, or too few marks or samples.
        ReleaseLeftOut: the model does not follow the angles over any horizon, or the fit does not settle.
        FitFailed: the release shows no damping.
    Source: docs/theory/pendulum_damping.md.
    """
    check_setting(setting)
    release = Release.of(run, knowledge, zero_std_rad, setting)
    if max(release.moved_rad) < _HARDLY_RAD:
        a, b = np.degrees(release.moved_rad)
        raise NotIdentifiable(f"{run.source}: after the release A moves by {a:.2g}° and B by {b:.2g}°; {_HELD}")
    horizons, effort, tell = release.horizons(setting), effort or Effort(), tell or (lambda _: None)
    end = horizons[-1]
    rubs = "friction" not in held_back(without)
    release, answers, shape, other = _searched(release, horizons, effort, tell, rubs)
    problem, best = release.problem(shape), answers[0]
    fit = problem.result(best, end, f"release {run.test}", 2, setting, _model_table(release, best, end, shape))
    if max(fit.std[n] / fit.values[n] for n in fit.values) > 0.2:
        raise FitFailed(f"{run.source}: {_not_shown(release, fit, shape)}")
    fit = replace(fit, warnings=[*fit.warnings, *other])
    if shape is not None:
        friction = release.friction(best, problem.covariance(best, end, setting, (16, 17)), shape)
        fit = replace(fit, friction=friction, warnings=[*fit.warnings, friction.told(f"release {run.test}")])
    if rubs:
        found = release.open_friction(shape, best, end, setting)
        if found is None:
            raise FitFailed(UNTOLD.format(run.source, "release", "record one at another speed, or clean the bearings"))
        fit = with_open_friction(fit, found, f"release {run.test}")
    by_number = release.by_number(problem, best, end, shape, (0, 1))
    fit = replace(fit, by_number=by_number, number_std=release.number_std)
    if not run.phase_absolute:
        return told(fit, answers, knowledge.physics)
    return covering(fit, answers, "from another start", "Another release decides")


def _not_shown(release: Release, fit: TransientFit, shape: Shape | None) -> str:
    """Why a release that is followed does not show the damping, and what to do."""
    over = f"{fit.horizon_s:.2g} s of the release do not show the damping"
    moved = [f"{name} by {np.degrees(m):.2g}°" for name, m in zip("AB", release.moved_rad, strict=True)]
    if min(release.moved_rad) < _HARDLY_RAD:
        return f"{over}: the pendulums moved {' and '.join(moved)} only; {_HELD}"
    if shape is not None:
        return (
            f"{over}: dry friction rules the motion (the pendulums moved {' and '.join(moved)}) and hides the viscous "
            "damping; clean or replace the bearings, or release at another speed"
        )
    return f"{over}; record a longer one"


def _searched(
    release: Release, horizons: list[float], effort: Effort, tell: Tell, rubs: bool
) -> tuple[Release, list[Minimum], Shape | None, list[str]]:
    """The release as it was followed, the answers, the shape of the dry friction in them, and warnings.

    Args:
        rubs: whether there may be dry friction.
    Raises:
        ReleaseLeftOut: there are none.
    """
    known = release.knowledge.friction if rubs else None
    if known is not None:
        with_known = _with_known_friction(release, horizons, known, effort, tell)
        if with_known is not None:
            followed, answers, shape = with_known
            return followed, answers, shape, []
        torque = known.sure_torque_at(release.speed_rad_s)
        if torque.min() > 0:
            a, b = np.degrees(release.moved_rad)
            raise FitFailed(
                f"{release.run.source}: no damping is found beside the dry friction that other tests show (at this "
                f"speed {torque[0]:.2g} and {torque[1]:.2g} N m; A moved by {a:.2g}°, B by {b:.2g}°): it hides the "
                "viscous damping. Clean or replace the bearings, or release at another speed"
            )
    try:
        release, answers = _followed(release, horizons, effort, tell)
    except _Stuck as error:
        rescued = _rescued(error.release, horizons, error.search, effort, tell) if rubs else None
        if rescued is None:
            raise _left_out(error.release, error.search) from error.search
        return error.release, *rescued, []
    if not rubs:
        return release, answers, None, []
    ask = release.friction_evidence(answers[0], horizons[-1])
    dry, other = _dry_or_else(release, answers[0], horizons[-1], ask)
    if dry and known is None:
        starts = [(release.with_torque(answers[0].theta, np.maximum(ask.step, 0.0)), False)]
        found = _with_friction(release, horizons[-1:], starts, effort, tell)
        if found is not None:
            return release, *found, []
    return release, answers, None, other


class _Stuck(Exception):
    """Viscous damping does not follow a release; with what was tried last."""

    def __init__(self, release: Release, search: NotFollowed) -> None:
        super().__init__(str(search))
        self.release, self.search = release, search


def _followed(release: Release, horizons: list[float], effort: Effort, tell: Tell) -> tuple[Release, list[Minimum]]:
    """The answers without dry friction, the pendulums' masses and lengths open where they are uncertain.

    The search goes with the numbers as they stand, which costs a fifth, and opens them where it ends: at the whole
    release, or where the residuals first were more than noise.

    Raises:
        _Stuck: there are none.
    """
    wide = release.opened
    none = np.zeros(len(wide.number_std))
    try:
        answers = _viscous(release, horizons, effort, tell)
    except NotFollowed as stuck:
        if not wide.number_std or stuck.doubtful is None:
            raise _Stuck(release, stuck) from stuck
        tell("with the pendulums' masses and lengths open")
        minimum, end = stuck.doubtful
        search = Search(wide.problem(), [h for h in horizons if h >= end], 1, effort, tell)
        try:
            return wide, search.answers([(np.r_[minimum.theta, none], False)], release.run.source)
        except NotFollowed as still:
            raise _Stuck(wide, still) from still
    return _with_numbers(release, answers, None, horizons[-1])


def _with_numbers(
    release: Release, answers: list[Minimum], shape: Shape | None, end_s: float
) -> tuple[Release, list[Minimum]]:
    """Answers with the pendulums' masses and lengths open, from where they are; as they are where that fails."""
    wide = release.opened
    if not wide.number_std:
        return release, answers
    problem, none = wide.problem(shape), np.zeros(len(wide.number_std))
    opened = [problem.solve(np.r_[answer.theta, none], end_s, _EARLY) for answer in answers]
    settled = [minimum for minimum in opened if minimum.converged]
    return (wide, plausible_answers(settled)) if settled else (release, answers)


def _with_known_friction(
    release: Release, horizons: list[float], known: Friction, effort: Effort, tell: Tell
) -> tuple[Release, list[Minimum], Shape] | None:
    """The answer from the friction that other tests show; None where none settles."""
    found = _with_friction(release, horizons, _frictional_starts(release, known, horizons), effort, tell)
    if found is not None:
        return *_with_numbers(release, found[0], found[1], horizons[-1]), found[1]
    wide = release.opened
    if not wide.number_std:
        return None
    found = _with_friction(wide, horizons, _frictional_starts(wide, known, horizons), effort, tell)
    return None if found is None else (wide, *found)


def _frictional_starts(release: Release, known: Friction, horizons: list[float]) -> list[tuple[np.ndarray, bool]]:
    """From the damping and the friction that another test found, as far as it surely did."""
    start = release.problem().prior.copy()
    torque = known.sure_torque_at(release.speed_rad_s)
    if release.run.phase_absolute:
        return [(release.with_torque(start, t), True) for t in (torque, *_torques(release, torque))]
    turns = [
        np.r_[start[:-1], turn] for turn in angles_to_try(laid_over(release.knowledge, start[:2], start[SUSPENSION]))
    ]
    trials = [release.with_torque(theta, torque) for theta in turns]
    return [(place, True) for place in race(release.problem("torque"), trials, horizons[:-1], holding)]


def _torques(release: Release, sure_Nm: np.ndarray) -> list[np.ndarray]:
    """Friction torques to start from: shares of what damping makes at the fastest, but what is surely known."""
    damping = release.knowledge.physics
    slip = np.array([_fastest(r.averages.time_s, r.averages.value) for r in release.readings])
    viscous = slip * np.array([damping.a.damping_Nms_per_rad, damping.b.damping_Nms_per_rad])
    likely = np.full(2, sure_Nm.max()) if sure_Nm.max() > 0 else None  # both pendulums are made alike
    tried = [np.where(sure_Nm > 0, sure_Nm, share * viscous) for share in _SHARES]
    return tried if likely is None else [np.where(sure_Nm > 0, sure_Nm, likely), *tried]


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
    """The answer with dry friction of the shape that explains the readings better; None where neither settles.

    The first shape that is followed is searched for, the other one starts from where that ended. What the readings
    leave open between them is in the fit's open friction. A friction surely below zero is none.
    """
    tell("with dry friction")
    found: dict[Shape, Minimum] = {}
    shapes: tuple[Shape, Shape] = ("contact", "torque")
    for shape in shapes:
        over = horizons[-1:] if found else horizons
        likely = [(m.theta, False) for m in found.values()] or starts[:1]
        minimum = _settled(Search(release.problem(shape), over, 1, effort, tell, _EARLY), likely, release)
        if minimum is None and shape == shapes[0] and len(starts) > 1:
            own = _ahead(release, horizons, starts[1:], shape)
            minimum = _settled(Search(release.problem(shape), over, 1, effort, tell, _EARLY), own, release)
        if minimum is not None:
            found[shape] = minimum
    if not found:
        return None
    shape, best = min(found.items(), key=lambda f: f[1].cost)
    return [best], shape


def _settled(search: Search, starts: list[tuple[np.ndarray, bool]], release: Release) -> Minimum | None:
    try:
        found = search.answers(starts, release.run.source)
    except NotFollowed:
        return None
    least = [m for m in found if np.all(m.theta[16:18] > -_SURELY * np.sqrt(np.diag(m.covariance))[16:18])]
    return least[0] if least else None


def _ahead(
    release: Release, horizons: list[float], starts: list[tuple[np.ndarray, bool]], shape: Shape
) -> list[tuple[np.ndarray, bool]]:
    """The starts that lead over the first horizons."""
    if len(starts) < 3 or len(horizons) <= _RACED:
        return starts
    try:
        places = race(release.problem(shape), [theta for theta, _ in starts], horizons[:_RACED], holding)
    except FitFailed:
        return starts
    return [(place, held) for place in places[:3] for held in (True, False)]


def _rescued(
    release: Release, horizons: list[float], stuck: NotFollowed, effort: Effort, tell: Tell
) -> tuple[list[Minimum], Shape] | None:
    """What dry friction makes of a release that viscous damping alone does not explain."""
    if stuck.doubtful is None or release.knowledge.friction is not None:
        return None
    minimum, end = stuck.doubtful
    if likely_causes(release, minimum, end):
        return None
    ask = release.friction_evidence(minimum, end)
    if not ask.found:
        return None
    starts = [(release.with_torque(minimum.theta, np.maximum(ask.step, 0.0)), False)]
    if release.run.phase_absolute:
        start = release.problem().prior.copy()
        starts += [(release.with_torque(start, t), True) for t in _torques(release, np.zeros(2))]
    return _with_friction(release, horizons, starts, effort, tell)


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

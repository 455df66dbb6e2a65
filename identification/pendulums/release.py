"""Pendulum damping from a release at speed.

A release starts near an unstable equilibrium, so the influence of the start on the angles grows exponentially. The fit
therefore proceeds over growing horizons (identification.pendulums.release_search). It starts from the result of an
unscented Kalman filter over the first seconds, and from a fan of dampings if that ends in a side minimum. If the
residuals of a horizon exceed noise, the whole run is left out, because a model that fails later may be biased already
before. Dry friction is included if a spin-down found it or the readings require it.
"""

from __future__ import annotations

import logging
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
from identification.pendulums.opening_search import is_strained, opening_start
from identification.pendulums.release_problem import SUSPENSION, TORQUES, RecordedRelease, Shape
from identification.pendulums.release_search import Effort, NotFollowed, Notify, Search, holding
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import NOT_SEPARATED, TransientFit, with_open_friction
from identification.pendulums.unknown_phase import angles_to_try, screened_starts, with_phase_warning
from identification.rungs import held_back
from identification.setting import ModelChoice, Setting, check_setting
from identification.tracking.release_start import damping_start
from identification.work import bounded_work

_log = logging.getLogger(__name__)

_SHIFTS = (0.0, np.log(3.0), -np.log(3.0), np.log(10.0), -np.log(10.0))
_FAN = sorted(product(_SHIFTS, _SHIFTS), key=lambda s: (abs(s[0]) + abs(s[1]), s))  # ln c3, ln c4; near ones first
_SHARES = (0.01, 0.03, 0.1, 0.3, 0.8)  # start values of friction over the largest viscous torque
_EARLY = 25  # iterations over a horizon with friction
_SCREENED_HORIZONS = 2  # number of horizons for the screening of starts with friction
_MAX_NEGATIVE_STD = 2.0  # standard deviations below 0 up to which a friction torque is accepted
_COMPARABLE_SHARE = 0.9  # share of friction's reduction of χ² above which a wrong number is the explanation
_MAX_NEGATIVE_SHARE = 0.2  # largest negative torque over the larger positive one
_MIN_MOVED_RAD = 0.02  # smallest motion that determines damping
_HELD = "a lock did not open, or dry friction holds the pendulum: look at the locks and clean the bearings"


class ReleaseLeftOut(FitFailed):
    """No fit follows the release.

    Attributes:
        causes: numbers of the rig file that would explain it, the most likely first; empty without any.
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
    notify: Notify | None = None,
    effort: Effort | None = None,
    without: Collection[str] = (),
) -> TransientFit:
    """Estimate the damping of both pendulums from the transient after a release at constant speed.

    Args:
        run: "point-NAME" run with both releases and the locked stretch before them.
        knowledge: masses, lengths, and prior knowledge of suspension, imbalance and dry friction. Its damping is the
            start value.
        zero_std_rad: standard uncertainty of each encoder's zero, rad.
        setting: fast uses the first part of the transient and assumes white rounding noise. balanced uses the whole
            transient and the actual effect of rounding. reference uses 1 ms blocks instead of 4 ms blocks.
        notify: called with one line of text before each attempt.
        effort: common budget of the releases of a campaign.
        without: rungs of the ladder that are left out (identification.rungs.RUNGS).
    Raises:
        ValueError: a rung is unknown.
        NotIdentifiable: there are no releases, or too few marks or samples.
        ReleaseLeftOut: the model does not follow the angles over any horizon, or the fit does not converge.
        FitFailed: the release does not show the damping.
        OutOfWork: the bound of the work (identification.work) was reached before an answer.
    Source: docs/theory/pendulum_damping.md.
    """
    check_setting(setting)
    with bounded_work(f"{run.source}: release"):
        return _fitted(run, knowledge, zero_std_rad, setting, notify or _ignore, effort or Effort(), without)


def _fitted(
    run: Run,
    knowledge: Knowledge,
    zero_std_rad: float,
    setting: Setting,
    notify: Notify,
    effort: Effort,
    without: Collection[str],
) -> TransientFit:
    """Fit a release; arguments and errors as for `fit_release`."""
    release = RecordedRelease.of(run, knowledge, zero_std_rad, setting)
    if min(release.moved_rad) < _MIN_MOVED_RAD:
        a, b = np.degrees(release.moved_rad)
        raise NotIdentifiable(f"{run.source}: after the release A moves by {a:.2g}° and B by {b:.2g}°; {_HELD}")
    horizons = release.horizons(setting)
    with_friction = "friction" not in held_back(without)
    try:
        release, answers, shape, other = _searched(release, horizons, effort, notify, with_friction)
    except ReleaseLeftOut:
        release = release.with_late_locks(setting)
        answers, shape, other = _from_other_instants(release, setting, effort), None, []
        if not answers:
            raise
    else:
        if shape is None and not release.number_std and is_strained(release.problem(), answers[0]):
            answers = plausible_answers([*answers, *_from_other_instants(release, setting, effort)])
    end = release.horizons(setting)[-1]
    problem, best = release.problem(shape), answers[0]
    fit = problem.result(best, end, f"release {run.test}", 2, setting, _model_table(release, best, end, shape))
    if max(fit.std[n] / fit.values[n] for n in fit.values) > 0.2:
        raise FitFailed(f"{run.source}: {_not_shown(release, fit, shape)}")
    openings = release.openings(best)
    named = [f"release {run.test}: {each.sentence}" for each in openings if each.unusual]
    fit = replace(fit, warnings=[*fit.warnings, *other, *named], openings=openings)
    if shape is not None:
        friction = release.friction(best, problem.covariance(best, end, setting, TORQUES), shape)
        fit = replace(fit, friction=friction, warnings=[*fit.warnings, friction.sentence(f"release {run.test}")])
    if with_friction:
        found = release.open_friction(shape, best, end, setting)
        if found is None:
            advice = "record one at another speed, or clean the bearings"
            raise FitFailed(NOT_SEPARATED.format(run.source, "release", advice))
        fit = with_open_friction(fit, found, f"release {run.test}")
    by_number = release.by_number(problem, best, end, shape, (0, 1))
    fit = replace(fit, by_number=by_number, number_std=release.number_std)
    if not run.phase_absolute:
        return with_phase_warning(fit, answers, knowledge.physics)
    return covering(fit, answers, "from another start", "Another release decides")


def _from_other_instants(release: RecordedRelease, setting: Setting, effort: Effort) -> list[Minimum]:
    """Return the minima without dry friction from other instants at which the locks may have opened; none if none fits.

    A rotor whose angle is not known is left out: its angle and the instants have the same effect.
    """
    if not release.run.phase_absolute:
        return []
    problem, horizons = release.problem(), release.horizons(setting)
    try:
        start = opening_start(release, problem, problem.prior.copy(), horizons[0])
        return Search(problem, horizons, 1, effort, _ignore).answers([(start, False)], release.run.source)
    except FitFailed as error:
        _log.debug("%s: other instants of the locks do not explain it: %s", release.run.source, error)
        return []


def _ignore(_: str) -> None:
    """Drop a message."""


def _not_shown(release: RecordedRelease, fit: TransientFit, shape: Shape | None) -> str:
    """Return the reason why a release that is followed does not show the damping, with advice."""
    over = f"{fit.horizon_s:.2g} s of the release do not show the damping"
    moved = [f"{name} by {np.degrees(m):.2g}°" for name, m in zip("AB", release.moved_rad, strict=True)]
    if min(release.moved_rad) < _MIN_MOVED_RAD:
        return f"{over}: the pendulums moved {' and '.join(moved)} only; {_HELD}"
    if shape is not None:
        return (
            f"{over}: dry friction dominates the motion (the pendulums moved {' and '.join(moved)}) and hides the "
            "viscous damping; clean or replace the bearings, or release at another speed"
        )
    return f"{over}; record a longer one"


def _searched(
    release: RecordedRelease, horizons: list[float], effort: Effort, notify: Notify, with_friction: bool
) -> tuple[RecordedRelease, list[Minimum], Shape | None, list[str]]:
    """Return the fitted release, its minima, the shape of their dry friction, and warnings.

    Args:
        release: release to fit.
        horizons: last instants of the growing stretches, s.
        effort: budget of the search.
        notify: called with one line of text before each attempt.
        with_friction: whether dry friction is allowed.
    Raises:
        ReleaseLeftOut: no minimum follows the angles.
    """
    known = release.knowledge.friction if with_friction else None
    if known is not None:
        with_known = _with_known_friction(release, horizons, known, effort, notify)
        if with_known is not None:
            followed, answers, shape = with_known
            return followed, answers, shape, []
        torque = known.sure_torque_at(release.speed_rad_s)
        if torque.min() > 0:
            a, b = np.degrees(release.moved_rad)
            raise FitFailed(
                f"{release.run.source}: the dry friction that other tests show (at this speed {torque[0]:.2g} and "
                f"{torque[1]:.2g} N m; A moved by {a:.2g}°, B by {b:.2g}°) hides the viscous damping. Clean or replace "
                "the bearings, or release at another speed"
            )
    try:
        release, answers = _followed(release, horizons, effort, notify)
    except _ViscousFailed as error:
        rescued = _rescued(error.release, horizons, error.search, effort, notify) if with_friction else None
        if rescued is None:
            raise _left_out(error.release, error.search) from error.search
        return error.release, *rescued, []
    if not with_friction:
        return release, answers, None, []
    evidence = release.friction_evidence(answers[0], horizons[-1])
    dry, other = _friction_or_number(release, answers[0], horizons[-1], evidence)
    if dry and known is None:
        starts = [(release.with_torque(answers[0].theta, np.maximum(evidence.step, 0.0)), False)]
        found = _with_friction(release, horizons[-1:], starts, effort, notify)
        if found is not None:
            return release, *found, []
    return release, answers, None, other


class _ViscousFailed(Exception):
    """Viscous damping alone does not follow a release.

    Attributes:
        release: release as it was fitted last.
        search: last search.
    """

    def __init__(self, release: RecordedRelease, search: NotFollowed) -> None:
        super().__init__(str(search))
        self.release, self.search = release, search


def _followed(
    release: RecordedRelease, horizons: list[float], effort: Effort, notify: Notify
) -> tuple[RecordedRelease, list[Minimum]]:
    """Return the minima without dry friction, with free masses and lengths of the pendulums if these are uncertain.

    The search uses fixed numbers, which costs a fifth. At its end the numbers are free: over the whole release, or from
    the first horizon with residuals above noise.

    Raises:
        _ViscousFailed: no minimum follows the angles.
    """
    wide = release.opened
    none = np.zeros(len(wide.number_std))
    try:
        answers = _viscous(release, horizons, effort, notify)
    except NotFollowed as stuck:
        if not wide.number_std or stuck.doubtful is None:
            raise _ViscousFailed(release, stuck) from stuck
        notify("with free masses and lengths of the pendulums")
        minimum, end = stuck.doubtful
        search = Search(wide.problem(), [h for h in horizons if h >= end], 1, effort, notify)
        try:
            return wide, search.answers([(np.r_[minimum.theta, none], False)], release.run.source)
        except NotFollowed as still:
            raise _ViscousFailed(wide, still) from still
    return _with_numbers(release, answers, None, horizons[-1])


def _with_numbers(
    release: RecordedRelease, answers: list[Minimum], shape: Shape | None, end_s: float
) -> tuple[RecordedRelease, list[Minimum]]:
    """Return minima with free masses and lengths of the pendulums, starting at given ones, or these if that fails."""
    wide = release.opened
    if not wide.number_std:
        return release, answers
    problem, none = wide.problem(shape), np.zeros(len(wide.number_std))
    opened = [problem.solve(np.r_[answer.theta, none], end_s, _EARLY) for answer in answers]
    settled = [minimum for minimum in opened if minimum.converged]
    return (wide, plausible_answers(settled)) if settled else (release, answers)


def _with_known_friction(
    release: RecordedRelease, horizons: list[float], known: Friction, effort: Effort, notify: Notify
) -> tuple[RecordedRelease, list[Minimum], Shape] | None:
    """Return the minimum with a start from the friction that other tests show; None if no fit converges."""
    found = _with_friction(release, horizons, _frictional_starts(release, known, horizons), effort, notify)
    if found is not None:
        return *_with_numbers(release, found[0], found[1], horizons[-1]), found[1]
    wide = release.opened
    if not wide.number_std:
        return None
    found = _with_friction(wide, horizons, _frictional_starts(wide, known, horizons), effort, notify)
    return None if found is None else (wide, *found)


def _frictional_starts(
    release: RecordedRelease, known: Friction, horizons: list[float]
) -> list[tuple[np.ndarray, bool]]:
    """Return start values with the damping and the significant friction of another test."""
    start = release.problem().prior.copy()
    torque = known.sure_torque_at(release.speed_rad_s)
    if release.run.phase_absolute:
        return [(release.with_torque(start, t), True) for t in (torque, *_torques(release, torque))]
    turns = [
        np.r_[start[:-1], turn] for turn in angles_to_try(laid_over(release.knowledge, start[:2], start[SUSPENSION]))
    ]
    trials = [release.with_torque(theta, torque) for theta in turns]
    return [(place, True) for place in screened_starts(release.problem("torque"), trials, horizons[:-1], holding)]


def _torques(release: RecordedRelease, sure_Nm: np.ndarray) -> list[np.ndarray]:
    """Return start values of friction torques: significant known ones, else shares of the largest viscous torque."""
    damping = release.knowledge.physics
    slip = np.array([_fastest(r.averages.time_s, r.averages.value) for r in release.readings])
    viscous = slip * np.array([damping.a.damping_Nms_per_rad, damping.b.damping_Nms_per_rad])
    likely = np.full(2, sure_Nm.max()) if sure_Nm.max() > 0 else None  # both pendulums have the same design
    tried = [np.where(sure_Nm > 0, sure_Nm, share * viscous) for share in _SHARES]
    return tried if likely is None else [np.where(sure_Nm > 0, sure_Nm, likely), *tried]


def _viscous(release: RecordedRelease, horizons: list[float], effort: Effort, notify: Notify) -> list[Minimum]:
    """Return the minima without dry friction and with fixed numbers."""
    problem = release.problem()
    start = problem.prior.copy()
    if release.run.phase_absolute:
        starts, fewest = _starts(release, start), 1
    else:
        places = screened_starts(problem, _turned_starts(release, start), horizons[:-1], holding)
        starts, fewest = _starts_around(places, start), len(places)
    return Search(problem, horizons, fewest, effort, notify).answers(starts, release.run.source)


def _with_friction(
    release: RecordedRelease,
    horizons: list[float],
    starts: list[tuple[np.ndarray, bool]],
    effort: Effort,
    notify: Notify,
) -> tuple[list[Minimum], Shape] | None:
    """Return the minimum with dry friction of the shape that explains the readings better; None if neither converges.

    The first shape is searched for. The other one starts from its minimum. The remaining uncertainty between both is in
    the fit's free friction. Significantly negative friction is not accepted.
    """
    notify("with dry friction")
    found: dict[Shape, Minimum] = {}
    shapes: tuple[Shape, Shape] = ("contact", "torque")
    for shape in shapes:
        over = horizons[-1:] if found else horizons
        likely = [(m.theta, False) for m in found.values()] or starts[:1]
        minimum = _settled(Search(release.problem(shape), over, 1, effort, notify, _EARLY), likely, release)
        if minimum is None and shape == shapes[0] and len(starts) > 1:
            own = _ahead(release, horizons, starts[1:], shape)
            minimum = _settled(Search(release.problem(shape), over, 1, effort, notify, _EARLY), own, release)
        if minimum is not None:
            found[shape] = minimum
    if not found:
        return None
    shape, best = min(found.items(), key=lambda f: f[1].cost)
    return [best], shape


def _settled(search: Search, starts: list[tuple[np.ndarray, bool]], release: RecordedRelease) -> Minimum | None:
    try:
        found = search.answers(starts, release.run.source)
    except NotFollowed as error:
        _log.debug("%s: fit with dry friction does not follow the angles: %s", release.run.source, error)
        return None
    at = list(TORQUES)
    least = [m for m in found if np.all(m.theta[at] > -_MAX_NEGATIVE_STD * np.sqrt(np.diag(m.covariance)[at]))]
    return least[0] if least else None


def _ahead(
    release: RecordedRelease, horizons: list[float], starts: list[tuple[np.ndarray, bool]], shape: Shape
) -> list[tuple[np.ndarray, bool]]:
    """Return the best start values after a screening over the first horizons."""
    if len(starts) < 3 or len(horizons) <= _SCREENED_HORIZONS:
        return starts
    try:
        places = screened_starts(
            release.problem(shape), [theta for theta, _ in starts], horizons[:_SCREENED_HORIZONS], holding
        )
    except FitFailed as error:
        _log.debug("%s: starts are not screened, all are used: %s", release.run.source, error)
        return starts
    return [(place, held) for place in places[:3] for held in (True, False)]


def _rescued(
    release: RecordedRelease, horizons: list[float], stuck: NotFollowed, effort: Effort, notify: Notify
) -> tuple[list[Minimum], Shape] | None:
    """Return a fit with dry friction of a release that viscous damping does not explain; None if that also fails."""
    if stuck.doubtful is None or release.knowledge.friction is not None:
        return None
    minimum, end = stuck.doubtful
    if likely_causes(release, minimum, end):
        return None
    evidence = release.friction_evidence(minimum, end)
    if not evidence.found:
        return None
    starts = [(release.with_torque(minimum.theta, np.maximum(evidence.step, 0.0)), False)]
    if release.run.phase_absolute:
        start = release.problem().prior.copy()
        starts += [(release.with_torque(start, t), True) for t in _torques(release, np.zeros(2))]
    return _with_friction(release, horizons, starts, effort, notify)


def _fastest(time_s: np.ndarray, angle_rad: np.ndarray) -> float:
    """Return the 95 % quantile of a pendulum's speed relative to the rotor, rad/s."""
    return float(np.quantile(np.abs(np.gradient(angle_rad, time_s)), 0.95))


def _friction_or_number(
    release: RecordedRelease, minimum: Minimum, end_s: float, evidence: Evidence
) -> tuple[bool, list[str]]:
    """Return whether dry friction explains the residuals of viscous damping best, and a warning if it does not."""
    if (
        not evidence.found
        or evidence.step.max() <= 0
        or evidence.step.min() < -_MAX_NEGATIVE_SHARE * evidence.step.max()
    ):
        return False, []
    causes = candidates(release, minimum, end_s)
    if not causes or causes[0].mended < _COMPARABLE_SHARE * evidence.mended:
        return True, []
    text = f"release {release.run.test}: the residuals exceed noise; {causes[0].text} would explain them. Measure it"
    return False, [text]


def _left_out(release: RecordedRelease, stuck: NotFollowed) -> ReleaseLeftOut:
    causes = likely_causes(release, *stuck.doubtful) if stuck.doubtful is not None else []
    return ReleaseLeftOut(str(stuck), causes)


def _starts(release: RecordedRelease, start: np.ndarray) -> Iterator[tuple[np.ndarray, bool]]:
    """Yield the filter's start values, held and free, then a held fan around the given damping, near ones first."""
    physics = laid_over(release.knowledge, start[:2], start[SUSPENSION])
    tracked = damping_start(release.run, physics, release.rest.history, release.rest.release_s)
    if tracked is not None:
        yield np.r_[tracked, start[2:]], True
        yield np.r_[tracked, start[2:]], False
    for shift in _FAN:
        yield start + np.r_[shift, np.zeros(len(start) - 2)], True


def _turned_starts(release: RecordedRelease, start: np.ndarray) -> list[np.ndarray]:
    """Return start values of the filter for several angles of the rotor."""
    nominal, out = laid_over(release.knowledge, start[:2], start[SUSPENSION]), list[np.ndarray]()
    zeros = np.zeros(len(release.speed.modes))
    for turn in angles_to_try(nominal):
        history = release.speed.moved(np.r_[zeros, turn])
        tracked = damping_start(release.run, nominal, history, release.rest.release_s)
        out.append(np.r_[start[:2] if tracked is None else tracked, start[2:-1], turn])
    return out


def _starts_around(places: list[np.ndarray], start: np.ndarray) -> Iterator[tuple[np.ndarray, bool]]:
    """Yield given start values held and free, then a held fan around the given damping at the first of them."""
    yield from ((place, held) for held in (True, False) for place in places)
    for shift in _FAN:
        yield np.r_[start[:2] + shift, places[0][2:]], True


def _model_table(release: RecordedRelease, minimum: Minimum, end_s: float, shape: Shape | None) -> list[ModelChoice]:
    """Return the model table: coupled motion against pendulums on a fixed rotor, which would not move."""
    cut = release.problem().cut(end_s)
    held = sum(float(np.sum(((c.value - c.value.mean()) * c.weight) ** 2)) for c in cut)
    n, count = sum(len(c.time_s) for c in cut), len(minimum.theta)
    coupled = float(minimum.residual[:n] @ minimum.residual[:n])
    rows = [
        ModelChoice(
            "pendulums on a fixed rotor", 4, held + 8, False, "pendulums on a fixed rotor stay at rest after a release"
        ),
    ]
    name = "coupled motion of disk and pendulums"
    why = "the moving disk drives the pendulums"
    if shape is not None:
        name += " with dry friction"
        why = "the friction is independent of the speed"
        if shape != "torque":
            why = "the friction is proportional to the contact force"
    return [*rows, ModelChoice(name, count, coupled + 2 * count, True, why)]

"""Spin-down of both pendulums together, with the reaction of the disk.

θ = (ln c3, ln c4, θ3, θ4, θ̇3, θ̇4, ψ, x, y, ẋ, ẏ, ln k1, ln k2, ln ζ1, ln ζ2) at the start of the stretch. The angle ψ
of the resting rotor is not measured, but it has an effect because the suspension differs between x and y. A rotation of
the whole rig by half a revolution does not change the encoders' readings, so ψ is searched over half a revolution from
several starts.

Dry friction (M_A, M_B) and a drag with the square of the speed (F_A, F_B) are added to θ if the readings require them.
One evaluation at the end of the fit without them gives the reduction of χ² (score test).
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from daq.signals.run import Run
from daq.signals.threads import on_one_thread
from identification.clocks import clock_errors
from identification.errors import FitFailed, NotIdentifiable
from identification.estimate import Estimate
from identification.least_squares import Minimum
from identification.pendulums.answers import covering, plausible_answers
from identification.pendulums.friction import Evidence, Friction
from identification.pendulums.known_numbers import knowing, zeros_std
from identification.pendulums.off_axis import errors_of
from identification.pendulums.open_friction import pooled
from identification.pendulums.push import TIME_CONSTANTS, Decline, find_decline, spin_down_readings
from identification.pendulums.spin_down_problem import COUNT, PSI, Kind, Kinds, SpinDown
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import (
    NOT_SEPARATED,
    EncoderReadings,
    TransientFit,
    TransientProblem,
    with_open_friction,
)
from identification.rungs import Rung, held_back
from identification.setting import ModelChoice, Setting, check_setting
from identification.work import bounded_work, tried
from rig_basics.texts import number_of

_log = logging.getLogger(__name__)

_PSI, _COUNT = PSI, COUNT
_ANGLES_TRIED = tuple((np.arange(6) * np.pi / 6).tolist())
_KINDS: dict[Kind, str] = {"torque": "dry friction", "contact": "a drag with the square of the speed"}
_OFF_AXIS = "encoders off their axes"
_RUNG: dict[Kind, Rung] = {"torque": "friction", "contact": "drag"}
_ATTEMPTS = 8
_MAX_CHI2 = 10.0  # χ²/dof above which a fit is rejected
_POOR_CHI2 = 50.0  # χ²/dof above which a later attempt uses a single angle of the rotor
_MIN_GAIN = 4.0  # smallest reduction of χ² plus two per unknown by another term: odds of 7 to 1
_MOST_STEPS = 80  # iterations; χ² has a long valley along the angle of the rotor
_BEFORE_PUSH_S = 0.03
_MIN_STRETCH_S = 0.08
_EARLY_S = 0.1


@on_one_thread
def fit_spin_down_run(
    run: Run, knowledge: Knowledge, *, setting: Setting = "balanced", without: Collection[str] = ()
) -> TransientFit:
    """Estimate the damping of both pendulums from one spin-down.

    Args:
        run: "spin-down" run: rotor at rest, both pendulums flicked.
        knowledge: masses, lengths and prior knowledge of the suspension.
        setting: fast assumes white rounding noise of the encoders. balanced and reference use its actual effect,
            reference with more draws.
        without: rungs of the ladder that are left out (identification.rungs.RUNGS).
    Raises:
        ValueError: a rung is unknown.
        NotIdentifiable: a pendulum hardly moves.
        FitFailed: the model does not follow the angles.
        OutOfWork: the bound of the work (identification.work) was reached before an answer.
    Source: docs/theory/pendulum_damping.md.
    """
    check_setting(setting)
    with bounded_work(f"{run.source}: spin-down"):
        return _fitted(run, knowledge, setting, held_back(without))


def _fitted(run: Run, knowledge: Knowledge, setting: Setting, held: frozenset[Rung]) -> TransientFit:
    """Fit a spin-down; arguments and errors as for `fit_spin_down_run`."""
    if run.angle_rad.ndim != 2 or len(run.angle_time_s) < 400:
        raise NotIdentifiable(
            f"{run.source}: {number_of(len(run.angle_time_s), 'encoder sample is', 'encoder samples are')} "
            f"too few, 400 are needed"
        )
    declines = [find_decline(run.angle_time_s, run.angle_rad[:, i]) for i in range(2)]
    fastest = max(d.rate_per_s for d in declines)
    whole = [spin_down_readings(run.angle_time_s, run.angle_rad[:, i], fastest) for i in range(2)]
    last = max(d.start_s for d in declines)
    fits = [_fit_from(run, whole, declines, (last, np.inf), knowledge, setting, held)]
    first = int(np.argmin([d.start_s for d in declines]))
    push = declines[1 - first].push_s - _BEFORE_PUSH_S
    if push - declines[first].start_s > _MIN_STRETCH_S:  # one pendulum runs down before the other is flicked
        try:
            fits.append(_fit_from(run, whole, declines, (declines[first].start_s, push), knowledge, setting, held))
        except (FitFailed, NotIdentifiable) as error:  # for example, a hand touches the second pendulum
            _log.info("%s: only the stretch after the second flick is used: %s", run.source, error)
    return _together(fits)


def _fit_from(
    run: Run,
    whole: list[EncoderReadings],
    declines: list[Decline],
    span: tuple[float, float],
    knowledge: Knowledge,
    setting: Setting,
    held: frozenset[Rung],
) -> TransientFit:
    """Fit one stretch, whose begin is moved later while the residual right after it exceeds the later residual."""
    begin, limit = span
    slowest, fastest = min(d.rate_per_s for d in declines), max(d.rate_per_s for d in declines)
    angles: tuple[float, ...] = _ANGLES_TRIED
    for attempts_left in range(_ATTEMPTS, -1, -1):
        end = min(*(float(w.averages.time_s[-1]) for w in whole), begin + TIME_CONSTANTS / slowest, limit)
        tried(f"the run-down from {begin:.3g} to {end:.3g} s")
        case = SpinDown(whole, declines, begin, end, knowledge)
        case, kinds, answers, rows = _chosen(case, angles, held)
        minimum, problem = answers[0], case.problem(kinds)
        if attempts_left and _early_excess(problem, minimum) and end - begin > _MIN_STRETCH_S:
            begin += min(0.04, 0.25 / fastest)  # the hand still touched the pendulum
            if problem.chi2_per_dof(minimum, end) > _POOR_CHI2:
                angles = (float(minimum.theta[_PSI]),)
            continue
        terms = [*(["friction"] if kinds else []), *([_OFF_AXIS] if case.off_axis else [])]
        table = _model_table(problem, minimum, declines, end, rows, terms)
        fit = problem.result(minimum, end, "spin-down", 2, setting, table)
        if minimum.converged and fit.chi2_per_dof < _MAX_CHI2:
            fit = _with_friction(case, fit, minimum, kinds, setting)
            if "friction" not in held:
                found = case.open_friction(kinds, minimum, setting)
                if found is None:
                    advice = "flick faster, or clean the bearings"
                    raise FitFailed(NOT_SEPARATED.format(run.source, "spin-down", advice))
                fit = with_open_friction(fit, found, "spin-down")
            fit = replace(fit, by_number=case.by_number(problem, minimum, kinds, (0, 1)))
            if case.off_axis:
                named = [f"spin-down: {each.sentence}" for each in errors_of(minimum) if each.significant]
                fit = replace(fit, warnings=[*fit.warnings, *named])
            return covering(fit, answers, "with the rotor standing at another angle", "A release at speed decides")
        if fit.chi2_per_dof < _MAX_CHI2:
            raise FitFailed(
                f"{run.source}: the spin-down's fit had not settled after "
                f"{number_of(minimum.iterations, 'iteration')}, although "
                f"its residuals are small enough (χ²/dof {fit.chi2_per_dof:.3g}, allowed below {_MAX_CHI2:g}); record "
                "a longer run-down, or flick faster"
            )
        raise FitFailed(
            f"{run.source}: no model of the run-down follows the spin-down, with dry friction or without: χ²/dof "
            f"{fit.chi2_per_dof:.3g}, expected below {_MAX_CHI2:g}; check that the rotor is at rest and that nothing "
            "touches a pendulum after its flick"
        )
    raise AssertionError("the last attempt returns or raises")


def _chosen(
    case: SpinDown, angles: Sequence[float], held: frozenset[Rung]
) -> tuple[SpinDown, Kinds, list[Minimum], list[ModelChoice]]:
    """Select the smallest adequate model: viscous damping, and with it friction, a drag, or encoders off their axes.

    Returns:
        Stretch with or without encoders off their axes, kinds of friction of the model, its minima, and a row for each
        tested model.
    """
    kinds: Kinds = ()
    answers = _answers(case, kinds, [case.start(kinds, psi) for psi in angles])
    rows: list[ModelChoice] = []
    for _ in range(len(_KINDS) + 1):
        scores: dict[Kind, Evidence] = {
            kind: case.score(kinds, kind, answers[0]) for kind in _KINDS if kind not in kinds
        }
        off = None if case.off_axis else case.off_axis_score(kinds, answers[0])
        own = [_KINDS[k] for k in kinds]
        rows += [_tested(score, [*own, _KINDS[kind]], answers[0]) for kind, score in scores.items()]
        rows += [] if off is None else [_tested(off, [*own, _OFF_AXIS], answers[0])]
        lost = case.problem(kinds).chi2_per_dof(answers[0], case.end_s) > _MAX_CHI2  # there a score test is unreliable
        likely: list[Kind] = [
            k
            for k, score in scores.items()
            if (lost or (score.found and score.step.max() > 0)) and _RUNG[k] not in held
        ]
        fitted: list[tuple[float, SpinDown, Kinds, list[Minimum]]] = []
        for kind in likely:
            more: Kinds = tuple(k for k in _KINDS if k in (*kinds, kind))
            starts = [case.extended(a.theta, kinds, more, {kind: scores[kind].step}) for a in answers[:1]]
            if lost:
                starts += [case.start(more, psi) for psi in angles]
            found = _answers(case, more, starts)
            if case.positive(found[0], more):
                fitted.append((_penalised(found), case, more, found))
        if off is not None and (lost or off.found):
            wider, theta = case.with_off_axis(answers[0].theta)
            found = _answers(wider, kinds, [theta])
            fitted.append((_penalised(found), wider, kinds, found))
        if not fitted or min(f[0] for f in fitted) > _penalised(answers) - _MIN_GAIN:
            break
        _, case, kinds, answers = min(fitted, key=lambda f: f[0])
    return case, kinds, answers, rows


def _penalised(answers: Sequence[Minimum]) -> float:
    """Return χ² of the best minimum plus two for each unknown, as of Akaike's criterion."""
    return answers[0].cost + 2 * len(answers[0].theta)


def _tested(score: Evidence, terms: Sequence[str], minimum: Minimum) -> ModelChoice:
    """Return the row of a model that a score test added to another one."""
    why = f"would reduce χ² by {score.mended:.3g}, {score.gain:.3g} in units of chance (limit {score.limit:.3g})"
    count = len(minimum.theta) + len(score.step)
    name = " and ".join(["viscous damping", *terms])
    return ModelChoice(name, count, minimum.cost - score.mended + 2 * count, False, why)


def _with_friction(case: SpinDown, fit: TransientFit, minimum: Minimum, kinds: Kinds, setting: Setting) -> TransientFit:
    if not kinds:
        return fit
    at = list(range(_COUNT, _COUNT + 2 * len(kinds)))
    std = np.sqrt(np.diag(case.problem(kinds).covariance(minimum, case.end_s, setting, at)))
    values: dict[Kind, tuple[float, float]] = {"torque": (0.0, 0.0), "contact": (0.0, 0.0)}
    spread = dict(values)
    for i, kind in enumerate(kinds):
        a, b = at[2 * i], at[2 * i + 1]
        values[kind] = float(minimum.theta[a]), float(minimum.theta[b])
        spread[kind] = float(std[2 * i]), float(std[2 * i + 1])
    friction = Friction(values["torque"], spread["torque"], values["contact"], spread["contact"])
    return replace(fit, friction=friction, warnings=[*fit.warnings, friction.sentence("spin-down")])


def _together(fits: list[TransientFit]) -> TransientFit:
    """Combine stretches of one record by their information."""
    if len(fits) == 1 or fits[1].chi2_per_dof > 2:
        return fits[0]
    opens = [f.open_friction for f in fits]
    if opens[0] is None or opens[1] is None:
        return fits[0]
    warnings = [w for f in fits for w in f.warnings if w != f.undecided]
    both = replace(fits[0], curves=[*fits[0].curves, *fits[1].curves], warnings=warnings)
    return with_open_friction(both, pooled([opens[0], opens[1]]), "spin-down")


def damping_estimate(run: Run, fit: TransientFit, method: str, zero_std_rad: float = 0.0) -> Estimate:
    """Return a transient's result as an estimate for the joint fit; c is proportional to the encoder's clock rate.

    Args:
        run: recording.
        fit: fit of the transient.
        method: name of the method.
        zero_std_rad: standard uncertainty of the encoders' zeros in the fit, rad.
    """
    names = tuple(fit.values)
    values = np.array(list(fit.values.values()))
    shared = clock_errors(run, {"angles": values})
    by_number = fit.slopes
    own = knowing(fit.covariance, by_number, {**zeros_std(zero_std_rad), **fit.number_std})
    return Estimate(run.test, (run.source,), names, values, own, shared, method, by_number)


def _model_table(
    problem: TransientProblem,
    minimum: Minimum,
    declines: list[Decline],
    end_s: float,
    tested: list[ModelChoice],
    terms: Sequence[str],
) -> list[ModelChoice]:
    """Return the model table: exponentials on a fixed rotor, coupled motion, and tested kinds of friction."""
    bare, size = 0.0, 0
    for channel, decline in zip(problem.cut(end_s), declines, strict=True):
        t = channel.time_s - channel.time_s[0]
        basis = np.column_stack([np.ones_like(t), np.exp(-decline.rate_per_s * t)]) * channel.weight[:, None]
        data = channel.value * channel.weight
        bare += float(np.sum((data - basis @ np.linalg.lstsq(basis, data, rcond=None)[0]) ** 2))
        size += len(t)
    coupled = float(minimum.residual[:size] @ minimum.residual[:size])
    count = len(minimum.theta)
    needed = bare + 2 * 6 > coupled + 2 * count
    why = f"χ² {bare:.3g} against {coupled:.3g} for {number_of(size, 'block')}: " + (
        "the disk's reaction on the pendulums is visible" if needed else "the disk's reaction is below the noise"
    )
    name = " with ".join(["coupled motion of disk and pendulums", *terms])
    return [
        ModelChoice("exponentials, rotor held", 6, bare + 2 * 6, False, why),
        # always chosen: it contains the other model, and its interval includes the uncertainty of the suspension
        ModelChoice(name, count, coupled + 2 * count, True, why),
        *(row for row in tested if row.parameters != count),
    ]


def _answers(case: SpinDown, kinds: Kinds, starts: Sequence[np.ndarray]) -> list[Minimum]:
    """Return the distinct minima from several starts, the best first, without those that are far worse."""
    problem, begin, end = case.problem(kinds), case.begin_s, case.end_s
    begin_s = problem.readings[0].averages.time_s[0]
    early = begin_s + 0.35 * (end - begin)
    found: list[Minimum] = []
    for start in starts:
        problem.prior[_PSI] = start[_PSI]
        theta = problem.solve(start, early, 6).theta
        problem.prior[_PSI] = theta[_PSI]
        found.append(problem.solve(theta, end, _MOST_STEPS, plateau=_MAX_CHI2))
    return plausible_answers(found)


def _early_excess(problem: TransientProblem, minimum: Minimum) -> bool:
    at = 0
    for channel in (r.averages for r in problem.readings):
        own = minimum.residual[at : at + len(channel.time_s)]
        at += len(own)
        first, last = channel.time_s[[0, -1]]
        early = channel.time_s < first + min(_EARLY_S, 0.3 * (last - first))
        if np.count_nonzero(~early) < 20:
            continue
        level, later = float(np.mean(own[early] ** 2)), float(np.mean(own[~early] ** 2))
        if level > (1 + 6 * np.sqrt(2 / max(1, np.count_nonzero(early)))) * max(1.0, later):
            return True
    return False

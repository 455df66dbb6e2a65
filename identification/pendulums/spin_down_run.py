"""Spin-down of both pendulums together, with the disk's reaction.

θ = (ln c3, ln c4, θ3, θ4, θ̇3, θ̇4, ψ, x, y, ẋ, ẏ, ln k1, ln k2, ln ζ1, ln ζ2) at the stretch's start. The rotor stands
at an angle ψ that nothing measures; it matters because the suspension differs between x and y. Turning everything by
half a revolution changes nothing the encoders see, so ψ is searched over half a revolution from several starts.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace

import numpy as np

from daq.signals import Run
from dynamics.speed_history import SpeedHistory
from identification.clocks import clock_errors
from identification.errors import FitFailed, NotIdentifiable
from identification.estimate import Estimate
from identification.least_squares import Minimum
from identification.pendulums.answers import covering, plausible_answers
from identification.pendulums.free_angles import both_angles, laid_over, log_suspension, swing
from identification.pendulums.push import TIME_CONSTANTS, Decline, find_decline, spin_down_readings
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import Readings, TransientFit, TransientProblem, log_intervals
from identification.samples import Averages
from identification.setting import ModelChoice, Setting, check_setting
from identification.threads import on_one_thread

_ANGLES, _SPEEDS, _PSI, _DISK, _SUSPENSION, _COUNT = slice(2, 4), slice(4, 6), 6, slice(7, 11), slice(11, 15), 15
_MOST_STEPS = 80  # the angle at which the rotor stands can be a long valley
_BEFORE_PUSH_S, _WORTH_S = 0.03, 0.08
_EARLY_S = 0.1
_DAMPING_STD = 1.0  # ln c; a pendulum that does not move yet says nothing of its own
_DISK_STD_M = 3e-4  # how far a flick may leave the disk shaking


@on_one_thread
def fit_spin_down_run(run: Run, knowledge: Knowledge, *, setting: Setting = "balanced") -> TransientFit:
    """Both pendulums' damping from one spin-down.

    Args:
        run: a "spin-down" run: rotor at rest, both pendulums flicked.
        knowledge: masses, lengths and what is known of the suspension.
        setting: fast takes the encoders' rounding for white noise, the others its own effect (reference more finely).
    Raises:
        NotIdentifiable: a pendulum hardly moves.
        FitFailed: the model does not follow the angles.
    Source: docs/theory/pendulum_damping.md.
    """
    check_setting(setting)
    if run.angle_rad.ndim != 2 or len(run.angle_time_s) < 400:
        raise NotIdentifiable(f"{run.source}: {len(run.angle_time_s)} encoder samples are too few")
    declines = [find_decline(run.angle_time_s, run.angle_rad[:, i]) for i in range(2)]
    fastest = max(d.rate_per_s for d in declines)
    whole = [spin_down_readings(run.angle_time_s, run.angle_rad[:, i], fastest) for i in range(2)]
    last = max(d.start_s for d in declines)
    fits = [_fit_from(run, whole, declines, (last, np.inf), knowledge, setting)]
    first = int(np.argmin([d.start_s for d in declines]))
    push = declines[1 - first].push_s - _BEFORE_PUSH_S
    if push - declines[first].start_s > _WORTH_S:  # one pendulum running down before the other is flicked
        with contextlib.suppress(FitFailed, NotIdentifiable):  # a hand on the second: the stretch after it stands alone
            fits.append(_fit_from(run, whole, declines, (declines[first].start_s, push), knowledge, setting))
    return _together(fits)


def _fit_from(
    run: Run, whole: list[Readings], declines: list[Decline], span: tuple[float, float], knowledge: Knowledge,
    setting: Setting,
) -> TransientFit:  # fmt: skip
    """One stretch; begins later while the residual right after its begin stands out."""
    begin, limit = span
    slowest, fastest = min(d.rate_per_s for d in declines), max(d.rate_per_s for d in declines)
    for attempts_left in range(8, -1, -1):
        end = min(*(float(w.averages.time_s[-1]) for w in whole), begin + TIME_CONSTANTS / slowest, limit)
        problem, start = _problem(whole, declines, begin, end, knowledge)
        answers = _answers(problem, start, end)
        minimum = answers[0]
        if attempts_left and _early_excess(problem, minimum) and end - begin > _WORTH_S:
            begin += min(0.04, 0.25 / fastest)  # the hand was still there
            continue
        fit = problem.result(minimum, end, "spin-down", 2, setting, _model_table(problem, minimum, declines, end))
        if minimum.converged and fit.chi2_per_dof < 10:
            return covering(fit, answers, "with the rotor standing at another angle", "A release at speed decides")
        raise FitFailed(
            f"{run.source}: the coupled model does not follow the spin-down: χ²/dof {fit.chi2_per_dof:.3g}, "
            f"{minimum.iterations} iterations"
        )
    raise AssertionError("the last attempt returns or raises")


def _together(fits: list[TransientFit]) -> TransientFit:
    """Stretches of one record, combined by their information."""
    if len(fits) == 1 or fits[1].chi2_per_dof > 2:
        return fits[0]
    information = [np.linalg.inv(f.covariance) for f in fits]
    covariance = np.linalg.inv(information[0] + information[1])
    pulled = sum(i @ np.array(list(f.values.values())) for i, f in zip(information, fits, strict=True))
    found = covariance @ pulled
    return replace(
        fits[0], values=dict(zip(fits[0].values, found.tolist(), strict=True)), covariance=covariance,
        intervals=log_intervals(found, covariance / np.outer(found, found)),
        curves=[*fits[0].curves, *fits[1].curves], warnings=fits[0].warnings + fits[1].warnings,
    )  # fmt: skip


def damping_estimate(run: Run, fit: TransientFit, method: str) -> Estimate:
    """A transient in the joint estimate's form; c goes with the encoder's clock rate."""
    names = tuple(fit.values)
    values = np.array(list(fit.values.values()))
    shared = clock_errors(run, {"encoder": values})
    return Estimate(run.test, run.source, names, values, fit.covariance, shared, method)


def _problem(
    whole: list[Readings], declines: list[Decline], begin: float, end: float, knowledge: Knowledge
) -> tuple[TransientProblem, np.ndarray]:
    ends = [min(end, max(begin, d.start_s) + TIME_CONSTANTS / d.rate_per_s) for d in declines]
    readings = (whole[0].between(begin, ends[0]), whole[1].between(begin, ends[1]))
    angles = [r.averages for r in readings]
    if min(len(a.time_s) for a in angles) < 12:
        raise NotIdentifiable(
            "fewer than 12 blocks of readings between two flicks; flick both at once or a second apart"
        )
    physics = knowledge.physics
    inertias = (physics.a.inertia_kg_m2, physics.b.inertia_kg_m2)

    def predict(theta: np.ndarray, end_s: float) -> tuple[np.ndarray, np.ndarray]:
        return _readings_of(theta, problem.cut(end_s), knowledge, begin)

    start = np.zeros(_COUNT)
    for i, (channel, decline) in enumerate(zip(angles, declines, strict=True)):
        rate = decline.rate_per_s
        t = channel.time_s - begin
        basis = np.column_stack([np.ones_like(t), np.exp(-rate * t)])
        rest, amplitude = np.linalg.lstsq(basis, channel.value, rcond=None)[0]
        if begin < decline.push_s:  # not flicked yet
            rest, amplitude = float(np.mean(channel.value)), 0.0
        start[i] = np.log(rate * inertias[i])
        start[2 + i], start[4 + i] = rest + amplitude, -rate * amplitude
    start[_SUSPENSION] = log_suspension(physics)[:4]
    omega = np.array(physics.natural_frequencies_rad_s)
    prior_std = np.full(_COUNT, np.inf)
    prior_std[:2], prior_std[_PSI] = _DAMPING_STD, np.pi
    prior_std[_DISK] = np.r_[_DISK_STD_M, _DISK_STD_M, _DISK_STD_M * omega]
    prior_std[_SUSPENSION] = knowledge.log_std[:4]
    problem = TransientProblem(readings, predict, start.copy(), prior_std)
    return problem, start


def _readings_of(
    theta: np.ndarray, cut: tuple[Averages, Averages], knowledge: Knowledge, begin: float
) -> tuple[np.ndarray, np.ndarray]:
    """Both encoders' angles and derivatives on a rotor that stands at ψ."""
    count = sum(len(c.time_s) for c in cut)
    if np.max(np.abs(theta[:2])) > 40 or np.max(np.abs(theta[_SUSPENSION])) > 40:
        return np.full(count, np.nan), np.zeros((count, _COUNT))
    now = laid_over(knowledge, theta[:2], theta[_SUSPENSION])
    state = np.r_[theta[7:9], theta[_ANGLES], theta[9:11], theta[_SPEEDS]]
    still = SpeedHistory.constant(0.0, float(theta[_PSI]), begin)
    motion = swing(now, still, state, begin, begin, max(float(c.time_s[-1]) for c in cut))
    if motion is None:
        return np.full(count, np.nan), np.zeros((count, _COUNT))
    start_by, log_by = np.zeros((8, _COUNT)), np.zeros((7, _COUNT))
    start_by[[0, 1, 2, 3, 4, 5, 6, 7], [7, 8, 2, 3, 9, 10, 4, 5]] = 1.0
    start_by[[2, 3], _PSI] = 1.0  # a turned rotor is two turned pendulums, read from a turned zero
    log_by[0, 0] = log_by[1, 1] = 1.0
    log_by[2:6, _SUSPENSION] = np.eye(4)
    angle, slope = both_angles(motion, cut, start_by, log_by)
    slope[:, _PSI] -= 1.0
    return angle, slope


def _model_table(
    problem: TransientProblem, minimum: Minimum, declines: list[Decline], end_s: float
) -> list[ModelChoice]:
    """The coupled motion beside what each pendulum would do on a rotor that does not move."""
    bare, size = 0.0, 0
    for channel, decline in zip(problem.cut(end_s), declines, strict=True):
        t = channel.time_s - channel.time_s[0]
        basis = np.column_stack([np.ones_like(t), np.exp(-decline.rate_per_s * t)]) * channel.weight[:, None]
        data = channel.value * channel.weight
        bare += float(np.sum((data - basis @ np.linalg.lstsq(basis, data, rcond=None)[0]) ** 2))
        size += len(t)
    coupled = float(minimum.residual[:size] @ minimum.residual[:size])
    needed = bare + 2 * 6 > coupled + 2 * _COUNT
    why = f"χ² {bare:.3g} against {coupled:.3g} for {size} blocks: " + (
        "the disk's push on the pendulums shows" if needed else "the disk's push is below the noise"
    )
    return [
        ModelChoice("bare exponentials, rotor held", 6, bare + 2 * 6, False, why),
        # also where it is not needed: it contains the other, and its interval what the suspension leaves open
        ModelChoice("coupled motion of disk and pendulums", _COUNT, coupled + 2 * _COUNT, True, why),
    ]


def _answers(problem: TransientProblem, start: np.ndarray, end: float) -> list[Minimum]:
    """The minima reached from several angles ψ, distinct ones, the best first; those far worse are left out."""
    begin_s = problem.readings[0].averages.time_s[0]
    early = begin_s + 0.35 * (end - begin_s)
    found: list[Minimum] = []
    for psi in np.arange(6) * np.pi / 6:
        begin = start.copy()
        begin[_PSI] = problem.prior[_PSI] = psi
        begin = problem.solve(begin, early, 6).theta
        problem.prior[_PSI] = begin[_PSI]
        found.append(problem.solve(begin, end, _MOST_STEPS))
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

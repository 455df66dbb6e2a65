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
from identification.errors import FitFailed, NotIdentifiable
from identification.estimate import Estimate
from identification.least_squares import Minimum
from identification.pendulums.spin_down import TIME_CONSTANTS, Decline, angle_averages, find_decline
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import (
    TransientFit,
    TransientProblem,
    free_angles,
    laid_over,
    log_suspension,
    step_for,
)
from identification.ring_down.fit import clock_rate_std
from identification.samples import Averages

_COUPLED, _PSI, _DISK, _SUSPENSION = slice(2, 6), 6, slice(7, 11), slice(11, 15)
_BEFORE_PUSH_S, _WORTH_S = 0.03, 0.08
_DAMPING_STD = 1.0  # ln c; a pendulum that does not move yet says nothing of its own
_DISK_STD_M = 3e-4  # how far a flick may leave the disk shaking


def fit_spin_down_run(run: Run, knowledge: Knowledge) -> TransientFit:
    """Both pendulums' damping from one spin-down.

    Args:
        run: a "spin-down" run: rotor at rest, both pendulums flicked.
        knowledge: masses, lengths and what is known of the suspension.
    Raises:
        NotIdentifiable: a pendulum hardly moves.
        FitFailed: the model does not follow the angles.
    Source: docs/theory/identification.md.
    """
    if run.angle_rad.ndim != 2 or len(run.angle_time_s) < 400:
        raise NotIdentifiable(f"{run.source}: {len(run.angle_time_s)} encoder samples are too few")
    whole = [angle_averages(run.angle_time_s, run.angle_rad[:, i]) for i in range(2)]
    declines = [find_decline(w) for w in whole]
    fits = [_fit_from(run, whole, declines, max(d.start_s for d in declines), np.inf, knowledge)]
    first = int(np.argmin([d.start_s for d in declines]))
    push = declines[1 - first].push_s - _BEFORE_PUSH_S
    if push - declines[first].start_s > _WORTH_S:  # one pendulum running down before the other is flicked
        with contextlib.suppress(FitFailed):  # a hand on the second pendulum: the stretch after it stands alone
            fits.append(_fit_from(run, whole, declines, declines[first].start_s, push, knowledge))
    return _together(fits)


def _fit_from(
    run: Run, whole: list[Averages], declines: list[Decline], begin: float, limit: float, knowledge: Knowledge
) -> TransientFit:
    """One stretch; begins later while the residual right after its begin stands out."""
    slowest = min(d.rate_per_s for d in declines)
    for attempts_left in range(5, -1, -1):
        end = min(*(float(w.time_s[-1]) for w in whole), begin + TIME_CONSTANTS / slowest, limit)
        problem, start = _problem(whole, declines, begin, end, knowledge)
        minimum = _best_phase(problem, start, end)
        if attempts_left and _early_excess(problem, minimum) and end - begin > _WORTH_S:
            begin += 0.04  # the hand was still there
            continue
        fit = problem.result(minimum, end, "spin-down", 2)
        if minimum.converged and fit.chi2_per_dof < 10:
            return fit
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
    values = dict(zip(fits[0].values, (covariance @ pulled).tolist(), strict=True))
    return replace(
        fits[0], values=values, covariance=covariance, curves=[*fits[0].curves, *fits[1].curves],
        warnings=fits[0].warnings + fits[1].warnings,
    )  # fmt: skip


def damping_estimate(run: Run, fit: TransientFit, method: str) -> Estimate:
    """A transient in the joint estimate's form; c goes with the encoder's clock rate."""
    names = tuple(fit.values)
    values = np.array(list(fit.values.values()))
    shared = {"clock encoder": values * clock_rate_std(run.clock_rate_std, "encoder")}
    return Estimate(run.test, run.source, names, values, fit.covariance, shared, method)


def _problem(
    whole: list[Averages], declines: list[Decline], begin: float, end: float, knowledge: Knowledge
) -> tuple[TransientProblem, np.ndarray]:
    angles = (whole[0].between(begin, end), whole[1].between(begin, end))
    physics = knowledge.physics
    step = step_for(physics, 0.0, 0.3)
    knots = np.array([begin, begin + 1.0])
    inertias = (physics.a.inertia_kg_m2, physics.b.inertia_kg_m2)

    def predict(theta: np.ndarray, end_s: float) -> np.ndarray:
        cut = (angles[0].between(-np.inf, end_s), angles[1].between(-np.inf, end_s))
        now = laid_over(knowledge, theta[:2], theta[_SUSPENSION])
        state = np.r_[theta[7:9], theta[2:4], theta[9:11], theta[4:6]]
        still = np.array([[theta[_PSI], 0.0, 0.0, 0.0]])
        return free_angles(now, knots, still, state, begin, cut, step, 0.004)

    start = np.zeros(15)
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
    prior_std = np.full(15, np.inf)
    prior_std[:2], prior_std[_PSI] = _DAMPING_STD, np.pi
    prior_std[_DISK] = np.r_[_DISK_STD_M, _DISK_STD_M, _DISK_STD_M * omega]
    prior_std[_SUSPENSION] = knowledge.log_std[:4]
    difference = np.full(15, 1e-5)
    difference[_DISK] = np.r_[1e-7, 1e-7, 1e-7 * omega]
    return TransientProblem(angles, predict, difference, start.copy(), prior_std), start


def _best_phase(problem: TransientProblem, start: np.ndarray, end: float) -> Minimum:
    """The best of several starts in ψ: two steps each on the first part, the winner to the end."""
    early = problem.angles[0].time_s[0] + 0.35 * (end - problem.angles[0].time_s[0])
    tries = []
    for psi in np.arange(6) * np.pi / 6:
        begin = start.copy()
        begin[_PSI] = psi
        problem.prior[_PSI] = psi
        tries.append(problem.solve(begin, early, 6))
    tries.sort(key=lambda m: m.cost)
    best = None
    for candidate in tries[:4]:
        problem.prior[_PSI] = candidate.theta[_PSI]
        minimum = problem.solve(candidate.theta, end)
        if best is None or minimum.cost < best.cost:
            best = minimum
        if problem.chi2_per_dof(best, end) < 1.2:
            break
    assert best is not None
    return best


def _early_excess(problem: TransientProblem, minimum: Minimum) -> bool:
    at = 0
    for channel in problem.angles:
        own = minimum.residual[at : at + len(channel.time_s)]
        at += len(own)
        early = channel.time_s < channel.time_s[0] + 0.1
        if np.count_nonzero(~early) < 20:
            continue
        level, later = float(np.mean(own[early] ** 2)), float(np.mean(own[~early] ** 2))
        if level > (1 + 6 * np.sqrt(2 / max(1, np.count_nonzero(early)))) * max(1.0, later):
            return True
    return False

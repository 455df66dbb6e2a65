"""Pendulum damping from a release at speed.

A release starts near an unstable equilibrium: what the angles do depends on their start to a degree that grows
exponentially, so the fit proceeds over growing horizons, each from the one before. Where the residuals of a horizon
are not noise the whole run is left out: a model that fails later may be biased before that shows.

θ = (ln c3, ln c4, θ3, θ4 at release, two encoder zeros, shift of the release's time, the disk's deviation x, y, ẋ, ẏ
from its locked orbit, ln k1, ln k2, ln ζ1, ln ζ2, ln S_P).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from daq.signals import Run
from dynamics.errors import OutsideDomain
from dynamics.integrate import integrate, locked_state
from dynamics.speed_history import SpeedHistory
from identification.errors import FitFailed, NotIdentifiable
from identification.least_squares import Minimum
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import (
    TransientFit,
    TransientProblem,
    free_angles,
    laid_over,
    log_suspension,
    step_for,
)
from identification.samples import Averages, block_averages, encoder_noise

_ZEROS, _SHIFT, _DISK, _SUSPENSION, _COUNT = slice(4, 6), 6, slice(7, 11), slice(11, 16), 16
_BLOCK_S, _OUTPUT_S = 0.004, 0.004
_SHIFT_STD_S, _DISK_STD_M = 1e-3, 2e-5
_LONGEST_S, _AFTER_SETTLING_S = 25.0, 1.5
_GOOD = 1.5  # χ²/dof


def fit_release(run: Run, knowledge: Knowledge, zero_std_rad: float) -> TransientFit:
    """Both pendulums' damping from the transient after a release at constant speed.

    Args:
        run: a "point-NAME" run with both releases and the locked stretch before.
        knowledge: masses, lengths and what is known of suspension, imbalance and (as start values) damping.
        zero_std_rad: standard uncertainty of each encoder's zero.
    Raises:
        NotIdentifiable: no releases, or too few marks or samples.
        FitFailed: the model does not follow the angles over any horizon.
    Source: docs/theory/identification.md.
    """
    go, history = _release_time(run), _history(run)
    after = run.angle_time_s > go + _BLOCK_S
    angles = _averages(run, after)
    problem, start = _problem(run, knowledge, history, go, angles, zero_std_rad)
    horizons = _horizons(angles)
    best: tuple[Minimum, float] | None = None
    for horizon in horizons:
        end = go + horizon
        minimum = problem.solve(start, end, 15)
        if not problem.chi2_per_dof(minimum, end) < _GOOD:
            raise FitFailed(
                f"{run.source}: the model follows the released pendulums for less than {horizon:.2g} of "
                f"{horizons[-1]:.2g} s (χ²/dof {problem.chi2_per_dof(minimum, end):.3g})"
            )
        best, start = (minimum, end), minimum.theta
    assert best is not None
    fit = problem.result(*best, f"release {run.test}", 2)
    if max(fit.std[n] / fit.values[n] for n in fit.values) > 0.2:
        raise FitFailed(f"{run.source}: only {fit.horizon_s:.2g} s of the release can be followed; damping stays open")
    return fit


def _release_time(run: Run) -> float:
    times = {r.pendulum: r.time_s for r in run.releases}
    if set(times) != {0, 1}:
        raise NotIdentifiable(f"{run.source}: it holds no release of both pendulums")
    if abs(times[0] - times[1]) > 2e-3 + 3 * max(r.time_std_s for r in run.releases):
        raise NotIdentifiable(f"{run.source}: pendulums released {abs(times[0] - times[1]):.3g} s apart")
    return 0.5 * (times[0] + times[1])


def _history(run: Run) -> SpeedHistory:
    try:
        return SpeedHistory.from_phases(run.mark_time_s, run.mark_phase_rad)
    except OutsideDomain as error:
        raise NotIdentifiable(f"{run.source}: {error}") from error


def _averages(run: Run, keep: np.ndarray) -> tuple[Averages, Averages]:
    out = []
    for i in range(2):
        angle = run.angle_rad[keep, i]
        if len(angle) < 500:
            raise NotIdentifiable(f"{run.source}: {len(angle)} encoder samples after the release are too few")
        noise = encoder_noise(angle, run.angle_step_rad)
        out.append(block_averages(run.angle_time_s[keep], angle, _BLOCK_S, noise))
    return out[0], out[1]


def _horizons(angles: tuple[Averages, Averages]) -> list[float]:
    """0.5 s, then half as long again each time, up to where both angles have come to rest."""
    begin = angles[0].time_s[0]
    last = begin
    for channel in angles:
        tail = channel.value[channel.time_s > channel.time_s[-1] - 1.0]
        moving = np.abs(channel.value - tail.mean()) > 0.05 + 2 * np.ptp(tail)
        if moving.any():
            last = max(last, channel.time_s[np.flatnonzero(moving)[-1]])
    longest = min(last + _AFTER_SETTLING_S, begin + _LONGEST_S, angles[0].time_s[-1], angles[1].time_s[-1]) - begin
    steps = 0.5 * 1.5 ** np.arange(12)
    return [float(s) for s in steps if s < 0.9 * longest] + [float(longest)]


def _problem(
    run: Run,
    knowledge: Knowledge,
    history: SpeedHistory,
    go: float,
    angles: tuple[Averages, Averages],
    zero_std: float,
) -> tuple[TransientProblem, np.ndarray]:
    physics = knowledge.physics
    earliest = max(run.mark_time_s[2], go - 12.0)
    if earliest > go - 0.2:
        raise NotIdentifiable(f"{run.source}: the speed before the release is not known")
    speed = float(history.phase(go)[0, 1])
    before = (run.angle_time_s < go - 0.02) & (run.angle_time_s > go - 2.0)
    if np.count_nonzero(before) < 100:
        raise NotIdentifiable(f"{run.source}: no encoder samples of the locked pendulums before the release")
    locked = run.angle_rad[before].mean(axis=0)
    predict = _prediction(knowledge, history, earliest, go, angles, step_for(physics, speed, 0.12))
    start = np.r_[
        np.log([physics.a.damping_Nms_per_rad, physics.b.damping_Nms_per_rad]), locked, np.zeros(7),
        log_suspension(physics),
    ]  # fmt: skip
    omega = physics.natural_frequencies_rad_s[0]
    # start angles are the locked ones less the zeros; what the mean of quantised readings leaves open is small
    prior_std = np.r_[
        1.0, 1.0, 0.25 * run.angle_step_rad, 0.25 * run.angle_step_rad, zero_std, zero_std,
        max(_SHIFT_STD_S, *(r.time_std_s for r in run.releases)),
        _DISK_STD_M, _DISK_STD_M, _DISK_STD_M * omega, _DISK_STD_M * omega, knowledge.log_std,
    ]  # fmt: skip
    difference = np.r_[np.full(6, 1e-7), 1e-6, 1e-8, 1e-8, 1e-8 * omega, 1e-8 * omega, np.full(5, 1e-7)]
    return TransientProblem(angles, predict, difference, start.copy(), prior_std), start


def _prediction(
    knowledge: Knowledge,
    history: SpeedHistory,
    earliest: float,
    go: float,
    angles: tuple[Averages, Averages],
    step: float,
) -> Callable[[np.ndarray, float], np.ndarray]:
    """Readings of both encoders from θ: θ's start angles are readings, the true angles are less by the zeros."""
    knots, coefficients = history.knots_s, history.coefficients
    psi, speed, _ = history.phase(earliest)[0]

    def predict(theta: np.ndarray, end_s: float) -> np.ndarray:
        cut = (angles[0].between(-np.inf, end_s), angles[1].between(-np.inf, end_s))
        now = laid_over(knowledge, theta[:2], theta[_SUSPENSION])
        true = theta[2:4] - theta[_ZEROS]
        at = go + theta[_SHIFT]
        locked = locked_state(now, speed, psi, true[0], true[1])
        lock_span = np.array([earliest, at])
        state = integrate(locked, lock_span, step, knots, coefficients, now.packed(), 0.0, 0.0)[-1]
        state[[0, 1, 4, 5]] += theta[_DISK]
        free = free_angles(now, knots, coefficients, state, at, cut, step, _OUTPUT_S)
        return free + np.repeat(theta[_ZEROS], [len(c.time_s) for c in cut])

    return predict

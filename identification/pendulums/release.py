"""Pendulum damping from a release at speed.

A release starts near an unstable equilibrium: what the angles do depends on their start to a degree that grows
exponentially, so the fit proceeds over growing horizons, each from the one before, from what an unscented Kalman filter
makes of the first second and, should that end in a side minimum, from a fan of dampings. Where the residuals of a
horizon are not noise the whole run is left out: a model that fails later may be biased before that shows.

θ = (ln c3, ln c4, θ3, θ4 at release, two encoder zeros, shift of the release's time, the disk's deviation x, y, ẋ, ẏ
from its locked orbit, ln k1, ln k2, ln ζ1, ln ζ2, ln S_P), and what the recorded phase lacks where it has no reference.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from daq.signals import Run
from dynamics.errors import OutsideDomain
from identification.errors import FitFailed, NotIdentifiable
from identification.least_squares import Minimum
from identification.pendulums.answers import plausible_answers
from identification.pendulums.decline import encoder_step
from identification.pendulums.free_angles import both_angles, laid_over, log_suspension, swing
from identification.pendulums.locked_start import LockedStart
from identification.pendulums.recorded_speed import recorded_speed
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import Readings, TransientFit, TransientProblem
from identification.pendulums.unknown_phase import TURN_STD_RAD, angles_to_try, race, told, with_turn
from identification.samples import block_averages, encoder_noise
from identification.setting import ModelChoice, Setting, check_setting
from identification.threads import on_one_thread
from identification.tracking.release_start import damping_start

_START, _ZEROS, _SHIFT, _DISK, _SUSPENSION, _COUNT = slice(2, 4), slice(4, 6), 6, slice(7, 11), slice(11, 16), 16
_BLOCK_S = {"fast": 0.004, "balanced": 0.004, "reference": 0.001}
_SHIFT_STD_S, _DISK_STD_M = 1e-3, 2e-5
_LONGEST_S, _AFTER_SETTLING_S, _MEMORY_S = 25.0, 0.5, 12.0
_DAMPING_STD = 2.5  # ln c: a start a hundred times wrong is within two of it
_HELD_STD = 0.4  # ln c
_GOOD = 1.5  # χ²/dof
_SHIFTS = (0.0, np.log(3.0), -np.log(3.0), np.log(10.0), -np.log(10.0))
_FAN = sorted(product(_SHIFTS, _SHIFTS), key=lambda s: (abs(s[0]) + abs(s[1]), s))  # of ln c3, ln c4, near ones first


@on_one_thread
def fit_release(run: Run, knowledge: Knowledge, zero_std_rad: float, *, setting: Setting = "balanced") -> TransientFit:
    """Both pendulums' damping from the transient after a release at constant speed.

    Args:
        run: a "point-NAME" run with both releases and the locked stretch before.
        knowledge: masses, lengths and what is known of suspension, imbalance and (as start values) damping.
        zero_std_rad: standard uncertainty of each encoder's zero.
        setting: fast fits the first part of the transient and takes rounding for white noise, balanced all of it with
            the rounding's own effect, reference every sample instead of 4 ms blocks.
    Raises:
        NotIdentifiable: no releases, or too few marks or samples.
        FitFailed: the model does not follow the angles over any horizon.
    Source: docs/theory/pendulum_damping.md.
    """
    check_setting(setting)
    go, go_std = _release_time(run)
    rest = _locked_start(run, go)
    begin = go + max(_BLOCK_S["balanced"], 4 * go_std)
    readings = _readings(run, begin, _BLOCK_S[setting])
    problem, start = _problem(run, knowledge, rest, (go_std, begin), readings, zero_std_rad)
    horizons = _horizons(readings)
    horizons = horizons[: max(2, len(horizons) - 2)] if setting == "fast" else horizons
    if run.phase_absolute:
        starts, fewest = _starts(run, knowledge, rest, start), 1
    else:
        places = race(problem, _turned_starts(run, knowledge, rest, start), horizons[:-1], _holding)
        starts, fewest = _starts_around(places, start), len(places)
    answers = _answers(run, problem, starts, horizons, fewest)
    fit = problem.result(
        answers[0], horizons[-1], f"release {run.test}", 2, setting, _model_table(answers[0], problem, horizons[-1])
    )
    if max(fit.std[n] / fit.values[n] for n in fit.values) > 0.2:
        raise FitFailed(
            f"{run.source}: {fit.horizon_s:.2g} s of the release do not show the damping; record a longer one"
        )
    return fit if run.phase_absolute else told(fit, answers, knowledge.physics)


def _answers(
    run: Run, problem: TransientProblem, starts: Iterable[tuple[np.ndarray, bool]], horizons: list[float], fewest: int
) -> list[Minimum]:
    """What the starts lead to that explains the readings, the best first.

    Args:
        fewest: starts tried in any case; after them the search ends as soon as one has led somewhere.
    Raises:
        FitFailed: the model does not follow the angles from any of them.
    """
    good: list[Minimum] = []
    least, furthest = np.inf, horizons[0]
    for number, (trial, held) in enumerate(starts, 1):
        minimum, reached = _grown(problem, trial, horizons, held)
        furthest = max(furthest, reached)
        if reached == horizons[-1]:
            misfit = problem.misfit(minimum, reached)
            least = min(least, misfit)
            if misfit < _GOOD:
                good.append(minimum)
        if good and number >= fewest:
            break
    if good:
        return plausible_answers(good)
    begin = problem.readings[0].averages.time_s[0]
    happened = (
        f"residuals {least:.3g} times what noise explains, expected below {_GOOD:g}"
        if np.isfinite(least)
        else f"from no start value did it get past the first {furthest - begin:.2g} s"
    )
    raise FitFailed(
        f"{run.source}: the model does not follow the released pendulums over {horizons[-1] - begin:.2g} s "
        f"({happened}); check masses, lengths and the speed's marks"
    )


def _grown(problem: TransientProblem, start: np.ndarray, horizons: list[float], held: bool) -> tuple[Minimum, float]:
    """Least squares over growing horizons, and the one it ended at: an early one where the model fails.

    Args:
        held: keep the damping near the start's for the first ones. Half a second says little about weak damping, and
            what it says can lead to a side minimum.
    """
    minimum, early, end = None, _holding(problem, start) if held else problem, horizons[0]
    for i, end in enumerate(horizons):
        last = i == len(horizons) - 1
        now = early if i < len(horizons) - 2 else problem
        minimum = now.solve(start, end, 25 if last else 8)
        if not last and not min(problem.chi2_per_dof(minimum, end), problem.misfit(minimum, end)) < 3 * _GOOD:
            break
        start = minimum.theta
    assert minimum is not None
    return minimum, end


def _holding(problem: TransientProblem, start: np.ndarray) -> TransientProblem:
    """The problem with the damping kept near the start's."""
    prior, std = problem.prior.copy(), problem.prior_std.copy()
    prior[:2], std[:2] = start[:2], _HELD_STD
    return replace(problem, prior=prior, prior_std=std)


def _starts(run: Run, knowledge: Knowledge, rest: LockedStart, start: np.ndarray) -> Iterator[tuple[np.ndarray, bool]]:
    """What the filter finds first, held and free, then a fan around the given damping, near ones first, held."""
    tracked = damping_start(run, laid_over(knowledge, start[:2], start[_SUSPENSION]), rest.history, rest.release_s)
    if tracked is not None:
        yield np.r_[tracked, start[2:]], True
        yield np.r_[tracked, start[2:]], False
    for shift in _FAN:
        yield start + np.r_[shift, np.zeros(len(start) - 2)], True


def _turned_starts(run: Run, knowledge: Knowledge, rest: LockedStart, start: np.ndarray) -> list[np.ndarray]:
    """What the filter finds from several angles of the rotor."""
    nominal, out = laid_over(knowledge, start[:2], start[_SUSPENSION]), []
    for turn in angles_to_try(nominal):
        tracked = damping_start(run, nominal, rest.turned(turn).history, rest.release_s)
        out.append(np.r_[start[:2] if tracked is None else tracked, start[2:-1], turn])
    return out


def _starts_around(places: list[np.ndarray], start: np.ndarray) -> Iterator[tuple[np.ndarray, bool]]:
    """Given places held and free, then a fan around the given damping at the first of them, held."""
    yield from ((place, held) for held in (True, False) for place in places)
    for shift in _FAN:
        yield np.r_[start[:2] + shift, places[0][2:]], True


def _release_time(run: Run) -> tuple[float, float]:
    times = {r.pendulum: r.time_s for r in run.releases}
    if set(times) != {0, 1}:
        raise NotIdentifiable(f"{run.source}: it holds no release of both pendulums")
    if abs(times[0] - times[1]) > 2e-3 + 3 * max(r.time_std_s for r in run.releases):
        raise NotIdentifiable(f"{run.source}: pendulums released {abs(times[0] - times[1]):.3g} s apart")
    return 0.5 * (times[0] + times[1]), max(_SHIFT_STD_S, *(r.time_std_s for r in run.releases))


def _locked_start(run: Run, release_s: float) -> LockedStart:
    """The speed over what the fit needs; two marks at the begin have no earlier ones to lean on."""
    needed = run.mark_time_s >= release_s - _MEMORY_S - 1.0
    needed[:2] = False
    try:
        history = recorded_speed(run.mark_time_s[needed], run.mark_phase_rad[needed])
    except OutsideDomain as error:
        raise NotIdentifiable(f"{run.source}: {error}") from error
    earliest = max(float(history.knots_s[0]), release_s - _MEMORY_S)
    if earliest > release_s - 0.2:
        raise NotIdentifiable(f"{run.source}: the speed before the release is not known")
    return LockedStart(history, earliest, release_s)


def _readings(run: Run, begin_s: float, block_s: float) -> tuple[Readings, Readings]:
    keep = run.angle_time_s > begin_s
    out = []
    for i in range(2):
        good = keep & np.isfinite(run.angle_rad[:, i])
        time, angle = run.angle_time_s[good], run.angle_rad[good, i]
        if len(angle) < 500:
            raise NotIdentifiable(f"{run.source}: {len(angle)} encoder samples after the release are too few")
        step = encoder_step(angle)  # what the recording says of it may be wrong, or it is not quantised
        noise = encoder_noise(angle, step) if step else encoder_noise(angle, 1e-6)
        out.append(Readings(time, angle, block_averages(time, angle, block_s, noise), step))
    return out[0], out[1]


def _horizons(readings: tuple[Readings, Readings]) -> list[float]:
    """Last instants: 0.5 s on, then 1.6 times as long each time, up to where both angles have come to rest."""
    blocks = [r.averages for r in readings]
    begin = last = blocks[0].time_s[0]
    for channel in blocks:
        tail = channel.value[channel.time_s > channel.time_s[-1] - 1.0]
        moving = np.abs(channel.value - tail.mean()) > 0.03 * np.ptp(channel.value) + 2 * np.ptp(tail)
        if np.ptp(tail) > 0.2 * np.ptp(channel.value):  # it creeps, or swings on
            last = channel.time_s[-1]
        elif moving.any():
            last = max(last, channel.time_s[np.flatnonzero(moving)[-1]])
    end = min(last + _AFTER_SETTLING_S, begin + _LONGEST_S, *(float(c.time_s[-1]) for c in blocks))
    return [float(begin + s) for s in 0.5 * 1.6 ** np.arange(10) if s < 0.7 * (end - begin)] + [float(end)]


def _problem(
    run: Run,
    knowledge: Knowledge,
    rest: LockedStart,
    instants: tuple[float, float],
    readings: tuple[Readings, Readings],
    zero_std: float,
) -> tuple[TransientProblem, np.ndarray]:
    physics, go, (go_std, begin) = knowledge.physics, rest.release_s, instants
    before = (run.angle_time_s < go - 0.02) & (run.angle_time_s > go - 2.0)
    if np.count_nonzero(before) < 100:
        raise NotIdentifiable(f"{run.source}: no encoder samples of the locked pendulums before the release")
    locked = np.nanmean(run.angle_rad[before], axis=0)
    step = max(r.step_rad for r in readings)
    start = np.r_[
        np.log([physics.a.damping_Nms_per_rad, physics.b.damping_Nms_per_rad]), locked, np.zeros(7),
        log_suspension(physics),
    ]  # fmt: skip
    omega = physics.natural_frequencies_rad_s[0]
    # start angles are the locked ones less the zeros; the mean of quantised readings at rest is good to a step/√12
    angle_std = max(step / np.sqrt(12), 1e-5)
    prior_std = np.r_[
        _DAMPING_STD, _DAMPING_STD, angle_std, angle_std, zero_std, zero_std, go_std,
        _DISK_STD_M, _DISK_STD_M, _DISK_STD_M * omega, _DISK_STD_M * omega, knowledge.log_std,
    ]  # fmt: skip

    def predict(theta: np.ndarray, end_s: float, turn_rad: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        return _readings_of(theta, problem.cut(end_s), knowledge, rest.turned(turn_rad) if turn_rad else rest, begin)

    if run.phase_absolute:
        problem = TransientProblem(readings, predict, start.copy(), prior_std)
        return problem, start
    start, prior_std = np.r_[start, 0.0], np.r_[prior_std, TURN_STD_RAD]
    problem = TransientProblem(readings, with_turn(predict, start[:2]), start.copy(), prior_std)
    return problem, start


def _readings_of(theta: np.ndarray, cut: tuple, knowledge: Knowledge, rest: LockedStart, begin: float):
    """Readings of both encoders and derivatives: θ's start angles are readings, the true ones less by the zeros."""
    count = sum(len(c.time_s) for c in cut)
    if np.max(np.abs(theta[:2])) > 40 or np.max(np.abs(theta[_SUSPENSION])) > 40:
        return np.full(count, np.nan), np.zeros((count, _COUNT))
    now, true, at = laid_over(knowledge, theta[:2], theta[_SUSPENSION]), theta[_START] - theta[_ZEROS], theta[_SHIFT]
    state, by = rest.at(now, true[0], true[1], at)
    state[[0, 1, 4, 5]] += theta[_DISK]
    last = max(float(c.time_s[-1]) for c in cut)
    motion = swing(now, rest.history, state, rest.release_s + at, begin, last)
    if motion is None:
        return np.full(count, np.nan), np.zeros((count, _COUNT))
    start_by, log_by = np.zeros((8, _COUNT)), np.zeros((7, _COUNT))
    start_by[:, _START], start_by[:, _ZEROS] = by[:, :2], -by[:, :2]
    start_by[:, _SHIFT] = by[:, 2] - motion.start_rates  # a later start has moved less
    start_by[[0, 1, 4, 5], [7, 8, 9, 10]] = 1.0
    start_by[:, _SUSPENSION] = by[:, 3:]
    log_by[0, 0] = log_by[1, 1] = 1.0
    log_by[2:, _SUSPENSION] = np.eye(5)
    angle, slope = both_angles(motion, cut, start_by, log_by)
    zero = np.repeat([0, 1], [len(c.time_s) for c in cut])
    slope[np.arange(count), 4 + zero] += 1.0
    return angle + theta[_ZEROS][zero], slope


def _model_table(minimum: Minimum, problem: TransientProblem, end_s: float) -> list[ModelChoice]:
    """The coupled motion beside pendulums on a rotor that does not move: those would stay where they are."""
    cut = problem.cut(end_s)
    held = sum(float(np.sum(((c.value - c.value.mean()) * c.weight) ** 2)) for c in cut)
    n, count = sum(len(c.time_s) for c in cut), len(minimum.theta)
    coupled = float(minimum.residual[:n] @ minimum.residual[:n])
    return [
        ModelChoice(
            "pendulums on a rotor that does not move", 4, held + 8, False, "a release has no motion of its own"
        ),
        ModelChoice("coupled motion of disk and pendulums", count, coupled + 2 * count, True, "the release moves them"),
    ]

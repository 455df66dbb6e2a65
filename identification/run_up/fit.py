"""Run-up and run-down: both resonances, damping ratios and the imbalance from one passage, whatever the ramp's rate.

The full transient is fitted, so there is no sweep-rate bias; the half-power and the Vold–Kalman reading are given
beside it for comparison. Model and estimator: docs/theory/run_up.md.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter

from daq.signals.clock_rates import rate_std_between
from daq.signals.run import Run
from daq.signals.threads import on_one_thread
from identification.curve import Curve
from identification.errors import FitFailed, NotIdentifiable
from identification.laser_wander import wander_sentences
from identification.least_squares import Solution
from identification.ring_down.direction_terms import DirectionTerms
from identification.run_up.bent_passage import KnownSuspension
from identification.run_up.choice import Comparison, compare
from identification.run_up.design import (
    Design,
    design_at,
    excess_covariance,
    imbalance_gains,
    phase_noise_covariance,
)
from identification.run_up.first_solution import Clocks, about_known, first_structure, from_starts, solve
from identification.run_up.forced_oscillator import Drive
from identification.run_up.model import TERMS, RunUpRecord, Structure, run_up_blocks
from identification.run_up.naive import half_power, vold_kalman
from identification.run_up.profile import intervals
from identification.run_up.reported import determined, either, reported, slow_roll_sentences
from identification.run_up.result import RunUpFit, run_up_estimate
from identification.run_up.rotor_phase import RotorPhase
from identification.run_up.sensors import sensor_averages
from identification.run_up.slow_roll_choice import Doubt
from identification.run_up.smallest_model import smallest_adequate
from identification.rungs import Rung, held_back
from identification.samples import correlation_inflation
from identification.setting import Setting, check_setting

__all__ = ["RunUpFit", "fit_run_up", "fit_run_up_run", "run_up_estimate"]

DELAY_STD_S = 10e-3  # between devices that keep clocks of their own
_BLOCKS_PER_TURN = {"fast": 12.0, "balanced": 16.0, "reference": 40.0}
_LEFT_OVER = 0.1  # share of the signal that marks a model that is none
_TOO_QUIET = 0.85  # residuals over noise; chance keeps 200 of them within 5 %
_WANDER = 1e-6  # rad²: a phase that walks farther by itself cannot tell whether the sensors lag
_PAD_S = 0.05
_WILD, _NEIGHBOURS, _MOST_WILD, _ROUNDS = 6.0, 51, 0.2, 6  # standard deviations, blocks, share, fits


@on_one_thread
def fit_run_up(
    time_s: np.ndarray,
    displacement_m: np.ndarray,
    phase_rad: np.ndarray,
    *,
    delay_std_s: float = 0.0,
    setting: Setting = "balanced",
    without: Collection[str] = (),
) -> RunUpFit:
    """Fit a run-up or run-down sampled on one time base.

    Args:
        time_s: shape (n,), ascending, s.
        displacement_m: shape (n, 2), sensors x and y, m; NaN, railed samples and outliers are left out.
        phase_rad: measured rotor phase ψ at the same samples, shape (n,), rad; ψ = 0 has the imbalance along +x. It
            may be wrapped, noisy or quantised; its noise is measured and goes into the intervals.
        delay_std_s: how far the sensors may lag behind the phase (filters, averaging), 1 σ; at 0 a lag is taken for
            none unless the data show it.
        setting: fast skips narrower models and profiles, reference averages least and gives every interval from the
            likelihood's profile.
        without: rungs of the ladder that are not taken (identification.rungs.RUNGS).
    Raises:
        ValueError: no such rung.
        NotIdentifiable: the speed passes no resonance, or too few samples.
        FitFailed: no convergence, or a model that leaves much of the signal.
    Source: docs/theory/run_up.md.
    """
    time, signals = np.asarray(time_s, float), np.asarray(displacement_m, float)
    if signals.shape != (len(time), 2) or np.shape(phase_rad) != (len(time),):
        raise NotIdentifiable(
            f"expected n times, displacements of shape (n, 2) and n phases, got {time.shape}, {signals.shape} and "
            f"{np.shape(phase_rad)}"
        )
    phase = RotorPhase.from_samples(time, np.asarray(phase_rad, float))
    return _fit(
        [(time, signals[:, 0]), (time, signals[:, 1])],
        phase,
        Clocks(delay_std_s, (0.0, 0.0)),
        setting,
        held_back(without),
    )


@on_one_thread
def fit_run_up_run(
    run: Run, *, setting: Setting = "balanced", known: KnownSuspension | None = None, without: Collection[str] = ()
) -> RunUpFit:
    """The same on a recorded run: both sensors on their own clocks, the phase as recorded or from tachometer marks.

    Args:
        known: how the suspension changes with the motion, by ring-downs; f and ζ are then those at zero amplitude.
    Raises:
        NotIdentifiable: fewer than ten marks, or a passage that holds no resonance.
        FitFailed: no convergence, or a model that leaves much of the signal.
    """
    try:
        if len(run.phase_time_s):
            phase = RotorPhase.from_samples(run.phase_time_s, run.phase_rad)
        else:
            phase = RotorPhase.from_marks(run.mark_time_s, run.mark_phase_rad)
    except NotIdentifiable as error:
        raise NotIdentifiable(f"{run.source}: {error}") from error
    x, y = (rate_std_between(run, axis, "phase") for axis in ("x", "y"))
    # a recording made elsewhere has one clock for all, however well its rate is known
    clocks = Clocks(DELAY_STD_S if max(x, y) > 0 else 0.0, (x, y))
    return _fit([(run.x_time_s, run.x_m), (run.y_time_s, run.y_m)], phase, clocks, setting, held_back(without), known)


def _fit(
    sensors: list[tuple[np.ndarray, np.ndarray]],
    phase: RotorPhase,
    clocks: Clocks,
    setting: Setting,
    without: frozenset[Rung],
    known: KnownSuspension | None = None,
) -> RunUpFit:
    check_setting(setting)
    start = max(phase.start_s, *(float(t[0]) for t, _ in sensors))
    end = min(phase.end_s, *(float(t[-1]) for t, _ in sensors))
    if end - start < 1.0:
        raise NotIdentifiable(f"sensors and phase share {max(0.0, end - start):.3g} s; a passage takes longer")
    drive = Drive.from_history(phase.history, start, end)
    pad = _PAD_S if clocks.apart else 0.0
    channels, warnings = [], []
    for name, (time, value) in zip("xy", sensors, strict=True):
        found, told = sensor_averages(
            name, time, value, (start + pad, end - pad), drive.top_rad_s, _BLOCKS_PER_TURN[setting]
        )
        channels.append(found)
        warnings += told
    record = RunUpRecord(channels[0], channels[1], drive)
    slow_roll = "slow-roll" not in without
    structure = first_structure(drive, clocks)
    if known is None:
        structure, solution = from_starts(record, structure, slow_roll)
    else:
        record, structure, solution = about_known(record, structure, known, slow_roll)
    record, solution, told = _without_wild_blocks(record, structure, solution)
    warnings += told
    quieter, told = _noise_of_residuals(record, solution)
    if told:
        record, warnings = quieter, warnings + told
        solution = solve(record, structure, solution.minimum.theta)
    design = design_at(record, structure, solution.minimum.theta)
    lags_known = clocks.apart or phase.wander_density * (end - start) > _WANDER

    def compared(at: Design) -> Comparison:
        return compare(record, at, lags_known, bool(np.isfinite(phase.mark_rad)), setting, without)

    solution, design, comparison, doubt = smallest_adequate(
        record, solution, design, compared, lambda wanted, phi: solve(record, wanted, phi), slow_roll
    )
    return _result(record, phase, solution, design, comparison, doubt, warnings, setting)


def _noise_of_residuals(record: RunUpRecord, solution: Solution) -> tuple[RunUpRecord, list[str]]:
    """The record with the residuals' noise where samples are so sparse that motion was taken for noise."""
    channels, told = [], []
    for name, channel, residual in zip("xy", record.channels, solution.residuals, strict=True):
        ratio = float(np.sqrt(np.mean(residual**2)))
        quiet = ratio < _TOO_QUIET
        noise = channel.noise * (max(ratio, 1e-9) if quiet else 1.0)
        channels.append(replace(channel, noise=noise))
        if quiet:
            told.append(
                f"sensor {name}: differences of neighbouring samples show more than noise, as when they are sparse; "
                f"{noise:.3g} m is taken from the residuals instead, so that χ² is no test of the model"
            )
    return replace(record, x=channels[0], y=channels[1], recent={}), told


def _without_wild_blocks(
    record: RunUpRecord, structure: Structure, solution: Solution
) -> tuple[RunUpRecord, Solution, list[str]]:
    """The fit without the blocks that hold outliers, which sparse samples near a resonance do not tell from motion.

    Wild is what stands off its neighbours' residuals: a model that is wrong there moves them all.
    """
    whole, lost = record, (0, 0)
    for _ in range(_ROUNDS):
        keep = []
        blocks = run_up_blocks(whole, structure, solution.minimum.theta)
        for block, coefficients in zip(blocks, solution.coefficients, strict=True):
            residual = np.abs(block.data - block.basis @ coefficients)
            if residual.max() < _WILD:
                keep.append(np.ones(len(residual), bool))
                continue
            level = median_filter(residual, _NEIGHBOURS) / 0.6745
            keep.append(residual < _WILD * np.maximum(level, 1.0))
        now = tuple(int(np.count_nonzero(~k)) for k in keep)
        if now == lost or max(n / len(k) for n, k in zip(now, keep, strict=True)) > _MOST_WILD:
            break
        lost = now
        record = replace(whole, x=whole.channels[0].where(keep[0]), y=whole.channels[1].where(keep[1]), recent={})
        solution = solve(record, structure, solution.minimum.theta)
    told = [
        f"{n} blocks of sensor {name} left out, which hold what neither motion nor noise explains"
        for name, n in zip("xy", lost, strict=True)
        if n
    ]
    return record, solution, told


def _result(
    record: RunUpRecord,
    phase: RotorPhase,
    solution: Solution,
    design: Design,
    comparison: Comparison,
    doubt: Doubt | None,
    warnings: list[str],
    setting: Setting,
) -> RunUpFit:
    warnings = warnings + comparison.warnings
    curves, correlated, rests = [], 1.0, []
    for axis, channel, residual in zip("xy", record.channels, solution.residuals, strict=True):
        metres = residual / channel.weight
        left = np.sqrt(max(0.0, float(np.var(metres) - np.mean(channel.weight**-2.0))))
        if left > _LEFT_OVER * np.std(channel.value) and left > np.median(1 / channel.weight):
            raise FitFailed(
                f"run-up: beyond noise the model leaves {left / np.std(channel.value):.0%} of sensor {axis}'s signal; "
                "is the phase the rotor's, and were the pendulums locked?"
            )
        correlated = max(correlated, correlation_inflation(residual))
        rests.append((axis, channel, metres))
        curves.append(Curve(f"run-up: {axis}", "m", channel.time_s, channel.value, channel.value - metres))
    slow = wander_sentences(rests)
    warnings += slow
    chi2 = solution.chi2_per_dof
    stretch = None if slow else max(chi2, 1e-3) * correlated**2
    names, values, covariance = _values(record, phase, design, stretch)
    if doubt is not None:
        other = design_at(record, doubt.structure, doubt.solution.minimum.theta)
        values, covariance = either(
            names, (values, covariance), _values(record, phase, other, stretch), doubt.probability
        )
    noise = max(1.0, chi2) * correlated**2
    gains = [gain / noise for gain in imbalance_gains(record, design)]
    keep, told = determined(record.drive, names, values, covariance, (gains[0], gains[1]))
    warnings += told
    if not solution.minimum.converged:
        warnings.append(
            f"the run-up's fit had not settled after {solution.minimum.iterations} iterations; do not quote it"
        )
    if chi2 > 1.3 and not slow:
        warnings.append(
            f"run-up residuals exceed the sensor noise: χ²/dof {chi2:.3g}; standard deviations are scaled up"
        )
    if correlated > 1.0 and not slow:
        warnings.append(f"run-up residuals are correlated; standard deviations are {correlated:.3g} times as long")
    terms, with_terms = _terms(record, phase, design, 1.0 if stretch is None else stretch)
    names, values, covariance = [names[i] for i in keep], values[keep], covariance[np.ix_(keep, keep)]
    warnings += slow_roll_sentences(names, values, covariance)
    naive = {a: half_power(c, record.drive.history) for a, c in zip("xy", record.channels, strict=True)}
    tracked = {a: vold_kalman(c, record.drive.history) for a, c in zip("xy", record.channels, strict=True)}
    fit = RunUpFit(
        dict(zip(names, values.tolist(), strict=True)),
        covariance,
        warnings,
        curves,
        naive,
        [c.noise for c in record.channels],
        chi2,
        tracked,
        {},
        comparison.model,
        comparison.table,
        solution.minimum.converged,
        terms,
        with_terms[keep],
    )
    return replace(fit, intervals=intervals(record, design, fit, setting))


def _terms(
    record: RunUpRecord, phase: RotorPhase, design: Design, stretch: float
) -> tuple[list[DirectionTerms], np.ndarray]:
    """The suspension's terms of each direction, and the covariance of all values with H1, H2, Q1, Q2, shape (n, 4)."""
    jacobian = reported(design, phase.mark_rad)[2]
    if record.bent is None:
        return [], np.zeros((len(jacobian), 4))
    spread = design.structure.spread[TERMS]
    pick = np.pad(spread, ((0, 0), (0, design.unknowns - design.nonlinear)))
    every = np.concatenate([jacobian, pick])
    covariance = every @ design.covariance @ every.T * stretch + phase_noise_covariance(record, phase, design, every)
    own = covariance[len(jacobian) :, len(jacobian) :]
    values, free, out = (
        design.structure.theta(design.phi)[TERMS],
        [bool(row.any()) for row in spread],
        list[DirectionTerms](),
    )
    for mode in range(2):
        at, both = [mode, 2 + mode], np.zeros((4, 4))
        both[2:, 2:] = own[np.ix_(at, at)]
        out.append(DirectionTerms(mode + 1, values[at], both, (free[mode], free[2 + mode]), 0.0))
    return out, covariance[: len(jacobian), len(jacobian) :]


def _values(
    record: RunUpRecord, phase: RotorPhase, design: Design, stretch: float | None
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names, values and covariance of the sensors' noise and the phase's.

    Args:
        stretch: of the variance that white noise gives; None where slow noise counts by its spectrum: it is far from a
            resonance, and what of it counts depends on the number.
    """
    names, values, jacobian = reported(design, phase.mark_rad)
    sensor_part = jacobian @ design.covariance @ jacobian.T
    if stretch is None:
        sensor_part = sensor_part + excess_covariance(record, design, jacobian)
    else:
        sensor_part = sensor_part * stretch
    return names, values, sensor_part + phase_noise_covariance(record, phase, design, jacobian)

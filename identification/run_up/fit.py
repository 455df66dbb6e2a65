"""Fit of a run-up or run-down: both resonances, damping ratios and the imbalance from one passage, for any ramp rate.

The complete transient is fitted, so that the sweep rate causes no bias. The result also contains the half-power and
the Vold–Kalman values for comparison. Model and estimator: docs/theory/run_up.md.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from daq.signals.clock_rates import rate_std_between
from daq.signals.rotor_doubts import phase_jumps
from daq.signals.run import Run
from daq.signals.threads import on_one_thread
from identification.errors import NotIdentifiable, UnexplainedPassage
from identification.least_squares import Solution
from identification.run_up.bent_passage import KnownSuspension
from identification.run_up.choice import ModelSelection, compare
from identification.run_up.contradictions import explained, phase_of
from identification.run_up.design import (
    Design,
    design_at,
)
from identification.run_up.first_solution import Clocks, about_known, first_structure, from_starts, solve
from identification.run_up.fitted_passage import fit_result
from identification.run_up.forced_oscillator import Excitation
from identification.run_up.model import RunUpRecord, Structure, run_up_blocks
from identification.run_up.result import RunUpFit, run_up_estimate
from identification.run_up.rotor_phase import PhaseHistory
from identification.run_up.sensors import sensor_averages
from identification.run_up.smallest_model import smallest_adequate
from identification.rungs import Rung, held_back
from identification.samples import Averages, checked_times
from identification.setting import Setting, check_setting
from identification.typed_scipy import median_filter
from rig_basics.texts import number_of

__all__ = ["RunUpFit", "fit_run_up", "fit_run_up_run", "run_up_estimate"]

DELAY_STD_S = 10e-3  # between devices with separate clocks
_BLOCKS_PER_TURN = {"fast": 12.0, "balanced": 16.0, "reference": 40.0}
_MIN_NOISE_RATIO = 0.85  # residuals over noise; 200 residuals of noise are within 5 % of 1
_MAX_WANDER_RAD2 = 1e-6  # above it, the random walk of the phase hides a lag of the sensors
_PAD_S = 0.05
_OUTLIER_STD, _NEIGHBOURS, _MAX_OUTLIERS, _MAX_ROUNDS = 6.0, 51, 0.2, 6  # standard deviations, blocks, share, fits


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
        displacement_m: displacement of sensors x and y, shape (n, 2), m. NaN, samples at the rail and outliers are left
            out.
        phase_rad: measured rotor phase ψ at the same samples, shape (n,), rad. At ψ = 0 the imbalance points along +x.
            The phase may be wrapped, noisy or quantised. Its noise is estimated and included in the intervals.
        delay_std_s: standard deviation of the sensors' lag behind the phase (filters, averaging), s. For 0, a lag is
            assumed to be absent unless the data require it.
        setting: fast omits narrower models and profiles; reference uses the shortest blocks and takes every interval
            from the profile likelihood.
        without: rungs of the ladder that are not used (identification.rungs.RUNGS).
    Raises:
        ValueError: a name in `without` is not a rung.
        NotIdentifiable: the speed passes no resonance, or there are too few samples.
        FitFailed: the fit did not converge, or the model leaves a large part of the signal.
    Source: docs/theory/run_up.md.
    """
    time, signals = checked_times(time_s), np.asarray(displacement_m, float)
    if signals.shape != (len(time), 2) or np.shape(phase_rad) != (len(time),):
        raise NotIdentifiable(
            f"expected n times, displacements of shape (n, 2) and n phases, got {time.shape}, {signals.shape} and "
            f"{np.shape(phase_rad)}"
        )
    angle = np.asarray(phase_rad, float)
    phase = PhaseHistory.from_samples(time, angle)
    sensors, clocks = [(time, signals[:, 0]), (time, signals[:, 1])], Clocks(delay_std_s, (0.0, 0.0))
    try:
        return _fit(sensors, phase, clocks, setting, held_back(without))
    except UnexplainedPassage as error:
        raise explained(error, sensors, phase, phase_jumps(time, angle)) from error


@on_one_thread
def fit_run_up_run(
    run: Run, *, setting: Setting = "balanced", known: KnownSuspension | None = None, without: Collection[str] = ()
) -> RunUpFit:
    """Fit a recorded run. Each sensor has its own clock; the phase is recorded or comes from tachometer marks.

    Args:
        run: run-up or run-down.
        setting, without: as in fit_run_up.
        known: amplitude dependence of the suspension from ring-downs. f and ζ are then those at zero amplitude.
    Raises:
        ValueError: a name in `without` is not a rung.
        NotIdentifiable: there are fewer than ten marks, or the passage contains no resonance.
        FitFailed: the fit did not converge, or the model leaves a large part of the signal.
    """
    try:
        phase, doubts = phase_of(run)
    except NotIdentifiable as error:
        raise NotIdentifiable(f"{run.source}: {error}") from error
    x, y = (rate_std_between(run, axis, "phase") for axis in ("x", "y"))
    # an imported recording has a common clock for all signals, independent of the uncertainty of its rate
    clocks = Clocks(DELAY_STD_S if max(x, y) > 0 else 0.0, (x, y))
    sensors = [(run.x_time_s, run.x_m), (run.y_time_s, run.y_m)]
    try:
        fit = _fit(sensors, phase, clocks, setting, held_back(without), known)
    except UnexplainedPassage as error:
        raise explained(error, sensors, phase, doubts) from error
    return replace(fit, warnings=[*fit.warnings, *(f"run-up: {doubt.words}" for doubt in doubts)])


def _fit(
    sensors: list[tuple[np.ndarray, np.ndarray]],
    phase: PhaseHistory,
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
    drive = Excitation.from_history(phase.history, start, end)
    pad = _PAD_S if clocks.apart else 0.0
    channels, warnings = list[Averages](), list[str]()
    for name, (time, value) in zip("xy", sensors, strict=True):
        found, remarks = sensor_averages(
            name, time, value, (start + pad, end - pad), drive.top_rad_s, _BLOCKS_PER_TURN[setting]
        )
        channels.append(found)
        warnings += remarks
    record = RunUpRecord(channels[0], channels[1], drive)
    slow_roll = "slow-roll" not in without
    structure = first_structure(drive, clocks)
    if known is None:
        structure, solution = from_starts(record, structure, slow_roll)
    else:
        record, structure, solution = about_known(record, structure, known, slow_roll)
    record, solution, remarks = _without_outlying_blocks(record, structure, solution)
    warnings += remarks
    quieter, remarks = _noise_of_residuals(record, solution)
    if remarks:
        record, warnings = quieter, warnings + remarks
        solution = solve(record, structure, solution.minimum.theta)
    design = design_at(record, structure, solution.minimum.theta)
    lags_known = clocks.apart or phase.wander_density * (end - start) > _MAX_WANDER_RAD2

    def compared(at: Design) -> ModelSelection:
        return compare(record, at, lags_known, bool(np.isfinite(phase.mark_rad)), setting, without)

    solution, design, comparison, doubt = smallest_adequate(
        record, solution, design, compared, lambda wanted, phi: solve(record, wanted, phi), slow_roll
    )
    return fit_result(record, phase, solution, design, comparison, doubt, warnings, setting)


def _noise_of_residuals(record: RunUpRecord, solution: Solution) -> tuple[RunUpRecord, list[str]]:
    """Take the noise from the residuals if samples are so sparse that their differences contain the motion."""
    channels, remarks = list[Averages](), list[str]()
    for name, channel, residual in zip("xy", record.channels, solution.residuals, strict=True):
        ratio = float(np.sqrt(np.mean(residual**2)))
        quiet = ratio < _MIN_NOISE_RATIO
        noise = channel.noise * (max(ratio, 1e-9) if quiet else 1.0)
        channels.append(replace(channel, noise=noise))
        if quiet:
            remarks.append(
                f"sensor {name}: differences of neighbouring samples show more than noise, as when they are sparse; "
                f"{noise:.3g} m is taken from the residuals instead, so that χ² does not test the model"
            )
    return replace(record, x=channels[0], y=channels[1], recent={}), remarks


def _without_outlying_blocks(
    record: RunUpRecord, structure: Structure, solution: Solution
) -> tuple[RunUpRecord, Solution, list[str]]:
    """Fit without blocks that contain outliers, which sparse samples near a resonance do not distinguish from motion.

    A block is an outlier if its residual differs from those of its neighbours. A wrong model would change all of them.
    """
    whole, lost = record, (0, 0)
    for _ in range(_MAX_ROUNDS):
        keep: list[np.ndarray] = []
        blocks = run_up_blocks(whole, structure, solution.minimum.theta)
        for block, coefficients in zip(blocks, solution.coefficients, strict=True):
            residual = np.abs(block.data - block.basis @ coefficients)
            if residual.max() < _OUTLIER_STD:
                keep.append(np.ones(len(residual), bool))
                continue
            level = median_filter(residual, _NEIGHBOURS) / 0.6745
            keep.append(residual < _OUTLIER_STD * np.maximum(level, 1.0))
        now = tuple(int(np.count_nonzero(~k)) for k in keep)
        if now == lost or max(n / len(k) for n, k in zip(now, keep, strict=True)) > _MAX_OUTLIERS:
            break
        lost = now
        record = replace(whole, x=whole.channels[0].where(keep[0]), y=whole.channels[1].where(keep[1]), recent={})
        solution = solve(record, structure, solution.minimum.theta)
    remarks = [
        f"{number_of(n, 'block')} of sensor {name} left out, whose residuals neither motion nor noise explains"
        for name, n in zip("xy", lost, strict=True)
        if n
    ]
    return record, solution, remarks

"""Conversion of a solved passage to its values, their covariance and the warnings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identification.curve import FittedCurve
from identification.errors import UnexplainedPassage
from identification.laser_wander import wander_sentences
from identification.least_squares import Solution
from identification.ring_down.direction_terms import DirectionTerms
from identification.run_up.choice import ModelSelection
from identification.run_up.design import (
    Design,
    design_at,
    excess_covariance,
    imbalance_gains,
    phase_noise_covariance,
)
from identification.run_up.model import TERMS, RunUpRecord
from identification.run_up.naive import half_power, vold_kalman
from identification.run_up.profile import intervals
from identification.run_up.reported import determined, either, reported, slow_roll_sentences
from identification.run_up.result import RunUpFit
from identification.run_up.rotor_phase import PhaseHistory
from identification.run_up.slow_roll_choice import Doubt
from identification.run_up.unmodelled import Unmodelled, unmodelled
from identification.samples import Averages, correlation_inflation
from identification.setting import Setting
from rig_basics.texts import number_of

_MAX_RESIDUAL_RATIO = 0.1  # residual over signal; a model above it is rejected


def fit_result(
    record: RunUpRecord,
    phase: PhaseHistory,
    solution: Solution,
    design: Design,
    comparison: ModelSelection,
    doubt: Doubt | None,
    warnings: list[str],
    setting: Setting,
) -> RunUpFit:
    """Convert a solved passage to a RunUpFit.

    Args:
        record: record of the passage.
        phase: rotor phase with its noise.
        solution: solved fit.
        design: linearised problem at the solution.
        comparison: compared models.
        doubt: the same model with or without a slow roll, if the data do not decide; None if they do.
        warnings: findings so far.
        setting: effort of the fit.
    Raises:
        UnexplainedPassage: the model leaves a large part of the signal.
    """
    curves, rests = _curves(record, solution)
    slow = wander_sentences(rests)
    warnings = [*warnings, *comparison.warnings, *slow]
    correlated = max(1.0, *(correlation_inflation(residual) for residual in solution.residuals))
    chi2 = solution.chi2_per_dof
    stretch = None if slow else max(chi2, 1e-3) * correlated**2
    besides = unmodelled(record, design)
    names, values, covariance = _values_of_both(record, phase, design, doubt, stretch, besides)
    noise = max(1.0, chi2) * correlated**2
    gains = [gain / noise for gain in imbalance_gains(record, design)]
    keep, remarks = determined(record.drive, names, values, covariance, (gains[0], gains[1]))
    warnings += remarks
    warnings += _doubts(solution, correlated, bool(slow))
    warnings += [besides.sentence] if besides else []
    terms, with_terms = _terms(record, phase, design, 1.0 if stretch is None else stretch, besides)
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


def _curves(
    record: RunUpRecord, solution: Solution
) -> tuple[list[FittedCurve], list[tuple[str, Averages, np.ndarray]]]:
    """Return the curves, and the residuals (m) of each sensor with its name and its averages."""
    curves, rests = list[FittedCurve](), list[tuple[str, Averages, np.ndarray]]()
    for axis, channel, residual in zip("xy", record.channels, solution.residuals, strict=True):
        metres = residual / channel.weight
        left = np.sqrt(max(0.0, float(np.var(metres) - np.mean(channel.weight**-2.0))))
        if left > _MAX_RESIDUAL_RATIO * np.std(channel.value) and left > np.median(1 / channel.weight):
            raise UnexplainedPassage(
                f"run-up: beyond noise the model leaves {left / np.std(channel.value):.0%} of sensor {axis}'s signal"
            )
        rests.append((axis, channel, metres))
        curves.append(FittedCurve(f"run-up: {axis}", "m", channel.time_s, channel.value, channel.value - metres))
    return curves, rests


def _doubts(solution: Solution, correlated: float, slow: bool) -> list[str]:
    """Return the warnings about convergence and residuals.

    Args:
        solution: solved fit.
        correlated: factor on the standard deviations from the correlation of the residuals.
        slow: whether slow noise was found, which explains large and correlated residuals.
    """
    warnings: list[str] = []
    chi2 = solution.chi2_per_dof
    if not solution.minimum.converged:
        warnings.append(
            f"the run-up's fit had not settled after {number_of(solution.minimum.iterations, 'iteration')}; "
            f"do not use its values"
        )
    if chi2 > 1.3 and not slow:
        warnings.append(
            f"run-up residuals exceed the sensor noise: χ²/dof {chi2:.3g}; standard deviations are scaled up"
        )
    if correlated > 1.0 and not slow:
        warnings.append(f"run-up residuals are correlated; standard deviations are scaled up by {correlated:.3g}")
    return warnings


def _terms(
    record: RunUpRecord, phase: PhaseHistory, design: Design, stretch: float, besides: Unmodelled | None
) -> tuple[list[DirectionTerms], np.ndarray]:
    """Terms of the suspension for each direction, and covariance of all values with H1, H2, Q1, Q2, shape (n, 4)."""
    jacobian = reported(design, phase.mark_rad)[2]
    if record.bent is None:
        return [], np.zeros((len(jacobian), 4))
    spread = design.structure.spread[TERMS]
    pick = np.pad(spread, ((0, 0), (0, design.unknowns - design.nonlinear)))
    every = np.concatenate([jacobian, pick])
    covariance = every @ design.covariance @ every.T * stretch + phase_noise_covariance(record, phase, design, every)
    covariance += 0.0 if besides is None else besides.covariance(design, every)
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


def _values_of_both(
    record: RunUpRecord,
    phase: PhaseHistory,
    design: Design,
    doubt: Doubt | None,
    stretch: float | None,
    besides: Unmodelled | None,
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names, values and covariance as `_values`, with the model that is not excluded and unmodelled motion."""
    names, values, covariance = _values(record, phase, design, stretch)
    if doubt is not None:
        other = design_at(record, doubt.structure, doubt.solution.minimum.theta)
        values, covariance = either(
            names, (values, covariance), _values(record, phase, other, stretch), doubt.probability
        )
    if besides is not None:
        covariance = covariance + besides.covariance(design, reported(design, phase.mark_rad)[2])
    return names, values, covariance


def _values(
    record: RunUpRecord, phase: PhaseHistory, design: Design, stretch: float | None
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names, values and covariance due to the noise of the sensors and of the phase.

    Args:
        record: record of the passage.
        phase: rotor phase with its noise.
        design: linearised problem at the solution.
        stretch: factor on the variance from white noise; None for slow noise, which counts by its spectrum. Such noise
            is far from a resonance, and its effect differs between the values.
    """
    names, values, jacobian = reported(design, phase.mark_rad)
    sensor_part = jacobian @ design.covariance @ jacobian.T
    if stretch is None:
        sensor_part = sensor_part + excess_covariance(record, design, jacobian)
    else:
        sensor_part = sensor_part * stretch
    return names, values, sensor_part + phase_noise_covariance(record, phase, design, jacobian)

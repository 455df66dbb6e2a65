"""Fit of ring-downs: natural frequencies, damping ratios and the axis angle of the sensors from free decays.

The model is in identification.ring_down.model. Estimator, criteria and intervals: docs/theory/ring_down.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from daq.signals.run import Run
from daq.signals.threads import on_one_thread
from identification.clocks import clock_errors
from identification.errors import IdentificationError, NotIdentifiable
from identification.estimate import Estimate
from identification.mass_slopes import mass_slopes
from identification.ring_down.attempt import BLOCKS_PER_CYCLE, FitOptions
from identification.ring_down.begin import proposed, settled
from identification.ring_down.decay import DecayData, Priors, both_alike, second_mode_gain
from identification.ring_down.disturbances import foreign_mode, without_lines
from identification.ring_down.evidence import (
    DryFriction,
    coarse_remark,
    refuse_line_in_mode,
    refuse_misfit,
    refuse_no_suspension_mode,
    refuse_nothing_rings,
    refuse_too_fast,
)
from identification.ring_down.model import BETA, RATIO
from identification.ring_down.outliers import without_spikes
from identification.ring_down.record import SensorRecord, read_channel
from identification.ring_down.resolution import (
    CLOSE,
    RESOLVED_GAIN,
    WEAK,
    Lone,
    lone_direction,
    not_of_the_pair,
    own_mode_missing,
    resolution,
    stronger_sensor,
)
from identification.ring_down.result import Findings, RingDownFit, result
from identification.rungs import held_back
from identification.setting import Setting, check_setting
from identification.sources import Sources
from identification.work import LIMIT_S, bounded_work
from rig_configs.suspension_terms import TERMS

Axis = Literal["x", "y"]

AXIS_PRIOR_STD = np.radians(3.0)  # standard uncertainty of the sensors' mounting, for a run-up that depends on it
DELAY_STD_S = 3e-3  # between the clocks of two lasers
# a resolved angle has a std below 3°; an angle 10° away therefore costs more than 9 of χ²
_MIN_ANGLE_CHANGE_RAD, _MAX_CHI2_LOSS, _MIN_CHI2_GAIN = np.radians(10.0), 8.0, 4.0
_WEAK_RATIO = 0.5  # amplitude of a sensor over the other's, below which the fit may go on without it
_MAX_RATIO_PULL, _FREE_RATIO_STD = 4.5, 0.3  # standard deviations of the gains' ratio; prior std beyond them


@on_one_thread
def fit_ring_down(
    time_s: np.ndarray,
    displacement_m: np.ndarray,
    mass_kg: float | None = None,
    *,
    setting: Setting = "balanced",
    axis_prior_deg: float = 30.0,
    without: Collection[str] = (),
    axis: Axis = "x",
    notify: Callable[[str], None] | None = None,
) -> RingDownFit:
    """Fit a free decay.

    Args:
        time_s: shape (n,), s, ascending, not necessarily uniform.
        displacement_m: displacement, m; shape (n,) for one sensor and one mode, or (n, 2) for sensors x and y with
            common sample times and two modes. NaN, samples at the rail and outliers are left out. The record may
            contain rest, pull and hold before the release.
        mass_kg: total moving mass, kg. With it the result contains stiffnesses.
        setting: fast, balanced or reference.
        axis_prior_deg: standard deviation of the sensors' rotation against the stiffness axes, deg. The default is so
            wide that the data decide.
        without: rungs of the ladder that are not used (identification.rungs.RUNGS).
        axis: direction of a single sensor, x for direction 1 and y for direction 2.
        notify: called with one line of text for each attempt.
    Raises:
        ValueError: a name in `without` is not a rung.
        NotIdentifiable: the record contains no decay, a decay that is too fast or too short, or damping below noise.
        FitFailed: the fit did not converge, or the model leaves a large part of the signal.
        OutOfWork: the bound of the work (identification.work) was reached before an answer.
    Source: docs/theory/ring_down.md.

    Example:
        >>> import numpy as np
        >>> from identification import fit_ring_down
        >>> time = np.arange(0.0, 20.0, 2e-3)
        >>> noise = np.random.default_rng(1).normal(0.0, 2e-6, len(time))
        >>> fit = fit_ring_down(time, 2e-3 * np.exp(-0.4 * time) * np.cos(19.0 * time) + noise)
        >>> round(fit.values["f1_Hz"], 4), round(fit.values["zeta1"], 4)
        (3.0246, 0.021)
        >>> print(fit)
        RingDownFit: one mode, ...
        name       value ...
    """
    signals = np.asarray(displacement_m, float)
    if signals.ndim not in (1, 2) or (signals.ndim == 2 and signals.shape[1] not in (1, 2)):
        raise NotIdentifiable(f"expected displacements of shape (n,) or (n, 2), got {signals.shape}")
    columns = [signals] if signals.ndim == 1 else list(signals.T)
    priors = Priors(_axis_prior(axis_prior_deg))
    record = [(time_s, column) for column in columns]
    with bounded_work("ring-down", notify, _limit_s(1, setting)):
        return _fit([record], mass_kg, setting, priors, without, "xy" if len(columns) == 2 else axis)


@on_one_thread
def fit_ring_down_runs(
    runs: Sequence[Run],
    mass_kg: float | None = None,
    *,
    setting: Setting = "balanced",
    axis_prior_deg: float = 30.0,
    without: Collection[str] = (),
    notify: Callable[[str], None] | None = None,
) -> RingDownFit:
    """Fit several ring-down runs together. Modes and axis angle are common, amplitudes and laser delay individual.

    Args:
        runs: any number of "ring-down-x" and "ring-down-y" runs.
        mass_kg: total moving mass, kg.
        setting, axis_prior_deg, without, notify: as in fit_ring_down.
    Raises:
        NotIdentifiable, FitFailed, OutOfWork: as in fit_ring_down.
    """
    pairs = [[(run.x_time_s, run.x_m), (run.y_time_s, run.y_m)] for run in runs]
    with bounded_work("ring-down", notify, _limit_s(len(runs), setting)):
        return _fit(pairs, mass_kg, setting, Priors(_axis_prior(axis_prior_deg), delay_s=DELAY_STD_S), without)


def _limit_s(records: int, setting: Setting) -> float:
    """Bound of a fit's work, s: per record, and in proportion to the blocks that a finer setting fits."""
    check_setting(setting)
    return LIMIT_S * records * max(1.0, BLOCKS_PER_CYCLE[setting] / BLOCKS_PER_CYCLE["balanced"])


def ring_down_estimate(run: Run, fit: RingDownFit, mass_kg: float, sources: Sources = ()) -> Estimate:
    """Convert the fit of a run to an Estimate. The clocks of its lasers are shared errors.

    Args:
        run: fitted run.
        fit: its fit.
        mass_kg: total moving mass of the fit, kg.
        sources: logs that were fitted together; by default the run's own.
    """
    sources = sources or (run.source,)
    names = tuple(n for n in ("k1_N_per_m", "k2_N_per_m", "zeta1", "zeta2") if n in fit.values)
    order = [list(fit.values).index(n) for n in names]
    values = np.array([fit.values[n] for n in names])
    own = math.cos(math.radians(run.turn_deg)) ** 2  # share of a direction's motion that its own sensor measures
    of = {"k1_N_per_m": np.array([own, 1 - own]), "k2_N_per_m": np.array([1 - own, own])}
    shares = np.array([of.get(name, np.zeros(2)) for name in names]).T
    slopes = {  # k is proportional to the square of the clock's rate
        axis: 2 * values * share for axis, share in zip(("x", "y"), shares, strict=True) if share.any()
    }
    shared = clock_errors(run, slopes, sources)
    own = fit.covariance[np.ix_(order, order)]
    method = "two coupled decays, separable least squares"
    by_number = mass_slopes(names, values, mass_kg)
    return Estimate(run.test, sources, names, values, own, shared, method, by_number, _with_terms(fit, names))


def _with_terms(fit: RingDownFit, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Term of the suspension that the fit determines → its covariance with the named ones of k1, k2, ζ1, ζ2."""
    out = dict[str, np.ndarray]()
    for found in fit.terms:
        k, zeta = f"k{found.direction}_N_per_m", f"zeta{found.direction}"
        for place, name in enumerate((TERMS[found.direction - 1], TERMS[found.direction + 1])):
            if found.covariance[2 + place, 2 + place] > 0:
                with_f, with_zeta = found.covariance[:2, 2 + place].tolist()
                of = {k: 2 * fit.values.get(k, 0.0) * with_f, zeta: with_zeta}
                out[name] = np.array([of.get(n, 0.0) for n in names])
    return out


def _axis_prior(degrees: float) -> float:
    if not degrees > 0:
        raise NotIdentifiable(
            f"expected axis_prior_deg > 0, a standard deviation, got {degrees!r}; for sensors mounted exactly give 0.1"
        )
    return float(np.radians(degrees))


def _fit(
    records: Sequence[Sequence[tuple[np.ndarray, np.ndarray]]],
    mass: float | None,
    setting: Setting,
    priors: Priors,
    without: Collection[str],
    axes: str = "xy",
) -> RingDownFit:
    if mass is not None and not 0 < mass < np.inf:
        raise NotIdentifiable(f"ring-down: a mass above 0 kg is needed, got {mass:g}; leave it out")
    channels, warnings = _read(records, axes)
    refuse_too_fast(channels)
    valid = tuple(tuple(c.keep for c in own) for own in channels)
    findings = Findings(setting, priors, mass, warnings, held_back(without))
    smooth = tuple(tuple(without_spikes(c)[0] for c in own) for own in channels)
    if "lines" not in findings.without:
        smooth = tuple(tuple(without_lines(c) for c in own) for own in smooth)
    start = proposed(smooth)
    if len(records[0]) == 1:
        return _one_direction(start, valid, findings, "xy".index(axes))
    lone = lone_direction(start)
    if lone is not None:
        return _lone(start, valid, findings, lone)
    before = list(warnings)
    try:
        return _both_directions(start, valid, findings)
    except DryFriction:
        raise
    except IdentificationError as error:
        strong = stronger_sensor(start, _WEAK_RATIO)
        if strong is None:
            raise
        findings.warnings[:] = before
        sentence = f"sensor {'xy'[1 - strong]}, which moves little, is left out; the fit with it failed: {error}"
        try:
            return _lone(start, valid, findings, Lone(strong, sentence))
        except IdentificationError as other:
            raise error from other  # both sensors together show more than one alone


def _lone(start: DecayData, valid: tuple[tuple[np.ndarray, ...], ...], findings: Findings, lone: Lone) -> RingDownFit:
    findings.warnings.append(lone.sentence)
    return _one_direction(start.only(lone.axis), tuple((v[lone.axis],) for v in valid), findings, lone.axis)


def _both_directions(start: DecayData, valid: tuple[tuple[np.ndarray, ...], ...], findings: Findings) -> RingDownFit:
    warnings, priors = findings.warnings, findings.priors
    before = list(warnings)
    plan = FitOptions(True, findings.setting, priors, valid, findings.without)
    fitted, count = plan.without_outliers(settled(start, plan))
    findings.add_outliers(count)
    pull = abs(float(fitted.theta[RATIO])) / priors.ratio
    if pull > _MAX_RATIO_PULL:
        plan = replace(plan, priors=replace(priors, ratio=_FREE_RATIO_STD))
        fitted = plan.again(fitted)
        warnings.append(
            f"the sensors' gains differ by {np.expm1(abs(fitted.theta[RATIO])):.1%}, where {priors.ratio:.1%} was "
            "expected, or the stiffness axes are not at right angles; the axis angle depends on which of both applies"
        )
    fitted = plan.labelled(plan.shortened(fitted))
    refuse_nothing_rings(fitted)
    refuse_misfit(fitted)
    refuse_line_in_mode(fitted)
    refuse_no_suspension_mode(fitted)
    warnings += coarse_remark(fitted)
    gain, single = second_mode_gain(fitted)
    strong = stronger_sensor(start, WEAK)
    foreign = foreign_mode(fitted)
    if foreign is not None:
        warnings[:] = before
        return _lone(start, valid, findings, not_of_the_pair(1 - foreign, float(fitted.omegas[foreign])))
    if gain < RESOLVED_GAIN and strong is not None:
        warnings[:] = before
        return _lone(start, valid, findings, own_mode_missing(strong, True))
    if gain < RESOLVED_GAIN or resolution(fitted, plan.priors, 1.0, gain).split < CLOSE:
        rival = both_alike(fitted, single, plan.priors)
        other = abs(float(rival.theta[BETA] - fitted.theta[BETA])) > _MIN_ANGLE_CHANGE_RAD
        worse = rival.solution.minimum.cost - fitted.solution.minimum.cost
        if gain < RESOLVED_GAIN or worse < -_MIN_CHI2_GAIN or (other and worse < _MAX_CHI2_LOSS):
            fitted, gain = rival, 0.0  # a distant angle fits as well: the angle is not determined
    return result(fitted, findings, ("1", "2"), gain)


def _read(
    records: Sequence[Sequence[tuple[np.ndarray, np.ndarray]]], axes: str
) -> tuple[list[list[SensorRecord]], list[str]]:
    channels, warnings = list[list[SensorRecord]](), list[str]()
    for record in records:
        own: list[SensorRecord] = []
        for sensor, (time, value) in zip(axes, record, strict=True):
            channel, remarks = read_channel(time, value, sensor)
            own.append(channel)
            warnings += remarks
        channels.append(own)
    return channels, warnings


def _one_direction(
    start: DecayData, valid: tuple[tuple[np.ndarray, ...], ...], findings: Findings, axis: int
) -> RingDownFit:
    plan = FitOptions(False, findings.setting, findings.priors, valid, findings.without)
    fitted, count = plan.without_outliers(settled(start, plan))
    findings.add_outliers(count)
    fitted = plan.with_fewest_modes(plan.shortened(fitted))
    refuse_nothing_rings(fitted)
    refuse_misfit(fitted)
    refuse_line_in_mode(fitted)
    refuse_no_suspension_mode(fitted)
    findings.warnings += coarse_remark(fitted)
    if fitted.model.modes == 2:
        findings.warnings.append(
            f"this sensor shows a second mode at {fitted.omegas[1] / (2 * np.pi):#.4g} Hz, which is fitted in addition "
            "to the first; its identification needs both sensors"
        )
    return result(fitted, findings, (str(axis + 1),))

"""Comparison of the nested models of a ring-down by BIC.

BIC = χ²/s + parameters · ln(blocks), where s is the larger of 1 and χ²/dof. Terms beyond the fitted model are judged by
a score test, which yields the reduction of χ² if they were added. Smaller models were judged during model selection.
"""

from __future__ import annotations

import numpy as np

from identification.ring_down.attempt import drift_criteria
from identification.ring_down.backbone import averaged_course
from identification.ring_down.decay import FittedDecay
from identification.ring_down.modes import averaged_decay, rate
from identification.ring_down.residuals import gain_of
from identification.ring_down.resolution import Resolution
from identification.ring_down.scores import known_columns
from identification.samples import Averages
from identification.setting import ModelChoice

_DRIFTS = {0: "offset", 1: "offset and slope", 3: "offset and cubic drift"}
_MIN_BIC_GAIN = 10.0  # very strong evidence
OTHER_LAW = "another law of rates over amplitude"


def model_table(fitted: FittedDecay, found: Resolution | None, terms: str = "") -> list[ModelChoice]:
    """Return a row for the chosen model and for each neighbour.

    The chosen model's `missing` contains the neighbours that were not fitted and are clearly better.

    Args:
        fitted: solved fit.
        found: resolution of a turned pair's axes; None for free modes.
        terms: description of the fitted terms of amplitude.
    """
    base = fitted.model.free + fitted.model.linear
    motion = f"{_motion(fitted, found)}{', ' if terms else ''}{terms}"
    drift = fitted.model.drift
    rows, better = list[ModelChoice](), list[str]()
    for order, criterion in drift_criteria(fitted).items():
        if order != drift:
            channels = sum(len(r.channels) for r in fitted.model.records)
            more = (order - drift) * channels
            rows.append(_row(f"{motion}, {_DRIFTS[order]}", base + more, criterion))
    for name, extra in _additions(fitted).items():
        gain, count = extra
        criterion = count * float(np.log(fitted.count)) - gain / max(1.0, fitted.solution.chi2_per_dof)
        rows.append(_row(f"{motion}, {name}", base + count, criterion))
        if criterion < -_MIN_BIC_GAIN:
            better.append(name)
    why = "smallest model that no larger one improves on"
    if better:
        why = f"but the residuals require more: {' and '.join(better)}"
    return [ModelChoice(f"{motion}, {_DRIFTS[drift]}", base, 0.0, True, why, tuple(better)), *rows]


def _row(name: str, parameters: int, criterion: float) -> ModelChoice:
    why = "not worth its parameters" if criterion >= 0 else "the data require it; not fitted"
    return ModelChoice(name, parameters, float(criterion), False, why)


def _motion(fitted: FittedDecay, found: Resolution | None) -> str:
    if found is not None:
        return "two modes along turned axes" if found.resolved else "two modes along axes that are not resolved"
    return "one mode" if fitted.model.modes == 1 else "two modes in one sensor"


def _additions(fitted: FittedDecay) -> dict[str, tuple[float, int]]:
    """Reduction of χ² and number of parameters of terms that no fit of this package contains."""
    known, residuals = known_columns(fitted)
    lams = [rate(float(w), float(z)) for w, z in zip(fitted.omegas, fitted.zetas, strict=True)]
    out: dict[str, tuple[float, int]] = {}
    bent = [0.0, 0]
    shaped = [0.0, 0]
    for i, (record, columns, residual) in enumerate(zip(fitted.model.records, known, residuals, strict=True)):
        waves = [
            [_wave(fitted, i, mode, t, c) for mode in range(len(lams))]
            for t, c in zip(record.times, record.channels, strict=True)
        ]
        faded = [
            [_faded(fitted, wave, lam, t, c) for wave, lam in zip(own, lams, strict=True)]
            for own, t, c in zip(waves, record.times, record.channels, strict=True)
        ]
        extra = record.scaled(_own_columns(faded))
        bent[0] += gain_of(residual, columns, extra)
        bent[1] += extra.shape[1]
        if fitted.model.turned:
            extra = record.scaled(_own_columns(waves))
            shaped[0] += gain_of(residual, columns, extra)
            shaped[1] += extra.shape[1] // 2
    out["amplitude-dependent rates" if fitted.model.backbone is None else OTHER_LAW] = (bent[0], int(bent[1]))
    if fitted.model.turned:
        out["modes out of phase between sensors"] = (shaped[0], int(shaped[1]))
    return out


def _wave(fitted: FittedDecay, record: int, mode: int, t: np.ndarray, channel: Averages) -> np.ndarray:
    """Motion of a mode for an amplitude of 1."""
    rates, backbone = fitted.model.mode_rates(fitted.theta, mode), fitted.model.backbone
    if backbone is None:
        return averaged_decay(rate(rates.omega, rates.zeta), t, channel.spread_s2)[0]
    return averaged_course(rates, backbone.amplitudes_m[record][mode], t, channel.spread_s2)[0]


def _faded(fitted: FittedDecay, wave: np.ndarray, lam: complex, t: np.ndarray, channel: Averages) -> np.ndarray:
    """Motion of a mode times its decay, a term of second order in its amplitude."""
    if fitted.model.backbone is None:
        return averaged_decay(lam + lam.real, t, channel.spread_s2)[0]
    return wave * np.exp(lam.real * t)


def _own_columns(waves: list[list[np.ndarray]]) -> np.ndarray:
    """Columns with the real and imaginary part of every mode, separate for each channel."""
    out = np.zeros((sum(len(own[0]) for own in waves), 2 * sum(len(w) for w in waves)))
    at = column = 0
    for own in waves:
        for wave in own:
            out[at : at + len(wave), column], out[at : at + len(wave), column + 1] = np.real(wave), np.imag(wave)
            column += 2
        at += len(own[0])
    return out

"""Update of a model with amplitude-dependent rates by a fit of it: amplitudes of the modes, and the exact motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identification.ring_down.backbone import Backbone, averaged_course
from identification.ring_down.exact_motion import lacking
from identification.ring_down.model import BETA, DELAYS, RATIO, DecayModel, DecayRecord, rotation
from rig_basics.arrays import Array

_MIN_AMPLITUDE = 1e-6  # of a mode's amplitude; a sensor with a smaller one does not show the mode


def amplitudes(model: DecayModel, coefficients: Sequence[Array]) -> tuple[tuple[float, ...], ...]:
    """Amplitude of each record and mode at the record's zero, along the mode's direction, m."""
    return tuple(
        tuple(float(np.sqrt(sum(abs(a) ** 2 for a in _own(model, record, c, mode)))) for mode in range(model.modes))
        for record, c in zip(model.records, coefficients, strict=True)
    )


def with_terms(
    model: DecayModel, theta: Array, coefficients: Sequence[Array], taken: tuple[bool, ...]
) -> tuple[DecayModel, Array]:
    """Return a model and its θ with other terms of amplitude (order η1, S1, η2, S2). Rates are constant without any."""
    values = theta[model.tail :] if model.backbone is not None else np.zeros(2 * model.modes)
    records = tuple(replace(record, lacking=()) for record in model.records)
    if not any(taken):
        return replace(model, records=records, backbone=None), theta[: model.tail]
    backbone = Backbone(taken[0::2], taken[1::2], amplitudes(model, coefficients))
    return (
        replace(model, records=records, backbone=backbone),
        np.concatenate([theta[: model.tail], np.where(taken, values, 0.0)]),
    )


def corrected(model: DecayModel, theta: Array, coefficients: Sequence[Array]) -> DecayModel:
    """Return the model with the amplitudes of a fit of it, and with the correction of its averaged motion.

    Args:
        model: fitted model.
        theta, coefficients: result of the fit.
    """
    if model.backbone is None:
        return model
    backbone = replace(model.backbone, amplitudes_m=amplitudes(model, coefficients))
    model = replace(model, backbone=backbone)
    records = tuple(
        replace(record, lacking=_lacking(model, record, i, theta, coefficients[i]))
        for i, record in enumerate(model.records)
    )
    return replace(model, records=records)


def _own(model: DecayModel, record: DecayRecord, c: Array, mode: int) -> list[complex]:
    """Complex amplitudes of a mode: one along its axis for a turned pair, one per channel for free modes."""
    count = 1 if model.turned else len(record.channels)
    return [complex(*c[2 * (i * model.modes + mode) : 2 * (i * model.modes + mode) + 2]) for i in range(count)]


def _lacking(model: DecayModel, record: DecayRecord, index: int, theta: Array, c: Array) -> tuple[Array, ...]:
    backbone = model.backbone
    assert backbone is not None
    mix, _ = rotation(float(theta[BETA]), float(np.exp(theta[RATIO]))) if model.turned else (np.eye(1), None)
    out: list[Array] = []
    for axis, (t, channel) in enumerate(zip(record.times, record.channels, strict=True)):
        own = t - (float(theta[DELAYS + index]) if model.delays and axis else 0.0)
        total = np.zeros(len(t))
        for mode in range(model.modes):
            if not any(backbone.opened[2 * mode : 2 * mode + 2]):
                continue
            rates, level = model.mode_rates(theta, mode), backbone.amplitudes_m[index][mode]
            wave, _ = averaged_course(rates, level, own, channel.spread_s2)
            starts = _own(model, record, c, mode)
            start = starts[0 if model.turned else axis]
            if abs(start) < _MIN_AMPLITUDE * level:
                continue
            part = lacking(rates, start, level / abs(start), own, channel.spread_s2, wave)
            total += part * (mix[axis, mode] if model.turned else 1.0)
        out.append(total)
    return tuple(out)

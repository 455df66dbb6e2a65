"""Start of the fit of a free decay.

A recording may contain rest, a pull and a hold before the release. `release_instant` proposes a start, and the model
corrects it. Windows with large residuals immediately after the start move it forward. Windows before the start move it
back if the decay, continued backwards, explains them as well as its own samples.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import replace
from typing import Protocol

import numpy as np

from identification.errors import IdentificationError, NotIdentifiable
from identification.ring_down.decay import COARSE_S, DecayData, FittedDecay
from identification.ring_down.outliers import sample_residuals
from identification.ring_down.record import SensorRecord
from identification.ring_down.release_instant import release_instant

_log = logging.getLogger(__name__)

_WINDOW_S = 0.05
_MAX_WINDOW_STD = 6.0  # standard deviations of a window's χ²
_MAX_FORWARD_S = 0.8  # for the last touch of a hand; a larger shift indicates a wrong model
_LEVELS = (0.9, 0.7, 0.5, 0.3)
_MAX_CHI2, _MAX_RESIDUAL_RATIO = 25.0, 0.15  # χ²/dof, and residual over signal
_MIN_EXCESS_RATIO = 0.4  # residual over signal before the start that excludes a free decay


class Attempt(Protocol):
    """Fit of a span, from its own start values and from those of a fit of another span."""

    def __call__(self, decay: DecayData, near: FittedDecay | None = None) -> FittedDecay:
        """Fit as Plan.__call__."""
        ...


def proposed(records: tuple[tuple[SensorRecord, ...], ...]) -> DecayData:
    """Return the decay from the estimated release of each record to its end.

    Raises:
        NotIdentifiable: a record contains no motion.
    """
    begins, ends = list[float](), list[float]()
    for channels in records:
        begins.append(max(release_instant([c.averages(COARSE_S) for c in channels]), _start(channels)))
        ends.append(min(float(c.time_s[-1]) for c in channels) + 1e-9)
    return DecayData(records, tuple(begins), tuple(ends))


def _start(channels: tuple[SensorRecord, ...]) -> float:
    """First time with samples in every channel, s."""
    return max(float(c.time_s[np.argmax(c.keep)]) for c in channels)


def settled(decay: DecayData, attempt: Attempt) -> FittedDecay:
    """Fit a decay and correct the start of each record's span.

    Raises:
        IdentificationError: error of the attempt, if no start yields a fit.
    """
    first: FittedDecay | None = None
    failure: IdentificationError | None = None
    for i, candidate in enumerate(_candidates(decay)):
        try:
            fitted = attempt(candidate)
            if i == 0:
                fitted = _whole_again(_forward(fitted, attempt), candidate, attempt)
        except IdentificationError as error:
            failure = failure or error
            continue
        if i == 0 and _is_sound(fitted) and not _misfits_everywhere(fitted):
            return _backward(fitted, attempt)
        if first is not None and _is_sound(fitted) and _skips_other_motion(fitted):
            return _backward(fitted, attempt)
        first = first or fitted
    if first is None:
        raise failure or NotIdentifiable("no begin of the decay was found")
    return first  # a model that misfits everywhere, with a large χ²


def _candidates(decay: DecayData) -> Iterator[DecayData]:
    """Proposed starts, starts of the records, and the last times at several levels of the largest motion."""
    yield decay
    starts = tuple(_start(channels) for channels in decay.records)
    lasts = [_last_times(channels) for channels in decay.records]
    for begins in dict.fromkeys([starts, *zip(*lasts, strict=True)]):
        if begins != decay.begins:
            yield replace(decay, begins=begins)


def _last_times(channels: tuple[SensorRecord, ...]) -> list[float]:
    """Last time at which the channel with the largest motion exceeds each level, s."""
    coarse = [c.averages(5 * COARSE_S) for c in channels]
    moves = [np.abs(c.value - np.median(c.value[3 * len(c.value) // 4 :])) for c in coarse]
    most = int(np.argmax([float(m.max()) for m in moves]))
    move, time = moves[most], coarse[most].time_s
    return [float(time[np.flatnonzero(move >= level * move.max())[-1]]) for level in _LEVELS]


def _forward(fitted: FittedDecay, attempt: Attempt) -> FittedDecay:
    """Move the start forward while the first residuals are large. Return the original fit if this has no effect."""
    original = fitted
    while True:
        late = _early_excess(fitted)
        if not any(late):
            return fitted if _is_sound(fitted) else original
        if max(b - o for b, o in zip(fitted.decay.begins, original.decay.begins, strict=True)) > _MAX_FORWARD_S:
            return original
        begins = tuple(b + n * _WINDOW_S for b, n in zip(fitted.decay.begins, late, strict=True))
        try:
            fitted = attempt(replace(fitted.decay, begins=begins))
        except IdentificationError as error:
            _log.debug("no fit from a later start, the former start is kept: %s", error)
            return original


def _whole_again(fitted: FittedDecay, proposal: DecayData, attempt: Attempt) -> FittedDecay:
    """Return to the proposed start if the shorter fit avoids a wrong minimum of a turned pair there."""
    if not fitted.model.turned:
        return fitted
    for share in (0.5, 1.0):  # half the way first
        begins = tuple(b - share * (b - p) for b, p in zip(fitted.decay.begins, proposal.begins, strict=True))
        if begins == fitted.decay.begins:
            return fitted
        whole = attempt(replace(proposal, begins=begins), fitted)
        if not any(_early_excess(whole)) and _is_sound(whole):
            fitted = whole
    return fitted


def _is_sound(fitted: FittedDecay) -> bool:
    """Whether no window of the record has significantly larger residuals than the record as a whole."""
    for record, residuals in zip(fitted.model.records, fitted.channel_residuals(), strict=True):
        for t, residual in zip(record.times, residuals, strict=True):
            label = np.maximum(np.floor(t / _WINDOW_S), 0).astype(int)
            number = np.bincount(label)
            squares = np.bincount(label, residual**2)
            level = max(1.0, float(np.median(residual**2)) / 0.4549)
            if np.any(squares / level > number + 1.5 * _MAX_WINDOW_STD * np.sqrt(2 * number) + 20):
                return False
    return True


def _misfits_everywhere(fitted: FittedDecay) -> bool:
    """Whether residuals above noise are a large part of a sensor's signal, even if no single window deviates."""
    if fitted.solution.chi2_per_dof < _MAX_CHI2:
        return False
    pairs = zip(fitted.model.records, fitted.plain_residuals(), strict=True)
    return any(
        float(np.std(residual)) > _MAX_RESIDUAL_RATIO * float(np.std(channel.value))
        for record, residuals in pairs
        for channel, residual in zip(record.channels, residuals, strict=True)
    )


def _skips_other_motion(fitted: FittedDecay) -> bool:
    """Whether a record's motion before the start differs strongly from the decay continued backwards.

    A wrong model also fits better to the small motion at the end. In that case the decay continued backwards is nearly
    correct, and a later start would hide the misfit.
    """
    for r, channels in enumerate(fitted.decay.records):
        for axis, channel in enumerate(channels):
            first, last = np.searchsorted(channel.time_s, (_start(channels), fitted.decay.begins[r]))
            kept = channel.keep[first:last]
            if np.count_nonzero(kept) < 20:
                continue
            residual, model = sample_residuals(fitted, r, axis, channel, int(first), int(last))
            size = float(np.sqrt(np.mean(residual[kept] ** 2)))
            excess = size > _MIN_EXCESS_RATIO * float(np.std(model[kept]))
            if excess and size > 10 * channel.noise / np.sqrt(len(residual)):
                return True
    return False


def _early_excess(fitted: FittedDecay) -> list[int]:
    """Number of windows to leave out in each record: up to the last of the first four with large residuals."""
    out: list[int] = []
    for record, residuals in zip(fitted.model.records, fitted.channel_residuals(), strict=True):
        worst = 0
        for t, residual in zip(record.times, residuals, strict=True):
            label = np.maximum(np.floor(t / _WINDOW_S), 0).astype(int)
            later = residual[label >= 4]
            level = max(1.0, float(np.median(later**2)) / 0.4549) if len(later) else 1.0
            for k in range(4):
                own = residual[label == k]
                if len(own) and float(own @ own) / level > len(own) + _MAX_WINDOW_STD * np.sqrt(2 * len(own)) + 12:
                    worst = max(worst, k + 1)
        out.append(worst)
    return out


def _backward(fitted: FittedDecay, attempt: Attempt) -> FittedDecay:
    """Move the start back if the decay, continued backwards, explains the samples before it."""
    for _ in range(4):
        begins = tuple(_earliest(fitted, r) for r in range(len(fitted.decay.records)))
        moved = [b - e for b, e in zip(fitted.decay.begins, begins, strict=True)]
        if max(moved) <= 0:
            return fitted
        earlier = attempt(replace(fitted.decay, begins=begins), fitted)  # its values may avoid a wrong minimum
        if any(_early_excess(earlier)):
            return fitted
        fitted = earlier
    return fitted


def _earliest(fitted: FittedDecay, record: int) -> float:
    """Earliest start from which a record's windows fit, s, with one window of margin except at the record's start."""
    channels, begin = fitted.decay.records[record], fitted.decay.begins[record]
    start = _start(channels)
    if begin <= start:
        return begin
    count = int(np.ceil((begin - start) / _WINDOW_S))
    reach = count
    for axis, channel in enumerate(channels):
        squares, number = _backward_squares(fitted, record, axis, channel, start, count)
        bad = squares > number + _MAX_WINDOW_STD * np.sqrt(2 * number) + 12
        if bad.any():
            reach = min(reach, int(np.argmax(bad)))
    if reach == count:
        return start
    return begin - max(reach - 1, 0) * _WINDOW_S


def _backward_squares(
    fitted: FittedDecay, record: int, axis: int, channel: SensorRecord, start: float, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """χ² and number of means of each window before the start, nearest first.

    Samples are averaged over quarters of a window, which reveals a smaller shift than single samples.
    """
    begin = fitted.decay.begins[record]
    first, last = np.searchsorted(channel.time_s, (start, begin))
    residual, _ = sample_residuals(fitted, record, axis, channel, int(first), int(last))
    kept = channel.keep[first:last]
    label = np.floor((begin - channel.time_s[first:last]) / (_WINDOW_S / 4)).astype(int)
    label = np.clip(label, 0, 4 * count - 1)[kept]
    number = np.bincount(label, minlength=4 * count)
    total = np.bincount(label, residual[kept], 4 * count)
    square = total**2 / np.maximum(number, 1) / channel.noise**2
    return square.reshape(count, 4).sum(axis=1), (number > 0).reshape(count, 4).sum(axis=1)

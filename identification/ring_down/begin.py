"""Where the fit of a free decay begins.

A recording may hold quiet, a pull and a hold before the release. `release_instant` proposes a begin; then the model
itself decides: windows of residuals right after the begin that stand out move it forward, windows before it that the
decay, continued backwards, explains as well as its own samples move it back.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Protocol

import numpy as np

from identification.errors import IdentificationError, NotIdentifiable
from identification.ring_down.decay import COARSE_S, Decay, Fitted
from identification.ring_down.outliers import sample_residuals
from identification.ring_down.record import Channel
from identification.ring_down.release_instant import release_instant

_WINDOW_S = 0.05
_BAD = 6.0  # standard deviations of a window's χ²
_MOST_FORWARD_S = 0.8  # a hand's last touch; what needs more is no release but a wrong model
_LEVELS = (0.9, 0.7, 0.5, 0.3)
_ALL_OFF, _UNEXPLAINED = 25.0, 0.15  # χ²/dof, and residual over signal
_GROSS = 0.4  # of the signal's own size: no free decay


class Attempt(Protocol):
    """A fit on some span, from its own start values and from those of a fit on another span."""

    def __call__(self, decay: Decay, near: Fitted | None = None) -> Fitted:
        """As Plan.__call__."""
        ...


def proposed(records: tuple[tuple[Channel, ...], ...]) -> Decay:
    """The decay from each record's proposed begin to its end.

    Raises:
        NotIdentifiable: nothing moves.
    """
    begins, ends = [], []
    for channels in records:
        begins.append(max(release_instant([c.averages(COARSE_S) for c in channels]), _start(channels)))
        ends.append(min(float(c.time_s[-1]) for c in channels) + 1e-9)
    return Decay(records, tuple(begins), tuple(ends))


def _start(channels: tuple[Channel, ...]) -> float:
    """From when on every channel has samples."""
    return max(float(c.time_s[np.argmax(c.keep)]) for c in channels)


def settled(decay: Decay, attempt: Attempt) -> Fitted:
    """Fit, with each record's begin where the free decay really begins.

    Raises:
        IdentificationError: as the attempt, when no begin gives a fit.
    """
    first: Fitted | None = None
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
        if first is not None and _is_sound(fitted) and _skips_what_is_no_decay(fitted):
            return _backward(fitted, attempt)
        first = first or fitted
    if first is None:
        raise failure or NotIdentifiable("no begin of the decay was found")
    return first  # a model that misfits everywhere; its χ² says so


def _candidates(decay: Decay) -> Iterator[Decay]:
    """The proposed begins, the records' own, and where each record was last at some levels of its largest motion."""
    yield decay
    starts = tuple(_start(channels) for channels in decay.records)
    lasts = [_last_times(channels) for channels in decay.records]
    for begins in dict.fromkeys([starts, *zip(*lasts, strict=True)]):
        if begins != decay.begins:
            yield replace(decay, begins=begins)


def _last_times(channels: tuple[Channel, ...]) -> list[float]:
    """When the channel that moves most was last beyond each level."""
    coarse = [c.averages(5 * COARSE_S) for c in channels]
    moves = [np.abs(c.value - np.median(c.value[3 * len(c.value) // 4 :])) for c in coarse]
    most = int(np.argmax([float(m.max()) for m in moves]))
    move, time = moves[most], coarse[most].time_s
    return [float(time[np.flatnonzero(move >= level * move.max())[-1]]) for level in _LEVELS]


def _forward(fitted: Fitted, attempt: Attempt) -> Fitted:
    """Begin later while the residual right after the begin stands out; back to where it was if that cures nothing."""
    original = fitted
    while True:
        late = _early_excess(fitted)
        if not any(late):
            return fitted if _is_sound(fitted) else original
        if max(b - o for b, o in zip(fitted.decay.begins, original.decay.begins, strict=True)) > _MOST_FORWARD_S:
            return original
        begins = tuple(b + n * _WINDOW_S for b, n in zip(fitted.decay.begins, late, strict=True))
        try:
            fitted = attempt(replace(fitted.decay, begins=begins))
        except IdentificationError:
            return original


def _whole_again(fitted: Fitted, proposal: Decay, attempt: Attempt) -> Fitted:
    """Back to the proposed begin where the fit of less led past a turned pair's wrong minimum there."""
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


def _is_sound(fitted: Fitted) -> bool:
    """Whether no window anywhere stands out from the record's usual residuals."""
    for record, residuals in zip(fitted.model.records, fitted.channel_residuals(), strict=True):
        for t, residual in zip(record.times, residuals, strict=True):
            label = np.maximum(np.floor(t / _WINDOW_S), 0).astype(int)
            number = np.bincount(label)
            squares = np.bincount(label, residual**2)
            level = max(1.0, float(np.median(residual**2)) / 0.4549)
            if np.any(squares / level > number + 1.5 * _BAD * np.sqrt(2 * number) + 20):
                return False
    return True


def _misfits_everywhere(fitted: Fitted) -> bool:
    """Whether much of a sensor's signal is left, and not as noise: then no window need stand out."""
    if fitted.solution.chi2_per_dof < _ALL_OFF:
        return False
    pairs = zip(fitted.model.records, fitted.plain_residuals(), strict=True)
    return any(
        float(np.std(residual)) > _UNEXPLAINED * float(np.std(channel.value))
        for record, residuals in pairs
        for channel, residual in zip(record.channels, residuals, strict=True)
    )


def _skips_what_is_no_decay(fitted: Fitted) -> bool:
    """Whether what lies before the begin differs grossly from the decay continued backwards, in some record.

    A wrong model also fits better where little is left of the motion; but then the decay continued backwards is nearly
    right, and leaving its best part out would hide the misfit.
    """
    for r, channels in enumerate(fitted.decay.records):
        for axis, channel in enumerate(channels):
            first, last = np.searchsorted(channel.time_s, (_start(channels), fitted.decay.begins[r]))
            kept = channel.keep[first:last]
            if np.count_nonzero(kept) < 20:
                continue
            residual, model = sample_residuals(fitted, r, axis, channel, int(first), int(last))
            size = float(np.sqrt(np.mean(residual[kept] ** 2)))
            if size > _GROSS * float(np.std(model[kept])) and size > 10 * channel.noise / np.sqrt(len(residual)):
                return True
    return False


def _early_excess(fitted: Fitted) -> list[int]:
    """Per record how many windows to leave out: through the last of the first four that stands out."""
    out = []
    for record, residuals in zip(fitted.model.records, fitted.channel_residuals(), strict=True):
        worst = 0
        for t, residual in zip(record.times, residuals, strict=True):
            label = np.maximum(np.floor(t / _WINDOW_S), 0).astype(int)
            later = residual[label >= 4]
            level = max(1.0, float(np.median(later**2)) / 0.4549) if len(later) else 1.0
            for k in range(4):
                own = residual[label == k]
                if len(own) and float(own @ own) / level > len(own) + _BAD * np.sqrt(2 * len(own)) + 12:
                    worst = max(worst, k + 1)
        out.append(worst)
    return out


def _backward(fitted: Fitted, attempt: Attempt) -> Fitted:
    """Begin earlier where the decay, continued backwards, explains the samples before its begin."""
    for _ in range(4):
        begins = tuple(_earliest(fitted, r) for r in range(len(fitted.decay.records)))
        moved = [b - e for b, e in zip(fitted.decay.begins, begins, strict=True)]
        if max(moved) <= 0:
            return fitted
        earlier = attempt(replace(fitted.decay, begins=begins), fitted)  # it may have led past a wrong minimum
        if any(_early_excess(earlier)):
            return fitted
        fitted = earlier
    return fitted


def _earliest(fitted: Fitted, record: int) -> float:
    """How far back a record's windows fit; one window of margin unless the record itself begins there."""
    channels, begin = fitted.decay.records[record], fitted.decay.begins[record]
    start = _start(channels)
    if begin <= start:
        return begin
    count = int(np.ceil((begin - start) / _WINDOW_S))
    reach = count
    for axis, channel in enumerate(channels):
        squares, number = _backward_squares(fitted, record, axis, channel, start, count)
        bad = squares > number + _BAD * np.sqrt(2 * number) + 12
        if bad.any():
            reach = min(reach, int(np.argmax(bad)))
    if reach == count:
        return start
    return begin - max(reach - 1, 0) * _WINDOW_S


def _backward_squares(
    fitted: Fitted, record: int, axis: int, channel: Channel, start: float, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """χ² and number of means of each window before the begin, the nearest first.

    Samples are averaged over a window's quarters first: a shift of a mean shows long before single samples do.
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

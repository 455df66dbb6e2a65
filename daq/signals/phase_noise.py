"""Noise of the readings of a rotor's phase: an encoder's steps, white noise, and the wander of an integrated speed."""

from __future__ import annotations

import math

import numpy as np

from daq.signals.run import Run
from rig_basics.arrays import Array
from rig_basics.units import TO_RPM

_FILE_ROUNDING = 20.0  # smallest ratio of an encoder's step to the rounding of a file's digits
_STRIDE = 32
_THIRD, _THIRD_WALK, _THIRD_WORST = 20.0, 6.0, 64.0  # variance of a third difference: white, walk, worst rounding
_MIN_READINGS, _MAX_READINGS = 400, 20_000
_MIN_STEP_RAD, _MIN_WANDER_RAD = 3e-4, 1e-4  # reported sizes: a step, and the wander of the phase in one second
_SEGMENT, _MIN_FREQUENCY, _ORDERS = 512, 0.02, 8.0  # readings; of the sampling rate; of the rotor's frequency
_MIN_DEVIATIONS = 8.0  # standard deviations of the density of a walk
_MIN_TURN_RAD, _STEPS = 2e-3, 6  # angle, and encoder steps, by which a rotor at rest has turned


def encoder_step(angle_rad: Array) -> float:
    """Return the step of a quantised angle, rad; 0 if its values are not on a grid.

    First and second differences are whole steps; among thousands of them some are a single step.
    """
    differences = np.sort(np.concatenate([np.abs(np.diff(angle_rad, order)) for order in (1, 2)]))
    moving = differences[differences > 1e-9]
    if len(moving) == 0:
        return 0.0
    leaps = moving[1:] / moving[:-1]
    widest = int(np.argmax(leaps)) if len(leaps) else 0
    if widest < 0.5 * len(leaps) and leaps[widest] > _FILE_ROUNDING:
        moving = moving[widest + 1 :]  # smaller values are the rounding of the file's digits
    smallest = float(np.min(moving))
    small = moving[moving < 20.5 * smallest]
    counts = np.round(small / smallest)
    step = float(small @ counts / (counts @ counts))  # a file's rounding averages out
    off = np.abs(small / step - counts)
    if len(small) < 0.2 * len(moving) or np.mean(off < 0.1) < 0.98:
        return 0.0
    return step


def white_and_walk(phase_rad: Array, step_rad: float, apart_s: float) -> tuple[float, float]:
    """Return the white variance of one reading in addition to its steps, rad², and the density of a walk, rad²/s.

    A third difference over k samples has twenty times the white variance for any k, and 6 k times that of a walk. The
    density is 0 if no walk is found.

    Args:
        phase_rad: readings of a smooth motion at even intervals, shape (n,).
        step_rad: step of the encoder; 0 without encoder.
        apart_s: time between readings, s.
    """
    near, far = (_third(phase_rad, k) for k in (1, _STRIDE))
    most = (_THIRD_WORST if step_rad else 2 * _THIRD) * (step_rad**2 / 12 if step_rad else near / _THIRD)
    if far > most:
        walk = max(0.0, far - near) / (_THIRD_WALK * (_STRIDE - 1))
        return max(0.0, near - _THIRD_WALK * walk) / _THIRD, walk / apart_s
    return max(0.0, near / _THIRD - step_rad**2 / 12), 0.0


def _third(value: Array, stride: int) -> float:
    """Mean square of third differences over `stride` readings, with outliers clipped."""
    third = (
        value[3 * stride :] - 3 * value[2 * stride : -stride] + 3 * value[stride : -2 * stride] - value[: -3 * stride]
    )
    robust = float(np.median(np.abs(third))) / 0.6745
    return float(np.mean(np.clip(np.abs(third), 0, 6 * robust if robust else np.inf) ** 2))


def phase_remarks(run: Run, turns: bool) -> list[str]:
    """Return sentences on the noise of a run's phase readings; empty for marks and for readings with little noise.

    Args:
        turns: True if the rotor turns in this test.
    """
    known = np.isfinite(run.phase_rad)
    time, phase = run.phase_time_s[known][:_MAX_READINGS], run.phase_rad[known][:_MAX_READINGS]
    if len(time) < _MIN_READINGS or not np.all(np.diff(time) > 0):
        return []
    step = encoder_step(np.diff(phase) if turns else phase)
    if not turns:
        return _at_rest(run.phase_time_s[known], run.phase_rad[known], step)
    if step > _MIN_STEP_RAD:  # a phase that is read in steps was not integrated
        return [f"the rotor's phase is read in steps of {math.degrees(step):.2g}°; its rounding counts as noise"]
    apart = float(np.median(np.diff(time)))
    walk = _integrated(phase, apart)
    if walk * apart < step**2 / 12 or math.sqrt(walk) <= _MIN_WANDER_RAD:  # the digits of a file may beat as slowly
        return []
    noise = math.sqrt(walk / apart) * TO_RPM
    return [
        f"the rotor's phase wanders like an integrated speed with {noise:.2g} rpm of noise in each reading, by "
        f"{math.degrees(math.sqrt(walk)):.2g}° in a second; it is left open within that"
    ]


def _integrated(phase: Array, apart_s: float) -> float:
    """Return the density of a random walk in a phase, rad²/s; 0 if none is significant.

    The increments of a walk have a flat spectrum, those of white noise a spectrum proportional to 4 sin²(πf) of the
    sampling rate. Both levels are medians over bands above the rotor's first orders. Ripple in narrow lines hardly
    changes a median.
    """
    increments = np.diff(phase)
    turn = abs(float(np.median(increments))) / (2 * math.pi)  # revolutions per reading
    segments = len(increments) // _SEGMENT
    if segments < 1:
        return 0.0
    parts = increments[: segments * _SEGMENT].reshape(segments, _SEGMENT)
    at = np.arange(_SEGMENT) - 0.5 * (_SEGMENT - 1)
    parts = parts - parts.mean(axis=1, keepdims=True)
    parts = parts - np.outer(parts @ at / float(at @ at), at)
    window = np.hanning(_SEGMENT)
    power = np.abs(np.fft.rfft(parts * window, axis=1)) ** 2 / float(np.sum(window**2))
    frequency = np.fft.rfftfreq(_SEGMENT)
    white = 4 * np.sin(math.pi * frequency) ** 2
    first = max(_MIN_FREQUENCY, _ORDERS * turn)
    low, high = (frequency > first) & (frequency < first + 0.06), (frequency > 0.2) & (frequency < 0.3)
    if first > 0.12:
        return 0.0
    (low_level, low_std), (high_level, high_std) = (_level(power[:, band]) for band in (low, high))
    share = float(np.mean(white[low]) / np.mean(white[high]))
    walk, std = (low_level - share * high_level) / (1 - share), math.hypot(low_std, share * high_std) / (1 - share)
    return walk / apart_s if walk > _MIN_DEVIATIONS * std else 0.0


def _level(power: Array) -> tuple[float, float]:
    """Mean of a band's spectrum from its median, and its standard deviation; windowing reduces the data by a third."""
    level = float(np.median(power)) / math.log(2)
    return level, level * math.sqrt(2 * 1.5 / power.size)


def _at_rest(time: Array, phase: Array, step: float) -> list[str]:
    """Return a sentence if the rotor turned in a test at rest."""
    many = max(1, len(time) // 20)
    turned = float(np.median(phase[-many:]) - np.median(phase[:many]))
    white = float(np.median(np.abs(np.diff(phase)))) / 0.95
    if abs(turned) < max(_MIN_TURN_RAD, _STEPS * step, _STEPS * white):
        return []
    rpm = turned / float(np.median(time[-many:]) - np.median(time[:many])) * TO_RPM
    return [
        f"the rotor turned at {abs(rpm):.2g} rpm, by {math.degrees(abs(turned)):.2g}°, in a test at rest; damping "
        "counts against the disk, directions are those of the sensors"
    ]

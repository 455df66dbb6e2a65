# pyright: strict
"""What the readings of a rotor's phase are worth: an encoder's steps, white noise, and an integrated speed's wander."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from daq.signals.run import Run

Array = NDArray[np.float64]

_FILE_ROUNDING = 20.0  # an encoder's step is at least so many times what a file's digits leave open
_STRIDE = 32
_THIRD, _THIRD_WALK, _THIRD_WORST = 20.0, 6.0, 64.0  # variance of a third difference: white, a walk, a rounding's most
_FEWEST, _MOST = 400, 20_000  # readings
_LEAST_STEP_RAD, _LEAST_WANDER_RAD = 3e-4, 1e-4  # worth a remark: a step, what the phase wanders in a second
_SEGMENT, _LOWEST, _ORDERS, _CLEARLY = 512, 0.02, 8.0, 8.0  # readings; of their rate; of the rotor; std of a walk
_LEAST_TURN_RAD, _STEPS = 2e-3, 6  # by which a rotor that should rest has turned; and steps of its encoder


def encoder_step(angle_rad: Array) -> float:
    """The step of a quantised angle, rad; 0 when its values lie on no grid.

    First and second differences are whole steps; among thousands of them some are a single one.
    """
    differences = np.sort(np.concatenate([np.abs(np.diff(angle_rad, order)) for order in (1, 2)]))
    moving = differences[differences > 1e-9]
    if len(moving) == 0:
        return 0.0
    leaps = moving[1:] / moving[:-1]
    widest = int(np.argmax(leaps)) if len(leaps) else 0
    if widest < 0.5 * len(leaps) and leaps[widest] > _FILE_ROUNDING:
        moving = moving[widest + 1 :]  # below are the digits that a file kept, not the encoder
    smallest = float(np.min(moving))
    small = moving[moving < 20.5 * smallest]
    counts = np.round(small / smallest)
    step = float(small @ counts / (counts @ counts))  # a file's rounding averages out
    off = np.abs(small / step - counts)
    if len(small) < 0.2 * len(moving) or np.mean(off < 0.1) < 0.98:
        return 0.0
    return step


def white_and_walk(phase_rad: Array, step_rad: float, apart_s: float) -> tuple[float, float]:
    """Variance of one reading's white noise beyond its steps (rad²), and density of a walk (rad²/s), 0 where none is.

    A third difference over k samples has twenty times the white variance whatever k, and six k times a walk's.

    Args:
        phase_rad: readings of a smooth motion, even in time, shape (n,).
        step_rad: of the encoder; 0 without one.
        apart_s: between readings.
    """
    near, far = (_third(phase_rad, k) for k in (1, _STRIDE))
    most = (_THIRD_WORST if step_rad else 2 * _THIRD) * (step_rad**2 / 12 if step_rad else near / _THIRD)
    if far > most:
        walk = max(0.0, far - near) / (_THIRD_WALK * (_STRIDE - 1))
        return max(0.0, near - _THIRD_WALK * walk) / _THIRD, walk / apart_s
    return max(0.0, near / _THIRD - step_rad**2 / 12), 0.0


def _third(value: Array, stride: int) -> float:
    """Mean square of third differences over so many readings, without the few that stand out."""
    third = (
        value[3 * stride :] - 3 * value[2 * stride : -stride] + 3 * value[stride : -2 * stride] - value[: -3 * stride]
    )
    robust = float(np.median(np.abs(third))) / 0.6745
    return float(np.mean(np.clip(np.abs(third), 0, 6 * robust if robust else np.inf) ** 2))


def phase_remarks(run: Run, turns: bool) -> list[str]:
    """What a reader should know of the readings of a run's phase, sentences; of marks and sound readings nothing.

    Args:
        turns: whether the rotor is meant to turn.
    """
    known = np.isfinite(run.phase_rad)
    time, phase = run.phase_time_s[known][:_MOST], run.phase_rad[known][:_MOST]
    if len(time) < _FEWEST or not np.all(np.diff(time) > 0):
        return []
    step = encoder_step(np.diff(phase) if turns else phase)
    if not turns:
        return _at_rest(run.phase_time_s[known], run.phase_rad[known], step)
    if step > _LEAST_STEP_RAD:  # what is read in steps was not integrated
        return [f"the rotor's phase is read in steps of {math.degrees(step):.2g}°; its rounding counts as noise"]
    apart = float(np.median(np.diff(time)))
    walk = _integrated(phase, apart)
    if walk * apart < step**2 / 12 or math.sqrt(walk) <= _LEAST_WANDER_RAD:  # digits of a file may beat as slowly
        return []
    noise = math.sqrt(walk / apart) * 30 / math.pi
    return [
        f"the rotor's phase wanders like an integrated speed with {noise:.2g} rpm of noise in each reading, by "
        f"{math.degrees(math.sqrt(walk)):.2g}° in a second; it is left open within that"
    ]


def _integrated(phase: Array, apart_s: float) -> float:
    """Density of a random walk in a phase, rad²/s; 0 where none stands out.

    The increments of a walk have a flat spectrum, those of white noise one with 4 sin²(πf) of the sampling rate; both
    are read from medians over bands above the rotor's first orders, which ripple in narrow lines hardly changes.
    """
    increments = np.diff(phase)
    turn = abs(float(np.median(increments))) / (2 * math.pi)  # revolutions a reading
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
    first = max(_LOWEST, _ORDERS * turn)
    low, high = (frequency > first) & (frequency < first + 0.06), (frequency > 0.2) & (frequency < 0.3)
    if first > 0.12:
        return 0.0
    (low_level, low_std), (high_level, high_std) = (_level(power[:, band]) for band in (low, high))
    share = float(np.mean(white[low]) / np.mean(white[high]))
    walk, std = (low_level - share * high_level) / (1 - share), math.hypot(low_std, share * high_std) / (1 - share)
    return walk / apart_s if walk > _CLEARLY * std else 0.0


def _level(power: Array) -> tuple[float, float]:
    """Mean of a band's spectrum by its median, and its standard deviation; windowed segments lose a third."""
    level = float(np.median(power)) / math.log(2)
    return level, level * math.sqrt(2 * 1.5 / power.size)


def _at_rest(time: Array, phase: Array, step: float) -> list[str]:
    """Of a rotor that should stand still."""
    many = max(1, len(time) // 20)
    turned = float(np.median(phase[-many:]) - np.median(phase[:many]))
    white = float(np.median(np.abs(np.diff(phase)))) / 0.95
    if abs(turned) < max(_LEAST_TURN_RAD, _STEPS * step, _STEPS * white):
        return []
    rpm = turned / float(np.median(time[-many:]) - np.median(time[:many])) * 30 / math.pi
    return [
        f"the rotor turned at {abs(rpm):.2g} rpm, by {math.degrees(abs(turned)):.2g}°, in a test at rest; damping "
        "counts against the disk, directions are those of the sensors"
    ]

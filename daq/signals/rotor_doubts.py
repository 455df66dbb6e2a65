"""What contradicts the phase of a rotor or the closed locks of its pendulums: in a log's events, and in the data."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from daq.drivers.index_marks import LOST_DEVIATION, NEIGHBOURS_RATIO, MarkSequence
from daq.log import Log
from daq.signals.run_clocks import since_start
from rig_basics.arrays import Array
from rig_basics.texts import number_of

Kind = Literal[
    "doubled marks", "missing turns", "time step", "phase jump", "encoder jump", "moved pendulum", "other order"
]
_WORDS: dict[Kind, str] = {
    "doubled marks": "{marks} came twice within {ms:.1f} ms{mended}, the first",
    "missing turns": "{turns} not counted{mended}",
    "time step": "the clock of the index marks stepped by {ms:+.1f} ms{mended}",
    "phase jump": "the phase jumps by {degrees:+.1f}°",
    "encoder jump": "encoder {pendulum} jumps by {degrees:+.1f}° in one sample (slipped on its shaft, or misread)",
    "moved pendulum": "pendulum {pendulum} moved by {degrees:+.1f}° in its lock, first",
    "other order": "the displacement turns at {size:.3f} times the speed of the phase: that of another rotor",
}

_TURN_RAD = 2 * np.pi
_WHOLE = 1e-6  # turns, of rounding errors
# Play of a closed lock, as in daq.acquisition.lock_positions.
_PLAY_RAD = np.radians(1.0)
# The angles in the first seconds of a record are those of the locks.
_FIRST_S = 1.0
_WRAPPED_RAD = 2.2 * np.pi  # range of a phase that is known within a turn only
_LEAST_JUMP_RAD = 0.1
_LEAST_ENCODER_JUMP_RAD = 0.05  # above the noise of any encoder
_PUSH_RAD_S2 = 2e3  # twice the acceleration of a pendulum by a quick flick, 10 rad/s in 10 ms
_STEPS_EACH_SIDE = 2  # steps of a phase before and after a step, whose median speed is that without a jump
_GAP_STEPS = 1.5  # steps of the samples; over a gap a flick changes the speed unseen
_JUMP_SPREADS = 20.0  # median deviations of the steps, which contain the noise of the phase
_PER_TURN, _MIN_TURNS = 16, 16
_OF_ROTOR = 0.05  # distance from the order 1, and largest share of the peak, of a response to the rotor itself


@dataclass(frozen=True)
class RotorDoubt:
    """A contradiction of phase, time or locks.

    Attributes:
        kind: what is contradicted.
        size: s for marks and time steps, turns for missing turns, rad for jumps and pendulums, the order for others.
        at_s: time since the run's start, s; NaN for the whole record.
        count: number of such findings; the size is then the largest.
        mended: whether the times and phases of the run are free of it.
        pendulum: "A" or "B"; empty for other kinds.
    """

    kind: Kind
    size: float
    at_s: float
    count: int = 1
    mended: bool = False
    pendulum: str = ""

    @property
    def words(self) -> str:
        """The finding as text."""
        words = _WORDS[self.kind].format(
            marks=number_of(self.count, "index mark"),
            turns=number_of(round(self.size), "turn was", "turns were") if math.isfinite(self.size) else "",
            size=self.size,
            ms=1e3 * self.size,
            degrees=np.degrees(self.size),
            count=self.count,
            pendulum=self.pendulum,
            mended=" (corrected)" if self.mended else "",
        )
        return f"{words} at {self.at_s:.2f} s" if np.isfinite(self.at_s) else words


def doubts_of_events(log: Log, device: str, start_s: float) -> tuple[RotorDoubt, ...]:
    """Return the doubts that the events of a device state; the samples after them are corrected already."""
    events = [e for e in log.events if e.get("device") == device and "time_ns" in e]
    return tuple(doubt for event in events for doubt in _of_event(event, start_s))


def _of_event(event: Mapping[str, Any], start_s: float) -> Iterable[RotorDoubt]:
    at_s = float(since_start(np.array([event["time_ns"]], np.int64), start_s)[0])
    if event["kind"] == "marks" and event.get("doubled_marks"):
        yield RotorDoubt("doubled marks", float(event["span_s"]), at_s, int(event["doubled_marks"]), mended=True)
    if event["kind"] == "clock" and event.get("clock_steps"):
        yield RotorDoubt("time step", float(event["step_s"]), at_s, mended=True)


def sound_marks(time_s: Array, phase_rad: Array) -> tuple[Array, Array, tuple[RotorDoubt, ...]]:
    """Return index marks without bounces, with turns that were not counted, and what was found.

    Args:
        time_s, phase_rad: time and phase of each mark, shape (n,). Phases between whole turns are left alone.
    """
    places = (phase_rad - phase_rad[:1]) / _TURN_RAD
    if len(time_s) < 4 or not np.allclose(places, np.rint(places), atol=_WHOLE):
        return time_s, phase_rad, ()
    sequence, doubts, added = MarkSequence("", {}), list[RotorDoubt](), np.zeros(len(time_s), np.int64)
    turns = np.rint(places).astype(np.int64)
    times_ns = np.rint((time_s - time_s[0]) * 1e9).astype(np.int64)
    keep, numbers, before_s = np.ones(len(time_s), bool), turns.copy(), float(time_s[0])
    for i, (at_ns, turn) in enumerate(zip(times_ns.tolist(), turns.tolist(), strict=True)):
        number, events = sequence.feed(at_ns, turn, at_ns)
        keep[i] = number is not None
        numbers[i] = turn if number is None else number
        if number is None:
            doubts.append(RotorDoubt("doubled marks", float(time_s[i]) - before_s, float(time_s[i]), mended=True))
            continue
        for lost in (int(event.facts["turns"]) for event in events if "turns" in event.facts):
            added[i - 1 :] += lost
            doubts.append(RotorDoubt("missing turns", lost, before_s, mended=True))
        before_s = float(time_s[i])
    times: Array = time_s[keep]
    phases: Array = phase_rad[0] + _TURN_RAD * (numbers + added)[keep]
    return times, phases, (*_counted(doubts), *_time_steps(times, phases))


def _counted(doubts: list[RotorDoubt]) -> list[RotorDoubt]:
    """Return one doubt for all doubled marks, and the others."""
    doubled = [doubt for doubt in doubts if doubt.kind == "doubled marks"]
    others = [doubt for doubt in doubts if doubt.kind != "doubled marks"]
    if not doubled:
        return others
    size = max(doubt.size for doubt in doubled)
    return [RotorDoubt("doubled marks", size, doubled[0].at_s, len(doubled), mended=True), *others]


def _time_steps(time_s: Array, phase_rad: Array) -> list[RotorDoubt]:
    """Return where the time between two marks is no whole number of turns, although the turns around it are even."""
    turn_s = np.diff(time_s) / np.maximum(np.diff(phase_rad) / _TURN_RAD, 1e-9)
    before, between, after = turn_s[:-2], turn_s[1:-1], turn_s[2:]
    even = np.maximum(before, after) <= NEIGHBOURS_RATIO * np.minimum(before, after)
    expected = np.sqrt(before * after)
    found = np.flatnonzero(even & (np.abs(between - expected) > LOST_DEVIATION * expected))
    counted = np.diff(phase_rad)[1:-1] / _TURN_RAD
    return [
        RotorDoubt("time step", float((between[i] - expected[i]) * counted[i]), float(time_s[i + 2]))
        for i in found.tolist()
    ]


def phase_jumps(time_s: Array, phase_rad: Array) -> list[RotorDoubt]:
    """Return the jumps of a phase that is sampled many times in a turn: its steps against those around them."""
    good = np.isfinite(phase_rad) & np.isfinite(time_s)
    time, phase = time_s[good], phase_rad[good]
    if len(phase) and np.ptp(phase) < _WRAPPED_RAD:
        phase = np.unwrap(phase)
    return [RotorDoubt("phase jump", size, at_s) for size, at_s in _jumps(time, phase, _LEAST_JUMP_RAD)]


def encoder_jumps(time_s: Array, angle_rad: Array) -> list[RotorDoubt]:
    """Return the jumps of the pendulums' angles between two samples, shapes (n,) and (n, 2), outside of gaps."""
    found: list[RotorDoubt] = []
    for name, angle in zip("AB", angle_rad.T, strict=False):
        good = np.isfinite(angle)
        step_s = float(np.median(np.diff(time_s[good]))) if np.count_nonzero(good) > 1 else 0.0
        least_rad = max(_LEAST_ENCODER_JUMP_RAD, _PUSH_RAD_S2 * step_s**2)
        for size, at_s in _jumps(time_s[good], angle[good], least_rad):
            found.append(RotorDoubt("encoder jump", size, at_s, pendulum=name))
    return found


def _jumps(time_s: Array, phase_rad: Array, least_rad: float) -> list[tuple[float, float]]:
    """Return size and instant of the steps of a phase that the steps around them contradict, outside of gaps."""
    passed = np.diff(time_s)
    if len(time_s) < 8 or np.any(passed <= 0):
        return []
    speed = np.diff(phase_rad) / passed
    usual = np.median(np.lib.stride_tricks.sliding_window_view(speed, 2 * _STEPS_EACH_SIDE + 1), axis=1)
    inner = slice(_STEPS_EACH_SIDE, -_STEPS_EACH_SIDE)
    jump = (speed[inner] - usual) * passed[inner]
    least = max(least_rad, _JUMP_SPREADS * float(np.median(np.abs(jump))))
    found = np.flatnonzero((np.abs(jump) > least) & (passed[inner] < _GAP_STEPS * np.median(passed)))
    return [(float(jump[i]), float(time_s[i + _STEPS_EACH_SIDE + 1])) for i in found.tolist()]


def moved_pendulums(time_s: Array, angle_rad: Array) -> list[RotorDoubt]:
    """Return the pendulums that leave the angle of the record's first second by more than the play of a lock."""
    found: list[RotorDoubt] = []
    if not len(time_s):
        return found
    first = time_s <= time_s[0] + _FIRST_S
    for name, angle in zip("AB", angle_rad.T, strict=True):
        moved = angle - np.median(angle[first])
        beyond = np.flatnonzero(np.abs(moved) > _PLAY_RAD)
        if len(beyond):
            largest = float(moved[np.argmax(np.abs(moved))])
            found.append(RotorDoubt("moved pendulum", largest, float(time_s[beyond[0]]), pendulum=name))
    return found


def other_order(phase_rad: Array, displacement_m: Array) -> list[RotorDoubt]:
    """Return the order of the displacement if it is not the rotor's: the largest line of its spectrum over the turns.

    Args:
        phase_rad, displacement_m: unwrapped phase at each sample and displacement, shape (n,).
    """
    good = np.isfinite(phase_rad) & np.isfinite(displacement_m)
    turns, value = phase_rad[good] / _TURN_RAD, displacement_m[good]
    rising = np.flatnonzero(np.diff(np.maximum.accumulate(turns), prepend=-np.inf) > 0)
    turns, value = turns[rising], value[rising]
    if len(turns) < _PER_TURN * _MIN_TURNS or turns[-1] - turns[0] < _MIN_TURNS:
        return []
    even = np.arange(turns[0], turns[-1], 1 / _PER_TURN)
    series = np.interp(even, turns, value)
    size = np.abs(np.fft.rfft((series - series.mean()) * np.hanning(len(series))))
    order = np.fft.rfftfreq(len(series), 1 / _PER_TURN)
    size[order < 4 / (turns[-1] - turns[0])] = 0.0
    peak, own = int(np.argmax(size)), np.abs(order - 1) < _OF_ROTOR
    if own[peak] or float(np.max(size[own], initial=0.0)) > 0.5 * size[peak]:
        return []
    return [RotorDoubt("other order", float(order[peak]), float("nan"))]

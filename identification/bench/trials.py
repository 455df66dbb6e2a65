"""One case measured: many records, every method on each of them, errors in units of the bound.

A method fails grossly on a record when it raises, or gives something that is not finite, or is off by more than the
case allows. Gross failures are counted and left out of rms, bias and coverage; a method that has any is on no front.
"""

from __future__ import annotations

import dataclasses
import math
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from zlib import crc32

import numpy as np

from identification.setting import Setting

SETTINGS: tuple[Setting, ...] = ("fast", "balanced", "reference")
AT_THE_BOUND = 1.15
"""Ratios of rms error to bound below this count as equal: a hundred runs scatter by 7 %."""
_LEAST_RECORDS = 3


@dataclass(frozen=True)
class Trial:
    """A made-up record.

    Attributes:
        record: what a method is given; a type of the case's own.
        truth: by name of the value.
        bound: Cramér–Rao bound by the same names, in the values' units.
    """

    record: Any
    truth: Mapping[str, float]
    bound: Mapping[str, float]


@dataclass(frozen=True)
class Answer:
    """What a method makes of a record.

    Attributes:
        values: by the names of the truth.
        intervals: 95 % intervals by name; empty for a method that states none.
    """

    values: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Method:
    """One way to find the values.

    Attributes:
        name, setting: for the table.
        answer: from the record; whatever it raises is a gross failure.
        peer: whether this is what somebody would do without this package.
        every_record: take all records, whatever it costs.
    """

    name: str
    setting: str
    answer: Callable[[Any], Answer]
    peer: bool = False
    every_record: bool = False


@dataclass(frozen=True)
class Case:
    """Records of one kind, and the methods for them.

    Attributes:
        service: "ring-down", "run-up", "spin-down", "release".
        name: what kind of record.
        draw: a record from a random generator.
        groups: columns of the table: symbol → names of the values in it.
        gross: relative error above which a value of a group is a gross failure.
        methods: ours and peers.
        unit: what the time in the table is of.
        units: how many of them a record holds.
    """

    service: str
    name: str
    draw: Callable[[np.random.Generator], Trial]
    groups: Mapping[str, tuple[str, ...]]
    gross: Mapping[str, float]
    methods: Sequence[Method]
    unit: str = "record"
    units: Callable[[Any], int] = lambda record: 1


@dataclass(frozen=True)
class Precision:
    """One method in one case.

    Attributes:
        service, case, method, setting, peer: what was measured.
        seconds, per: median time of one unit, and what that is ("record", "update").
        runs, gross: records tried, gross failures among them.
        rms, bias: error over bound by group, over the group's values; the bias is the one farthest from zero.
        coverage: share of the 95 % intervals that hold the truth by group; None where none is stated.
        failure: the most frequent reason of gross failures.
        front, front_of_all, peer_ratio: as in dynamics.bench.records.Measurement.
    """

    service: str
    case: str
    method: str
    setting: str
    peer: bool
    seconds: float
    runs: int
    gross: int
    rms: Mapping[str, float]
    bias: Mapping[str, float]
    coverage: Mapping[str, float | None]
    failure: str = ""
    per: str = "record"
    front: bool = False
    front_of_all: bool = False
    peer_ratio: float | None = None

    @property
    def true_error(self) -> float:
        """The largest rms error over bound; inf when the method fails in places."""
        return math.inf if self.gross or not self.rms else max(self.rms.values())

    def as_json(self) -> dict[str, Any]:
        """The row under its field names."""
        return dataclasses.asdict(self)


def measure(case: Case, runs: int, seed: int, most_s: float = math.inf) -> list[Precision]:
    """Every method on the same records.

    Args:
        runs: records.
        seed: the same seed gives a case the same records, the first ones whatever their number.
        most_s: a method that has taken longer than this over three records or more gets no further ones.
    """
    own_seed = crc32(f"{case.service}: {case.name}".encode())
    outcomes: list[list[_Outcome]] = [[] for _ in case.methods]
    for number in range(1, runs + 1):
        trial = case.draw(np.random.default_rng([seed, own_seed, number]))
        for method, own in zip(case.methods, outcomes, strict=True):
            spent = sum(o.seconds for o in own[1:])  # the first may compile and import
            if method.every_record or number <= _LEAST_RECORDS or spent < most_s:
                own.append(_answer(method, case, trial))
    return [_row(case, method, own) for method, own in zip(case.methods, outcomes, strict=True)]


@dataclass(frozen=True)
class _Outcome:
    """One method on one record: time, errors over bound and hits of the intervals by name, or why it failed."""

    seconds: float
    units: int
    error: Mapping[str, float]
    held: Mapping[str, bool]
    failure: str


def _answer(method: Method, case: Case, trial: Trial) -> _Outcome:
    units, began = case.units(trial.record), time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a peer's overflow shows in its figures
            found = method.answer(trial.record)
    except Exception as error:  # a peer may raise anything; what it raised is told in the row
        return _Outcome(time.perf_counter() - began, units, {}, {}, f"{type(error).__name__}: {error}")
    seconds = time.perf_counter() - began
    for group, names in case.groups.items():
        for name in names:
            value = found.values.get(name, math.nan)
            if not abs(value / trial.truth[name] - 1) <= case.gross[group]:
                return _Outcome(seconds, units, {}, {}, f"{name} = {value:.4g} where {trial.truth[name]:.4g} is true")
    names = [n for group in case.groups.values() for n in group]
    error = {n: (found.values[n] - trial.truth[n]) / trial.bound[n] for n in names}
    held = {n: low <= trial.truth[n] <= high for n in names for low, high in _interval(found, n)}
    return _Outcome(seconds, units, error, held, "")


def _interval(found: Answer, name: str) -> Iterable[tuple[float, float]]:
    return (found.intervals[name],) if name in found.intervals else ()


def _row(case: Case, method: Method, outcomes: Sequence[_Outcome]) -> Precision:
    good = [o for o in outcomes if not o.failure]
    rms: dict[str, float] = {}
    bias: dict[str, float] = {}
    coverage: dict[str, float | None] = {}
    for group, names in case.groups.items() if good else ():
        errors = np.array([[o.error[n] for n in names] for o in good])
        means = errors.mean(axis=0)
        rms[group] = float(np.sqrt(np.mean(errors**2)))
        bias[group] = float(means[np.argmax(np.abs(means))])
        held = [o.held[n] for o in good for n in names if n in o.held]
        coverage[group] = float(np.mean(held)) if held else None
    reasons = [o.failure for o in outcomes if o.failure]
    return Precision(
        case.service,
        case.name,
        method.name,
        method.setting,
        method.peer,
        float(np.median([o.seconds / o.units for o in outcomes])),
        len(outcomes),
        len(reasons),
        rms,
        bias,
        coverage,
        max(reasons, key=reasons.count) if reasons else "",
        case.unit,
    )

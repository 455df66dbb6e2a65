"""Measurement of one case: every method on many records, with errors in units of the bound.

A method has a gross failure on a record if it raises, if its result is not finite, or if its error exceeds that allowed
by the case. Gross failures are counted and excluded from rms, bias and coverage. A method with a gross failure is on no
front.
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
"""Ratio of rms error to bound below which methods count as equal; that of a hundred runs has a scatter of 7 %."""
_LEAST_RECORDS = 3


@dataclass(frozen=True)
class SyntheticRecord:
    """A synthetic record.

    Attributes:
        record: input of a method; each case has its own type.
        truth: true values by name.
        bound: Cramér–Rao bound by the same names, in the values' units.
    """

    record: Any
    truth: Mapping[str, float]
    bound: Mapping[str, float]


@dataclass(frozen=True)
class MethodResult:
    """Result of a method on a record.

    Attributes:
        values: values by the names of the truth.
        intervals: 95 % intervals by name; empty for a method without intervals.
    """

    values: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict[str, tuple[float, float]])


@dataclass(frozen=True)
class Method:
    """A method of estimation.

    Attributes:
        name, setting: name and setting for the table.
        answer: function from the record to the result; any exception is a gross failure.
        peer: whether the method is independent of this package.
        every_record: whether to apply the method to all records regardless of its time.
    """

    name: str
    setting: str
    answer: Callable[[Any], MethodResult]
    peer: bool = False
    every_record: bool = False


@dataclass(frozen=True)
class TrialSet:
    """Records of one kind, and the methods for them.

    Attributes:
        service: "ring-down", "run-up", "spin-down", "release".
        name: kind of record.
        draw: function from a random generator to a record.
        groups: columns of the table: symbol → names of the values in it.
        gross: relative error above which a value of a group is a gross failure.
        methods: this package's methods and peers.
        unit: unit of work for the time in the table.
        units: function from a record to its number of units.
        seed: seed of the records; None derives it from service and name.
    """

    service: str
    name: str
    draw: Callable[[np.random.Generator], SyntheticRecord]
    groups: Mapping[str, tuple[str, ...]]
    gross: Mapping[str, float]
    methods: Sequence[Method]
    unit: str = "record"
    units: Callable[[Any], int] = lambda record: 1
    seed: int | None = None


@dataclass(frozen=True)
class Precision:
    """Result of one method in one case.

    Attributes:
        service, case, method, setting, peer: case and method.
        seconds, per: median time of one unit of work, s, and the unit ("record", "update").
        runs, gross: number of records, and of gross failures among them.
        rms, bias: error over bound by group, over the group's values; the bias is the one farthest from zero.
        coverage: share of the 95 % intervals that contain the truth by group; None without intervals.
        failure: most frequent reason of gross failures.
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
        """Largest rms error over bound; inf if the method has gross failures."""
        return math.inf if self.gross or not self.rms else max(self.rms.values())

    def as_json(self) -> dict[str, Any]:
        """Return the row by its field names."""
        return dataclasses.asdict(self)


def measure(case: TrialSet, runs: int, seed: int, most_s: float = math.inf) -> list[Precision]:
    """Apply every method to the same records.

    Args:
        case: case to measure.
        runs: number of records.
        seed: seed of the records. The first records of a case are the same for any number of records.
        most_s: total time over at least three records after which a method gets no further ones, s.
    """
    own_seed = crc32(f"{case.service}: {case.name}".encode()) if case.seed is None else case.seed
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
    """Outcome of one method on one record: time, errors over bound and hits of the intervals by name, or failure."""

    seconds: float
    units: int
    error: Mapping[str, float]
    held: Mapping[str, bool]
    failure: str


def _answer(method: Method, case: TrialSet, trial: SyntheticRecord) -> _Outcome:
    units, began = case.units(trial.record), time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a peer's overflow shows in its figures
            found = method.answer(trial.record)
    except Exception as error:  # a peer may raise any exception; the row contains it
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


def _interval(found: MethodResult, name: str) -> Iterable[tuple[float, float]]:
    return (found.intervals[name],) if name in found.intervals else ()


def _row(case: TrialSet, method: Method, outcomes: Sequence[_Outcome]) -> Precision:
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

"""What a benchmark run gives: rows of measured time against true error, compared within each case.

Two fronts are marked in every case. A row is on a front when nothing faster is as exact: on the first among the
project's own methods, on the second among all, peers included.
"""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np

ROUNDING = 1e-13
"""Errors below this count as equal: references and eigenvalue routines agree no better."""
USEFUL = 1e-8
"""The accuracy at which tables show the cheapest setting of each method: the default of the services."""


@dataclass(frozen=True)
class Measurement:
    """One method at one setting in one case.

    Attributes:
        service: "multipliers", "map", "motion", "batch", "steady states" or "process".
        case: what was computed.
        method, setting: with what, and with which steps, tolerance or accuracy.
        seconds: median time of one unit.
        per: the unit: "point", "run", "call" or "process".
        true_error: against the reference: of the largest multiplier relative to max(1, modulus), or of an angle at
            the end in rad; None where no reference ran or none applies.
        error_estimate: the bound the method itself states, None where it states none.
        peer: whether this is somebody else's work.
        automatic: whether this is the service as a user calls it, which chooses method and steps and bounds its error.
        front, front_of_all: on the front of the project's own methods, of all methods.
        peer_ratio: time over that of the fastest peer of the case at least as exact; None for peers and without one.
    """

    service: str
    case: str
    method: str
    setting: str
    seconds: float
    per: str
    true_error: float | None = None
    error_estimate: float | None = None
    peer: bool = False
    automatic: bool = False
    front: bool = False
    front_of_all: bool = False
    peer_ratio: float | None = None

    def as_json(self) -> dict[str, Any]:
        """The row under its field names."""
        return dataclasses.asdict(self)


@dataclass(frozen=True)
class Target:
    """A figure the dynamics is held to.

    Attributes:
        name: what is measured, with its unit.
        wanted: upper bound.
        got: what was measured.
    """

    name: str
    wanted: float
    got: float

    @property
    def met(self) -> bool:
        """Whether the figure is within the bound."""
        return self.got <= self.wanted

    def as_json(self) -> dict[str, Any]:
        """The target with its verdict."""
        return {**dataclasses.asdict(self), "met": self.met}


class Comparable(Protocol):
    """A row, a frozen dataclass, that fronts and peer ratios can be told of."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def service(self) -> str:
        """Rows of one service and case are compared with each other."""
        ...

    @property
    def case(self) -> str:
        """See service."""
        ...

    @property
    def seconds(self) -> float:
        """What it cost."""
        ...

    @property
    def true_error(self) -> float | None:
        """What it is worth; None when nobody knows, inf for a method that fails."""
        ...

    @property
    def peer(self) -> bool:
        """Somebody else's work."""
        ...


Row = TypeVar("Row", bound=Comparable)


def compared(rows: Iterable[Row], alike: float = ROUNDING) -> list[Row]:
    """The rows with fronts and peer ratios, in their order.

    Args:
        alike: errors below this count as equal.
    """
    rows = list(rows)
    cases: dict[tuple[str, str], list[int]] = defaultdict(list)
    for i, row in enumerate(rows):
        cases[row.service, row.case].append(i)
    for members in cases.values():
        own = _front(rows, [i for i in members if not rows[i].peer], alike)
        everyone = _front(rows, members, alike)
        peers = [rows[i] for i in members if rows[i].peer]
        for i in members:
            rows[i] = dataclasses.replace(
                rows[i], front=i in own, front_of_all=i in everyone, peer_ratio=_peer_ratio(rows[i], peers, alike)
            )
    return rows


def _front(rows: Sequence[Comparable], members: Iterable[int], alike: float) -> set[int]:
    """Members that are more exact than everything faster; empty where nothing has a true error."""
    front, best = set(), math.inf
    known = [(rows[i].seconds, error, i) for i in members if (error := rows[i].true_error) is not None]
    for _, error, i in sorted(known):
        if max(error, alike) < best:
            front.add(i)
            best = max(error, alike)
    return front


def _peer_ratio(row: Comparable, peers: Sequence[Comparable], alike: float) -> float | None:
    if row.peer or row.true_error == math.inf:  # nothing is as exact as what failed
        return None
    allowed = math.inf if row.true_error is None else max(row.true_error, alike)
    as_exact = [p.seconds for p in peers if row.true_error is None or (p.true_error or 0.0) <= allowed]
    return row.seconds / min(as_exact) if as_exact else None


def over_points(rows: Iterable[Measurement], case: str, names: Sequence[str]) -> list[Measurement]:
    """One row for each method and setting (and for each setting of the automatic choice) measured in all cases named.

    Its time is the median, its errors are the largest.
    """
    alike: dict[tuple[str, str], list[Measurement]] = defaultdict(list)
    for row in rows:
        if row.case in names:
            alike["automatic" if row.automatic else row.method, row.setting].append(row)
    return [
        dataclasses.replace(
            same[0],
            case=case,
            method=", ".join(dict.fromkeys(r.method for r in same)),
            seconds=float(np.median([r.seconds for r in same])),
            true_error=_largest([r.true_error for r in same]),
            error_estimate=_largest([r.error_estimate for r in same]),
        )
        for same in alike.values()
        if len(same) == len(names)
    ]


def _largest(values: Sequence[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return max(known) if len(known) == len(values) else None


def worth_showing(rows: Sequence[Measurement]) -> list[Measurement]:
    """The rows a table has room for: fronts, peers, the services themselves, each method's cheapest useful setting."""
    useful: dict[tuple[str, str, str], Measurement] = {}
    for row in rows:
        key = (row.service, row.case, row.method)
        if row.true_error is not None and row.true_error <= USEFUL:
            useful[key] = min(useful.get(key, row), row, key=lambda r: r.seconds)
    chosen = {id(r) for r in useful.values()}
    return [r for r in rows if r.front or r.peer or r.automatic or r.true_error is None or id(r) in chosen]

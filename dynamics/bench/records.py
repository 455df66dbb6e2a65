"""Rows of a benchmark run: measured time against true error, compared within each case.

Each case has two fronts. A row is on a front if no faster row is as exact. The first front contains the project's own
methods, the second one all methods including peers.
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
"""Errors below this value count as equal: references and eigenvalue routines agree no better."""
USEFUL = 1e-8
"""Accuracy at which tables show the cheapest setting of each method; the default of the services."""


@dataclass(frozen=True)
class Measurement:
    """One method at one setting in one case.

    Attributes:
        service: "multipliers", "map", "motion", "batch", "steady states" or "process".
        case: what is computed.
        method, setting: method, and its steps, tolerance or accuracy.
        seconds: median time of one unit, s.
        per: the unit: "point", "run", "call" or "process".
        true_error: difference from the reference: of the largest multiplier relative to max(1, modulus), or of an
            angle at the end in rad. None without a reference.
        error_estimate: error bound returned by the method, or None.
        peer: whether the method belongs to another project.
        accuracy: accuracy requested from a service; None for methods with steps or a tolerance.
        count: number of units computed in one call, for services that compute many.
        chosen: methods selected by a service, without "automatic".
        automatic: whether this is the service called by users, which selects method and steps and bounds its error.
        front, front_of_all: whether the row is on the front of the project's own methods, of all methods.
        peer_ratio: time divided by the time of the fastest peer of the case that is at least as exact. None for peers
            and without such a peer.
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
    accuracy: float | None = None
    count: int | None = None
    chosen: tuple[str, ...] = ()
    front: bool = False
    front_of_all: bool = False
    peer_ratio: float | None = None

    def as_json(self) -> dict[str, Any]:
        """Fields as a JSON object."""
        return dataclasses.asdict(self)


@dataclass(frozen=True)
class Target:
    """Measured figure with its required upper bound.

    Attributes:
        name: name of the figure with its unit.
        wanted: upper bound.
        got: measured value.
    """

    name: str
    wanted: float
    got: float

    @property
    def met(self) -> bool:
        """Whether the figure is within the bound."""
        return self.got <= self.wanted

    def as_json(self) -> dict[str, Any]:
        """Fields and verdict as a JSON object."""
        return {**dataclasses.asdict(self), "met": self.met}


class Comparable(Protocol):
    """Row (a frozen dataclass) for which fronts and peer ratios can be computed."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def service(self) -> str:
        """Service; rows with the same service and case are compared with each other."""
        ...

    @property
    def case(self) -> str:
        """Case; see `service`."""
        ...

    @property
    def seconds(self) -> float:
        """Cost of one unit, s."""
        ...

    @property
    def true_error(self) -> float | None:
        """True error. None if unknown, inf for a method that failed."""
        ...

    @property
    def peer(self) -> bool:
        """Whether the method belongs to another project."""
        ...


Row = TypeVar("Row", bound=Comparable)


def compared(rows: Iterable[Row], alike: float = ROUNDING) -> list[Row]:
    """The rows with fronts and peer ratios, in their order.

    Args:
        alike: errors below this value count as equal.
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
    """Members that are more exact than every faster member. Empty if no member has a true error."""
    front, best = set[int](), math.inf
    known = [(rows[i].seconds, error, i) for i in members if (error := rows[i].true_error) is not None]
    for _, error, i in sorted(known):
        if max(error, alike) < best:
            front.add(i)
            best = max(error, alike)
    return front


def _peer_ratio(row: Comparable, peers: Sequence[Comparable], alike: float) -> float | None:
    if row.peer or row.true_error == math.inf:  # a failed method has no peer of equal accuracy
        return None
    allowed = math.inf if row.true_error is None else max(row.true_error, alike)
    as_exact = [p.seconds for p in peers if row.true_error is None or (p.true_error or 0.0) <= allowed]
    return row.seconds / min(as_exact) if as_exact else None


def over_points(rows: Iterable[Measurement], case: str, names: Sequence[str]) -> list[Measurement]:
    """One row for each method and setting measured in all named cases.

    The automatic choice counts as one method. The time of a row is the median, its errors are the largest.
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
            chosen=tuple(dict.fromkeys(method for r in same for method in r.chosen)),
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
    """Rows shown in a table: fronts, peers, the services, and the cheapest useful setting of each method."""
    useful: dict[tuple[str, str, str], Measurement] = {}
    for row in rows:
        key = (row.service, row.case, row.method)
        if row.true_error is not None and row.true_error <= USEFUL:
            useful[key] = min(useful.get(key, row), row, key=lambda r: r.seconds)
    chosen = {id(r) for r in useful.values()}
    return [r for r in rows if r.front or r.peer or r.automatic or r.true_error is None or id(r) in chosen]

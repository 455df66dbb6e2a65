"""Recommended settings of the services, derived from the rows of one benchmark run."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any

from dynamics.bench.records import Measurement
from dynamics.bench.wording import times
from rig_basics.texts import number_of

MAX_EQUAL_TIME_RATIO = 1.5
"""Largest time ratio to the cheapest accuracy that counts as equal: benchmark times scatter by this factor."""


@dataclass(frozen=True)
class Recommendation:
    """A recommended setting of one service.

    Attributes:
        service: name of the service.
        setting: recommended setting, or None if the rows do not support one.
        text: the recommendation in one line, with its figures.
        figures: by setting: "time" relative to the compared setting, "error" (smallest and largest of the cases) if
            known.
    """

    service: str
    setting: str | None
    text: str
    figures: Mapping[str, Mapping[str, Any]] = field(default_factory=dict[str, Mapping[str, Any]])

    @property
    def decided(self) -> bool:
        """Whether the rows support a recommendation."""
        return self.setting is not None

    def as_json(self) -> dict[str, Any]:
        """Fields as a JSON object."""
        return {**dataclasses.asdict(self), "decided": self.decided}


def recommended_accuracies(rows: Sequence[Measurement]) -> list[Recommendation]:
    """For each measured service: the tightest accuracy that takes about the time of the cheapest one.

    Args:
        rows: rows of one run, after `compared`.
    """
    by_service: dict[str, list[tuple[float, Measurement]]] = {}
    for row in rows:
        if row.automatic and row.accuracy is not None:
            by_service.setdefault(row.service, []).append((row.accuracy, row))
    return [_of_service(service, found) for service, found in by_service.items()]


def _of_service(service: str, rows: Sequence[tuple[float, Measurement]]) -> Recommendation:
    cases = {row.case for _, row in rows}
    cases_of: dict[float, set[str]] = {}
    for requested, row in rows:
        cases_of.setdefault(requested, set()).add(row.case)
    accuracies = sorted((requested for requested, own in cases_of.items() if own == cases), reverse=True)
    ours = {requested: [row for a, row in rows if a == requested] for requested in accuracies}
    if len(accuracies) < 2:
        known = f"only accuracy {accuracies[0]:.0e} was" if accuracies else "no accuracy was in all cases"
        return Recommendation(service, None, f"{service}: no recommendation, {known} measured{_peers(rows)}")
    if any(row.true_error is None for _, row in rows):
        return Recommendation(service, None, f"{service}: no recommendation, true errors are not known in this run")
    seconds = {requested: {row.case: row.seconds for row in ours[requested]} for requested in accuracies}
    cheapest = min(accuracies, key=lambda a: median(seconds[a].values()))
    ratio = {a: median(seconds[a][case] / seconds[cheapest][case] for case in cases) for a in accuracies}
    figures = {f"accuracy {a:.0e}": {"time": ratio[a], "error": _span(ours[a])} for a in accuracies}
    broken = [a for a in accuracies if any((row.true_error or 0.0) > a for row in ours[a])]
    for_nothing = [a for a in accuracies if ratio[a] <= MAX_EQUAL_TIME_RATIO and a not in broken]
    if not for_nothing:
        text = f"{service}: no recommendation, the cheapest accuracies are not kept ({_listed(broken)})"
        return Recommendation(service, None, text, figures)
    best = min(for_nothing)
    text = f"{service}: use {best:.0e}"
    if best != cheapest:
        text += f", it takes {times(ratio[best])} the time of {cheapest:.0e}"
    elif len(for_nothing) == 1:
        text += ", the cheapest"
    text += f"; its largest true error here is {max(r.true_error or 0.0 for r in ours[best]):.0e}"
    tighter = [a for a in accuracies if a < best]
    if tighter:
        text += f"; tighter ones take {times(min(ratio[a] for a in tighter))}"
        text += f" to {times(max(ratio[a] for a in tighter))}" if len(tighter) > 1 else ""
        text += " the time, use them only if needed"
    if broken:
        text += f"; not kept: {_listed(broken)}"
    return Recommendation(service, f"accuracy {best:.0e}", text + _peers([(best, row) for row in ours[best]]), figures)


def _listed(accuracies: Sequence[float]) -> str:
    return ", ".join(f"{a:.0e}" for a in accuracies)


def _span(rows: Sequence[Measurement]) -> tuple[float, float]:
    errors = [row.true_error or 0.0 for row in rows]
    return min(errors), max(errors)


def _peers(rows: Sequence[tuple[float, Measurement]]) -> str:
    """Text on rows in which a peer is faster and at least as exact; otherwise empty."""
    behind = [row.peer_ratio for _, row in rows if row.peer_ratio is not None and row.peer_ratio > 1.0]
    compared = sum(row.peer_ratio is not None for _, row in rows)
    if not behind:
        return ""
    return (
        f"; a peer at least as exact is up to {times(max(behind))} as fast ({len(behind)} of "
        f"{number_of(compared, 'row')})"
    )


def log_ratio(one: float, other: float) -> float:
    """ln(one / other); inf or −inf if one of them is zero or infinite."""
    if one == other:
        return 0.0
    if one == math.inf or other == 0.0:
        return math.inf
    return -math.inf if other == math.inf or one == 0.0 else math.log(one / other)

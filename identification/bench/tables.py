"""Rows of the estimators' benchmark as cells of a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dynamics.bench.records import Target
from dynamics.bench.tables import BenchmarkPage, duration, standing
from identification.bench.recommendations import recommended_settings
from identification.bench.trials import AT_THE_BOUND, Precision
from rig_basics.texts import number_of

HEADER = ("method", "setting", "time", "rms / bound", "bias / bound", "95 % covers", "gross", "ours / peer", "front")
LEGEND = (
    "Bound: smallest standard deviation of an unbiased estimate (Cramér–Rao), from the Fisher information of each "
    "record's model by numerical differences, with all other parameters unknown as well (amplitudes, phases, offsets, "
    "axis angle; for a release suspension, zeros and start within their priors). Damaged records have the bound of the "
    "clean one. rms and bias (the one farthest from zero) are errors over the bound; 1 is the optimum. Several values "
    "are separated by dots as in the case's title. 95 % covers: share of the stated intervals that contain the truth, "
    "in per cent, blank for methods without intervals. Gross: records without a result or with a gross error, and the "
    "number of records (fewer for slow methods). These records are excluded from the other figures, and a method with "
    "any is on no front. Times are medians over the records. Front: ● no method of this package is faster and as "
    f"exact, ◉ no method at all, peers included; errors up to {AT_THE_BOUND:g} bounds count as equal. Ours / peer: "
    "time over that of the fastest peer that is at least as exact."
)


def page(
    rows: Sequence[Precision], targets: Sequence[Target], machine: Mapping[str, Any], notes: Sequence[str]
) -> BenchmarkPage:
    """Return the page of a whole run."""
    return BenchmarkPage(
        "Work and precision of the identification",
        machine,
        [*notes, *failures(rows)],
        targets,
        LEGEND,
        HEADER,
        blocks(rows),
        recommended_settings(rows),
    )


def blocks(rows: Sequence[Precision]) -> list[tuple[str, list[tuple[str, ...]]]]:
    """Return the rows by case in order, as (description of the case, cells under HEADER for each of its rows)."""
    cases: dict[tuple[str, str], list[Precision]] = {}
    for row in rows:
        cases.setdefault((row.service, row.case), []).append(row)
    found: list[tuple[str, list[tuple[str, ...]]]] = []
    for (service, case), members in cases.items():
        groups = next((" · ".join(r.rms) for r in members if r.rms), "no answers")
        runs = max(r.runs for r in members)
        found.append(
            (
                f"{service}: {case} ({groups}; {number_of(runs, 'record')}, time a {members[0].per})",
                [_cells(r) for r in members],
            )
        )
    return found


def failures(rows: Sequence[Precision]) -> list[str]:
    """Return the failures of this package's estimators, one line for all settings of a case."""
    cases: dict[tuple[str, str, str], list[Precision]] = {}
    for row in rows:
        if row.gross and not row.peer:
            cases.setdefault((row.method, row.service, row.case), []).append(row)
    return [
        f"{method} failed at {service}, {case}: {', '.join(f'{r.setting} {r.gross} of {r.runs}' for r in failed)}; "
        f"for example {failed[0].failure}"
        for (method, service, case), failed in cases.items()
    ]


def _cells(row: Precision) -> tuple[str, ...]:
    covered = [None if c is None else f"{100 * c:.3g}" for c in row.coverage.values()]
    return (
        row.method,
        row.setting,
        duration(row.seconds),
        _joined(row.rms),
        _joined(row.bias),
        " · ".join(c for c in covered if c is not None),
        f"{row.gross}/{row.runs}",
        *standing(peer=row.peer, front=row.front, front_of_all=row.front_of_all, peer_ratio=row.peer_ratio),
    )


def _joined(figures: Mapping[str, float]) -> str:
    return " · ".join(_figure(v) for v in figures.values())


def _figure(value: float) -> str:
    size = abs(value)
    return f"{value:.2f}" if size < 10 else f"{value:.0f}" if size < 1000 else f"{value:.0e}"

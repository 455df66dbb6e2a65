"""Rows of a benchmark as table cells, for the terminal and for Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dynamics.bench.recommendations import Recommendation, recommended_accuracies
from dynamics.bench.records import Measurement, Target

HEADER = ("method", "setting", "time", "true error", "stated bound", "ours / peer", "front")
LEGEND = (
    "Times are medians. Front: ● no method of this project is faster and as exact, ◉ no method at all is, peers "
    "included. Ours / peer: time divided by that of the fastest peer in the same run that is at least as exact."
)
RECOMMENDED = "Recommended settings, from the rows of this run:"


def duration(seconds: float) -> str:
    """Time with a suitable unit, three digits."""
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"


def blocks(rows: Sequence[Measurement]) -> list[tuple[str, list[tuple[str, ...]]]]:
    """Rows by case, in order: (description of the case, cells under HEADER for each of its rows)."""
    found: dict[str, list[tuple[str, ...]]] = {}
    for row in rows:
        found.setdefault(f"{row.service}: {row.case} (time a {row.per})", []).append(_cells(row))
    return list(found.items())


def _cells(row: Measurement) -> tuple[str, ...]:
    return (
        row.method,
        row.setting,
        duration(row.seconds),
        _error(row.true_error),
        _error(row.error_estimate),
        *standing(peer=row.peer, front=row.front, front_of_all=row.front_of_all, peer_ratio=row.peer_ratio),
    )


def standing(*, peer: bool, front: bool, front_of_all: bool, peer_ratio: float | None) -> tuple[str, str]:
    """Last two cells of a row: time ratio to a peer, and the mark of the fronts."""
    mark = "◉" if front_of_all else "●" if front else ""
    return "" if peer_ratio is None else f"{peer_ratio:.3g}", f"peer {mark}".strip() if peer else mark


def _error(value: float | None) -> str:
    return "" if value is None else "0" if value == 0 else f"{value:.1e}"


def target_line(target: Target) -> tuple[str, str, str, str]:
    """Cells (name, bound, measured value, "met" or "missed")."""
    verdict = "met" if target.met else "missed"
    return target.name, f"≤ {target.wanted:.3g}", f"{target.got:.3g}", verdict


def machine_line(machine: Mapping[str, Any]) -> str:
    """Machine and versions of the run, in one line."""
    load = machine["load_before"]
    busy = "" if load is None else f", load before the run {load:.2f}"
    return (
        f"{machine['processor']}, {machine['cores']} cores{busy}; Python {machine['python']}, numba "
        f"{machine['numba']}, numpy {machine['numpy']}"
    )


@dataclass(frozen=True)
class BenchmarkPage:
    """Contents of a benchmark page.

    Attributes:
        title: title of the page.
        machine: machine and versions, from work_precision.machine.
        notes: remarks on this run.
        targets: figures with their required bounds.
        legend: meaning of the columns.
        header: names of the columns.
        blocks: (description of the case, cells under the header for each of its rows).
        recommendations: settings supported by the rows. The page begins with them.
    """

    title: str
    machine: Mapping[str, Any]
    notes: Sequence[str]
    targets: Sequence[Target]
    legend: str
    header: tuple[str, ...]
    blocks: Sequence[tuple[str, Sequence[tuple[str, ...]]]]
    recommendations: Sequence[Recommendation] = ()


def page(
    rows: Sequence[Measurement], targets: Sequence[Target], machine: Mapping[str, Any], notes: Sequence[str]
) -> BenchmarkPage:
    """Page of one benchmark run of the dynamics."""
    return BenchmarkPage(
        "Work and precision of the dynamics",
        machine,
        notes,
        targets,
        LEGEND,
        HEADER,
        blocks(rows),
        recommended_accuracies(rows),
    )


def markdown(whole: BenchmarkPage) -> str:
    """The page in Markdown."""
    lines = [f"# {whole.title}", ""]
    if whole.recommendations:
        lines += [RECOMMENDED, "", *(f"- {found.text}" for found in whole.recommendations), ""]
    lines += [machine_line(whole.machine), ""]
    lines += [f"- {note}" for note in whole.notes] + [""] * bool(whole.notes)
    lines += _table(("figure", "target", "measured", ""), [target_line(t) for t in whole.targets])
    lines += ["", whole.legend, ""]
    body: list[tuple[str, ...]] = []
    for case, cells in whole.blocks:
        body += [(f"**{case}**", *[""] * (len(whole.header) - 1)), *cells]
    lines += _table(whole.header, body)
    return "\n".join(lines) + "\n"


def _table(header: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
    lines = [header, ["---"] * len(header), *body]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]

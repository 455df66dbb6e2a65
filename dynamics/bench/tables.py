"""A benchmark's rows as cells of a table: the same on a terminal and in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dynamics.bench.records import Measurement, Target

HEADER = ("method", "setting", "time", "true error", "stated bound", "ours / peer", "front")
LEGEND = (
    "Times are medians. Front: ● nothing of ours is faster and as exact, ◉ nothing at all is, peers included. "
    "Ours / peer: time over that of the fastest peer at least as exact in the same run."
)


def duration(seconds: float) -> str:
    """A time with the unit that suits it, three digits."""
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"


def blocks(rows: Sequence[Measurement]) -> list[tuple[str, list[tuple[str, ...]]]]:
    """Rows by case, in order: (what the case is, cells under HEADER for each of its rows)."""
    found: dict[str, list[tuple[str, ...]]] = {}
    for row in rows:
        found.setdefault(f"{row.service}: {row.case} (time a {row.per})", []).append(_cells(row))
    return list(found.items())


def _cells(row: Measurement) -> tuple[str, ...]:
    mark = "◉" if row.front_of_all else "●" if row.front else ""
    return (
        row.method, row.setting, duration(row.seconds), _error(row.true_error), _error(row.error_estimate),
        "" if row.peer_ratio is None else f"{row.peer_ratio:.3g}", f"peer {mark}".strip() if row.peer else mark,
    )  # fmt: skip


def _error(value: float | None) -> str:
    return "" if value is None else "0" if value == 0 else f"{value:.1e}"


def target_line(target: Target) -> tuple[str, str, str, str]:
    """(name, wanted, got, met or missed)."""
    verdict = "met" if target.met else "missed"
    return target.name, f"≤ {target.wanted:.3g}", f"{target.got:.3g}", verdict


def machine_line(machine: Mapping[str, Any]) -> str:
    """What the figures were measured on, in one line."""
    load = machine["load_before"]
    busy = "" if load is None else f", load before the run {load:.2f}"
    return (
        f"{machine['processor']}, {machine['cores']} cores{busy}; Python {machine['python']}, numba "
        f"{machine['numba']}, numpy {machine['numpy']}"
    )


def markdown(
    rows: Sequence[Measurement], targets: Sequence[Target], machine: Mapping[str, Any], notes: Sequence[str]
) -> str:
    """The whole run as a Markdown page."""
    lines = ["# Work and precision of the dynamics", "", machine_line(machine), ""]
    lines += [f"- {note}" for note in notes] + [""] * bool(notes)
    lines += _table(("figure", "target", "measured", ""), [target_line(t) for t in targets])
    lines += ["", LEGEND, ""]
    body: list[tuple[str, ...]] = []
    for case, cells in blocks(rows):
        body += [(f"**{case}**", *[""] * (len(HEADER) - 1)), *cells]
    lines += _table(HEADER, body)
    return "\n".join(lines) + "\n"


def _table(header: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
    lines = [header, ["---"] * len(header), *body]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]

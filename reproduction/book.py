"""All items in one self-contained HTML file, and the same verdicts as a page of the docs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, cast

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from matplotlib import image

from daq.version import software_version
from reproduction.files import Written
from rig_basics.texts import number_of
from rig_basics.whole_file import write_whole_text

_TEMPLATE = "book.html.j2"
_TONES = 15  # levels of each colour in the small copies of the figures for the docs
_CLASSES = {"holds": "good", "holds in part": "open", "does not hold": "bad"}


def write_book(path: Path, made: Sequence[Written]) -> Path:
    """Write the book.

    Args:
        path: the HTML file, in the folder of the items' folders.
        made: items in their order.
    Returns:
        The path.
    """
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    text = resources.files("reproduction").joinpath(_TEMPLATE).read_text(encoding="utf-8")
    page = environment.from_string(text).render(
        version=software_version(),
        items=[_entry(one) for one in made],
        counts=counts_of(made),
        classes=_CLASSES,
        wrong=[(one.item.id, claim) for one in made for claim in one.claims if claim["verdict"] != "holds"],
    )
    write_whole_text(path, page)
    return path


def counts_of(made: Sequence[Written]) -> dict[str, int]:
    """Return the number of claims of each verdict."""
    found = Counter(claim["verdict"] for one in made for claim in one.claims)
    return {verdict: found[verdict] for verdict in _CLASSES if found[verdict]}


def _entry(one: Written) -> dict[str, Any]:
    record = one.record
    names = [f"{panel['name']}.{end}" for panel in record["panels"] for end in ("svg", "png")]
    names += [f"{table['name']}.parquet" for table in record["tables"]]
    return {
        "id": record["id"],
        "title": record["title"],
        "seconds": record["seconds"],
        "failed": one.failed,
        "panels": [{"svg": Markup(one.svg(p["name"])), "description": p["description"]} for p in record["panels"]],
        "claims": record["claims"],
        "tables": [
            {**table, "rows": [[_cell(value) for value in row] for row in table["rows"]]} for table in record["tables"]
        ],
        "assumed": record["assumed"],
        "parameters": [(name, _cell(value)) for name, value in record["parameters"].items()],
        "files": [f"{one.folder.name}/{name}" for name in (*names, "item.json")],
    }


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def write_docs(page: Path, made: Sequence[Written]) -> None:
    """Write the verdicts as Markdown, and small copies of the figures into a folder of the page's name next to it."""
    figures = page.with_suffix("")
    figures.mkdir(parents=True, exist_ok=True)
    for one in made:
        for panel in one.record["panels"]:
            _small_copy(one.folder / f"{panel['name']}.png", figures / _figure_name(one, panel))
    write_whole_text(page, docs_page(made, figures.name))


def _small_copy(figure: Path, copy: Path) -> None:
    """Write a copy of half the width and height with fewer colours: a tenth of the bytes."""
    pixels = np.asarray(image.imread(figure), np.float64)[..., :3]
    rows, columns = (size // 2 for size in pixels.shape[:2])
    halved = pixels[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2, 3).mean(axis=(1, 3))
    cast("Any", image).imsave(copy, np.round(halved * _TONES) / _TONES, pil_kwargs={"optimize": True})


def _figure_name(one: Written, panel: Mapping[str, str]) -> str:
    return f"{one.item.id}-{panel['name']}.png"


def docs_page(made: Sequence[Written], figures: str) -> str:
    """Return the page in Markdown: every figure, and every claim with its verdict and the numbers that decide it.

    Args:
        figures: folder of the figures, relative to the page.
    """
    counts = counts_of(made)
    lines = [
        "# The source, reproduced",
        "",
        "<!-- Written by `rig reproduce`; run it for all items with this page as its docs, do not edit this page. -->",
        "",
        "The source is R. Horváth, *Passive Pendulum Balancer for Rotor Systems*, dissertation, Auburn University,",
        "2006. `rig reproduce` computes its figures and tables again, with their data, and judges its claims. The",
        "statements are in our words.",
        "Wrong equations are in [misprints.md](theory/misprints.md).",
        "",
        f"{number_of(sum(counts.values()), 'claim')}: "
        f"{', '.join(f'{verdict} {count}' for verdict, count in counts.items())}.",
        "",
        "## Claims that do not hold, or hold in part",
        "",
        "| item | where | claimed | | computed |",
        "|---|---|---|---|---|",
    ]
    wrong = [(one.item.id, claim) for one in made for claim in one.claims if claim["verdict"] != "holds"]
    lines += [f"| {number} | {_row(claim)}" for number, claim in wrong]
    for one in made:
        lines += ["", f"## {one.item.id}: {one.item.title}", ""]
        if one.failed:
            lines += [f"Not reproduced: {one.failed}"]
            continue
        for panel in one.record["panels"]:
            lines += [f"![{panel['description']}]({figures}/{_figure_name(one, panel)})", "", panel["description"], ""]
        lines += [f"- Assumed: {text}" for text in one.record["assumed"]] + ["" for _ in one.record["assumed"][:1]]
        lines += ["| where | claimed | | computed |", "|---|---|---|---|"]
        lines += [f"| {_row(claim)}" for claim in one.claims]
    return "\n".join(lines) + "\n"


def _row(claim: Mapping[str, str]) -> str:
    verdict = claim["verdict"] if claim["verdict"] == "holds" else f"**{claim['verdict']}**"
    cells = (claim["place"], claim["statement"], verdict, claim["computed"])
    return " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

"""All items in one self-contained HTML file, and the same verdicts as pages of the docs."""

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
from reproduction.catalogue import Page, pages
from reproduction.files import Written
from rig_basics.texts import number_of
from rig_basics.whole_file import write_whole_text

_TEMPLATE = "book.html.j2"
_TONES = 15  # levels of each colour in the small copies of the figures for the docs
_WRITTEN = "<!-- Written by `rig reproduce` for all items; do not edit this page. -->"
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


def write_docs(folder: Path, made: Sequence[Written]) -> None:
    """Write the verdicts as pages in Markdown, and small copies of the figures into the folder "figures"."""
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    for one in made:
        for panel in one.record["panels"]:
            _small_copy(one.folder / f"{panel['name']}.png", folder / "figures" / _figure_name(one, panel))
    by_item = {one.item: one for one in made}
    on_pages = {page: [by_item[item] for item in items] for page, items in pages(by_item).items()}
    write_whole_text(folder / "index.md", _overview(made, on_pages))
    for page, ones in on_pages.items():
        write_whole_text(folder / f"{page.name}.md", _items_page(page.title, ones))


def _small_copy(figure: Path, copy: Path) -> None:
    """Write a copy of half the width and height with fewer colours: a tenth of the bytes."""
    pixels = np.asarray(image.imread(figure), np.float64)[..., :3]
    rows, columns = (size // 2 for size in pixels.shape[:2])
    halved = pixels[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2, 3).mean(axis=(1, 3))
    cast("Any", image).imsave(copy, np.round(halved * _TONES) / _TONES, pil_kwargs={"optimize": True})


def _figure_name(one: Written, panel: Mapping[str, str]) -> str:
    return f"{one.item.id}-{panel['name']}.png"


def _overview(made: Sequence[Written], on_pages: Mapping[Page, Sequence[Written]]) -> str:
    """Return the book's first page: its source, the claims that do not hold with links to their numbers, the pages."""
    counts = counts_of(made)
    lines = [
        "# The source, reproduced",
        "",
        _WRITTEN,
        "",
        "The source is R. Horváth, *Passive Pendulum Balancer for Rotor Systems*, dissertation, Auburn University,",
        "2006. `rig reproduce` computes its figures and tables again, with their data, and judges its claims. The",
        "statements are in our words.",
        "",
        f"{number_of(sum(counts.values()), 'claim')}: "
        f"{', '.join(f'{verdict} {count}' for verdict, count in counts.items())}.",
        "",
        "## Claims that do not hold, or hold in part",
        "",
        "| item | where | claimed | verdict |",
        "|---|---|---|---|",
    ]
    lines += [
        _row(f"[{one.item.id}]({page.name}.md)", claim["place"], claim["statement"], _verdict(claim))
        for page, ones in on_pages.items()
        for one in ones
        for claim in one.claims
        if claim["verdict"] != "holds"
    ]
    names = [page.name for page in on_pages]
    return "\n".join([*lines, "", "```{toctree}", ":maxdepth: 1", *names, "misprints", "```"]) + "\n"


def _items_page(title: str, items: Sequence[Written]) -> str:
    """Return a page of items: every figure, and every claim with its verdict and the numbers that decide it."""
    lines = [f"# {title}", "", _WRITTEN]
    for one in items:
        lines += ["", f"## {one.item.id}: {one.item.title}", ""]
        if one.failed:
            lines += [f"Not reproduced: {one.failed}"]
            continue
        for panel in one.record["panels"]:
            lines += [f"![{panel['description']}](figures/{_figure_name(one, panel)})", "", panel["description"], ""]
        lines += [f"- Assumed: {text}" for text in one.record["assumed"]] + ["" for _ in one.record["assumed"][:1]]
        lines += ["| where | claimed | verdict | computed |", "|---|---|---|---|"]
        lines += [_row(claim["place"], claim["statement"], _verdict(claim), claim["computed"]) for claim in one.claims]
    return "\n".join(lines) + "\n"


def _verdict(claim: Mapping[str, str]) -> str:
    return claim["verdict"] if claim["verdict"] == "holds" else f"**{claim['verdict']}**"


def _row(*cells: str) -> str:
    escaped = (cell.replace("|", "\\|") for cell in cells)
    return f"| {' | '.join(escaped)} |"

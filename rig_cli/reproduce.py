"""`rig reproduce`: the source's figures, tables and claims, reproduced and judged."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from rig_basics.texts import number_of
from rig_cli.console import notify, print_json, wait_for_compilation
from rig_cli.numbers import WholeCount
from rig_cli.options import Json
from rig_cli.share_progress import share_progress
from rig_configs import RigFileError

if TYPE_CHECKING:
    from reproduction.files import Written


def reproduce(
    *ids: str,
    every: Annotated[bool, Parameter(name="--all", negative="", help="all items")] = False,
    list_: Annotated[bool, Parameter(name="--list", negative="", help="list the items and end")] = False,
    out: Annotated[Path, Parameter(name=["--out", "-o"], help="folder for the book and the items' files")] = Path(
        "out/reproduction"
    ),
    jobs: Annotated[WholeCount | None, Parameter(help="processes; default: one a processor")] = None,
    docs: Annotated[Path | None, Parameter(help="folder for the verdicts as pages in Markdown, with figures")] = None,
    json: Json = False,
) -> int:
    """Reproduce figures and tables of the source and judge its claims.

    IDS are the source's numbers, as 2.2, 3.13 or table-3.2; 3 means all of chapter 3. Each item's folder contains its
    figures (SVG, PNG), their data (parquet) and item.json with parameters, assumptions and verdicts; book.html contains
    all of them.

    Example: `rig reproduce 3.13`
    """
    with wait_for_compilation("reproduction"):
        from reproduction.book import counts_of, write_book, write_docs  # loads figures and the compiler
        from reproduction.catalogue import ITEMS, chosen
        from reproduction.running import reproduce as make

    if list_:
        if json:
            print_json({"items": [{"id": item.id, "title": item.title} for item in ITEMS]})
        else:
            for item in ITEMS:
                print(f"{item.id:10} {item.title}")
        return 0
    if every == bool(ids):
        raise RigFileError("rig reproduce: expected items of the source, as 2.2 or 3, or --all; --list shows them")
    items = chosen(ids)
    out.mkdir(parents=True, exist_ok=True)
    with share_progress(f"{number_of(len(items), 'item')} of the source") as progress:
        made = make(items, out, min(jobs or os.cpu_count() or 1, len(items)), lambda share, what: progress(share))
    book = write_book(out / "book.html", made)
    if docs is not None:
        write_docs(docs, made)
    if json:
        print_json(
            {
                "book": str(book),
                "verdicts": counts_of(made),
                "items": [
                    {"id": one.item.id, "folder": str(one.folder), "failed": one.failed or None, "claims": one.claims}
                    for one in made
                ],
            }
        )
        return _exit_code(made)
    for one in made:
        print(f"{one.item.id}: {one.item.title}")
        for claim in one.claims:
            print(f"  {claim['verdict']}: {claim['statement']} ({claim['place']}) {claim['computed']}")
    counts = ", ".join(f"{count} {verdict}" for verdict, count in counts_of(made).items())
    notify(f"{counts}; the book is {book}")
    return _exit_code(made)


def _exit_code(made: Sequence[Written]) -> int:
    """Return 3 if an item could not be reproduced."""
    failed = [one for one in made if one.failed]
    for one in failed:
        notify(f"{one.item.id} could not be reproduced: {one.failed}")
    return 3 if failed else 0

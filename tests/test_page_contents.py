"""Topics of a page are headings, so that the page's contents list all of them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
# Written by programs, or one short record of a decision each.
LEFT_OUT = {"book", "decisions"}
PAGES = [page for page in sorted(DOCS.rglob("*.md")) if page.relative_to(DOCS).parts[0] not in LEFT_OUT]
RUN_IN = re.compile(r"^\*\*[A-Z0-9`][^*\n]{0,59}[.:?]\*\*", re.MULTILINE)


def run_ins(text: str) -> list[str]:
    """Bold words at the start of a line that stand for a heading."""
    return RUN_IN.findall(text)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(DOCS).as_posix())
def test_topics_are_headings(page: Path) -> None:
    assert run_ins(page.read_text(encoding="utf-8")) == []


def test_a_run_in_is_found() -> None:
    text = "# Page\n**First.** A text.\n\n**Refused?** 403\n\n- **Item.** In a list.\n\nA **bold word.** In a text.\n"
    assert run_ins(text) == ["**First.**", "**Refused?**"]

"""The records in docs/decisions are numbered without gaps, listed in order, and referred to by numbers that exist."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "decisions"
RECORDS = sorted(FOLDER.glob("[0-9]*.md"))
_NAMED = re.compile(r"\bdecisions/(\d{4}-[a-z-]+)|\((\d{4}-[a-z-]+)\.md\)")
_NUMBERED = re.compile(r"\bADR (\d+)\b|[(\s](00\d\d)\b[.)]")


def texts() -> list[tuple[Path, str]]:
    """Pages and modules that may refer to a record."""
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "docs").rglob("*.ipynb")]
    modules = [path for folder in ROOT.glob("*/py.typed") for path in folder.parent.rglob("*.py")]
    return [(path, path.read_text(encoding="utf-8")) for path in (*pages, *modules)]


def test_the_numbers_have_no_gap_and_are_those_of_the_titles() -> None:
    assert [int(record.name[:4]) for record in RECORDS] == list(range(1, len(RECORDS) + 1))
    titles = [record.read_text(encoding="utf-8").splitlines()[0] for record in RECORDS]
    assert [int(title.removeprefix("# ").split(".")[0]) for title in titles] == list(range(1, len(RECORDS) + 1))


def test_the_index_lists_the_records_in_order() -> None:
    index = (FOLDER / "index.md").read_text(encoding="utf-8")
    assert re.findall(r"^(\d{4}-[a-z-]+)$", index, re.MULTILINE) == [record.stem for record in RECORDS]


def test_references_lead_to_a_record() -> None:
    names = {record.stem for record in RECORDS}
    named = {(str(path), one or two) for path, text in texts() for one, two in _NAMED.findall(text)}
    assert len(named) > 3
    assert {(path, name) for path, name in named if name not in names} == set()
    pages = [(path, text) for path, text in texts() if path.suffix == ".md" and path.parent in (ROOT / "docs", FOLDER)]
    numbered = {(str(path), int(one or two)) for path, text in pages for one, two in _NUMBERED.findall(text)}
    assert {(path, number) for path, number in numbered if not 1 <= number <= len(RECORDS)} == set()

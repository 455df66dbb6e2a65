"""README and the other pages of the root are short, and their links, make targets and commands exist."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from rig_cli.main import commands

ROOT = Path(__file__).parents[1]
LONGEST_WORDS = {"README.md": 900, "CHANGELOG.md": 600, "CONTRIBUTING.md": 450, "SECURITY.md": 450}
PAGES = [ROOT / name for name in LONGEST_WORDS]
_LINK = re.compile(r"\]\(([^)#]+)(?:#[^)]*)?\)")
_TARGET = re.compile(r"(?:^|`)make ([a-z-]+)", re.MULTILINE)
_COMMAND = re.compile(r"(?:^|`)rig ([a-z]+)", re.MULTILINE)

each = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


def missing(text: str) -> list[str]:
    """Links, make targets and commands of a page of the root that do not exist."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    links = [link for link in _LINK.findall(text) if "://" not in link and not (ROOT / link).exists()]
    targets = [target for target in _TARGET.findall(text) if not re.search(rf"^{target}:", makefile, re.MULTILINE)]
    return links + targets + sorted(set(_COMMAND.findall(text)) - set(commands()))


@each
def test_a_page_of_the_root_is_short(page: Path) -> None:
    assert len(page.read_text(encoding="utf-8").split()) <= LONGEST_WORDS[page.name]


@each
def test_what_a_page_of_the_root_names_exists(page: Path) -> None:
    assert missing(page.read_text(encoding="utf-8")) == []


@each
def test_the_source_distribution_contains_what_a_page_links_to(page: Path) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    included = set(project["tool"]["hatch"]["build"]["targets"]["sdist"]["include"])
    links = [link for link in _LINK.findall(page.read_text(encoding="utf-8")) if "://" not in link]
    assert {page.name, *(link.split("/")[0] for link in links)} <= included


def test_what_does_not_exist_is_found() -> None:
    text = (
        "```\nmake demo\nmake tea\n```\n[a](docs/index.md#x) [b](docs/no.md), `rig demo` and `rig dance`, https://x.y"
    )
    assert missing(text) == ["docs/no.md", "tea", "dance"]


def test_the_first_page_leads_every_role_to_a_page() -> None:
    last = (ROOT / "README.md").read_text(encoding="utf-8").split("## Where to go next")[1]
    rows = [row for row in last.splitlines() if row.startswith("| an ")]
    assert [row.split("|")[1].strip() for row in rows] == [
        "an operator",
        "an experimenter",
        "an analyst",
        "an engineer",
    ]
    assert all("](docs/" in row for row in rows)


def test_the_changelog_has_the_sections_of_keep_a_changelog() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    kinds = set(re.findall(r"^### (.*)$", text, re.MULTILINE))
    assert kinds <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    assert re.findall(r"^## (?!\d+\.\d+\.\d+ \((?:unreleased|\d{4}-\d\d-\d\d)\)$).*$", text, re.MULTILINE) == []

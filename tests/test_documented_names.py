"""Modules, names and files of the project that README and docs mention exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = sorted(path.parent.name for path in ROOT.glob("*/py.typed"))
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
NEW_IN_AN_EXAMPLE = {"analysis/figures/radius.py"}  # the file that the how-to makes
_PACKAGE = "|".join(PACKAGES)
_NAME = re.compile(rf"(?<![\w./-])((?:{_PACKAGE})(?:\.[A-Za-z_]\w*)+)(?!\.\w|\w)(?<!\.md)")
_FILE = re.compile(rf"(?<![\w/.-])((?:{_PACKAGE}|tests|benchmarks|examples)/[\w/.-]+\.(?:py|toml))\b")


def exists(name: str) -> bool:
    """Whether a dotted name leads to a module, or to a module that contains the next part of the name."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        place = ROOT.joinpath(*parts[:count])
        module = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
        if module.is_file():
            rest, stub = parts[count:], module.with_suffix(".pyi")
            text = module.read_text(encoding="utf-8") + (stub.read_text(encoding="utf-8") if stub.is_file() else "")
            return not rest or re.search(rf"\b{rest[0]}\b", text) is not None
    return False


def missing(text: str) -> list[str]:
    names = [name for name in _NAME.findall(text) if not exists(name)]
    return names + [f for f in _FILE.findall(text) if f not in NEW_IN_AN_EXAMPLE and not (ROOT / f).is_file()]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_mentions_what_exists(page: Path) -> None:
    assert missing(page.read_text(encoding="utf-8")) == []


def test_what_does_not_exist_is_found() -> None:
    text = "`daq.signals.settling.settled`, `daq.signals.settled_x`, daq/clock.py and daq/clocks.py"
    assert missing(text) == ["daq.signals.settled_x", "daq/clocks.py"]

"""Where the site's MathJax comes from, and what every built page is checked for.

A page that is read offline, next to the rig, must load nothing from the network. An option that is copied from a page
must keep its two dashes.
"""

from __future__ import annotations

import importlib.metadata
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

# One file with all glyphs as outlines: browsers refuse font files next to a page that was opened from a disk.
_MATHJAX = "sphinx-mathjax-offline/static/mathjax/tex-svg.js"
_LOADED = re.compile(r"<(?:script|link|img)\b[^>]*\b(?:src|href)=\"(?:https?:)?//[^\"]*\"[^>]*>")
_LINK_ONLY = re.compile(r"\brel=\"(?:canonical|license)\"")
_CHANGED_OPTION = re.compile(r"(?:^|(?<=[\s>(\[,|/]))[–—][a-z][\w-]*", re.MULTILINE)
_TAG = re.compile(r"<[^>]+>")


def mathjax() -> Path:
    """Return the script that sets the equations, from the wheel of the docs dependencies."""
    return Path(str(importlib.metadata.distribution("sphinx-mathjax-offline").locate_file(_MATHJAX)))


def faults(html: str) -> list[str]:
    """List what is wrong on a built page: resources from the network, options with a dash instead of two hyphens."""
    loaded = [tag for tag in _LOADED.findall(html) if not _LINK_ONLY.search(tag)]
    return [f"from the network: {tag}" for tag in loaded] + [
        f"option without its hyphens: {option}" for option in _CHANGED_OPTION.findall(_TAG.sub("\n", html))
    ]


def far_pages(contents: Mapping[str, Sequence[str]], first: str = "index", clicks: int = 2) -> list[str]:
    """List the pages that a reader does not reach in so many clicks through the contents of pages.

    Args:
        contents: the pages in the contents of each page that has contents.
    """
    near = reached = {first}
    for _ in range(clicks):
        reached = {page for name in reached for page in contents.get(name, ())}
        near |= reached
    return sorted({page for pages in contents.values() for page in pages} - near)


def faults_of_site(folder: Path) -> list[str]:
    """List the faults of all pages in a folder, each with the page's name."""
    pages = sorted(folder.rglob("*.html"))
    return [f"{page.relative_to(folder)}: {fault}" for page in pages for fault in faults(page.read_text("utf-8"))]

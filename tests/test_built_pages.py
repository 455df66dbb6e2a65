"""The check of the built site finds what the network would have to deliver and options that lost their hyphens."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

CHECK = Path(__file__).parents[1] / "docs" / "_ext" / "built_pages.py"


def _check() -> ModuleType:
    spec = importlib.util.spec_from_file_location("built_pages", CHECK)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    "page",
    [
        "<h2>Find the devices with –ask</h2>",
        "<td><p>–list-only</p></td>",
        "<p>rig devices (–network) opens no port</p>",
        '<p>as <a href="#x">—json</a></p>',
        "<title>–ask</title>",
    ],
)
def test_an_option_without_hyphens_is_found(page: str) -> None:
    (fault,) = _check().faults(page)
    assert "option" in fault


@pytest.mark.parametrize(
    "page",
    [
        '<script defer src="https://cdn.example.org/tex.js"></script>',
        '<link rel="stylesheet" href="//example.org/fonts.css">',
        '<img alt="" src="http://example.org/badge.svg">',
    ],
)
def test_a_resource_from_the_network_is_found(page: str) -> None:
    (fault,) = _check().faults(page)
    assert "example.org" in fault


def test_a_right_page_has_no_fault() -> None:
    page = (
        '<script defer="defer" src="../_static/tex-svg.js"></script><link rel="canonical" href="https://example.org/">'
        '<p>With --ask, points A–E, 2–3 mm – the usual one, and <a href="https://example.org">a link</a>.</p>'
    )
    assert _check().faults(page) == []


def test_all_pages_of_a_site_are_checked(tmp_path: Path) -> None:
    (tmp_path / "how-to").mkdir()
    (tmp_path / "index.html").write_text("<p>fine</p>", encoding="utf-8")
    (tmp_path / "how-to" / "operator.html").write_text("<p>–ask</p>", encoding="utf-8")
    assert _check().faults_of_site(tmp_path) == [f"{Path('how-to/operator.html')}: option without its hyphens: –ask"]


def test_a_page_three_clicks_away_is_found() -> None:
    contents = {"index": ["how-to/index"], "how-to/index": ["how-to/operator"], "how-to/operator": ["how-to/stop"]}
    assert _check().far_pages(contents) == ["how-to/stop"]
    assert _check().far_pages({**contents, "index": ["how-to/index", "how-to/operator"]}) == []

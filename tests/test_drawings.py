"""The drawings of the architecture show what is in the code, and refuse what is not."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

SOURCE = Path(__file__).parents[1] / "docs" / "_ext" / "drawings.py"


@pytest.fixture(scope="module")
def drawings() -> ModuleType:
    spec = importlib.util.spec_from_file_location("drawings", SOURCE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["drawings"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_both_marks_are_replaced(drawings: ModuleType) -> None:
    page = "# Architecture\n" + "\n\n".join(drawings.MARKS)
    drawn = drawings.with_drawings(page)
    assert drawn.count("<svg") == 2
    assert not any(mark in drawn for mark in drawings.MARKS)
    assert "Bytes in and out of one device" in drawn, "the first sentence of Link"


def test_the_architecture_page_shows_both(drawings: ModuleType) -> None:
    page = (SOURCE.parents[1] / "architecture.md").read_text(encoding="utf-8")
    assert all(mark in page for mark in drawings.MARKS)


def test_a_flow_that_no_module_knows_is_refused(drawings: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawings, "FLOWS", (*drawings.FLOWS, ("interlocks", "report", "")))
    with pytest.raises(LookupError, match="interlocks → report: no module imports"):
        drawings.way_of_data()


def test_a_name_that_is_gone_is_refused(drawings: ModuleType) -> None:
    with pytest.raises(LookupError, match="Gone has no docstring, or does not exist"):
        drawings.sentence_of("daq.transports.link:Gone")


def test_the_arrows_lead_downwards_only(drawings: ModuleType) -> None:
    depth = {name: row for row, names in enumerate(drawings.layers()) for name in names}
    arrows = drawings.direct_imports()
    assert arrows
    assert all(depth[above] < depth[below] for above, below in arrows)
    assert ("identification", "daq") in arrows
    assert ("identification", "rig_basics") not in arrows, "follows from others"

"""Maps of stability: question (`question`), computation (`answers`), files (`files`)."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from analysis.maps.answers import MapAnswer, answer
    from analysis.maps.axes import MapAxis
    from analysis.maps.families import BestValue, BorderFamily, SearchRange
    from analysis.maps.files import load_map, write_map
    from analysis.maps.question import MapQuestion, parameters_source, rig_source
    from analysis.maps.records import MapRecord, record
    from analysis.maps.refinement import refined_grid

__all__ = [
    "BestValue",
    "BorderFamily",
    "MapAnswer",
    "MapAxis",
    "MapQuestion",
    "MapRecord",
    "SearchRange",
    "answer",
    "load_map",
    "parameters_source",
    "record",
    "refined_grid",
    "rig_source",
    "write_map",
]

_HOME = {
    "BestValue": "families",
    "Family": "families",
    "MapAnswer": "answers",
    "MapAxis": "axes",
    "MapQuestion": "question",
    "MapRecord": "records",
    "SearchRange": "families",
    "answer": "answers",
    "load_map": "files",
    "parameters_source": "question",
    "record": "records",
    "refined_grid": "refinement",
    "rig_source": "question",
    "write_map": "files",
}


def __getattr__(name: str) -> Any:
    """Return a public name from its module, which is loaded at first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)

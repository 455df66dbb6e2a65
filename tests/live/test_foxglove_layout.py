"""The layout for Foxglove names channels and fields that logs have."""

import json
from pathlib import Path

from daq.channels import CHANNELS

LAYOUT = Path(__file__).parents[2] / "docs" / "foxglove" / "layout.json"


def test_every_path_is_a_field_of_a_log_and_every_panel_is_laid_out() -> None:
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))
    paths = [path["value"] for panel in layout["configById"].values() for path in panel["paths"]]
    assert len(paths) == 6
    for path in paths:
        topic, _, field = path.rpartition(".")
        assert field in CHANNELS[topic].names, path
    placed: list[str] = []
    parts = [layout["layout"]]
    while parts:
        part = parts.pop()
        if isinstance(part, str):
            placed.append(part)
        else:
            parts += [part["first"], part["second"]]
    assert sorted(placed) == sorted(layout["configById"])

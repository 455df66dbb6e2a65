# pyright: strict
"""Files that hold a map."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from analysis.maps.answer import MapAnswer


def write_map(path: Path, found: MapAnswer) -> None:
    """Write a map's arrays in the format of the file's suffix."""
    np.savez_compressed(path, allow_pickle=False, **cast(dict[str, Any], arrays(found)))


def arrays(found: MapAnswer) -> dict[str, NDArray[Any]]:
    """What is kept: the axes under their keys, the map, and each border's points."""
    kept: dict[str, NDArray[Any]] = {
        found.question.x.keys[0]: found.grid.x,
        found.question.y.keys[0]: found.grid.y,
        "multiplier_max": found.grid.multiplier_max,
        "error_estimate": found.grid.error_estimate,
        "decay_rate_per_s": found.grid.decay_rate_per_s,
    }
    for number, branch in enumerate(found.borders.branches if found.borders else (), 1):
        kept[f"border_{number}"] = np.column_stack([branch.x, branch.y])
        kept[f"border_{number}_multiplier"] = branch.multiplier
    return kept

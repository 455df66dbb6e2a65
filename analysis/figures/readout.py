# pyright: strict
"""Values that a page shows under the pointer."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Readout:
    """Values over the axes of a figure; the nearest point's are shown.

    Attributes:
        box: left, bottom, right and top of the axes as shares of the figure.
        names: of x and y.
        logarithmic: whether an axis is.
        x, y: of the points, shapes (n,) and (m,), rising from one side of the axes to the other.
        layers: name to values, shape (m, n); NaN: none there.
    """

    box: tuple[float, float, float, float]
    names: tuple[str, str]
    logarithmic: tuple[bool, bool]
    x: NDArray[np.floating]
    y: NDArray[np.floating]
    layers: Mapping[str, NDArray[np.floating]]

    def as_json(self) -> str:
        """For the page's script; values as base64 of 32-bit numbers, little end first."""

        def packed(values: NDArray[np.floating]) -> str:
            return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")

        held = {
            "box": self.box,
            "names": self.names,
            "logarithmic": self.logarithmic,
            "x": packed(self.x),
            "y": packed(self.y),
            "layers": [{"name": name, "values": packed(values)} for name, values in self.layers.items()],
        }
        return json.dumps(held).replace("<", "\\u003c")  # nothing in it ends the script

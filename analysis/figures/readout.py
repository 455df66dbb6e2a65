"""Values that a page displays at the pointer."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from analysis.maps.axes import MapAxis


@dataclass(frozen=True)
class Readout:
    """Values over the axes of a figure; those of the nearest point are displayed.

    Attributes:
        box: left, bottom, right and top of the axes as shares of the figure.
        names: names of x and y.
        logarithmic: whether each axis is logarithmic.
        x, y: coordinates of the points, shapes (n,) and (m,), rising from one side of the axes to the other.
        layers: name to values, shape (m, n); NaN where no value exists.
    """

    box: tuple[float, float, float, float]
    names: tuple[str, str]
    logarithmic: tuple[bool, bool]
    x: NDArray[np.floating]
    y: NDArray[np.floating]
    layers: Mapping[str, NDArray[np.floating]]

    @classmethod
    def over(
        cls,
        axes: Axes,
        lines: tuple[MapAxis, MapAxis],
        x: NDArray[np.floating],
        y: NDArray[np.floating],
        layers: Mapping[str, NDArray[np.floating]],
    ) -> Readout:
        """Return the readout over the axes of a figure.

        Args:
            axes: the axes, placed for good.
            lines: axes of the map's question.
            x, y, layers: as the attributes.
        """
        box = axes.get_position()
        return cls(
            (float(box.x0), float(box.y0), float(box.x1), float(box.y1)),
            (lines[0].name, lines[1].name),
            (lines[0].logarithmic, lines[1].logarithmic),
            x,
            y,
            layers,
        )

    def as_json(self) -> str:
        """Return JSON for the page's script; values as base64 of 32-bit little-endian floats."""

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
        return json.dumps(held).replace("<", "\\u003c")  # the text cannot end the script element

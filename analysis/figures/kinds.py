"""All kinds of figures of logs by name, with their contents and drawing functions."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol, cast

from matplotlib.figure import Figure

from analysis.rig_model import RigModel
from daq.signals.run import Run


class DrawRun(Protocol):
    """Function that draws one run."""

    def __call__(self, run: Run, model: RigModel | None = None, over: Run | None = None) -> Figure:
        """Draw a run, with the model and another run over it if they are given."""
        ...


@dataclass(frozen=True)
class FigureKind:
    """A kind of figure.

    Attributes:
        name: name as an argument of `rig plot`, also listed in `rig_cli.plot.Kind`. An identifier without hyphens.
        shows: contents in one line.
        of: input: each run, each log as recorded, or all of them together. The last two are drawn by functions of their
            own in `rig_cli.plotted`.
        overlays: whether a second run may be drawn over it.
    """

    name: str
    shows: str
    of: Literal["run", "log", "all"] = "run"
    overlays: bool = True

    @property
    def draw(self) -> DrawRun:
        """Drawing function of a kind that shows runs: `analysis.figures.<module>.draw_<name>`."""
        module = importlib.import_module(f"analysis.figures.{_MODULES.get(self.name, self.name)}")
        return cast("DrawRun", getattr(module, f"draw_{self.name}"))


_MODULES = {"time": "time_history"}
_ALL = (
    FigureKind("time", "displacements, pendulum angles and speed over time, measured and simulated"),
    FigureKind("orbit", "the disk centre's path with the index mark; of a run-up, six orbits through its resonances"),
    FigureKind("dial", "pendulum angles on the rotor: held, measured at the end, predicted"),
    FigureKind("bode", "1× amplitude and phase over speed"),
    FigureKind("polar", "1× vectors in the plane, speeds marked along the curve"),
    FigureKind("waterfall", "cascade of spectra over speed"),
    FigureKind("spectrum", "full spectrum, forward and backward, and power densities with units"),
    FigureKind("orders", "amplitude over order and speed"),
    FigureKind("health", "rates, gaps, losses and ages of all streams over time", of="log", overlays=False),
    FigureKind("slip", "pendulum angles and slip order over speed", of="all", overlays=False),
    FigureKind("multipliers", "multipliers in the plane and along the speed", of="all", overlays=False),
    FigureKind("map", "stability map with the points that the logs are of", of="all", overlays=False),
    FigureKind("residuals", "what identification fitted to each log, and what it left", of="all", overlays=False),
    FigureKind("history", "parameters over time, of parameters files", of="all", overlays=False),
)
KINDS: Mapping[str, FigureKind] = {kind.name: kind for kind in _ALL}

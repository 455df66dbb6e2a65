"""A rig's parameters over time, converted from the history of identification to the figure's types."""

from __future__ import annotations

from matplotlib.figure import Figure

from analysis.figures.parameter_history import Value, draw_parameter_history
from identification.history import History
from rig_configs import PARAMETER_UNITS


def history_figure(found: History, level: float) -> Figure:
    """Draw the history.

    Args:
        found: parameters files in the order of their tests.
        level: probability of marking any change if there is none.
    """
    joint, single, marks = list[Value](), list[Value](), list[Value]()
    for instant, step in zip(found.instants, found.steps, strict=True):
        joint += [
            Value(n, instant.time, v, instant.parameters.std[n], instant.path.stem)
            for n, v in instant.parameters.values.items()
        ]
        single += [
            Value(
                n,
                t.recorded or instant.time,
                t.estimate.value(n),
                t.estimate.std[n],
                t.estimate.test,
                left_out=bool(t.left_out),
            )
            for t in instant.tests
            for n in t.estimate.names
        ]
        marks += [
            Value(c.name, instant.time, c.new, c.std, f"{100 * c.relative:+.3g} %")
            for c in (step.significant(level) if step else [])
        ]
    rig = next((i.rig for i in found.instants if i.rig), "")
    units = {n: PARAMETER_UNITS[n] for n in PARAMETER_UNITS if any(v.name == n for v in joint)}
    return draw_parameter_history(joint, single, marks, units, rig)

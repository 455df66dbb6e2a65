"""Figures 4.5 and 4.6: borders of stability for several dampings of suspension and pendulums."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.stability_map import set_plane
from analysis.maps.families import SearchRange, best_value
from dynamics.equations.parameters import RotorParameters
from dynamics.stability.borders import Borders
from reproduction.items.stability_plane import X_RANGE, Y_RANGE, borders_of_plane, frame_of_rig
from reproduction.results import Claim, Panel, Reproduced, SourceTable
from reproduction.workspace import VIRTUAL, Workspace, numbers_of

_FAMILY_ZETA = (0.005, 0.02, 0.05, 0.1, 0.2)
_FAMILY_C34 = (3e-4, 1e-3, 3e-3, 1e-2, 3e-2)
_WIDE_C34 = (1e-5, 1.0, 11)
_SHADES = ("#440154", "#3b528b", "#21918c", "#5ec962", "#b8a000")
_DASHES = ("-", (0, (7, 2)), (0, (4, 2)), (0, (6, 2, 1, 2)), (0, (1, 1.3)))


def _family(work: Workspace, settings: Sequence[Sequence[str]]) -> list[Borders]:
    found = list[Borders]()
    for each in settings:
        found.append(borders_of_plane(work.physics(VIRTUAL, each)))
        work.progress(0.7 * len(found) / len(settings))
    return found


def _draw_family(members: Sequence[Borders], names: Sequence[str], title: str, p: RotorParameters) -> Figure:
    with sheet(WIDTH_IN, 4.8, title) as figure:
        axes: Axes = figure.subplots()
        axes.grid(False)
        for borders, name, shade, dashes in zip(members, names, _SHADES, _DASHES, strict=True):
            for branch in borders.branches:
                axes.plot(
                    branch.x,
                    branch.y,
                    color=shade,
                    ls=dashes,
                    lw=1.6,
                    label=f"{name}: {100 * borders.stable_share:.1f} %",
                )
        set_plane(axes, (np.array(X_RANGE), np.array(Y_RANGE)), replace(frame_of_rig(p), points=()))
    return figure


def _family_table(members: Sequence[Borders], values: Sequence[float], key: str) -> SourceTable:
    parts = [(value, branch) for value, borders in zip(values, members, strict=True) for branch in borders.branches]
    return SourceTable(
        "borders",
        f"Borders for each {key}",
        {
            key: np.concatenate([np.full(len(branch.x), value) for value, branch in parts]),
            "speed_ratio": np.concatenate([branch.x for _, branch in parts]),
            "stiffness_ratio": np.concatenate([branch.y for _, branch in parts]),
        },
    )


def _zeta(value: float) -> list[str]:
    return [f"suspension.zeta1={value!r}", f"suspension.zeta2={value!r}"]


def _c34(value: float) -> list[str]:
    return [f"pendulums.{name}.damping_Nms_per_rad={value!r}" for name in ("a", "b")]


def family_over_zeta_4_5(work: Workspace) -> Reproduced:
    """Reproduce Figure 4.5: borders for five damping ratios of the suspension; the ratio of the largest stable area."""
    members = _family(work, [_zeta(value) for value in _FAMILY_ZETA])
    p = work.physics()
    names = [f"ζ = {value:g}" for value in _FAMILY_ZETA]
    figure = _draw_family(
        members, names, "4.5: borders for several damping ratios of the suspension, with stable shares", p
    )

    def share(value: float) -> tuple[float, float]:
        return borders_of_plane(work.physics(VIRTUAL, _zeta(value))).stable_share, 0.0

    best = best_value(
        share,
        lambda value: 1e-4,
        SearchRange(("suspension.zeta1",), 0.005, 2.0, True),
        lambda done: work.progress(0.7 + 0.3 * done),
    )
    shares = ", ".join(
        f"{100 * borders.stable_share:.1f} % at {value:g}" for value, borders in zip(_FAMILY_ZETA, members, strict=True)
    )
    ends = float(best.shares[0]), float(best.shares[-1])
    return Reproduced(
        (
            Panel(
                "family",
                "Borders of the stable areas for five damping ratios; the share of the range that is stable "
                "stands with each.",
                figure,
            ),
        ),
        (
            _family_table(members, _FAMILY_ZETA, "zeta"),
            SourceTable(
                "share",
                "Stable share of the range over ζ",
                {"zeta": best.values, "stable_share": best.shares},
                shown=True,
            ),
        ),
        numbers_of(p) | {"zeta1": "0.005 … 0.2", "zeta2": "0.005 … 0.2"},
        (
            "The five damping ratios, within appendix A's 0.001 … 0.2; c34 = 0.001 N m s/rad is the source's.",
            "The stable area is that of Ω = 0.3 … 7, K = 1 … 16.",
        ),
        (
            Claim(
                "4.1.5",
                "There is a damping ratio of the suspension at which the stable area is greatest.",
                ("holds" if best.value <= 0.2 else "holds in part")
                if not best.at_end and best.share > max(ends) + 0.01
                else "does not hold",
                f"{100 * best.share:.2f} % at ζ = {best.value:.4f} ({best.interval[0]:.3f} … {best.interval[1]:.3f})"
                f", {100 * ends[0]:.1f} % at 0.005 and {100 * ends[1]:.1f} % at 2; within the facility's range "
                f"(appendix A: up to 0.2) the area only grows: {shares}",
            ),
        ),
    )


def family_over_c34_4_6(work: Workspace) -> Reproduced:
    """Reproduce Figure 4.6: borders for five dampings of the pendulums."""
    members = _family(work, [_c34(value) for value in _FAMILY_C34])
    p = work.physics()
    names = [f"c34 = {value:g} N m s/rad" for value in _FAMILY_C34]
    figure = _draw_family(members, names, "4.6: borders for several dampings of the pendulums, with stable shares", p)
    wide = np.geomspace(*_WIDE_C34)
    shares = np.array([borders_of_plane(work.physics(VIRTUAL, _c34(float(value)))).stable_share for value in wide])
    own = [borders.stable_share for borders in members]
    grows = bool(np.all(np.diff(own) > 0))
    falls = [float(wide[i + 1]) for i in np.flatnonzero(np.diff(shares) < -1e-4)]
    return Reproduced(
        (
            Panel(
                "family",
                "Borders of the stable areas for five dampings of the pendulums; the share of the range that "
                "is stable stands with each.",
                figure,
            ),
        ),
        (
            _family_table(members, _FAMILY_C34, "c34_Nms_per_rad"),
            SourceTable(
                "share",
                "Stable share of the range over c34",
                {"c34_Nms_per_rad": wide, "stable_share": shares},
                shown=True,
            ),
        ),
        numbers_of(p) | {"c3_Nms_per_rad": "3e-4 … 0.03", "c4_Nms_per_rad": "3e-4 … 0.03"},
        ("The five dampings around the source's 0.001 N m s/rad; ζ = 0.02.",),
        (
            Claim(
                "4.1.5",
                "More damping of the pendulums makes the stable area larger.",
                ("holds" if not falls else "holds in part") if grows else "does not hold",
                "; ".join(f"{100 * share:.1f} % at {value:g}" for value, share in zip(_FAMILY_C34, own, strict=True))
                + (
                    f"; over 1e-5 … 1 N m s/rad it falls again from {falls[0]:.2g} on"
                    if falls
                    else "; it never falls over 1e-5 … 1 N m s/rad"
                ),
            ),
        ),
    )

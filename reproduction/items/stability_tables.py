"""Tables 3.1 to 3.3: stability of each type of singular point, cell by cell."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.figures.balancing_plane import draw_regions
from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import GOOD, GREY, MODEL, label
from dynamics import Scene, SpeedHistory, simulate
from dynamics.equations.balancing import IMPROPERLY_OVERSIZED, PROPERLY_OVERSIZED, UNDERSIZED
from dynamics.steady.point_eigenvalues import point_eigenvalues
from dynamics.steady.whirl import circular_whirl
from reproduction.items.point_sweeps import (
    ABSENT,
    C34,
    CASES,
    SHOWN_C34,
    SHOWN_SPEED,
    SHOWN_ZETA,
    SPEEDS,
    SUB,
    SUPER,
    ZETAS,
    SweepRig,
    Swept,
    points_of,
    real_parts,
    swept,
)
from reproduction.results import Claim, Panel, Reproduced, SourceTable, Verdict
from reproduction.workspace import Workspace, numbers_of
from rig_basics.texts import number_of

_CURVES_C34 = tuple(float(c) for c in np.logspace(-5, 0, 61))
_LINEAR_1_PER_S = 0.01  # limit of the linear part of the axis of real parts
_ROMAN = {"I": ("mirror image 1", "mirror image 2"), "II": ("set I", "set II"), "III": ("set I", "set II")}

Cells = dict[tuple[str, str], tuple[bool, bool]]
"""(operation, region) → the source's verdicts on sets I and II: stable or not."""

_NEVER = (False, False)
_TABLE_3_1: Cells = {(SUB, PROPERLY_OVERSIZED): _NEVER, (SUPER, PROPERLY_OVERSIZED): (True, True)}
_TABLE_3_2: Cells = {(op, case.region): _NEVER for op in (SUB, SUPER) for case in CASES}
_TABLE_3_2[SUPER, IMPROPERLY_OVERSIZED] = (False, True)
_TABLE_3_3: Cells = {(op, case.region): _NEVER for op in (SUB, SUPER) for case in CASES}
for _region in (PROPERLY_OVERSIZED, UNDERSIZED, IMPROPERLY_OVERSIZED):
    _TABLE_3_3[SUB, _region] = (False, True)
_TABLE_3_3[SUPER, UNDERSIZED] = (False, True)


def table_3_1(work: Workspace) -> Reproduced:
    """Reproduce Table 3.1: Type I."""
    made = _made(work, "I", "3.1", _TABLE_3_1)
    outside = [swept(SweepRig.of(work, case), op, "I") for case in CASES[1:] for op in (SUB, SUPER)]
    met = sum(int(np.sum(one.stable != ABSENT)) for one in outside)
    claim = Claim.judged(
        "Table 3.1",
        "Outside ABCD Type I does not exist.",
        met == 0,
        f"{number_of(sum(one.stable[0].size for one in outside), 'place')} of undersized and improperly "
        f"oversized sets: {met}",
    )
    grown = _grown(SweepRig.of(work, CASES[0]))
    return Reproduced(made.panels, made.tables, made.parameters, made.assumed, (*made.claims, claim, grown))


def _grown(bench: SweepRig) -> Claim:
    """Compare the growth of an unstable Type I above resonance, integrated from near it, with its eigenvalue."""
    ratio = 1.1
    p = bench.damped(SHOWN_ZETA, SHOWN_C34)
    point, speed = points_of(p, ratio, "I")[0], p.speed_rad_s(ratio)
    largest = point_eigenvalues(p, speed, [point])[0, 0]
    period, late, windows = 2 * math.pi / abs(float(largest.imag)), 10.0, 6
    start = circular_whirl(speed, point)[0] + np.array([0, 0, 1e-5, 0, 0, 0, 0, 0])
    times: NDArray[np.float64] = np.linspace(0.0, late + (windows + 1) * period, 6001)
    state = simulate(p, Scene(SpeedHistory.constant(speed), (True, True), start), times, 1e-7).state
    away = np.max(np.abs(state[:, 2:4] - np.array(point.theta_rad)), axis=1)
    first, last = (
        float(np.max(away[(times >= begin) & (times <= begin + period)])) for begin in (late, late + windows * period)
    )
    rate = math.log(last / first) / (windows * period)
    return Claim.judged(
        "(3-26) to (3-32)",
        "Eigenvalues of the linearised equations describe how a deviation grows.",
        abs(rate / largest.real - 1) < 0.02,
        f"Type I at Ω = {ratio:g}, ζ = {SHOWN_ZETA:g}, c34 = {SHOWN_C34:g} N m s/rad: Re λ = {largest.real:+.4f} 1/s "
        f"(unstable above resonance); integrated from 1e-5 rad off it {rate:+.4f} 1/s",
    )


def table_3_2(work: Workspace) -> Reproduced:
    """Reproduce Table 3.2: Type II, both sets."""
    return _made(work, "II", "3.2", _TABLE_3_2)


def table_3_3(work: Workspace) -> Reproduced:
    """Reproduce Table 3.3: Type III, both sets."""
    return _made(work, "III", "3.3", _TABLE_3_3)


def _made(work: Workspace, kind: str, number: str, cells: Cells) -> Reproduced:
    benches = {case.region: SweepRig.of(work, case) for case in CASES}
    found = dict[tuple[str, str], Swept]()
    curves = dict[tuple[str, str], list[NDArray[np.float64]]]()
    for i, (operation, region) in enumerate(cells):
        found[operation, region] = swept(benches[region], operation, kind)
        curves[operation, region] = real_parts(benches[region], operation, kind, _CURVES_C34)
        work.progress((i + 1) / len(cells))
    panel = Panel(
        "real-parts",
        f"Each row a cell of Table {number}: the set's place in the plane, and the real parts of the eigenvalues of "
        "its two points over pendulum damping; the largest in colour.",
        _drawn(benches, curves, cells, kind, number),
    )
    return Reproduced(
        (panel,),
        (_cells(found, cells, kind), _curve_table(curves, kind)),
        numbers_of(benches[PROPERLY_OVERSIZED].rig)
        | {"c34_Nms_per_rad": "1e-5 … 1", "zeta1": "0.005 … 0.3", "zeta2": "0.005 … 0.3"},
        (
            "Pendulum sets: S_A, S_B = " + "; ".join(f"{c.a:g}, {c.b:g} S_P ({c.region})" for c in CASES) + ".",
            f"Curves at Ω = {SHOWN_SPEED[SUB]:g} and {SHOWN_SPEED[SUPER]:g}, ζ = {SHOWN_ZETA:g}; verdicts from "
            f"Ω = {', '.join(f'{r:g}' for r in SPEEDS[SUB] + SPEEDS[SUPER])}, "
            f"ζ = {', '.join(f'{z:g}' for z in ZETAS)} and {number_of(len(C34), 'value')} of c34 from 1e-5 "
            f"to 1 N m s/rad.",
            "The source does not state which of a type's two solutions its sets are: set II is the one whose whirl "
            "lies further along the pendulums' moment.",
            "A cell holds where every point of the sweep agrees, in part where Ω = 0.8 or 2.5, ζ = 0.05 and c34 = "
            "0.001 N m s/rad agree.",
        ),
        tuple(_judged(found[cell], cell, claimed, kind, number) for cell, claimed in cells.items()),
    )


def _judged(found: Swept, cell: tuple[str, str], claimed: tuple[bool, bool], kind: str, number: str) -> Claim:
    """Return one cell: the claim on both sets compared with the sweep."""
    operation, region = cell
    agree = [
        (own == (1 if expected else -1)) | (own == ABSENT) for own, expected in zip(found.stable, claimed, strict=True)
    ]
    at = found.at(SHOWN_SPEED[operation], SHOWN_ZETA, SHOWN_C34)
    shown = all(own == (1 if expected else -1) for own, expected in zip(at.tolist(), claimed, strict=True))
    verdict: Verdict = "holds" if all(a.all() for a in agree) else "holds in part" if shown else "does not hold"
    words = (
        "both sets are unstable"
        if not any(claimed)
        else ("both mirror images are stable" if all(claimed) else "set II is stable, set I unstable")
    )
    if kind == "I":
        words = "it is stable" if all(claimed) else "it is unstable"
    parts = [f"{name} {_counted(own)}" for name, own in zip(_ROMAN[kind], found.stable, strict=True)]
    off = [
        _needed(own, found.speeds)
        for own, expected, a in zip(found.stable, claimed, agree, strict=True)
        if expected and not a.all()
    ]
    return Claim(
        f"Table {number}", f"Type {kind}, {operation}, {region}: {words}.", verdict, "; ".join([*parts, *off[:1]])
    )


def _counted(own: NDArray[np.int64]) -> str:
    there = int(np.sum(own != ABSENT))
    lost = own.size - there
    return f"stable at {int(np.sum(own == 1))} of {there}" + (f", lost at {lost}" if lost else "")


def _needed(own: NDArray[np.int64], speeds: tuple[float, ...]) -> str:
    """Return the pendulum damping above which all is stable, by speed."""
    words: list[str] = []
    for ratio, plane in zip(speeds, own, strict=True):
        bad = np.any((plane != 1) & (plane != ABSENT), axis=0)
        last = int(np.max(np.flatnonzero(bad), initial=-1))
        least = "any" if last < 0 else "none" if last + 1 == len(C34) else f"from {C34[last + 1]:.2g}"
        worst = [z for z, row in zip(ZETAS, plane, strict=True) if np.any((row != 1) & (row != ABSENT))]
        words.append(f"Ω = {ratio:g}: {least}" + (f" (unstable below at ζ = {_some(worst)})" if worst else ""))
    return "c34 that is enough at every ζ, N m s/rad: " + ", ".join(words)


def _some(zetas: list[float]) -> str:
    return "all" if len(zetas) == len(ZETAS) else ", ".join(f"{z:g}" for z in zetas)


def _cells(found: dict[tuple[str, str], Swept], cells: Cells, kind: str) -> SourceTable:
    rows = [
        (operation, region, name, "stable" if claimed[i] else "unstable", own)
        for (operation, region), claimed in cells.items()
        for i, (name, own) in enumerate(zip(_ROMAN[kind], found[operation, region].stable, strict=True))
    ]
    return SourceTable(
        "cells",
        f"Type {kind} over the sweep",
        {
            "operation": [r[0] for r in rows],
            "region": [r[1] for r in rows],
            "set": [r[2] for r in rows],
            "source": [r[3] for r in rows],
            "stable": [float(np.sum(r[4] == 1)) for r in rows],
            "unstable": [float(np.sum(r[4] == -1)) for r in rows],
            "lost": [float(np.sum(r[4] == ABSENT)) for r in rows],
        },
        shown=True,
    )


def _curve_table(curves: dict[tuple[str, str], list[NDArray[np.float64]]], kind: str) -> SourceTable:
    columns: dict[str, NDArray[np.float64]] = {"c34_Nms_per_rad": np.array(_CURVES_C34)}
    for (operation, region), both in curves.items():
        for name, own in zip(_ROMAN[kind], both, strict=False):
            start = f"{operation} {region} {name}"
            columns |= {f"{start} real_{i + 1}_1_per_s": own[:, i] for i in range(8)}
    return SourceTable("real-parts", "Real parts of the eigenvalues over c34", columns)


def _drawn(
    benches: dict[str, SweepRig],
    curves: dict[tuple[str, str], list[NDArray[np.float64]]],
    cells: Cells,
    kind: str,
    number: str,
) -> Figure:
    title = f"Table {number}: Type {kind}, real parts of the eigenvalues over pendulum damping"
    with sheet(WIDTH_IN, 1.75 * len(cells) + 0.3, title) as figure:
        grid = figure.add_gridspec(len(cells), 3, width_ratios=(0.62, 1, 1))
        for i, (operation, region) in enumerate(cells):
            _place(figure.add_subplot(grid[i, 0]), benches[region], operation)
            both = curves[operation, region]
            for j, name in enumerate(_ROMAN[kind]):
                axes = figure.add_subplot(grid[i, 1 + j])
                _curves(axes, both[j] if j < len(both) else None, name)
                if j == 0:
                    label(axes, None, "Re λ, 1/s")
                if i == len(cells) - 1:
                    label(axes, "c34, N m s/rad")
    return figure


def _place(axes: Axes, bench: SweepRig, operation: str) -> None:
    s = bench.rig.imbalance_moment_kg_m
    draw_regions(axes, s, 2.2 * s)
    for patch in (*axes.patches, *axes.lines):
        patch.set_label("")
    axes.plot(1e3 * bench.case.a * s, 1e3 * bench.case.b * s, "o", color="black", ms=4)
    axes.set(xticks=(), yticks=())
    label(axes, "S_A", "S_B", f"{operation}, Ω = {SHOWN_SPEED[operation]:g}")


def _curves(axes: Axes, values: NDArray[np.float64] | None, name: str) -> None:
    axes.set_xscale("log")
    if values is None:
        label(axes, None, None, f"{name}: does not exist here")
        return
    largest, c34 = values.max(axis=1), np.array(_CURVES_C34)
    colour = GOOD if np.all(largest < 0) else MODEL
    for own in values.T:
        axes.plot(c34, own, color=GREY, lw=0.7)
    axes.plot(c34, largest, color=colour, lw=1.8)
    axes.axhline(0, color="black", lw=0.8)
    axes.set_yscale("symlog", linthresh=_LINEAR_1_PER_S, linscale=0.9)
    axes.set_yticks((-100, -1, -0.01, 0, 0.01, 1, 100), ("−100", "−1", "−0.01", "0", "0.01", "1", "100"))
    axes.set(ylim=(-5e3, 1e2), xlim=(c34[0], c34[-1]))
    axes.tick_params(labelsize=7)
    verdict = "stable" if np.all(largest < 0) else "unstable" if np.all(largest > 0) else "stable in part"
    axes.set_title(f"{name}: {verdict}", color=colour, parse_math=False)

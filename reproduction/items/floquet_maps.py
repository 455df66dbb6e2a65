"""Figures 4.1 and 4.2: stability of the balanced state over speed ratio and stiffness ratio."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy
from matplotlib.axes import Axes
from numpy.typing import NDArray

from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.stability_map import draw_borders, set_plane
from analysis.figures.style import MEASURED, MODEL
from dynamics import balanced_angles, stability_map
from dynamics.equations.linearised import type_one
from dynamics.equations.parameters import RotorParameters
from dynamics.equations.periodic_matrix import (
    PeriodicMatrix,
    evaluate,
)
from dynamics.stability.floquet import piecewise, single_pass
from dynamics.stability.floquet.methods import per_radian
from reproduction.items.stability_plane import ON_LINE, X_RANGE, Y_RANGE, borders_of_plane, frame_of_rig
from reproduction.results import Claim, Panel, Reproduced, SourceTable
from reproduction.workspace import VIRTUAL, Workspace, numbers_of
from rig_basics.arrays import Array
from rig_basics.texts import number_of
from rig_configs import load_rig

_COARSE = (42, 25)
_PLANE = "The range Ω = 0.3 … 7, K = 1 … 16, and ζ = 0.02, c34 = 0.001 N m s/rad: the source gives neither in its text."


def _stable_spans(p: RotorParameters, stiffness_ratio: float, top: float = X_RANGE[1]) -> list[tuple[float, float]]:
    """Return the ranges of speed ratio in which Type I is stable at one stiffness ratio."""
    ratios = np.linspace(X_RANGE[0], top, 4001)
    found = stability_map(p, ratios, np.array([stiffness_ratio]), 1e-8).multiplier_max[0] < 1
    edges = np.flatnonzero(np.diff(np.concatenate([[False], found, [False]]).astype(int)))
    return [(float(ratios[a]), float(ratios[min(b, len(ratios)) - 1])) for a, b in edges.reshape(-1, 2).tolist()]


def _words(spans: Sequence[tuple[float, float]]) -> str:
    return ", ".join(f"{low:.3f} … {high:.3f}" for low, high in spans) or "nowhere"


def coarse_map_4_1(work: Workspace) -> Reproduced:
    """Reproduce Figure 4.1: stable and unstable points of a coarse grid, by the source's two schemes and by ours."""
    p = work.physics()
    x, y = np.linspace(*X_RANGE, _COARSE[0]), np.linspace(*Y_RANGE, _COARSE[1])
    ours: Array = np.asarray(stability_map(p, x, y, 1e-8).multiplier_max, np.float64)
    by_pieces, by_pass = np.empty_like(ours), np.empty_like(ours)
    angles = balanced_angles(p)[0]
    for row, ratio in enumerate(y.tolist()):
        rig = replace(p, k2_N_per_m=ratio * p.k1_N_per_m)
        for column, speed_ratio in enumerate(x.tolist()):
            matrix = type_one(rig, *angles, rig.speed_rad_s(speed_ratio))
            for method, steps, into in ((piecewise, 50, by_pieces), (single_pass, 10, by_pass)):
                half: Array = method.monodromy(matrix, steps).astype(np.float64)
                values: NDArray[np.complex128] = np.linalg.eigvals(half).astype(np.complex128)
                into[row, column] = float(np.max(np.abs(values))) ** 2
        work.progress((row + 1) / len(y))
    with sheet(WIDTH_IN, 4.4, "4.1: coarse stability map of the balanced state") as figure:
        axes: Axes = figure.subplots()
        axes.grid(False)
        grid_x, grid_y = np.meshgrid(x, y)
        stable = ours < 1
        axes.plot(grid_x[stable], grid_y[stable], ".", color=MEASURED, ms=4, label="stable")
        axes.plot(grid_x[~stable], grid_y[~stable], "x", color=MODEL, ms=4, mew=0.9, label="unstable")
        set_plane(axes, (x, y), replace(frame_of_rig(p), points=()))
    differ = int(np.count_nonzero((by_pieces < 1) != stable)), int(np.count_nonzero((by_pass < 1) != stable))
    spans = _stable_spans(p, ON_LINE)
    kept: dict[str, Array] = {
        "speed_ratio": grid_x.ravel(),
        "stiffness_ratio": grid_y.ravel(),
        "multiplier": ours.ravel(),
        "multiplier_piecewise_100": by_pieces.ravel(),
        "multiplier_single_pass": by_pass.ravel(),
    }
    return Reproduced(
        (Panel("map", "Dots: stable, crosses: unstable; dashed lines: resonances Ω = 1 and Ω = √K.", figure),),
        (SourceTable("map", "Largest multiplier over a revolution at the points of the coarse grid", kept),),
        numbers_of(p),
        (_PLANE, "100 pieces a revolution; a tolerance of 1e-8 for the single pass, as the listing has."),
        (
            Claim.judged(
                "4.1.4",
                "There are two stable areas with an unstable zone between them.",
                len(spans) == 2,
                f"on the line K = {ON_LINE:g} Type I is stable at Ω = {_words(spans)} (up to Ω = 7)",
            ),
            Claim.judged(
                "4.1.4",
                "Piecewise scheme and single pass give alike maps.",
                sum(differ) == 0,
                f"of {number_of(stable.size, 'point')} {differ[0]} and {differ[1]} have another verdict than "
                f"ours; largest "
                f"difference of multipliers {np.max(np.abs(by_pieces - ours)):.1e} and "
                f"{np.max(np.abs(by_pass - ours)):.1e}",
            ),
            _less_work(p, float(np.max(np.abs(by_pieces - ours)))),
        ),
    )


_PIECES, _TOLERANCE = 100, 1e-8


def _less_work(p: RotorParameters, error: float) -> Claim:
    """Count the evaluations of [A] that each of the source's schemes needs, the cost of an interpreted program."""
    evaluations = list[int]()
    for ratio in load_rig(VIRTUAL).points.values():
        matrix = type_one(p, *balanced_angles(p)[0], p.speed_rad_s(ratio.speed_ratio))
        a = np.empty((8, 8))

        def rate(phase: float, y: Array, matrix: PeriodicMatrix = matrix, a: Array = a) -> Array:
            evaluate(per_radian(matrix), phase, a)
            return a @ y

        runs: list[Any] = [
            scipy.integrate.solve_ivp(rate, (0.0, 2 * math.pi), start, "RK45", rtol=_TOLERANCE, atol=_TOLERANCE)
            for start in np.eye(8)
        ]
        evaluations.append(sum(int(run.nfev) for run in runs))
    return Claim.judged(
        "4.1.4",
        "The piecewise scheme needs much less processor time.",
        min(evaluations) > 10 * _PIECES,
        f"evaluations of [A] a point: {_PIECES} and as many exponentials, against {min(evaluations)} to "
        f"{max(evaluations)} at A to E for eight columns by a Runge–Kutta pair of order 5 at {_TOLERANCE:g}; but "
        f"{_PIECES} pieces err by up to {error:.0e} in the multiplier",
    )


def fine_map_4_2(work: Workspace) -> Reproduced:
    """Reproduce Figure 4.2: borders of the stable areas, both resonances, the points A to E."""
    p = work.physics()
    found = borders_of_plane(p)
    frame = frame_of_rig(p)
    with sheet(WIDTH_IN, 4.8, "4.2: borders of the stable areas and the points of validation") as figure:
        axes: Axes = figure.subplots()
        axes.grid(False)
        _shade(axes, p)
        draw_borders(axes, found)
        set_plane(axes, (np.array(X_RANGE), np.array(Y_RANGE)), frame)
    at = {point.name: point.speed_ratio for point in frame.points}
    moduli = stability_map(p, np.array(list(at.values())), np.array([ON_LINE]), 1e-9).multiplier_max[0]
    stable = {"A": False, "B": True, "C": True, "D": False, "E": True}
    firsts = {k: _stable_spans(p, k)[0] for k in (4.0, 9.0, ON_LINE)}
    widths = [high - low for low, high in firsts.values()]
    above = _stable_spans(p, ON_LINE, 12.0)[-1]
    second = math.sqrt(ON_LINE)
    points = "; ".join(f"{name} {value:.6f}" for name, value in zip(at, moduli.tolist(), strict=True))
    branches = [(i, branch) for i, branch in enumerate(found.branches)]
    table = {
        "branch": np.concatenate([np.full(len(b.x), i) for i, b in branches]),
        "speed_ratio": np.concatenate([b.x for _, b in branches]),
        "stiffness_ratio": np.concatenate([b.y for _, b in branches]),
    }
    return Reproduced(
        (Panel("map", "Shaded: stable. Dashed: resonances; dotted: the line of the points A to E.", figure),),
        (SourceTable("borders", "Borders as curves, each point within 1e-10 of the border", table),),
        numbers_of(p),
        (_PLANE, "Speeds of A to E: they stand only in the figure, which is lost; the shipped rig's are taken."),
        (
            Claim.judged(
                "4.1.4",
                "A and D are unstable, B, C and E are stable.",
                all((v < 1) == stable[n] for n, v in zip(at, moduli.tolist(), strict=True)),
                f"largest multipliers over a revolution: {points}",
            ),
            Claim.judged(
                "4.1.4",
                "The stable section between the resonances widens as the second spring gets stiffer.",
                widths[0] < widths[1] < widths[2],
                "; ".join(f"K = {k:g}: Ω = {a:.3f} … {b:.3f}" for k, (a, b) in firsts.items()),
            ),
            Claim.judged(
                "4.1.4",
                "The second resonance on the points' line is at Ω = 3.86.",
                abs(second - 3.86) < 0.005,
                f"√{ON_LINE:g} = {second:.4f}",
            ),
            Claim(
                "4.1.4",
                "Above the second resonance Type I is stable.",
                "holds" if above[0] <= second and above[1] >= 12.0 else "holds in part",
                f"on the points' line from Ω = {above[0]:.3f} on (looked at up to 12); it is unstable from the "
                f"resonance, {second:.3f}, up to there",
            ),
        ),
    )


def _shade(axes: Axes, p: RotorParameters) -> None:
    x, y = np.linspace(*X_RANGE, 700), np.linspace(*Y_RANGE, 400)
    stable = stability_map(p, x, y, 1e-6).multiplier_max < 1
    axes.contourf(x, y, stable, levels=[0.5, 1.5], colors=["#d7def1"])

# pyright: strict, reportUnknownMemberType=false
"""Chapter 4: stability maps of the balanced state, its multipliers along the line of points, families over damping."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.axes3d import Axes3D  # pyright: ignore[reportMissingTypeStubs]
from numpy.typing import NDArray
from scipy.integrate import solve_ivp  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.stability_map import MapFrame, MapPoint, draw_borders, set_plane
from analysis.figures.style import GREY, MEASURED, MODEL, label
from analysis.maps.families import SearchRange, best_value
from dynamics import balanced_angles, stability_map
from dynamics.equations.linearised import type_one
from dynamics.equations.parameters import RotorParameters
from dynamics.equations.periodic_matrix import (
    PeriodicMatrix,
    evaluate,  # pyright: ignore[reportUnknownVariableType]
)
from dynamics.stability.borders import Borders, stability_borders
from dynamics.stability.floquet import piecewise, single_pass
from dynamics.stability.floquet.methods import per_radian
from dynamics.stability.map_plane import SpeedStiffnessPlane
from reproduction.results import Claim, Panel, Reproduced, Table
from reproduction.workspace import VIRTUAL, Workspace, numbers_of
from rig_configs import load_rig

Array = NDArray[np.float64]

X_RANGE, Y_RANGE = (0.3, 7.0), (1.0, 16.0)
ON_LINE = 14.9
_COARSE = (42, 25)
_FAMILY_ZETA = (0.005, 0.02, 0.05, 0.1, 0.2)
_FAMILY_C34 = (3e-4, 1e-3, 3e-3, 1e-2, 3e-2)
_WIDE_C34 = (1e-5, 1.0, 11)
_SHADES = ("#440154", "#3b528b", "#21918c", "#5ec962", "#b8a000")
_DASHES = ("-", (0, (7, 2)), (0, (4, 2)), (0, (6, 2, 1, 2)), (0, (1, 1.3)))
_PLANE = "The range Ω = 0.3 … 7, K = 1 … 16, and ζ = 0.02, c34 = 0.001 N m s/rad: the source gives neither in its text."


def _frame(p: RotorParameters) -> MapFrame:
    rig = load_rig(VIRTUAL)
    points = [MapPoint(name, point.speed_ratio, point.expected) for name, point in rig.points.items()]
    return MapFrame(points=points, own=p.k2_N_per_m / p.k1_N_per_m)


def _borders(p: RotorParameters) -> Borders:
    return stability_borders(SpeedStiffnessPlane(p, balanced_angles(p)[0]), X_RANGE, Y_RANGE, spacing=1 / 800)


def _stable_spans(p: RotorParameters, stiffness_ratio: float, top: float = X_RANGE[1]) -> list[tuple[float, float]]:
    """Speed ratios between which Type I is stable at one stiffness ratio."""
    ratios = np.linspace(X_RANGE[0], top, 4001)
    found = stability_map(p, ratios, np.array([stiffness_ratio]), 1e-8).multiplier_max[0] < 1
    edges = np.flatnonzero(np.diff(np.concatenate([[False], found, [False]]).astype(int)))
    return [(float(ratios[a]), float(ratios[min(b, len(ratios)) - 1])) for a, b in edges.reshape(-1, 2).tolist()]


def _words(spans: Sequence[tuple[float, float]]) -> str:
    return ", ".join(f"{low:.3f} … {high:.3f}" for low, high in spans) or "nowhere"


def coarse_map_4_1(work: Workspace) -> Reproduced:
    """Figure 4.1: stable and unstable points of a coarse grid, by the source's two schemes and by ours."""
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
        work.tell((row + 1) / len(y))
    with sheet(WIDTH_IN, 4.4, "4.1: coarse stability map of the balanced state") as figure:
        axes: Axes = figure.subplots()
        axes.grid(False)
        grid_x, grid_y = np.meshgrid(x, y)
        stable = ours < 1
        axes.plot(grid_x[stable], grid_y[stable], ".", color=MEASURED, ms=4, label="stable")
        axes.plot(grid_x[~stable], grid_y[~stable], "x", color=MODEL, ms=4, mew=0.9, label="unstable")
        set_plane(axes, (x, y), replace(_frame(p), points=()))
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
        (Table("map", "Largest multiplier over a revolution at the points of the coarse grid", kept),),
        numbers_of(p),
        (_PLANE, "100 pieces a revolution; a tolerance of 1e-8 for the single pass, as the listing has."),
        (
            Claim.judged("4.1.4", "There are two stable areas with an unstable zone between them.", len(spans) == 2,
                         f"on the line K = {ON_LINE:g} Type I is stable at Ω = {_words(spans)} (up to Ω = 7)"),
            Claim.judged("4.1.4", "Piecewise scheme and single pass give alike maps.", sum(differ) == 0,
                         f"of {stable.size} points {differ[0]} and {differ[1]} have another verdict than ours; largest "
                         f"difference of multipliers {np.max(np.abs(by_pieces - ours)):.1e} and "
                         f"{np.max(np.abs(by_pass - ours)):.1e}"),
            _less_work(p, float(np.max(np.abs(by_pieces - ours)))),
        ),
    )  # fmt: skip


_PIECES, _TOLERANCE = 100, 1e-8


def _less_work(p: RotorParameters, error: float) -> Claim:
    """Evaluations of [A] that each of the source's schemes needs: what an interpreted program pays for."""
    evaluations = list[int]()
    for ratio in load_rig(VIRTUAL).points.values():
        matrix = type_one(p, *balanced_angles(p)[0], p.speed_rad_s(ratio.speed_ratio))
        a = np.empty((8, 8))

        def rate(phase: float, y: Array, matrix: PeriodicMatrix = matrix, a: Array = a) -> Array:
            evaluate(per_radian(matrix), phase, a)
            return a @ y

        runs: list[Any] = [
            solve_ivp(rate, (0.0, 2 * math.pi), start, "RK45", rtol=_TOLERANCE, atol=_TOLERANCE) for start in np.eye(8)
        ]
        evaluations.append(sum(int(run.nfev) for run in runs))
    return Claim.judged(
        "4.1.4", "The piecewise scheme needs much less processor time.", min(evaluations) > 10 * _PIECES,
        f"evaluations of [A] a point: {_PIECES} and as many exponentials, against {min(evaluations)} to "
        f"{max(evaluations)} at A to E for eight columns by a Runge–Kutta pair of order 5 at {_TOLERANCE:g}; but "
        f"{_PIECES} pieces err by up to {error:.0e} in the multiplier",
    )  # fmt: skip


def fine_map_4_2(work: Workspace) -> Reproduced:
    """Figure 4.2: borders of the stable areas, both resonances, the points A to E."""
    p = work.physics()
    found = _borders(p)
    frame = _frame(p)
    with sheet(WIDTH_IN, 4.8, "4.2: borders of the stable areas and the points of validation") as figure:
        axes: Axes = figure.subplots()
        axes.grid(False)
        _shade(axes, p)
        draw_borders(axes, found)
        set_plane(axes, (np.array(X_RANGE), np.array(Y_RANGE)), frame)
    at = {point.name: point.speed_ratio for point in frame.points}
    moduli = stability_map(p, np.array(list(at.values())), np.array([ON_LINE]), 1e-9).multiplier_max[0]
    said = {"A": False, "B": True, "C": True, "D": False, "E": True}
    firsts = {k: _stable_spans(p, k)[0] for k in (4.0, 9.0, ON_LINE)}
    widths = [high - low for low, high in firsts.values()]
    above = _stable_spans(p, ON_LINE, 12.0)[-1]
    second = math.sqrt(ON_LINE)
    points = "; ".join(f"{name} {value:.6f}" for name, value in zip(at, moduli.tolist(), strict=True))
    branches = [(i, branch) for i, branch in enumerate(found.branches)]
    table = {"branch": np.concatenate([np.full(len(b.x), i) for i, b in branches]),
             "speed_ratio": np.concatenate([b.x for _, b in branches]),
             "stiffness_ratio": np.concatenate([b.y for _, b in branches])}  # fmt: skip
    return Reproduced(
        (Panel("map", "Shaded: stable. Dashed: resonances; dotted: the line of the points A to E.", figure),),
        (Table("borders", "Borders as curves, each point within 1e-10 of the border", table),),
        numbers_of(p),
        (_PLANE, "Speeds of A to E: they stand only in the figure, which is lost; the shipped rig's are taken."),
        (
            Claim.judged("4.1.4", "A and D are unstable, B, C and E are stable.",
                         all((v < 1) == said[n] for n, v in zip(at, moduli.tolist(), strict=True)),
                         f"largest multipliers over a revolution: {points}"),
            Claim.judged("4.1.4", "The stable section between the resonances widens as the second spring gets stiffer.",
                         widths[0] < widths[1] < widths[2],
                         "; ".join(f"K = {k:g}: Ω = {a:.3f} … {b:.3f}" for k, (a, b) in firsts.items())),
            Claim.judged("4.1.4", "The second resonance on the points' line is at Ω = 3.86.",
                         abs(second - 3.86) < 0.005,
                         f"√{ON_LINE:g} = {second:.4f}"),
            Claim("4.1.4", "Above the second resonance Type I is stable.",
                  "holds" if above[0] <= second and above[1] >= 12.0 else "holds in part",
                  f"on the points' line from Ω = {above[0]:.3f} on (looked at up to 12); it is unstable from the "
                  f"resonance, {second:.3f}, up to there"),
        ),
    )  # fmt: skip


def _shade(axes: Axes, p: RotorParameters) -> None:
    x, y = np.linspace(*X_RANGE, 700), np.linspace(*Y_RANGE, 400)
    stable = stability_map(p, x, y, 1e-6).multiplier_max < 1
    axes.contourf(x, y, stable, levels=[0.5, 1.5], colors=["#d7def1"])


def _spectra(p: RotorParameters, ratios: Array) -> NDArray[np.complex128]:
    """All multipliers over a revolution along the speed, each followed from one speed to the next; shape (n, 8)."""
    angles = balanced_angles(p)[0]
    rows = list[NDArray[np.complex128]]()
    for ratio in ratios.tolist():
        half = piecewise.monodromy(type_one(p, *angles, p.speed_rad_s(ratio)), 400)
        values = np.linalg.eigvals(half).astype(np.complex128) ** 2
        if rows:
            order, left = list[int](), list(range(len(values)))
            for before in rows[-1]:
                nearest = min(left, key=lambda i: abs(values[i] - before))
                left.remove(nearest)
                order.append(nearest)
            values = values[order]
        rows.append(values)
    return np.array(rows)


_RATIOS = np.linspace(0.5, 6.5, 1201)


def largest_multiplier_4_3(work: Workspace) -> Reproduced:
    """Figure 4.3: the pair of multipliers of largest modulus along the points' line, with the unit cylinder."""
    p = work.physics()
    spectra = _spectra(p, _RATIOS)
    largest = spectra[np.arange(len(spectra)), np.argmax(np.abs(spectra), axis=1)]
    points = {point.name: point.speed_ratio for point in _frame(p).points}
    with sheet(WIDTH_IN, 5.0, "4.3: the largest multipliers over a revolution along K = 14.9") as figure:
        _cylinder(figure, largest, points)
    moduli = np.abs(largest)
    crossings = _RATIOS[1:][np.diff((moduli < 1).astype(int)) != 0]
    at = {name: complex(largest[int(np.argmin(np.abs(_RATIOS - ratio)))]) for name, ratio in points.items()}
    pairs = [name for name, value in at.items() if abs(value.imag) > 1e-6]
    inside = [name for name, value in at.items() if abs(value) < 1]
    return Reproduced(
        (Panel("cylinder", "Multipliers of largest modulus over the speed ratio, with the unit cylinder.", figure),),
        (Table("largest", "The multiplier of largest modulus over one revolution along K = 14.9",
               {"speed_ratio": _RATIOS, "real": largest.real, "imaginary": largest.imag}),),
        numbers_of(p),
        ("Ω = 0.5 … 6.5.",),
        (
            Claim.judged("4.1.4", "Along the line the largest multiplier is outside, inside, outside and again inside "
                         "the unit cylinder.", inside == ["B", "C", "E"] and len(crossings) == 3,
                         f"inside at {', '.join(inside)}; it crosses at Ω = "
                         + ", ".join(f"{ratio:.3f}" for ratio in crossings.tolist())),
            Claim.judged("4.1.4", "The largest multipliers are a complex conjugate pair.", len(pairs) == len(at),
                         f"a pair at {', '.join(pairs) or 'none'}; real at "
                         f"{', '.join(name for name in at if name not in pairs)}: "
                         + ", ".join(f"{name} {value.real:.4f}{value.imag:+.4f}i" for name, value in at.items())),
        ),
    )  # fmt: skip


def _cylinder(figure: Figure, largest: NDArray[np.complex128], points: dict[str, float]) -> None:
    axes = figure.add_subplot(projection="3d")
    assert isinstance(axes, Axes3D)
    turn = np.linspace(0, 2 * math.pi, 61)
    for ratio in np.linspace(0.5, 6.5, 13):
        axes.plot(np.full_like(turn, ratio), np.cos(turn), np.sin(turn), color=GREY, lw=0.5)
    for side in (1, -1):
        pair = largest.real, side * np.abs(largest.imag)
        inside = np.abs(largest) < 1
        for part, colour in ((inside, MEASURED), (~inside, MODEL)):
            shown = [np.where(part, values, np.nan) for values in pair]
            axes.plot(_RATIOS, *shown, color=colour, lw=1.6)
    for name, ratio in points.items():
        i = int(np.argmin(np.abs(_RATIOS - ratio)))
        axes.plot([ratio], [largest[i].real], [abs(largest[i].imag)], "o", color="black", ms=4)
        axes.text(ratio, float(largest[i].real), float(abs(largest[i].imag)) + 0.18, name)
    axes.plot([], [], [], color=MEASURED, label="stable")
    axes.plot([], [], [], color=MODEL, label="unstable")
    axes.set(xlabel="speed ratio Ω", ylabel="real part", zlabel="imaginary part")
    axes.set_box_aspect((2.4, 1, 1))
    axes.view_init(elev=22, azim=-62)


def three_views_4_4(work: Workspace) -> Reproduced:
    """Figure 4.4: all multipliers along the points' line, seen from three sides."""
    p = work.physics()
    spectra = _spectra(p, _RATIOS)
    with sheet(WIDTH_IN, 5.6, "4.4: three views of the multipliers along K = 14.9") as figure:
        grid = figure.add_gridspec(2, 2, width_ratios=(1.7, 1))
        top, below, plane = (
            figure.add_subplot(grid[0, 0]),
            figure.add_subplot(grid[1, 0]),
            figure.add_subplot(grid[:, 1]),
        )
        largest = np.argmax(np.abs(spectra), axis=1)
        rows = np.arange(len(spectra))
        for axes, values, name in ((top, spectra.real, "real part"), (below, spectra.imag, "imaginary part")):
            axes.plot(_RATIOS, values, ".", color=GREY, ms=1.0)
            axes.plot(_RATIOS, values[rows, largest], ".", color=MODEL, ms=2.2)
            axes.axhline(1, color="black", lw=0.8)
            axes.axhline(-1, color="black", lw=0.8)
            axes.set(ylim=(-1.6, 2.2))
            label(axes, "speed ratio Ω" if name == "imaginary part" else None, name)
        turn = np.linspace(0, 2 * math.pi, 181)
        plane.plot(np.cos(turn), np.sin(turn), color="black", lw=0.8)
        plane.plot(spectra.real, spectra.imag, ".", color=GREY, ms=1.0)
        plane.plot(spectra[rows, largest].real, spectra[rows, largest].imag, ".", color=MODEL, ms=2.2)
        plane.plot([], [], "o", color=MODEL, ms=4, label="largest modulus")
        plane.plot([], [], "o", color=GREY, ms=3, label="the other seven")
        plane.set(aspect="equal", xlim=(-1.6, 2.2), ylim=(-1.6, 1.6))
        label(plane, "real part", "imaginary part")
    product = np.abs(np.prod(spectra, axis=1))
    period = 2 * math.pi / (p.speed_rad_s(1.0) * _RATIOS)
    liouville = _trace_rate(p)
    off = float(np.max(np.abs(np.log(product) / period / liouville - 1)))
    columns: dict[str, Array] = {"speed_ratio": _RATIOS}
    for i in range(8):
        columns |= {f"real_{i + 1}": spectra[:, i].real, f"imaginary_{i + 1}": spectra[:, i].imag}
    return Reproduced(
        (Panel("views", "All eight multipliers from above, from the side, and along the cylinder's axis.", figure),),
        (Table("multipliers", "All multipliers over one revolution along K = 14.9", columns),),
        numbers_of(p),
        ("Ω = 0.5 … 6.5.",),
        (
            Claim.judged("Figure 4.4", "The product of all multipliers follows from the damping alone (Liouville's "
                         "theorem: a check of our figure).", off < 1e-6,
                         f"log of the product over a period against the trace, {liouville:.4f} /s: within {off:.1e}"),
        ),
    )  # fmt: skip


def _trace_rate(p: RotorParameters) -> float:
    """Mean trace of the linearised equations, 1/s."""
    matrix = type_one(p, *balanced_angles(p)[0], p.speed_rad_s(2.0))
    return float(np.trace(matrix.harmonics[0]).real)


def _family(work: Workspace, settings: Sequence[Sequence[str]]) -> list[Borders]:
    found = list[Borders]()
    for each in settings:
        found.append(_borders(work.physics(VIRTUAL, each)))
        work.tell(0.7 * len(found) / len(settings))
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
        set_plane(axes, (np.array(X_RANGE), np.array(Y_RANGE)), replace(_frame(p), points=()))
    return figure


def _family_table(members: Sequence[Borders], values: Sequence[float], key: str) -> Table:
    parts = [(value, branch) for value, borders in zip(values, members, strict=True) for branch in borders.branches]
    return Table("borders", f"Borders for each {key}", {
        key: np.concatenate([np.full(len(branch.x), value) for value, branch in parts]),
        "speed_ratio": np.concatenate([branch.x for _, branch in parts]),
        "stiffness_ratio": np.concatenate([branch.y for _, branch in parts]),
    })  # fmt: skip


def _zeta(value: float) -> list[str]:
    return [f"suspension.zeta1={value!r}", f"suspension.zeta2={value!r}"]


def _c34(value: float) -> list[str]:
    return [f"pendulums.{name}.damping_Nms_per_rad={value!r}" for name in ("a", "b")]


def family_over_zeta_4_5(work: Workspace) -> Reproduced:
    """Figure 4.5: borders for five damping ratios of the suspension, and the ratio with the greatest stable area."""
    members = _family(work, [_zeta(value) for value in _FAMILY_ZETA])
    p = work.physics()
    names = [f"ζ = {value:g}" for value in _FAMILY_ZETA]
    figure = _draw_family(
        members, names, "4.5: borders for several damping ratios of the suspension, with stable shares", p
    )

    def share(value: float) -> tuple[float, float]:
        return _borders(work.physics(VIRTUAL, _zeta(value))).stable_share, 0.0

    best = best_value(share, lambda value: 1e-4, SearchRange(("suspension.zeta1",), 0.005, 2.0, True),
                      lambda done: work.tell(0.7 + 0.3 * done))  # fmt: skip
    shares = ", ".join(
        f"{100 * borders.stable_share:.1f} % at {value:g}" for value, borders in zip(_FAMILY_ZETA, members, strict=True)
    )
    ends = float(best.shares[0]), float(best.shares[-1])
    return Reproduced(
        (Panel("family", "Borders of the stable areas for five damping ratios; the share of the range that is stable "
               "stands with each.", figure),),
        (_family_table(members, _FAMILY_ZETA, "zeta"),
         Table("share", "Stable share of the range over ζ", {"zeta": best.values, "stable_share": best.shares},
               shown=True)),
        numbers_of(p) | {"zeta1": "0.005 … 0.2", "zeta2": "0.005 … 0.2"},
        ("The five damping ratios, within appendix A's 0.001 … 0.2; c34 = 0.001 N m s/rad is the source's.",
         "The stable area is that of Ω = 0.3 … 7, K = 1 … 16."),
        (
            Claim("4.1.5", "There is a damping ratio of the suspension at which the stable area is greatest.",
                  ("holds" if best.value <= 0.2 else "holds in part")
                  if not best.at_end and best.share > max(ends) + 0.01 else "does not hold",
                  f"{100 * best.share:.2f} % at ζ = {best.value:.4f} ({best.interval[0]:.3f} … {best.interval[1]:.3f})"
                  f", {100 * ends[0]:.1f} % at 0.005 and {100 * ends[1]:.1f} % at 2; within the facility's range "
                  f"(appendix A: up to 0.2) the area only grows: {shares}"),
        ),
    )  # fmt: skip


def family_over_c34_4_6(work: Workspace) -> Reproduced:
    """Figure 4.6: borders for five dampings of the pendulums."""
    members = _family(work, [_c34(value) for value in _FAMILY_C34])
    p = work.physics()
    names = [f"c34 = {value:g} N m s/rad" for value in _FAMILY_C34]
    figure = _draw_family(members, names, "4.6: borders for several dampings of the pendulums, with stable shares", p)
    wide = np.geomspace(*_WIDE_C34)
    shares = np.array([_borders(work.physics(VIRTUAL, _c34(float(value)))).stable_share for value in wide])
    own = [borders.stable_share for borders in members]
    grows = bool(np.all(np.diff(own) > 0))
    falls = [float(wide[i + 1]) for i in np.flatnonzero(np.diff(shares) < -1e-4)]
    return Reproduced(
        (Panel("family", "Borders of the stable areas for five dampings of the pendulums; the share of the range that "
               "is stable stands with each.", figure),),
        (_family_table(members, _FAMILY_C34, "c34_Nms_per_rad"),
         Table("share", "Stable share of the range over c34", {"c34_Nms_per_rad": wide, "stable_share": shares},
               shown=True)),
        numbers_of(p) | {"c3_Nms_per_rad": "3e-4 … 0.03", "c4_Nms_per_rad": "3e-4 … 0.03"},
        ("The five dampings around the source's 0.001 N m s/rad; ζ = 0.02.",),
        (
            Claim("4.1.5", "More damping of the pendulums makes the stable area larger.",
                  ("holds" if not falls else "holds in part") if grows else "does not hold",
                  "; ".join(f"{100 * share:.1f} % at {value:g}" for value, share in zip(_FAMILY_C34, own, strict=True))
                  + (f"; over 1e-5 … 1 N m s/rad it falls again from {falls[0]:.2g} on" if falls
                     else "; it never falls over 1e-5 … 1 N m s/rad")),
        ),
    )  # fmt: skip

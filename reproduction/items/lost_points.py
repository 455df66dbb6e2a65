"""Figures 3.6 and 3.7: loss of singular points over damping and speed, and motion of the pendulums there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from numpy.typing import NDArray

from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import label
from dynamics.equations.balancing import IMPROPERLY_OVERSIZED, PROPERLY_OVERSIZED
from dynamics.steady.point_loss import point_losses, speeds_at_loss
from dynamics.steady.singular_points import singular_points
from reproduction.items.point_sweeps import CASES, SweepRig, stable_types
from reproduction.items.slips import Ends, draw_ends, ends_counted, released, slip_rates_text, slip_verdict, turning
from reproduction.results import Claim, Panel, Reproduced, SourceTable
from reproduction.workspace import Workspace, numbers_of
from rig_basics.arrays import Array
from rig_basics.texts import number_of

LIGHT, HEAVY = 1e-3, 0.1
"""Pendulum damping, N m s/rad: the rig's, and one at which Type I is stable directly above resonance."""
ZETAS: Array = np.linspace(0.01, 0.5, 36)
RATIOS: Array = np.linspace(0.4, 2.0, 49)
RELEASED = (7, 11)
"""Number of releases over damping and over speed."""
NAMES = ("I", "II", "III", "none")
COLOURS = ("#8fd1b8", "#f0b48a", "#8fbbe0", "#4d4d4d")


@dataclass(frozen=True)
class _Map:
    """The stable type over damping and speed: index into NAMES, shape (RATIOS, ZETAS)."""

    c34: float
    stable: NDArray[np.int64]
    several: int


def _mapped(work: Workspace, bench: SweepRig, c34: float, done: float) -> _Map:
    found, several = np.empty((len(RATIOS), len(ZETAS)), np.int64), 0
    for j, zeta in enumerate(ZETAS):
        p = bench.damped(float(zeta), c34)
        for i, ratio in enumerate(RATIOS):
            types = stable_types(p, float(ratio))
            several += len(types) > 1
            found[i, j] = NAMES.index(types[0]) if types else NAMES.index("none")
        work.progress(done + 0.25 * (j + 1) / len(ZETAS))
    return _Map(c34, found, several)


def loss_3_6(work: Workspace) -> Reproduced:
    """Reproduce Figure 3.6: properly oversized."""
    return _made(work, PROPERLY_OVERSIZED, "3.6")


def loss_3_7(work: Workspace) -> Reproduced:
    """Reproduce Figure 3.7: improperly oversized."""
    return _made(work, IMPROPERLY_OVERSIZED, "3.7")


def _made(work: Workspace, region: str, number: str) -> Reproduced:
    bench = SweepRig.of(work, next(case for case in CASES if case.region == region))
    maps = [_mapped(work, bench, c34, 0.25 * i) for i, c34 in enumerate((HEAVY, LIGHT))]
    at, ends = _releases(work, bench)
    with sheet(WIDTH_IN, 4.6, f"{number}: where singular points are lost, {region} pendulums", _FOOT) as figure:
        row: list[Axes] = figure.subplots(1, 2, sharey=True).tolist()
        for axes, one in zip(row, maps, strict=True):
            _draw(axes, bench, one)
        draw_ends(row[1], at[:, 0], at[:, 1], ends)
        label(row[0], None, "speed ratio Ω = ω/ω_n")
    points = np.meshgrid(ZETAS, RATIOS)
    columns = {"zeta": points[0].ravel(), "speed_ratio": points[1].ravel()}
    for one in maps:
        columns |= {f"stable_c34_{one.c34:g}": np.array(NAMES)[one.stable.ravel()]}
    case = bench.case
    return Reproduced(
        (
            Panel(
                "loss",
                "Type with a stable singular point over damping ratio and speed ratio; dark: none. Lines: where the "
                "points of Types II and III are lost, in closed form. Marks on the right: where releases end.",
                figure,
            ),
        ),
        (
            SourceTable("map", "Type that is stable", columns),
            SourceTable(
                "releases",
                "Where releases end",
                {
                    "zeta": at[:, 0],
                    "speed_ratio": at[:, 1],
                    "ends": ends.name.tolist(),
                    "turns_per_revolution_A": ends.turns[:, 0],
                    "turns_per_revolution_B": ends.turns[:, 1],
                },
            ),
        ),
        numbers_of(bench.rig) | {"zeta1": "0.01 … 0.5", "zeta2": "0.01 … 0.5", "c34_Nms_per_rad": f"{HEAVY}, {LIGHT}"},
        (
            f"S_A = {case.a:g} S_P, S_B = {case.b:g} S_P; the source gives no numbers. Damping across, speed upwards, "
            "as its text describes.",
        ),
        (
            *_border_claims(bench, region, number),
            *(_proper_claims if region == PROPERLY_OVERSIZED else _improper_claims)(work, bench, maps),
            *_slip_claims(bench, at, ends, number),
        ),
    )


_FOOT = (
    "Damping ratio ζ of the suspension, the same in both directions. Slipping: pendulums that turn against the "
    "rotor for ever.",
)


def _draw(axes: Axes, bench: SweepRig, found: _Map) -> None:
    axes.grid(False)
    axes.pcolormesh(
        ZETAS,
        RATIOS,
        found.stable,
        cmap=ListedColormap(COLOURS),
        vmin=-0.5,
        vmax=3.5,
        shading="nearest",
        rasterized=True,
    )
    for name, colour in zip(NAMES, COLOURS, strict=True):
        if np.any(found.stable == NAMES.index(name)):
            axes.fill_between([], [], [], color=colour, label="no stable point" if name == "none" else f"{name} stable")
    for loss, style in zip(point_losses(bench.damped(0.1, 1e-3)), ("--", "-"), strict=True):
        if loss.speed_ratios:
            share = bench.rig.imbalance_moment_kg_m / loss.moment_kg_m
            for edge in speeds_at_loss(share, ZETAS):
                axes.plot(ZETAS, edge, style, color="black", lw=1.3, label=f"{loss.type} lost between these")
    axes.set(xlim=(ZETAS[0], ZETAS[-1]), ylim=(RATIOS[0], RATIOS[-1]))
    label(axes, "damping ratio ζ", None, f"c34 = {found.c34:g} N m s/rad")


def _releases(work: Workspace, bench: SweepRig) -> tuple[Array, Ends]:
    """Return damping and speed of releases, shape (n, 2), and their ends; pendulum damping LIGHT."""
    zetas: Array = np.linspace(float(ZETAS[0]), float(ZETAS[-1]), RELEASED[0] + 2)[1:-1]
    ratios: Array = np.linspace(float(RATIOS[0]), float(RATIOS[-1]), RELEASED[1] + 2)[1:-1]
    at = np.array([(z, r) for z in zetas.tolist() for r in ratios.tolist()], np.float64)
    rigs = [bench.damped(z, LIGHT) for z, _ in at.tolist()]
    speeds = [p.speed_rad_s(r) for p, (_, r) in zip(rigs, at.tolist(), strict=True)]
    return at, released(rigs, speeds, lambda share: work.progress(0.5 + 0.5 * share))


def _border(bench: SweepRig, kind: str, zeta: float, below: bool) -> float:
    """Return the speed ratio at which points of a type end, by bisection on the points themselves."""
    p = bench.damped(zeta, LIGHT)
    there, gone = (0.01, 1.0) if below else (100.0, 1.0)
    for _ in range(60):
        middle = math.sqrt(there * gone)
        exists = any(point.type == kind for point in singular_points(p, p.speed_rad_s(middle)))
        there, gone = (middle, gone) if exists else (there, middle)
    return there


def _border_claims(bench: SweepRig, region: str, number: str) -> tuple[Claim, ...]:
    """Compare the closed form with the points, and the border over damping with the claim."""
    kinds = [loss for loss in point_losses(bench.damped(0.1, LIGHT)) if loss.speed_ratios]
    tried = (0.02, 0.1, 0.3, 0.5)
    worst, lower = 0.0, dict[str, list[float]]()
    for loss in kinds:
        share = bench.rig.imbalance_moment_kg_m / loss.moment_kg_m
        edges = speeds_at_loss(share, np.array(tried))
        for edge, below in zip(edges, (True, False), strict=True):
            found = [_border(bench, loss.type, zeta, below) for zeta in tried]
            worst = max(worst, float(np.max(np.abs(np.array(found) / edge - 1))))
        lower[loss.type] = [float(x) for x in edges[0]]
    three = lower["III"]
    return (
        Claim.judged(
            f"Figure {number}",
            "Points are lost where damping is high and the speed near the critical one, the more "
            "the higher the damping.",
            worst < 1e-9 and all(a > b for a, b in pairwise(three)),
            f"{region}: lost where 2ζΩ > |1 − Ω²| tan β, sin β = S_P/S_T; border against the points themselves within "
            f"{worst:.0e}; Type III lost from Ω = "
            + ", ".join(f"{x:.3f} (ζ = {z:g})" for x, z in zip(three, tried, strict=True)),
        ),
    )


def _first_stable(bench: SweepRig, zeta: float, c34: float, kind: str) -> float:
    """Return the lowest speed ratio from which a type is stable up to Ω = 2.5, on a grid of 0.5 %; NaN if never."""
    p = bench.damped(zeta, c34)
    first = math.nan
    for ratio in np.geomspace(2.5, 0.97, 190):
        if kind not in stable_types(p, float(ratio)):
            break
        first = float(ratio)
    return first


def _proper_claims(work: Workspace, bench: SweepRig, maps: list[_Map]) -> tuple[Claim, ...]:
    del work
    tried = (0.02, 0.1, 0.3, 0.5)
    first = {c34: [_first_stable(bench, z, c34, "I") for z in tried] for c34 in (1.0, HEAVY, 1e-2, LIGHT)}
    flat = {c34: max(abs(x - 1) for x in values) < 0.02 for c34, values in first.items()}
    shown = "; ".join(f"c34 = {c34:g}: " + ", ".join(f"{x:.2f}" for x in values) for c34, values in first.items())
    text = "The area ends upwards at the critical speed, at any damping: above it Type I is stable."
    computed = f"Type I stable from Ω = (at ζ = {', '.join(f'{z:g}' for z in tried)}) {shown} N m s/rad"
    verdict = "holds" if all(flat.values()) else "holds in part" if any(flat.values()) else "does not hold"
    return (Claim("Figure 3.6", text, verdict, computed), _one_type(maps))


def _improper_claims(work: Workspace, bench: SweepRig, maps: list[_Map]) -> tuple[Claim, ...]:
    two, three = point_losses(bench.damped(0.2, LIGHT))
    (low, _), (_, high) = three.speed_ratios[0], two.speed_ratios[0]
    undersized = SweepRig.of(work, CASES[1])
    missing = 0
    tried = [(z, r) for z in (0.0, 0.1, 1.0, 5.0) for r in (0.3, 0.9, 0.999, 1.001, 1.1, 3.0)]
    for zeta, ratio in tried:
        p = undersized.damped(zeta, LIGHT)
        missing += len([q for q in singular_points(p, p.speed_rad_s(ratio)) if q.type in ("II", "III")]) != 4
        missing += sum(len(loss.speed_ratios) for loss in point_losses(p))
    return (
        Claim.judged(
            "Figure 3.7",
            "Below resonance Type III is lost, above it Type II: both near the critical speed, both with damping.",
            low < 1 < high,
            f"at ζ = 0.2 Type III from Ω = {low:.3f}, Type II up to {high:.3f}",
        ),
        Claim.judged(
            "3.1",
            "Undersized pendulums lose no singular point at any speed or damping.",
            missing == 0,
            f"{number_of(len(tried), 'pair')} of ζ = 0 … 5 and Ω = 0.3 … 3: all four points of Types II and III there "
            f"{'always' if missing == 0 else f'but at {missing}'} (S_A + S_B < S_P)",
        ),
        _one_type(maps),
    )


def _one_type(maps: list[_Map]) -> Claim:
    several, size = sum(one.several for one in maps), sum(one.stable.size for one in maps)
    none = [np.count_nonzero(one.stable == NAMES.index("none")) / one.stable.size for one in maps]
    return Claim.judged(
        "3.1",
        "At most one type of singular point is stable.",
        several == 0,
        f"{number_of(size, 'point')} of both maps: two types stable at {several}; none at "
        + ", ".join(f"{100 * own:.0f} % (c34 = {one.c34:g} N m s/rad)" for own, one in zip(none, maps, strict=True)),
    )


def _slip_claims(bench: SweepRig, at: Array, ends: Ends, number: str) -> tuple[Claim, Claim]:
    """Return claims on the motion where no point is stable, and on releases where one is."""
    types = [stable_types(bench.damped(z, LIGHT), r) for z, r in at.tolist()]
    bare, slips = np.array([not own for own in types]), turning(ends)
    reach = np.array([name in own for name, own in zip(ends.name.tolist(), types, strict=True)])
    return (
        Claim(
            f"Figure {number}, open",
            "Where no singular point is stable the pendulums slip on the rotor for ever.",
            slip_verdict(ends, bare),
            f"c34 = {LIGHT:g} N m s/rad: {ends_counted(ends, bare)}; {slip_rates_text(ends, bare, at[:, 1])}",
        ),
        Claim.judged(
            "3.1, open",
            f"Where a singular point is stable a release from 0° and 180° ends in it ({bench.case.region}).",
            bool(np.all(reach[~bare])),
            f"of {number_of(int((~bare).sum()), 'release')} {int(reach.sum())} do, "
            f"{int((slips & ~bare).sum())} slip all the same"
            + (f": {slip_rates_text(ends, ~bare, at[:, 1])}" if np.any(slips & ~bare) else ""),
        ),
    )

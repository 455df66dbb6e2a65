"""Section 3.1: which pendulum sets balance which imbalance, each region tested by releases."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from analysis.figures.balancing_plane import SHADES, draw_regions, name_corners
from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import GOOD, GREY, MEASURED, MODEL, label
from dynamics.equations.balancing import PROPERLY_OVERSIZED, UNDERSIZED, balancing_region
from dynamics.equations.parameters import RotorParameters
from dynamics.steady.basins.single import ReleaseEnds, release_ends
from reproduction.items.pendulum_sets import FROM_RAD, ZETA, isotropic_rig, with_moments
from reproduction.results import Claim, Panel, Reproduced, SourceTable
from reproduction.workspace import Workspace, numbers_of
from rig_basics.arrays import Array
from rig_basics.texts import number_of

RATIO = 2.5
GRID = 12  # sets along each axis of the plane
STEP = 0.15  # of S_P, between sets; the first is half a step from 0, so that none is on a border
_DISTANCE = 0.03  # of S_P, of the sets on both sides of a border
_SECONDS = 250.0
_ZERO_M = 1e-6
_LOOKS = {"I": ("o", GOOD), "II": ("^", MODEL), "III": ("s", MEASURED)}


def _released(work: Workspace, rigs: list[RotorParameters]) -> ReleaseEnds:
    return release_ends(rigs, [p.speed_rad_s(RATIO) for p in rigs], FROM_RAD, _SECONDS, progress=work.progress)


def _expected(a: float, b: float, s: float) -> str:
    """Return the type that a set above resonance reaches by (3-4) to (3-6) and Table 3.4."""
    region = balancing_region(a, b, s)
    return "I" if region == PROPERLY_OVERSIZED else "III" if region == UNDERSIZED else "II"


def _sets() -> Array:
    """Return pairs S_A/S_P, S_B/S_P: a grid, and pairs on both sides of each border, shape (n, 2)."""
    along = STEP * (np.arange(GRID, dtype=np.float64) + 0.5)
    grid = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    share = np.array([0.3, 0.5, 0.7])
    border = np.array([(f * s, (1 - f) * s) for f in share for s in (1 - _DISTANCE, 1 + _DISTANCE)])
    right = np.array([(b + d, b) for b in (0.35, 0.55, 0.75) for d in (1 - _DISTANCE, 1 + _DISTANCE)])
    return np.asarray(np.concatenate([grid, border, right, right[:, ::-1]]), np.float64)


def regions_3_2(work: Workspace) -> Reproduced:
    """Reproduce Figure 3.2: regions for one imbalance, and the ends of releases of sets in all of them."""
    p = isotropic_rig(work)
    s, pairs = p.imbalance_moment_kg_m, _sets()
    rigs = [with_moments(p, float(a) * s, float(b) * s) for a, b in pairs]
    ends = _released(work, rigs)
    expected = np.array([_expected(float(a), float(b), 1.0) for a, b in pairs])
    upto = STEP * GRID * s
    with sheet(WIDTH_IN, 6.4, "3.2: what a pendulum set can balance, and where releases end") as figure:
        axes: Axes = figure.subplots()
        draw_regions(axes, s, upto)
        for kind, (marker, colour) in _LOOKS.items():
            own = ends.name == kind
            axes.plot(*(1e3 * s * pairs[own].T), marker, color=colour, ms=4.5, label=f"released: ends in {kind}")
        other = ~np.isin(ends.name, list(_LOOKS))
        if other.any():
            axes.plot(*(1e3 * s * pairs[other].T), "x", color="black", label="released: no end found")
        name_corners(axes, s, upto)
    table = SourceTable(
        "releases",
        "Sets of pendulums, their type by (3-4), and where a release ends",
        {
            "S_A_g_m": 1e3 * s * pairs[:, 0],
            "S_B_g_m": 1e3 * s * pairs[:, 1],
            "expected": expected.tolist(),
            "reached": ends.name.tolist(),
            "amplitude_mm": 1e3 * ends.amplitude_m,
            "settled_s": ends.settled_s,
        },
    )
    return Reproduced(
        (
            Panel(
                "regions",
                f"Plane of the pendulums' first mass moments for S_P = {1e3 * s:.3f} g m; each mark is a release at "
                f"Ω = {RATIO:g} and what it ends in.",
                figure,
            ),
        ),
        (table,),
        numbers_of(p) | {"speed_ratio": RATIO, "pendulums.a.mass_kg": "varied", "pendulums.b.mass_kg": "varied"},
        (
            "The source gives no numbers: the isotropic rig's imbalance and pendulum lengths; masses make the moments.",
            "A pendulum's damping goes with its mass, so that c/J stays: light ones settle as soon as heavy ones.",
            f"Released at Ω = {RATIO:g}, ζ = {ZETA:g} from {math.degrees(FROM_RAD[0]):.1f}° and "
            f"{math.degrees(FROM_RAD[1]):.1f}°; the natural frequency kept as masses change.",
        ),
        _claims_3_2(pairs, ends, expected),
    )


def _claims_3_2(pairs: Array, ends: ReleaseEnds, expected: NDArray[np.str_]) -> tuple[Claim, ...]:
    balanced, border = ends.name == "I", slice(GRID * GRID, None)
    inside, wrong = expected == "I", ends.name != expected
    residual = np.where(balanced, 0.0, ends.amplitude_m)
    text = f"{number_of(len(pairs), 'set')} released"
    agree = bool(np.array_equal(balanced, inside))
    elsewhere = [
        f"; S_A = {a:.2f}, S_B = {b:.2f} of S_P: {name}"
        for (a, b), name in zip(pairs[wrong], ends.name[wrong], strict=True)
    ]
    return (
        Claim.judged(
            "(3-4), Figure 3.2",
            "A set balances all of the imbalance exactly where S_A + S_B ≥ S_P and |S_A − S_B| ≤ S_P.",
            agree,
            f"{text}, {int(inside.sum())} of them inside: {int((balanced & inside).sum())} inside and "
            f"{int((balanced & ~inside).sum())} outside end balanced",
        ),
        Claim.judged(
            "Figure 3.2",
            "The borders are lines: sets close to them on both sides differ.",
            bool(np.array_equal(balanced[border], inside[border])),
            f"{number_of(len(pairs[border]), 'set')} {100 * _DISTANCE:g} % of S_P off AB, AD and BC: "
            f"{int(np.sum(balanced[border] == inside[border]))} end as their side requires",
        ),
        Claim.judged(
            "3.1",
            "Outside the rotor stays unbalanced.",
            bool(np.all(residual[~inside] > _ZERO_M)),
            f"smallest amplitude of the {number_of(int((~inside).sum()), 'set')} outside "
            f"{1e6 * np.min(residual[~inside]):.3g} µm",
        ),
        Claim.judged(
            "3.1, Table 3.4",
            "Above resonance undersized pendulums end together (III), improperly oversized ones opposed (II).",
            not wrong.any(),
            f"{text}, {int(wrong.sum())} end elsewhere" + "".join(elsewhere[:4]),
        ),
    )


SERIES = (0.5, 1.0, 1.5, 2.0)
EQUAL = (0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.1)
_SHADES = ("#3b528b", "#21918c", "#5ec962", "#b8a000")


def series_3_3(work: Workspace) -> Reproduced:
    """Reproduce Figure 3.3: borders for a series of imbalances, with releases of equal pendulums at each."""
    p = isotropic_rig(work)
    whole = p.imbalance_moment_kg_m
    cases = [(share * whole, equal * SERIES[-1] * whole) for share in SERIES for equal in EQUAL]
    rigs = [with_moments(p.with_values(SP_kg_m=s), each, each) for s, each in cases]
    ends = _released(work, rigs)
    with sheet(WIDTH_IN, 4.3, "3.3: borders for a series of imbalances") as figure:
        left, right_axes = figure.subplots(1, 2).tolist()
        _draw_series(left, whole)
        _draw_equal(right_axes, whole, cases, ends)
    regions = [balancing_region(each, each, s) for s, each in cases]
    reached = ends.name.tolist()
    right = sum(("I" if r == PROPERLY_OVERSIZED else "III") == got for r, got in zip(regions, reached, strict=True))
    fits = right == len(cases) and set(regions) <= {PROPERLY_OVERSIZED, UNDERSIZED}
    columns = {
        "S_P_g_m": [1e3 * s for s, _ in cases],
        "S_A_g_m": [1e3 * each for _, each in cases],
        "S_B_g_m": [1e3 * each for _, each in cases],
        "region": regions,
        "reached": reached,
    }
    return Reproduced(
        (Panel("series", "Borders of the regions for four imbalances, one colour each.", figure),),
        (SourceTable("equal", "Equal pendulums against each imbalance", columns, shown=True),),
        numbers_of(p) | {"speed_ratio": RATIO, "S_P_kg_m": "series"},
        (f"The series: {', '.join(f'{x:g}' for x in SERIES)} of the isotropic rig's S_P; the source's is lost.",),
        (
            Claim.judged(
                "3.1, Figure 3.3",
                "Equal first mass moments are undersized or properly oversized against any "
                "imbalance, never improperly.",
                fits,
                f"{number_of(len(cases), 'release')} of equal pendulums against {len(SERIES)} imbalances: "
                f"{reached.count('I')} end "
                f"in I, {reached.count('III')} in III, {len(cases) - right} elsewhere than the region requires",
            ),
        ),
    )


def _draw_series(axes: Axes, whole: float) -> None:
    top = 1e3 * 2.6 * whole
    for share, shade in zip(SERIES, _SHADES, strict=True):
        s = 1e3 * share * whole
        axes.plot((0, top - s), (s, top), color=shade, lw=1.4, label=f"borders for S_P = {s:.2f} g m")
        axes.plot((s, top), (0, top - s), color=shade, lw=1.4)
        axes.plot((0, s), (s, 0), color=shade, lw=1.4)
    axes.plot((0, top), (0, top), color=GREY, lw=0.9, ls=(0, (6, 3)), label="S_A = S_B")
    axes.set(xlim=(0, top), ylim=(0, top), aspect="equal")
    label(axes, "S_A, g m", "S_B, g m", "borders")


def _draw_equal(axes: Axes, whole: float, cases: list[tuple[float, float]], ends: ReleaseEnds) -> None:
    top = 1e3 * 2.3 * whole
    axes.fill_between((0, top), (0, 2 * top), top, color=SHADES[UNDERSIZED], lw=0, label=UNDERSIZED)
    axes.fill_between((0, top), 0, (0, 2 * top), color=SHADES[PROPERLY_OVERSIZED], lw=0, label=PROPERLY_OVERSIZED)
    moments = 1e3 * np.array(cases)
    for kind, (marker, colour) in _LOOKS.items():
        own = ends.name == kind
        if own.any():
            axes.plot(moments[own, 1], moments[own, 0], marker, color=colour, ms=5, label=f"released: ends in {kind}")
    axes.grid(False)
    axes.set(xlim=(0, top), ylim=(0, top))
    label(axes, "S_A = S_B, g m", "S_P, g m", "along S_A = S_B")

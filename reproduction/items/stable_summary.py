"""Table 3.4: the stable type in six cases, its dependence on damping, and the claims of the text."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.figures.sheet import WIDTH_IN, sheet
from dynamics.equations.balancing import IMPROPERLY_OVERSIZED, PROPERLY_OVERSIZED, UNDERSIZED
from reproduction.items.point_poses import draw_pose, stable_first
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
    swept,
)
from reproduction.results import Claim, Panel, Reproduced, SourceTable, Verdict
from reproduction.workspace import Workspace, numbers_of
from rig_basics.texts import number_of

_KINDS = ("I", "II", "III")
_SOURCE_TABLE = {
    (SUB, PROPERLY_OVERSIZED): ("III", True),
    (SUB, UNDERSIZED): ("III", False),
    (SUB, IMPROPERLY_OVERSIZED): ("III", True),
    (SUPER, PROPERLY_OVERSIZED): ("I", False),
    (SUPER, UNDERSIZED): ("III", False),
    (SUPER, IMPROPERLY_OVERSIZED): ("II", True),
}
"""The source's table: the stable type, and whether it depends on rotor damping."""
_DAMPED = 0.3

Cell = tuple[str, str]
Sweeps = dict[Cell, dict[str, Swept]]


def table_3_4(work: Workspace) -> Reproduced:
    """Reproduce Table 3.4, and the summary of section 3.1."""
    benches = {case.region: SweepRig.of(work, case) for case in CASES}
    sweeps = Sweeps()
    for i, (operation, region) in enumerate(_SOURCE_TABLE):
        sweeps[operation, region] = {kind: swept(benches[region], operation, kind) for kind in _KINDS}
        work.progress((i + 1) / len(_SOURCE_TABLE))
    stable = {cell: {kind: _any_stable(one) for kind, one in kinds.items()} for cell, kinds in sweeps.items()}
    return Reproduced(
        (
            Panel(
                "poses",
                f"The stable point of each of the six cases at ζ = {SHOWN_ZETA:g}, Ω = {SHOWN_SPEED[SUB]:g} and "
                f"{SHOWN_SPEED[SUPER]:g}, seen on the rotor; C drawn at one distance from O for any amplitude.",
                _drawn(benches),
            ),
        ),
        (_table(sweeps, stable),),
        numbers_of(benches[PROPERLY_OVERSIZED].rig)
        | {"zeta1": "0.005 … 0.3", "zeta2": "0.005 … 0.3", "c34_Nms_per_rad": "1e-5 … 1"},
        (
            "Pendulum sets: S_A, S_B = " + "; ".join(f"{c.a:g}, {c.b:g} S_P ({c.region})" for c in CASES) + ".",
            f"Verdicts from Ω = {', '.join(f'{r:g}' for r in SPEEDS[SUB] + SPEEDS[SUPER])}, "
            f"ζ = {', '.join(f'{z:g}' for z in ZETAS)} and {number_of(len(C34), 'value')} of c34 from 1e-5 "
            f"to 1 N m s/rad.",
            "A function of rotor damping is taken to mean: whether the stable point exists depends on it.",
        ),
        (*(_cell(cell, sweeps, stable) for cell in _SOURCE_TABLE), *_summary(benches, stable)),
    )


def _any_stable(one: Swept) -> NDArray[np.bool_]:
    """Return where a type has a stable point, shape (speeds, ZETAS, C34)."""
    return np.any(one.stable == 1, axis=0)


def _cell(cell: Cell, sweeps: Sweeps, stable: dict[Cell, dict[str, NDArray[np.bool_]]]) -> Claim:
    operation, region = cell
    kind, depends = _SOURCE_TABLE[cell]
    own, there = stable[cell][kind], np.any(sweeps[cell][kind].stable != ABSENT, axis=0)
    others = {other: int(np.sum(stable[cell][other])) for other in _KINDS if other != kind}
    lost = int(np.sum(~there))
    exact = bool(np.all(own | ~there)) and not any(others.values()) and (lost > 0) == depends
    shown = sweeps[cell][kind].at(SHOWN_SPEED[operation], SHOWN_ZETA, SHOWN_C34)
    verdict: Verdict = (
        "holds" if exact else "holds in part" if 1 in shown.tolist() and (lost > 0) == depends else ("does not hold")
    )
    words = "a function of rotor damping" if depends else "independent of rotor damping"
    unstable = there & ~own
    where = _where(unstable, operation) if unstable.any() else ""
    return Claim(
        "Table 3.4",
        f"{operation.capitalize()}, {region}: Type {kind} alone is stable, {words}.",
        verdict,
        f"stable at {int(own.sum())} of {own.size}, lost at {lost} by damping"
        + (f", unstable at {int(unstable.sum())}: {where}" if where else "")
        + "; others stable: "
        + ", ".join(f"{other} at {count}" for other, count in others.items()),
    )


def _where(places: NDArray[np.bool_], operation: str) -> str:
    """Return the ranges of a set of places of the sweep."""
    speeds, zetas, dampings = (np.flatnonzero(np.any(places, axis=axes)) for axes in ((1, 2), (0, 2), (0, 1)))
    return (
        f"Ω = {SPEEDS[operation][speeds[0]]:g} … {SPEEDS[operation][speeds[-1]]:g}, ζ = {ZETAS[zetas[0]]:g} … "
        f"{ZETAS[zetas[-1]]:g}, c34 up to {C34[dampings[-1]]:.2g} N m s/rad"
    )


def _summary(benches: dict[str, SweepRig], stable: dict[Cell, dict[str, NDArray[np.bool_]]]) -> tuple[Claim, ...]:
    """Return the text's claims on its own tables."""
    counts = {cell: sum(own.astype(int) for own in kinds.values()) for cell, kinds in stable.items()}
    most = max(int(np.max(count)) for count in counts.values())
    none = sum(int(np.sum(count == 0)) for count in counts.values())
    size = sum(np.size(count) for count in counts.values())
    sub = {kind: sum(int(np.sum(stable[SUB, case.region][kind])) for case in CASES) for kind in _KINDS}
    over = {
        region: {kind: int(np.sum(stable[SUPER, region][kind])) for kind in _KINDS}
        for region in (PROPERLY_OVERSIZED, IMPROPERLY_OVERSIZED)
    }
    bench = benches[UNDERSIZED]
    angles = [
        math.degrees(stable_first(bench.damped(zeta, SHOWN_C34), SHOWN_SPEED[SUB], "III").theta_rad[0])
        for zeta in (SHOWN_ZETA, _DAMPED)
    ]
    same: Verdict = "holds in part" if abs(angles[0] - angles[1]) > 1 else "holds"
    one: Verdict = "holds" if most == 1 and none == 0 else "holds in part" if most == 1 else "does not hold"
    return (
        Claim(
            "3.1, summary",
            "In each case there is one type of stable singular point.",
            one,
            f"never two types at one of {number_of(size, 'place')}; at {none} none: lost, or unstable close "
            f"above resonance",
        ),
        Claim.judged(
            "3.1, summary",
            "Below resonance Type II alone is stable.",
            sub["II"] > 0 and sub["I"] + sub["III"] == 0,
            f"stable below resonance: II at {sub['II']}, III at {number_of(sub['III'], 'place')}; the "
            f"source's own Tables 3.3 and "
            "3.4 have III",
        ),
        Claim.judged(
            "3.1, summary",
            "Above resonance oversized pendulums have Type III stable.",
            all(kinds["III"] > 0 and kinds["I"] + kinds["II"] == 0 for kinds in over.values()),
            "; ".join(
                f"{region}: I at {k['I']}, II at {k['II']}, III at {number_of(k['III'], 'place')}"
                for region, k in over.items()
            ),
        ),
        Claim(
            "3.1, summary",
            "Below resonance undersized pendulums do not depend on rotor damping.",
            same,
            f"Type III exists and is stable at every ζ, but stands at {angles[0]:.1f}° with ζ = {SHOWN_ZETA:g} and at "
            f"{angles[1]:.1f}° with ζ = {_DAMPED:g} (Ω = {SHOWN_SPEED[SUB]:g})",
        ),
    )


def _table(sweeps: Sweeps, stable: dict[Cell, dict[str, NDArray[np.bool_]]]) -> SourceTable:
    columns: dict[str, list[str] | list[float]] = {
        "operation": [cell[0] for cell in _SOURCE_TABLE],
        "region": [cell[1] for cell in _SOURCE_TABLE],
        "source": [kind + (", by damping" if depends else "") for kind, depends in _SOURCE_TABLE.values()],
    }
    for kind in _KINDS:
        columns[f"{kind}_stable_share"] = [float(np.mean(stable[cell][kind])) for cell in _SOURCE_TABLE]
        gone = [np.all(sweeps[cell][kind].stable == ABSENT, axis=0) for cell in _SOURCE_TABLE]
        columns[f"{kind}_absent_share"] = [np.count_nonzero(g) / np.size(g) for g in gone]
    return SourceTable("stable-types", "Share of the sweep at which a type has a stable point", columns, shown=True)


def _drawn(benches: dict[str, SweepRig]) -> Figure:
    with sheet(WIDTH_IN, 5.6, "Table 3.4: the stable singular point of each case, seen on the rotor") as figure:
        rows = figure.subplots(2, 3).tolist()
        for row, operation in zip(rows, (SUB, SUPER), strict=True):
            cells: list[Axes] = row
            for axes, case in zip(cells, CASES, strict=True):
                kind, depends = _SOURCE_TABLE[operation, case.region]
                p = benches[case.region].damped(SHOWN_ZETA, SHOWN_C34)
                point = stable_first(p, SHOWN_SPEED[operation], kind)
                title = (
                    f"{operation}, {case.region}\nType {kind}{' (lost at high ζ)' if depends else ''}, "
                    f"{1e3 * abs(point.z_m):.2f} mm"
                )
                draw_pose(axes, p, point, title)
    return figure

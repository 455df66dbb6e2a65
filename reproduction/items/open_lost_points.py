"""Open question of the source: motion where singular points are lost, with two different stiffnesses."""

from __future__ import annotations

import logging
import math
import os
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from numpy.typing import NDArray

from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import label
from dynamics import steady_states
from dynamics.equations.parameters import RotorParameters
from dynamics.errors import DynamicsError
from dynamics.steady.point_loss import point_losses
from reproduction.items.slips import Ends, draw_ends, ends_counted, released, slip_rates_text, slip_verdict, turning
from reproduction.results import Claim, Panel, Reproduced, SourceTable
from reproduction.workspace import VIRTUAL, Workspace, numbers_of
from rig_basics.arrays import Array
from rig_basics.texts import number_of
from rig_basics.thread_pool import ThreadPool

_log = logging.getLogger(__name__)

ZETAS: Array = np.exp(np.linspace(math.log(0.005), math.log(0.3), 22))
RATIOS: Array = np.linspace(0.4, 6.0, 57)
RELEASED = (5, 12)
"""Number of releases over damping and over speed."""
_ACCURACY = 1e-6
_SETS = ("none", "I", "II", "III", "I, III", "refused")
_COLOURS = ("#4d4d4d", "#8fd1b8", "#f0b48a", "#8fbbe0", "#d9c4e8", "#ffffff")


def _damped(p: RotorParameters, zeta: float) -> RotorParameters:
    return replace(p, zeta1=zeta, zeta2=zeta)


@dataclass(frozen=True)
class _Here:
    """Stable types at one point, whether a steady state of Type III exists, and whether the states were refused."""

    types: tuple[str, ...]
    three: bool
    refused: bool = False

    @property
    def stable(self) -> str:
        """Name in _SETS."""
        return "refused" if self.refused else ", ".join(self.types) or "none"


def _here(p: RotorParameters, ratio: float) -> _Here:
    try:
        found = steady_states(p, p.speed_rad_s(ratio), _ACCURACY)
    except DynamicsError as error:
        _log.info("states at a speed ratio of %.6g: %s", ratio, error)
        return _Here((), False, refused=True)
    types = tuple(sorted({state.type for state in found if state.stable}))
    return _Here(types, any(state.type == "III" for state in found))


def open_lost_points(work: Workspace) -> Reproduced:
    """Find where no steady state of any type is stable with K = 14.9, and the ends of releases there."""
    p = work.physics(VIRTUAL)
    places: list[tuple[float, float]] = [(z, r) for z in ZETAS.tolist() for r in RATIOS.tolist()]
    found = list[_Here]()

    def at_place(place: tuple[float, float]) -> _Here:
        return _here(_damped(p, place[0]), place[1])

    with ThreadPool(os.cpu_count() or 1) as pool:
        for here in pool.map(at_place, places):
            found.append(here)
            work.progress(0.6 * len(found) / len(places))
    names = [here.stable for here in found]
    grid = np.array(names).reshape(len(ZETAS), len(RATIOS))
    three = np.array([here.three for here in found]).reshape(grid.shape)
    at, ends, reachable = _releases(work, p)
    with sheet(WIDTH_IN, 5.0, "Where no steady state is stable: k2 = 14.9 k1", _FOOT) as figure:
        axes: Axes = figure.subplots()
        _draw(axes, p, grid)
        draw_ends(axes, at[:, 1], at[:, 0], ends)
    return Reproduced(
        (
            Panel(
                "map",
                "Types of stable steady states over speed ratio and damping ratio; dark: none. Dots: borders of the "
                "loss of Type III by the mean torque. Marks: where releases end.",
                figure,
            ),
        ),
        (
            SourceTable(
                "map",
                "Types of stable steady states",
                {"zeta": [z for z, _ in places], "speed_ratio": [r for _, r in places], "stable": names},
            ),
            SourceTable(
                "releases",
                "Where releases end",
                {
                    "zeta": at[:, 0],
                    "speed_ratio": at[:, 1],
                    "stable": [each.stable for each in reachable],
                    "ends": ends.name.tolist(),
                    "turns_per_revolution_A": ends.turns[:, 0],
                    "turns_per_revolution_B": ends.turns[:, 1],
                },
            ),
        ),
        numbers_of(p) | {"zeta1": "0.005 … 0.3", "zeta2": "0.005 … 0.3"},
        (
            "The rig file of the anisotropic rig (K = 14.9), ζ the same in both directions; every steady state of "
            "Types I, II, III that the search finds is judged.",
        ),
        _claims(p, grid, three, at, ends, reachable),
    )


_FOOT = (
    "Slipping: pendulums that turn against the rotor for ever. Lines: the closed condition holds for the mean "
    "torque; between a pair of them Type III's points are lost.",
)


def _releases(work: Workspace, p: RotorParameters) -> tuple[Array, Ends, list[_Here]]:
    zetas: Array = np.exp(np.linspace(math.log(ZETAS[0]), math.log(ZETAS[-1]), 2 * RELEASED[0] + 1)[1::2])
    ratios: Array = np.linspace(float(RATIOS[0]), float(RATIOS[-1]), 2 * RELEASED[1] + 1)[1::2]
    at = np.array([(z, r) for z in zetas.tolist() for r in ratios.tolist()], np.float64)
    rigs = [_damped(p, z) for z, _ in at.tolist()]
    speeds = [p.speed_rad_s(r) for _, r in at.tolist()]
    ends = released(rigs, speeds, lambda share: work.progress(0.6 + 0.4 * share))
    return at, ends, [_here(rig, r) for rig, (_, r) in zip(rigs, at.tolist(), strict=True)]


def _draw(axes: Axes, p: RotorParameters, grid: NDArray[np.str_]) -> None:
    axes.grid(False)
    index = np.array([[_SETS.index(name) if name in _SETS else -1 for name in row] for row in grid], np.float64)
    index[index < 0] = np.nan
    axes.pcolormesh(
        RATIOS,
        ZETAS,
        index,
        cmap=ListedColormap(_COLOURS),
        vmin=-0.5,
        vmax=len(_SETS) - 0.5,
        shading="nearest",
        rasterized=True,
    )
    for name, colour in zip(_SETS, _COLOURS, strict=True):
        if np.any(grid == name):
            axes.fill_between([], [], [], color=colour, label="nothing stable" if name == "none" else f"{name} stable")
    fine: Array = np.exp(np.linspace(math.log(ZETAS[0]), math.log(ZETAS[-1]), 160))
    edges = [(z, edge) for z in fine.tolist() for pair in point_losses(_damped(p, z))[1].speed_ratios for edge in pair]
    axes.plot(
        [e for _, e in edges],
        [z for z, _ in edges],
        ".",
        color="black",
        ms=1.6,
        label="III: border of loss, mean torque",
    )
    axes.set(xlim=(RATIOS[0], RATIOS[-1]), ylim=(ZETAS[0], ZETAS[-1]), yscale="log")
    axes.set_yticks((0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3), ("0.005", "0.01", "0.02", "0.05", "0.1", "0.2", "0.3"))
    axes.set_yticks((), minor=True)
    label(axes, "speed ratio Ω = ω/ω_n1", "damping ratio ζ1 = ζ2")


def _bands(free: NDArray[np.bool_]) -> str:
    """Return the speed ratios at which a row of the map has no stable state."""
    found, begun, last = list[str](), None, 0.0
    for ratio, bare in zip([*RATIOS.tolist(), math.inf], [*free.tolist(), False], strict=True):
        if bare and begun is None:
            begun = last = ratio
        elif bare:
            last = ratio
        elif begun is not None:
            found.append(f"{begun:.1f} … {last:.1f}" if last > begun else f"{begun:.1f}")
            begun = None
    return ", ".join(found) or "nowhere"


def _claims(
    p: RotorParameters, grid: NDArray[np.str_], three: NDArray[np.bool_], at: Array, ends: Ends, here: list[_Here]
) -> tuple[Claim, ...]:
    bare_map, bare = grid == "none", np.array([not each.types and not each.refused for each in here])
    rows = {f"{ZETAS[i]:.2g}": _bands(bare_map[i]) for i in sorted({k * (len(ZETAS) - 1) // 3 for k in range(4)})}
    unbalanced = np.array(["I" not in each.types for each in here])
    replaced = np.array([bool({"II", "III"} & {*each.types}) for each in here])
    slips = turning(ends)
    reach = np.array([own in each.types for own, each in zip(ends.name.tolist(), here, strict=True)])
    return (
        Claim.judged(
            "4.4, conclusions",
            "Where Type I is unstable another type is stable instead.",
            not bool(np.any(unbalanced & ~replaced)) and not bare_map.any(),
            f"nothing at all is stable at {100 * np.mean(bare_map):.0f} % of {number_of(grid.size, 'point')}: Ω = "
            + "; ".join(f"{bands} (ζ = {zeta})" for zeta, bands in rows.items()),
        ),
        Claim(
            "open",
            "Where nothing is stable the pendulums slip on the rotor for ever.",
            slip_verdict(ends, bare),
            f"{ends_counted(ends, bare)}; {slip_rates_text(ends, bare, at[:, 1])} (ω_n of the softer direction)",
        ),
        _mean_torque_claim(p, three),
        Claim.judged(
            "open",
            "Where something is stable a release from 0° and 180° ends in it.",
            bool(np.all(reach[~bare])),
            f"of {number_of(int((~bare).sum()), 'release')} {int(reach.sum())} do, "
            f"{int((slips & ~bare).sum())} slip all the same",
        ),
    )


def _mean_torque_claim(p: RotorParameters, three: NDArray[np.bool_]) -> Claim:
    """Compare the closed condition of the mean torque with the orbits themselves."""
    expected = np.array(
        [[not point_losses(_damped(p, z))[1].holds(r) for r in RATIOS.tolist()] for z in ZETAS.tolist()]
    )
    agree = np.count_nonzero(expected == three) / three.size
    return Claim.judged(
        "3.1, for k2 ≠ k1",
        "The closed condition of loss, with the mean of 1/D over both directions, predicts where "
        "orbits of Type III exist.",
        agree > 0.98,
        f"the search finds them, and finds none, as the condition predicts at {100 * agree:.1f} % of "
        f"{number_of(three.size, 'point')}; of the others {int(np.sum(three & ~expected))} have one that it denies",
    )

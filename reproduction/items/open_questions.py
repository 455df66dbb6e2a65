"""Chapter 5: computations on the source's questions for future work."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.stability_map import MapFrame, draw_borders, set_plane
from analysis.figures.style import GOOD, GREY, MEASURED, MODEL, label
from dynamics import balanced_angles, release_outcome, stability_map, steady_states
from dynamics.equations.parameters import RotorParameters
from dynamics.errors import DynamicsError
from dynamics.stability.borders import stability_borders
from dynamics.stability.map_plane import SpeedStiffnessPlane
from dynamics.steady.reaction import Reaction, reaction
from dynamics.steady.steady_state import SteadyState
from reproduction.results import Claim, Panel, Reproduced, SourceTable
from reproduction.workspace import VIRTUAL, Workspace, numbers_of
from rig_basics.arrays import Array
from rig_basics.texts import number_of
from rig_basics.units import TO_RPM
from rig_configs import load_rig

_log = logging.getLogger(__name__)

_G = 9.81
_CHAPTER = "chapter 5"
_BALANCED = ("B", "C", "E")
_LOOKS = {"B": (MEASURED, "-"), "C": (GOOD, (0, (6, 2))), "E": (MODEL, (0, (6, 2, 1, 2)))}


def _ratio(name: str) -> float:
    return load_rig(VIRTUAL).points[name].speed_ratio


def _with_c34(p: RotorParameters, c34: float) -> RotorParameters:
    return replace(p, a=replace(p.a, damping_Nms_per_rad=c34), b=replace(p.b, damping_Nms_per_rad=c34))


def _stable(p: RotorParameters, speed_ratio: float) -> list[SteadyState]:
    """Return the stable states; an empty list if none can be found."""
    try:
        return [state for state in steady_states(p, p.speed_rad_s(speed_ratio), 1e-6) if state.stable]
    except DynamicsError as error:
        _log.warning("no stable states at a speed ratio of %.6g: %s", speed_ratio, error)
        return []


_GRAVITY_RATIOS = np.round(np.linspace(1.2, 8.0, 69), 3)


def _state_at(p: RotorParameters, name: str, states: Sequence[SteadyState]) -> str:
    """Return speed, type and amplitude of a point's stable state."""
    rpm = p.speed_rad_s(_ratio(name)) * TO_RPM
    state = f"{states[0].type}, {1e6 * states[0].amplitude_m:.1f} µm" if states else "no stable state"
    return f"{name} ({rpm:.0f} rpm) {state}"


def _draw_gravity(kinds: NDArray[np.str_], left: Array, swing: Array, weak: Array) -> Figure:
    """Draw vibration and swing over speed ratio, by the kind of the stable state."""
    with sheet(WIDTH_IN, 4.6, "Gravity: a horizontal shaft, vibration and swing that are left") as figure:
        axes: list[Axes] = figure.subplots(2, 1, sharex=True).tolist()
        for kind, colour in (("I", MEASURED), ("III", MODEL)):
            axes[0].semilogy(
                _GRAVITY_RATIOS,
                np.where(kinds == kind, left, np.nan),
                ".",
                color=colour,
                label=f"stable: {'balanced (I)' if kind == 'I' else 'together (III)'}",
            )
            axes[1].semilogy(_GRAVITY_RATIOS, np.where(kinds == kind, swing, np.nan), ".", color=colour)
        axes[1].semilogy(_GRAVITY_RATIOS, weak, color=GREY, lw=1.0, label="g/(R ω²)")
        for one in axes:
            for here in _GRAVITY_RATIOS[kinds == "none"].tolist():
                one.axvspan(here - 0.05, here + 0.05, color="#e8e8e8", lw=0)
        label(axes[0], None, "rms vibration, µm")
        label(axes[1], "speed ratio Ω", "swing of θ3, ± °")
    return figure


def gravity(work: Workspace) -> Reproduced:
    """A horizontal shaft: stable states, remaining vibration and swing of the pendulums."""
    p = work.physics()
    heavy = replace(p, gravity_m_per_s2=_G)
    rows = list[tuple[float, str, float, float]]()
    for i, ratio in enumerate(_GRAVITY_RATIOS.tolist()):
        states = _stable(heavy, ratio)
        if states:
            swing = float(np.degrees(np.ptp(states[0].states[:, 2])) / 2)
            rows.append((ratio, states[0].type, 1e6 * states[0].amplitude_m, swing))
        else:
            rows.append((ratio, "none", math.nan, math.nan))
        work.progress((i + 1) / len(_GRAVITY_RATIOS))
    kinds = np.array([kind for _, kind, _, _ in rows])
    left, swing = np.array([row[2] for row in rows]), np.array([row[3] for row in rows])
    first = [p.speed_rad_s(ratio) for ratio in _GRAVITY_RATIOS.tolist()]
    weak = np.degrees(_G / (p.a.length_m * np.array(first) ** 2))
    figure = _draw_gravity(kinds, left, swing, weak)
    flat = {name: _stable(p, _ratio(name)) for name in _BALANCED}
    weighed = {name: _stable(heavy, _ratio(name)) for name in _BALANCED}
    words = ", ".join(_state_at(p, name, states) for name, states in weighed.items())
    lost = {name: _gravity_limit(p, _ratio(name)) for name in ("B", "C")}
    works = [name for name, states in weighed.items() if states and states[0].type == flat[name][0].type]
    least = [row[0] for row in rows if row[1] == "I"]
    return Reproduced(
        (
            Panel(
                "gravity",
                "Stable states of a horizontal rig over the speed ratio: vibration and swing; grey: none.",
                figure,
            ),
        ),
        (
            SourceTable(
                "gravity",
                "Stable states with gravity in the disk's plane",
                {"speed_ratio": _GRAVITY_RATIOS, "state": kinds, "vibration_um": left, "swing_deg": swing},
            ),
        ),
        numbers_of(p) | {"gravity_m_per_s2": _G},
        ("The nominal rig laid on its side, gravity along −y; its sag M_S g/k2 is not a vibration.",),
        (
            Claim(
                _CHAPTER,
                "(Question) The balancer works on a horizontal shaft.",
                "holds" if len(works) == len(_BALANCED) else "holds in part" if works else "does not hold",
                f"{words}; in the second stable area balanced from Ω = {min(least, default=math.nan):.2f} on",
            ),
            Claim.judged(
                _CHAPTER,
                "(Question) In the first stable area gravity unlocks the pendulums: they slip.",
                all(name in works or slip for name, (_, slip, _) in lost.items()),
                "; ".join(
                    f"{name}: balanced up to g = {limit:.2f} m/s², g/(R ω²) = {angle:.1f}°"
                    + (", a release at 9.81 m/s² slips" if slip else "")
                    for name, (limit, slip, angle) in lost.items()
                ),
            ),
        ),
    )


def _gravity_limit(p: RotorParameters, speed_ratio: float) -> tuple[float, bool, float]:
    """Return the gravity up to which Type I is stable, m/s²; whether a release at 9.81 m/s² slips; g/(R ω²), °."""
    low, high = 0.0, _G
    while high - low > 0.01:
        middle = 0.5 * (low + high)
        balanced = any(s.type == "I" for s in _stable(replace(p, gravity_m_per_s2=middle), speed_ratio))
        low, high = (middle, high) if balanced else (low, middle)
    speed = p.speed_rad_s(speed_ratio)
    slips = release_outcome(replace(p, gravity_m_per_s2=_G), speed).state == "slipping"
    return low, slips, math.degrees(low / (p.a.length_m * speed**2))


_C34 = np.geomspace(1e-4, 0.1, 25)


def _draw_damping(constants: dict[str, Array], wide: Array, shares: Array) -> Figure:
    """Draw time constants and stable share over the pendulums' damping."""
    with sheet(WIDTH_IN, 4.6, "Damping of the pendulums: time constant against stable area") as figure:
        axes: list[Axes] = figure.subplots(2, 1, sharex=True).tolist()
        for name, (colour, dashes) in _LOOKS.items():
            axes[0].loglog(_C34, constants[name], color=colour, ls=dashes, label=f"point {name}")
        axes[1].semilogx(wide, 100 * shares, "o-", color="black", ms=3)
        label(axes[0], None, "slowest time constant, s")
        label(axes[1], "c34, N m s/rad", "stable share of the plane, %")
    return figure


def pendulum_damping(work: Workspace) -> Reproduced:
    """The best damping of the pendulums: decay rate of deviations, and size of the stable area."""
    p = work.physics()
    constants = {name: np.empty(len(_C34)) for name in _BALANCED}
    for i, value in enumerate(_C34.tolist()):
        q = _with_c34(p, value)
        for name in _BALANCED:
            found = stability_map(q, np.array([_ratio(name)]), np.array([p.k2_N_per_m / p.k1_N_per_m]), 1e-10)
            modulus = float(found.multiplier_max[0, 0])
            turn = 2 * math.pi / p.speed_rad_s(_ratio(name))
            constants[name][i] = -turn / math.log(modulus) if modulus < 1 else math.nan
    wide = _C34[::4]
    shares = np.empty(len(wide))
    for i, value in enumerate(wide.tolist()):
        q = _with_c34(p, value)
        plane = SpeedStiffnessPlane(q, balanced_angles(q)[0])
        shares[i] = stability_borders(plane, (0.3, 7.0), (1.0, 16.0), first=(64, 48), spacing=0.01).stable_share
        work.progress((i + 1) / len(wide))
    figure = _draw_damping(constants, wide, shares)
    best = {name: int(np.nanargmin(values)) for name, values in constants.items()}
    inner = [name for name, i in best.items() if 0 < i < len(_C34) - 1]
    shown = "; ".join(
        f"{name}: {constants[name][i]:.2f} s at c34 = {_C34[i]:.2g} ({constants[name][-1]:.0f} s at 0.1)"
        for name, i in best.items()
    )
    against = float(wide[int(np.argmax(shares))]) > 3 * max(float(_C34[i]) for i in best.values())
    return Reproduced(
        (
            Panel(
                "damping",
                "Above: slowest time constant of the balanced state at three points; below: stable share of "
                "the plane Ω = 0.3 … 7, K = 1 … 16.",
                figure,
            ),
        ),
        (
            SourceTable(
                "time-constants",
                "Slowest time constant of the balanced state over c34, s",
                {"c34_Nms_per_rad": _C34, **{f"{name}_s": values for name, values in constants.items()}},
            ),
            SourceTable(
                "shares", "Stable share of the plane over c34", {"c34_Nms_per_rad": wide, "stable_share": shares}
            ),
        ),
        numbers_of(p) | {"c3_Nms_per_rad": "1e-4 … 0.1", "c4_Nms_per_rad": "1e-4 … 0.1"},
        ("Best is what dies out fastest: the slowest time constant, by the largest multiplier.",),
        (
            Claim.judged(
                _CHAPTER, "(Question) There is a best damping of the pendulums.", len(inner) == len(best), shown
            ),
            Claim.judged(
                _CHAPTER,
                "(Question) What settles fastest is not what is stable in the largest area.",
                against,
                f"the stable share grows from {100 * shares[0]:.1f} % at {wide[0]:.1g} to "
                f"{100 * float(np.max(shares)):.1f} % at {wide[int(np.argmax(shares))]:.2g} N m s/rad",
            ),
        ),
    )


_GRID = (56, 31)
_CLASSES = ("neither", "I alone", "III alone", "I and III")
_CLASS_COLOURS = ("#f2f2f2", "#9ecae1", "#fdbf6f", "#b2df8a")


def type_three(work: Workspace) -> Reproduced:
    """Type III on anisotropic suspensions: where it is stable, compared with Type I."""
    p = work.physics()
    x, y = np.linspace(0.4, 7.0, _GRID[0]), np.linspace(1.5, 16.0, _GRID[1])
    found = {zeta: _classes(work, zeta, x, y) for zeta in (0.02, 0.05)}
    with sheet(WIDTH_IN, 3.9, "Type III on anisotropic suspensions: which of Types I and III is stable") as figure:
        row: list[Axes] = figure.subplots(1, 2, sharey=True).tolist()
        for axes, (zeta, classes) in zip(row, found.items(), strict=True):
            axes.grid(False)
            axes.pcolormesh(
                x,
                y,
                classes,
                cmap=ListedColormap(_CLASS_COLOURS),
                vmin=-0.5,
                vmax=3.5,
                shading="nearest",
                rasterized=True,
            )
            q = work.physics(VIRTUAL, [f"suspension.zeta1={zeta}", f"suspension.zeta2={zeta}"])
            borders = stability_borders(
                SpeedStiffnessPlane(q, balanced_angles(q)[0]), (0.4, 7.0), (1.5, 16.0), first=(96, 72), spacing=1 / 400
            )
            draw_borders(axes, borders)
            set_plane(axes, (x, y), MapFrame(own=p.k2_N_per_m / p.k1_N_per_m))
            label(axes, None, None, f"ζ = {zeta:g}")
        for name, colour in zip(_CLASSES, _CLASS_COLOURS, strict=True):
            row[0].plot([], [], "s", color=colour, mec="#888888", mew=0.5, ms=8, label=name)
    claims = list[Claim]()
    for zeta, classes in found.items():
        unstable = np.isin(classes, (0, 2))
        share = float(np.count_nonzero(classes == 2) / np.count_nonzero(unstable))
        both = float(np.count_nonzero(classes == 3) / classes.size)
        claims.append(
            Claim(
                "4.4, chapter 5",
                f"Where Type I is not stable, Type III is (ζ = {zeta:g}).",
                "holds" if share > 0.999 else "holds in part" if share > 0.05 else "does not hold",
                f"of {number_of(int(unstable.sum()), 'point')} of the plane at which Type I is unstable, III is "
                f"stable at "
                f"{100 * share:.1f} %; both are stable at {100 * both:.1f} % of the plane",
            )
        )
    grid_x, grid_y = np.meshgrid(x, y)
    columns = {"speed_ratio": grid_x.ravel(), "stiffness_ratio": grid_y.ravel()}
    names = {f"class_zeta_{zeta:g}": np.array(_CLASSES)[classes].ravel() for zeta, classes in found.items()}
    return Reproduced(
        (
            Panel(
                "classes",
                "Which of Types I and III is stable over speed ratio and stiffness ratio, for two damping "
                "ratios; lines: borders of Type I.",
                figure,
            ),
        ),
        (SourceTable("classes", "Stable types over the plane", {**columns, **names}),),
        numbers_of(p) | {"zeta1": "0.02, 0.05", "zeta2": "0.02, 0.05"},
        ("Type III is found as a periodic orbit and judged by its own multipliers.",),
        tuple(claims),
    )


def _classes(work: Workspace, zeta: float, x: Array, y: Array) -> NDArray[np.intp]:
    """Return indices into _CLASSES, shape (m, n)."""
    p = work.physics(VIRTUAL, [f"suspension.zeta1={zeta}", f"suspension.zeta2={zeta}"])
    found = np.zeros((len(y), len(x)), np.intp)
    for row, ratio in enumerate(y.tolist()):
        q = replace(p, k2_N_per_m=ratio * p.k1_N_per_m)
        for column, speed_ratio in enumerate(x.tolist()):
            types = {state.type for state in _stable(q, speed_ratio)}
            found[row, column] = ("I" in types) + 2 * ("III" in types)
        work.progress((row + 1) / len(y) * (0.5 if zeta < 0.03 else 1.0))
    return found


_STEP_C34 = np.geomspace(2e-4, 3e-2, 9)
_STEP = 1.2


def imbalance_step(work: Workspace) -> Reproduced:
    """A sudden change of the imbalance: reaction time over the pendulums' damping."""
    p = work.physics()
    found = {name: [_stepped(p, name, value) for value in _STEP_C34.tolist()] for name in _BALANCED}
    work.progress(0.7)
    nominal = {name: _stepped(p, name, 1e-3) for name in _BALANCED}
    with sheet(WIDTH_IN, 4.8, f"Sudden change of the imbalance by {100 * (_STEP - 1):.0f} %") as figure:
        axes: list[Axes] = figure.subplots(2, 1).tolist()
        for name, (colour, dashes) in _LOOKS.items():
            one = nominal[name]
            axes[0].plot(one.time_s, 1e3 * one.amplitude_m, color=colour, ls=dashes, label=f"point {name}")
            axes[1].loglog(_STEP_C34, [each.reaction_s for each in found[name]], "o", color=colour, ls=dashes, ms=3)
        axes[0].set(xlim=(0, 12))
        label(axes[0], "time after the change, s (c34 = 0.001 N m s/rad)", "rms vibration, mm")
        label(axes[1], "c34, N m s/rad", "reaction time, s")
    times = {name: np.array([each.reaction_s for each in rows]) for name, rows in found.items()}
    back = all(each.after is not None and each.after.type == "I" for rows in found.values() for each in rows)
    best = {name: int(np.nanargmin(values)) for name, values in times.items()}
    shown = "; ".join(
        f"{name}: {times[name][i]:.1f} s at c34 = {_STEP_C34[i]:.2g}, {times[name][-1]:.1f} s at "
        f"{_STEP_C34[-1]:.2g}, peak at 0.001 {1e3 * nominal[name].peak_m:.3f} mm"
        for name, i in best.items()
    )
    columns = {f"{name}_s": values for name, values in times.items()}
    return Reproduced(
        (
            Panel(
                "step",
                "Above: rms vibration of each revolution after the imbalance has jumped; below: time until it "
                "stays within 5 % of its largest value.",
                figure,
            ),
        ),
        (SourceTable("reaction", "Reaction time over c34, s", {"c34_Nms_per_rad": _STEP_C34, **columns}, shown=True),),
        numbers_of(p) | {"change": f"S_P × {_STEP:g}"},
        (
            f"The imbalance grows by {100 * (_STEP - 1):.0f} % at once, the rotor's mass stays, the speed is held.",
            "The reaction is over when the vibration stays within 5 % of its largest deviation from its end.",
        ),
        (
            Claim.judged(_CHAPTER, "(Question) The pendulums balance the changed rotor again.", back, shown),
            Claim(
                "chapter 5",
                "(Question) One damping of the pendulums gives the fastest reaction.",
                "holds in part" if len({int(i) for i in best.values()}) > 1 else "holds",
                "it depends on the speed: "
                + ", ".join(f"{n} {_STEP_C34[i]:.2g}" for n, i in best.items())
                + " N m s/rad",
            ),
        ),
    )


def _stepped(p: RotorParameters, name: str, c34: float) -> Reaction:
    q = _with_c34(p, c34)
    return reaction(q, replace(q, imbalance_radius_m=_STEP * q.imbalance_radius_m), q.speed_rad_s(_ratio(name)))

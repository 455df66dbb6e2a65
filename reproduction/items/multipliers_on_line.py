"""Figures 4.3 and 4.4: the balanced state's multipliers along the line of the points."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.axes3d import Axes3D
from numpy.typing import NDArray

from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import GREY, MEASURED, MODEL, label
from dynamics import balanced_angles
from dynamics.equations.linearised import type_one
from dynamics.equations.parameters import RotorParameters
from dynamics.stability.floquet import piecewise
from reproduction.items.stability_plane import frame_of_rig
from reproduction.results import Claim, Panel, Reproduced, SourceTable
from reproduction.workspace import Workspace, numbers_of
from rig_basics.arrays import Array


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
    points = {point.name: point.speed_ratio for point in frame_of_rig(p).points}
    with sheet(WIDTH_IN, 5.0, "4.3: the largest multipliers over a revolution along K = 14.9") as figure:
        _cylinder(figure, largest, points)
    moduli = np.abs(largest)
    crossings = _RATIOS[1:][np.diff((moduli < 1).astype(int)) != 0]
    at = {name: complex(largest[int(np.argmin(np.abs(_RATIOS - ratio)))]) for name, ratio in points.items()}
    pairs = [name for name, value in at.items() if abs(value.imag) > 1e-6]
    inside = [name for name, value in at.items() if abs(value) < 1]
    return Reproduced(
        (Panel("cylinder", "Multipliers of largest modulus over the speed ratio, with the unit cylinder.", figure),),
        (
            SourceTable(
                "largest",
                "The multiplier of largest modulus over one revolution along K = 14.9",
                {"speed_ratio": _RATIOS, "real": largest.real, "imaginary": largest.imag},
            ),
        ),
        numbers_of(p),
        ("Ω = 0.5 … 6.5.",),
        (
            Claim.judged(
                "4.1.4",
                "Along the line the largest multiplier is outside, inside, outside and again inside the unit cylinder.",
                inside == ["B", "C", "E"] and len(crossings) == 3,
                f"inside at {', '.join(inside)}; it crosses at Ω = "
                + ", ".join(f"{ratio:.3f}" for ratio in crossings.tolist()),
            ),
            Claim.judged(
                "4.1.4",
                "The largest multipliers are a complex conjugate pair.",
                len(pairs) == len(at),
                f"a pair at {', '.join(pairs) or 'none'}; real at "
                f"{', '.join(name for name in at if name not in pairs)}: "
                + ", ".join(f"{name} {value.real:.4f}{value.imag:+.4f}i" for name, value in at.items()),
            ),
        ),
    )


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
        (SourceTable("multipliers", "All multipliers over one revolution along K = 14.9", columns),),
        numbers_of(p),
        ("Ω = 0.5 … 6.5.",),
        (
            Claim.judged(
                "Figure 4.4",
                "The product of all multipliers follows from the damping alone (Liouville's "
                "theorem: a check of our figure).",
                off < 1e-6,
                f"log of the product over a period against the trace, {liouville:.4f} /s: within {off:.1e}",
            ),
        ),
    )


def _trace_rate(p: RotorParameters) -> float:
    """Mean trace of the linearised equations, 1/s."""
    matrix = type_one(p, *balanced_angles(p)[0], p.speed_rad_s(2.0))
    return float(np.trace(matrix.harmonics[0]).real)

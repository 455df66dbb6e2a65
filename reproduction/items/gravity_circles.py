"""Section 3.1: reach of the centre of gravity by pendulum sets, and the effect of opposed ones."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes

from analysis.figures.balancing_plane import draw_regions, draw_ring
from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import GOOD, MODEL
from dynamics import gravity_disk
from dynamics.equations.balancing import PROPERLY_OVERSIZED, balancing_region
from dynamics.equations.parameters import RotorParameters
from dynamics.motions.frequency_response import frequency_response
from dynamics.steady.basins.single import release_ends
from dynamics.steady.singular_points import singular_points
from reproduction.items.pendulum_sets import FROM_RAD, isotropic_rig, with_moments, without_pendulums
from reproduction.results import Claim, Panel, Reproduced, SourceTable
from reproduction.workspace import Workspace, numbers_of
from rig_basics.texts import number_of

_RING_SCALE = 0.055  # in units of the plane
_RINGS_AT = 0.2 + 0.45 * np.arange(5)  # of S_P; none on a border
_COMPARED = (1.2, 1.6, 2.5, 6.0, 20.0)  # speed ratios of the comparison of opposed pendulums with none


def gravity_circles_3_4(work: Workspace) -> Reproduced:
    """Reproduce Figure 3.4: the ring that the centre of gravity can reach, at places of the plane."""
    p = isotropic_rig(work)
    s = p.imbalance_moment_kg_m
    pairs = [(float(a) * s, float(b) * s) for a in _RINGS_AT for b in _RINGS_AT]
    upto = 2.25 * s
    with sheet(WIDTH_IN, 6.6, "3.4: where each pendulum set can put the centre of gravity") as figure:
        axes: Axes = figure.subplots()
        draw_regions(axes, s, upto)
        for a, b in pairs:
            draw_ring(axes, (a, b, s), _RING_SCALE)
        axes.plot([], [], "+", color="black", ms=6, label="rotor axis, at the set's S_A, S_B")
        axes.plot([], [], "o", color=GOOD, alpha=0.6, ms=9, label="reached, axis included")
        axes.plot([], [], "o", color=MODEL, alpha=0.6, ms=9, label="reached, axis not included")
    disks = [gravity_disk(with_moments(p, a, b)) for a, b in pairs]
    masses = [with_moments(p, a, b).total_mass_kg for a, b in pairs]
    columns = {
        "S_A_g_m": [1e3 * a for a, _ in pairs],
        "S_B_g_m": [1e3 * b for _, b in pairs],
        "centre_mm": [1e3 * d.centre_m for d in disks],
        "outer_mm": [1e3 * d.outer_m for d in disks],
        "inner_mm": [1e3 * d.inner_m for d in disks],
        "holds_axis": [str(d.holds_axis) for d in disks],
        "region": [balancing_region(a, b, s) for a, b in pairs],
    }
    helped, curve = _opposed_against_none(p)
    return Reproduced(
        (
            Panel(
                "circles",
                "A ring for each of 25 pendulum sets: its centre is off the rotor axis (+) by S_P/M_S, its radii are "
                "(S_A + S_B)/M_S and |S_A − S_B|/M_S; the blind spot is the hole.",
                figure,
            ),
        ),
        (SourceTable("rings", "Rings", columns), curve),
        numbers_of(p),
        (f"S_P of the isotropic rig; rings at {_RING_SCALE:g} of the plane's scale, the axis at the set's place.",),
        (*_ring_claims(p, pairs, [d.inner_m * m for d, m in zip(disks, masses, strict=True)]), helped),
    )


def _ring_claims(p: RotorParameters, pairs: list[tuple[float, float]], inner: list[float]) -> tuple[Claim, ...]:
    """Compare the rings with poses of both pendulums in all directions."""
    s, turn = p.imbalance_moment_kg_m, np.exp(1j * np.linspace(0, 2 * math.pi, 721))
    reach = [np.abs(a * turn[:, None] + b * turn[None, :-1]) for a, b in pairs]
    hole = [float(r.min()) for r in reach]
    equal = [i for i, (a, b) in enumerate(pairs) if a == b]
    others = min(h for i, h in enumerate(hole) if i not in equal)
    step = [(a + b) * math.pi / 720 for a, b in pairs]  # largest distance of a pose from the nearest tested one
    apart = max(abs(found - computed) / wide for found, computed, wide in zip(hole, inner, step, strict=True))
    nearest = [float(np.abs(s + a * turn[:, None] + b * turn[None, :-1]).min()) for a, b in pairs]
    inside = [balancing_region(a, b, s) == PROPERLY_OVERSIZED for a, b in pairs]
    agree = all((near < wide) == own for near, wide, own in zip(nearest, step, inside, strict=True))
    blind = [own and a != b for own, (a, b) in zip(inside, pairs, strict=True)]
    return (
        Claim.judged(
            "Figure 3.4",
            "Sets with equal moments have no blind spot, all others have one.",
            all((hole[i] < step[i]) == (i in equal) for i in range(len(pairs))) and apart <= 1,
            f"{number_of(len(pairs), 'set')}, 720 × 720 poses each: the smallest reach of the {len(equal)} "
            f"equal ones is "
            f"{1e3 * max(hole[i] for i in equal):.1e} g m, of the others {1e3 * others:.3f} g m or more",
        ),
        Claim.judged(
            "Figure 3.4",
            "The axis lies in the ring inside ABCD, and outside of it (in the blind spot or beyond the rim) elsewhere.",
            agree,
            f"{sum(inside)} of {number_of(len(pairs), 'set')} are inside ABCD; poses bring the "
            f"centre of gravity to the axis for "
            f"{number_of(sum(near < wide for near, wide in zip(nearest, step, strict=True)), 'set')}, the same ones",
        ),
        Claim.judged(
            "Figure 3.4",
            "A blind spot does not keep a set from balancing while the axis is not in it.",
            any(blind) and agree,
            f"{number_of(sum(blind), 'set')} inside ABCD have a blind spot, and a pose of balance",
        ),
    )


def _opposed(p: RotorParameters, share: float, ratio: float) -> float:
    """Return the amplitude of the smaller Type II over that without, at |S_A − S_B| = share S_P; NaN if II is lost."""
    s = p.imbalance_moment_kg_m
    own = with_moments(p, (share + 0.5) * s, 0.5 * s)
    speed = own.speed_rad_s(ratio)
    alone = abs(speed**2 * s / complex(own.k1_N_per_m - own.total_mass_kg * speed**2, speed * own.damping_Ns_per_m[0]))
    found = [abs(point.z_m) for point in singular_points(own, speed) if point.type == "II"]
    return min(found, default=math.nan) / alone


def _opposed_against_none(p: RotorParameters) -> tuple[Claim, SourceTable]:
    """Return for which differences opposed pendulums reduce the amplitude, (3-7)."""
    shares = np.linspace(1.02, 2.6, 80)
    curves = {ratio: np.array([_opposed(p, float(x), ratio) for x in shares]) for ratio in _COMPARED}
    border = {
        ratio: float(np.interp(1.0, curve, shares)) for ratio, curve in curves.items() if np.all(np.isfinite(curve))
    }
    s = p.imbalance_moment_kg_m
    tried = (1.3, 1.7, 2.3)
    rigs = [with_moments(p, (x + 0.5) * s, 0.5 * s) for x in tried]
    ends = release_ends(rigs, [own.speed_rad_s(6.0) for own in rigs], FROM_RAD, 100.0)
    none = [
        own.imbalance_moment_kg_m
        / own.total_mass_kg
        * float(frequency_response(without_pendulums(own), np.array([6.0])).amplification[0, 0])
        for own in rigs
    ]
    shown = ", ".join(
        f"{x:g}: {name} at {a / n:.2f}" for x, name, a, n in zip(tried, ends.name, ends.amplitude_m, none, strict=True)
    )
    return (
        Claim.judged(
            "(3-7)",
            "Improperly oversized pendulums reduce the vibration where |S_A − S_B| < S_P, else they raise it.",
            all(abs(value - 1) < 0.05 for value in border.values()),
            "that difference is above S_P in all of this region by (3-5); they reduce it up to |S_A − S_B|/S_P = "
            + ", ".join(f"{value:.3f} at Ω = {ratio:g}" for ratio, value in border.items())
            + f" (ζ = {p.zeta1:g}); released at Ω = 6, amplitude over that without a balancer for {shown}",
        ),
        SourceTable(
            "opposed",
            "Amplitude of Type II over that without a balancer, by |S_A − S_B|/S_P",
            {"difference_over_S_P": shares} | {f"speed_ratio_{ratio:g}": c for ratio, c in curves.items()},
        ),
    )

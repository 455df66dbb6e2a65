"""`rig predict --balancing` and `--lost`: what a rig's pendulums can balance, and where singular points are lost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig_basics.units import TO_RPM
from rig_cli.console import print_json, wait_for_compilation
from rig_cli.options import what_if_words
from rig_configs import IdentifiedParameters, Rig

if TYPE_CHECKING:
    from analysis.moment_margins import MomentMargins
    from dynamics import RotorParameters

_GRAMS = 1e3


def report_balancing(
    rig: Rig, known: IdentifiedParameters, settings: Sequence[str], plot: Path | None, json: bool
) -> int:
    """Print region, margins of S_P, ring of the centre of gravity and balanced angles; draw them if requested."""
    with wait_for_compilation("dynamics"):
        from analysis.moment_margins import moment_margins

        physics = rig.physics
        found = moment_margins(rig, known)
    if plot is not None:
        from analysis.figures.balancing_plane import draw_balancing
        from analysis.figures.page import write_figure

        title = f"{rig.name}: {found.margins.region}{what_if_words(settings, '; ')}"
        write_figure(plot, draw_balancing(physics, title, found.std_kg_m), title)
    result = _balancing_json(physics, found) | {
        "what_if": list(settings),
        "plot": None if plot is None else str(plot),
    }
    if json:
        print_json(result)
        return 0
    for line in _balancing_lines(result, found):
        print(line)
    if settings:
        print(what_if_words(settings))
    return 0


def _balancing_json(physics: RotorParameters, found: MomentMargins) -> dict[str, Any]:
    from analysis.moment_margins import probability_of_region
    from dynamics import balanced_angles, gravity_disk

    disk, margins = gravity_disk(physics), found.margins
    chance = (
        probability_of_region(margins.may_grow_kg_m, found.grow_std_kg_m)
        + probability_of_region(margins.may_shrink_kg_m, found.shrink_std_kg_m)
        - 1.0
    )
    return {
        "balancing_region": margins.region,
        "SA_kg_m": found.moments_kg_m[0],
        "SB_kg_m": found.moments_kg_m[1],
        "SP_kg_m": found.moments_kg_m[2],
        "std_kg_m": dict(zip(("SA", "SB", "SP"), found.std_kg_m, strict=True)),
        "SP_least_balanced_kg_m": margins.least_kg_m,
        "SP_most_balanced_kg_m": margins.most_kg_m,
        "SP_may_grow_kg_m": margins.may_grow_kg_m,
        "SP_may_grow_std_kg_m": found.grow_std_kg_m,
        "SP_may_shrink_kg_m": margins.may_shrink_kg_m,
        "SP_may_shrink_std_kg_m": found.shrink_std_kg_m,
        "probability_of_region": chance,
        "gravity_ring": {
            "centre_mm": 1e3 * disk.centre_m,
            "inner_mm": 1e3 * disk.inner_m,
            "outer_mm": 1e3 * disk.outer_m,
            "holds_axis": disk.holds_axis,
        },
        "balanced_deg": [[math.degrees(angle) for angle in pair] for pair in balanced_angles(physics)],
    }


def _balancing_lines(result: dict[str, Any], found: MomentMargins) -> list[str]:
    moments = zip(("S_A", "S_B", "S_P"), found.moments_kg_m, found.std_kg_m, strict=True)
    shown = ", ".join(f"{name} {_g_m(value, std)}" for name, value, std in moments)
    margins, ring = found.margins, result["gravity_ring"]
    lines = [f"{shown}: pendulums {margins.region}"]
    lines.append(
        f"full balance exists for S_P from {_GRAMS * margins.least_kg_m:.4g} to {_GRAMS * margins.most_kg_m:.4g} g m"
    )
    ways = (
        ("grow", margins.may_grow_kg_m, found.grow_std_kg_m),
        ("shrink", margins.may_shrink_kg_m, found.shrink_std_kg_m),
    )
    for way, margin, std in ways:
        lines.append(
            f"  S_P may {way} without limit: the region stays"
            if margin is None
            else f"  S_P may {way} by {_g_m(margin, std)} before the region changes"
        )
    if any(found.std_kg_m):
        lines.append(f"  probability that it is {margins.region}: {result['probability_of_region']:.4g}")
    lines.append(
        f"centre of gravity: a ring with radii {ring['inner_mm']:.4g} … {ring['outer_mm']:.4g} mm, its centre "
        f"{ring['centre_mm']:.4g} mm from the axis, which is {'in' if ring['holds_axis'] else 'not in'} it"
    )
    poses = " or ".join(f"θ3 {a:.3f}° θ4 {b:.3f}°" for a, b in result["balanced_deg"])
    return [*lines, f"balanced (Type I): {poses}" if poses else "balanced (Type I): no pose"]


def _g_m(value: float, std: float) -> str:
    return f"{_GRAMS * value:.4g} g m" + (f" ± {_GRAMS * std:.2g}" if std > 0 else "")


def report_lost(rig: Rig, known: IdentifiedParameters, settings: Sequence[str], plot: Path | None, json: bool) -> int:
    """Print the speeds at which singular points of Types II and III do not exist."""
    with wait_for_compilation("dynamics"):
        from dynamics.steady.point_loss import point_losses

        physics = known.with_effects(rig.physics)
        losses = point_losses(physics)
    if plot is not None:
        from analysis.figures.page import write_figure
        from analysis.figures.point_loss import draw_point_loss

        title = f"{rig.name}: where singular points are lost{what_if_words(settings, '; ')}"
        write_figure(plot, draw_point_loss(physics, title), title)
    rpm = physics.natural_frequencies_rad_s[0] * TO_RPM
    exact = physics.is_isotropic and physics.gravity_m_per_s2 == 0
    if json:
        print_json(
            {
                "exact": exact,
                "lost": [
                    {
                        "type": loss.type,
                        "ST_kg_m": loss.moment_kg_m,
                        "speed_ratio": [_finite(pair, 1.0) for pair in loss.speed_ratios],
                        "speed_rpm": [_finite(pair, rpm) for pair in loss.speed_ratios],
                    }
                    for loss in losses
                ],
                "what_if": list(settings),
                "plot": None if plot is None else str(plot),
            }
        )
        return 0
    for loss in losses:
        bands = ", ".join(
            f"{low:.4g} … {high:.4g} ({low * rpm:.4g} … {high * rpm:.4g} rpm)" for low, high in loss.speed_ratios
        )
        print(
            f"Type {loss.type:3} (S_T {_GRAMS * loss.moment_kg_m:.4g} g m): "
            + (f"lost at speed ratio {bands}" if bands else "never lost")
        )
    print(
        "exact: isotropic suspension"
        if exact
        else "from the mean torque of pendulums at rest on the rotor; orbits with wobble may differ slightly"
    )
    print("stable and slipping motions at each speed: rig map --quantity coexisting")
    if settings:
        print(what_if_words(settings))
    return 0


def _finite(pair: tuple[float, float], unit: float) -> list[float | None]:
    """Return the ends of a band in a unit; None for an infinite end."""
    return [end * unit if math.isfinite(end) else None for end in pair]

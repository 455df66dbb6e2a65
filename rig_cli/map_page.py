"""Output of `rig map`: figure, JSON and text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from analysis.figures.page import write_figure
from analysis.figures.plane_maps import draw_map
from analysis.maps.answers import MapAnswer
from analysis.maps.question import MapQuestion
from dynamics.stability.borders import Borders
from rig_basics.texts import number_of
from rig_cli.console import notify
from rig_cli.options import what_if_words


def report_omissions(question: MapQuestion) -> None:
    """Report effects of the rig that the map does not include."""
    known, rig = question.known, question.loaded()
    if known and known.slow_roll and known.slow_roll.bow_m:
        notify("the map leaves the bow out: a bent shaft has no state at rest")
    if rig.physics.a.friction_arm_m or rig.physics.b.friction_arm_m:
        notify("the map leaves dry friction out")


def draw(path: Path, found: MapAnswer) -> None:
    """Write the map's figure."""
    figure, readout = draw_map(found)
    write_figure(path, figure, f"Stability map of {found.question.loaded().name}", readout)


def map_json(found: MapAnswer) -> dict[str, Any]:
    """Return the result for JSON."""
    grid, lines = found.grid, found.borders
    there, size = np.isfinite(grid.multiplier_max), grid.multiplier_max.size
    return {
        "x": found.question.x.key,
        "y": found.question.y.key,
        "points": size,
        "balanced_share": float(np.mean(there)),
        "seconds": found.seconds,
        "microseconds_per_point": 1e6 * found.seconds / size,
        "method": found.method,
        "accuracy": grid.accuracy,
        "largest_error_estimate": float(np.nanmax(grid.error_estimate, initial=0.0)),
        "stable_share": float(np.mean(grid.stable)),
        "points_beyond_accuracy": grid.missed,
        "borders": None if lines is None else borders_json(lines),
        "borders_complete_to": None if lines is None else list(lines.complete_to),
        "stable_share_by_borders": None if lines is None else lines.stable_share,
        "unresolved_share": None if lines is None else found.unresolved,
        "computed_share": 1.0 if found.computed is None else float(np.mean(found.computed)),
        "family": _family_json(found),
        "best": _best_json(found),
    }


def _family_json(found: MapAnswer) -> dict[str, Any] | None:
    family = found.question.family
    return (
        None
        if family is None
        else {
            "key": family.key,
            "members": [
                {
                    "value": one.value,
                    "stable_share": one.borders.stable_share,
                    "unresolved_share": one.unresolved,
                    "borders": borders_json(one.borders),
                }
                for one in found.family
            ],
        }
    )


def _best_json(found: MapAnswer) -> dict[str, Any] | None:
    best, within = found.best, found.question.best
    return (
        None
        if best is None or within is None
        else {
            "key": within.key,
            "value": best.value,
            "interval": list(best.interval),
            "stable_share": best.share,
            "stable_share_error": best.share_error,
            "at_end": best.at_end,
            "stable_share_at_ends": [float(best.shares[0]), float(best.shares[-1])],
            "values": best.values.tolist(),
            "stable_shares": best.shares.tolist(),
            "unresolved_shares": best.unresolved.tolist(),
        }
    )


def borders_json(lines: Borders) -> list[dict[str, Any]]:
    """Return for each branch its length, whether it is closed, the kinds of stability loss, and its ends."""
    return [
        {
            "points": len(b.x),
            "closed": b.closed,
            "kinds": dict(Counter(b.kind)),
            "off_share_of_range": b.off,
            "from": [float(b.x[0]), float(b.y[0])],
            "to": [float(b.x[-1]), float(b.y[-1])],
        }
        for b in lines.branches
    ]


def print_map(result: Mapping[str, Any], settings: Sequence[str]) -> None:
    """Print the result as text."""
    print(
        f"{number_of(result['points'], 'point')} in {result['seconds']:.3g} s "
        f"({result['microseconds_per_point']:.3g} µs a point), "
        f"balanced state stable on {100 * result['stable_share']:.1f} %, largest error estimate "
        f"{result['largest_error_estimate']:.1g}"
    )
    if result["balanced_share"] < 1:
        print(f"no balanced state exists on {100 * (1 - result['balanced_share']):.1f} %")
    print(f"method: {result['method']}")
    branches: list[dict[str, Any]] = result["borders"] or []
    for border in branches:
        ends = (
            "closed"
            if border["closed"]
            else "from {:.4g}, {:.4g} to {:.4g}, {:.4g}".format(*border["from"], *border["to"])
        )
        print(f"border: {', '.join(border['kinds'])}; {number_of(border['points'], 'point')}, {ends}")
    if result["borders"] is not None:
        across, up = result["borders_complete_to"]
        print(
            f"stable within the borders: {100 * result['stable_share_by_borders']:.3f} %; islands and bands "
            f"narrower than 1/{1 / across:.0f} of x or 1/{1 / up:.0f} of y may have been missed"
            f"{_unresolved_words(result['unresolved_share'])}"
        )
    _print_refined_and_varied(result)
    if settings:
        print(what_if_words(settings))
    if missed := result["points_beyond_accuracy"]:
        notify(
            f"{number_of(missed, 'point is', 'points are')} less accurate than requested; error_estimate has "
            f"the error of each"
        )


def _print_refined_and_varied(result: Mapping[str, Any]) -> None:
    if result["computed_share"] < 1:
        print(
            f"refined at borders: {100 * result['computed_share']:.1f} % of the points computed, the others "
            "interpolated; an island between points of the coarse grid may have been missed"
        )
    family: dict[str, Any] = result["family"] or {"key": "", "members": []}
    for member in family["members"]:
        print(
            f"{family['key']} = {member['value']:.6g}: stable on {100 * member['stable_share']:.3f} %"
            f"{_unresolved_words(member['unresolved_share'])}"
        )
    if best := result["best"]:
        (low, high), (first, last) = best["interval"], best["stable_share_at_ends"]
        end = "; the range's end is the best, a wider range may hold a better one" if best["at_end"] else ""
        print(
            f"largest stable share at {best['key']} = {best['value']:.4g} ({low:.4g} … {high:.4g}): "
            f"{100 * best['stable_share']:.3f} % ± {100 * best['stable_share_error']:.1g} %; "
            f"at the ends {100 * first:.3f} % and {100 * last:.3f} %{end}"
        )
        beyond = [value for value, lost in zip(best["values"], best["unresolved_shares"], strict=True) if lost]
        if beyond:
            lost = _unresolved_words(max(best["unresolved_shares"]))
            print(f"between {min(beyond):.4g} and {max(beyond):.4g} the shares are lower bounds{lost}")


def _unresolved_words(share: float) -> str:
    return f", {100 * share:.3g} % not resolved (no border can be followed there)" if share else ""

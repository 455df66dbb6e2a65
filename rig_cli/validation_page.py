# pyright: strict
"""What a validation came to, in lines for the terminal: what all points say first, then each point."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def whole_lines(result: Mapping[str, Any]) -> list[str]:
    """What all points say together, and what is or would be the reason for a failure.

    Args:
        result: as `Validation.to_json` gives it.
    """
    agreement, explained = result.get("agreement"), result.get("explanations")
    lines: list[str] = list(result.get("reasons", ()))
    lines += [] if explained is None else explained["sentences"]
    if agreement is not None:
        lines.append(f"together: {'pass' if agreement['passed'] else 'FAIL'}: {agreement['why']}")
    return lines + [sentence for series in result.get("start_ups", ()) for sentence in series["sentences"]]


def noticed_lines(result: Mapping[str, Any]) -> list[str]:
    """The smallest deviation of each cause that the points together would notice, largest shares last."""
    lines: list[str] = []
    for one in result.get("noticed", ()):
        points = {name: size for name, size in one["points"].items() if size is not None}
        if one["together"] is None or not points:
            continue
        best = min(points, key=lambda name: points[name])
        unit = one["unit"]
        lines.append(f"{one['words']}: {one['together']:.2g} {unit} by all, {points[best]:.2g} {unit} by {best} alone")
    return lines

"""Result of a validation in lines for the terminal: first all points together, then each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def whole_lines(result: Mapping[str, Any]) -> list[str]:
    """Return the result of all points together, and present or possible reasons for a failure.

    Args:
        result: as returned by `Validation.to_json`.
    """
    agreement, explained = result.get("agreement"), result.get("explanations")
    lines: list[str] = list(result.get("reasons", ()))
    lines += [] if explained is None else explained["sentences"]
    compared = result.get("points") or result.get("start_ups")
    if agreement is not None and (compared or not agreement["passed"]):  # "all points agree" needs a point
        lines.append(f"together: {'pass' if agreement['passed'] else 'FAIL'}: {agreement['why']}")
    return lines + [sentence for series in result.get("start_ups", ()) for sentence in series["sentences"]]


def noticed_lines(result: Mapping[str, Any]) -> list[str]:
    """Return the smallest deviation of each cause that the points together would detect, in the order of the result."""
    lines: list[str] = []
    for one in result.get("noticed", ()):
        points = {name: size for name, size in one["points"].items() if size is not None}
        if one["together"] is None or not points:
            continue
        best = min(points, key=lambda name: points[name])
        unit = one["unit"]
        lines.append(f"{one['words']}: {one['together']:.2g} {unit} by all, {points[best]:.2g} {unit} by {best} alone")
    return lines

"""Ratios as text."""

from __future__ import annotations


def times(ratio: float) -> str:
    """A ratio of times or errors: two digits, "1.2 times"."""
    return f"{ratio:.2g} times" if ratio < 100 else f"{ratio:.0f} times"

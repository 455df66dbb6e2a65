"""How much a test tries: few cases in the suite that runs at every change, many in `make test-thorough`.

A test of statistics, a sweep or a search keeps one body. Its number of cases comes from `cases`, and its limits
follow from that number, so that the short form can fail for the same fault as the long one. Where a test cannot be
shortened, a cheaper test of the same behaviour stays in the suite and the long one is marked `thorough`.
"""

from __future__ import annotations

import os

import pytest

THOROUGH = os.environ.get("RIG_TESTS_THOROUGH") == "1"
"""Whether the long forms run: `make test-thorough` sets the variable."""

thorough = pytest.mark.skipif(not THOROUGH, reason="runs in `make test-thorough`")
"""Marks a test, or a `pytest.param`, that runs only there."""


def cases(suite: int, thorough: int) -> int:
    """The number of draws, seeds or examples of a test: `suite` at every change, `thorough` in the long run."""
    return thorough if THOROUGH else suite

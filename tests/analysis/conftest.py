"""Fixtures of several tests of the analysis; a module that needs another rig or draw has its own."""

from __future__ import annotations

import pytest
from analysis_runs import Drawn, draw

from rig_configs import Rig, load_rig


@pytest.fixture(scope="module")
def rig() -> Rig:
    """The nominal rig."""
    return load_rig("virtual")


@pytest.fixture(scope="module")
def drawn(rig: Rig) -> Drawn:
    """Parameters drawn around the nominal ones, and their identification."""
    return draw(rig, 0)

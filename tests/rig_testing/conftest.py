"""The kit with fewer damaged inputs than `rig driver check`, which a driver's author runs."""

from __future__ import annotations

import pytest

from rig_testing import mutations
from tests.effort import cases


@pytest.fixture(autouse=True)
def fewer_damaged_inputs(monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit of inputs with wrong samples follows from their number; the broken twins are found by as few."""
    monkeypatch.setattr(mutations, "QUICK", cases(1000, mutations.QUICK))

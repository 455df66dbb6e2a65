"""Figures 4.10 to 4.14: a point recorded through drivers on a virtual rig and judged with identified parameters."""

from __future__ import annotations

from pathlib import Path

from tests.effort import thorough
from tests.reproduction.judged import column, made, verdicts


@thorough  # the campaign of tests/benchmarks/test_believed_figures.py records and judges points in the suite
def test_point_d(tmp_path: Path) -> None:
    found = made("4.13", tmp_path)
    assert set(verdicts(found).values()) == {"holds"}
    assert list((found.folder / "recordings" / "point").glob("*.mcap"))
    quantities = list(column(found, "steady", "quantity"))
    theta3 = quantities.index("theta3_deg")
    assert abs(column(found, "steady", "measured")[theta3] - 304.0) < 0.5
    assert 0 < column(found, "steady", "measured_std")[theta3] < 0.5

"""Chapter 4's maps: verdicts, and numbers known from elsewhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynamics import balanced_angles
from dynamics.equations.parameters import RotorParameters
from dynamics.stability.borders import Borders, stability_borders
from dynamics.stability.map_plane import SpeedStiffnessPlane
from reproduction.items import damping_families, floquet_maps
from tests.effort import thorough
from tests.reproduction.judged import column, made, verdicts


def test_the_coarse_map_by_the_source_s_schemes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(floquet_maps, "_COARSE", (21, 9))
    found = made("4.1", tmp_path)
    verdict_of = verdicts(found)
    assert verdict_of["Piecewise scheme and single pass give alike maps."] == "holds"
    assert verdict_of["The piecewise scheme needs much less processor time."] == "holds"
    assert verdict_of["There are two stable areas with an unstable zone between them."] == "holds"
    assert np.max(np.abs(column(found, "map", "multiplier") - column(found, "map", "multiplier_single_pass"))) < 1e-8


def test_borders_and_points(tmp_path: Path) -> None:
    found = made("4.2", tmp_path)
    texts = {claim["statement"]: claim["computed"] for claim in found.claims}
    assert (
        "A 1.361992; B 0.937055; C 0.974796; D 1.373347; E 0.978556"
        in texts["A and D are unstable, B, C and E are stable."]
    )
    assert verdicts(found)["Above the second resonance Type I is stable."] == "holds in part"
    assert sum(verdict == "holds" for verdict in verdicts(found).values()) == 3


def test_multipliers_along_the_line(tmp_path: Path) -> None:
    verdict_of = verdicts(made("4.3", tmp_path))
    assert verdict_of["The largest multipliers are a complex conjugate pair."] == "does not hold"
    views = made("4.4", tmp_path)
    assert set(verdicts(views).values()) == {"holds"}
    parts = [[column(views, "multipliers", f"{part}_{i}") for i in range(1, 9)] for part in ("real", "imaginary")]
    largest = np.max(np.hypot(*np.array(parts)), axis=0)
    at = np.interp([0.83, 5.8], column(views, "multipliers", "speed_ratio"), largest)
    assert at == pytest.approx([1.361992, 0.978556], abs=2e-3)


@thorough
def test_families(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def coarse(p: RotorParameters) -> Borders:
        plane = SpeedStiffnessPlane(p, balanced_angles(p)[0])
        return stability_borders(plane, (0.3, 7.0), (1.0, 16.0), first=(24, 18), levels=0, spacing=1 / 50)

    monkeypatch.setattr(damping_families, "borders_of_plane", coarse)
    monkeypatch.setattr(damping_families, "_WIDE_C34", (1e-5, 1.0, 5))
    zeta = made("4.5", tmp_path)
    assert set(verdicts(zeta).values()) == {"holds in part"}, "the best damping is beyond the facility's range"
    shares = column(zeta, "share", "stable_share")
    best = column(zeta, "share", "zeta")[np.argmax(shares)]
    assert best == pytest.approx(0.295, abs=0.03)
    assert shares[0] < 0.6
    c34 = made("4.6", tmp_path)
    assert set(verdicts(c34).values()) == {"holds in part"}, "it falls again where damping is very large"

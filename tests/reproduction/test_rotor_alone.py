"""Chapter 2: the closed form against numbers known otherwise, and verdicts that could be others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynamics import Pendulum
from dynamics.errors import OutsideDomain
from dynamics.motions.frequency_response import frequency_response, light_pendulum_torque
from tests.dynamics.nominal import rig
from tests.reproduction.judged import column, made, verdicts


def test_response_of_a_textbook_oscillator() -> None:
    p = replace(rig(zeta=0.1), a=Pendulum.absent(), b=Pendulum.absent())
    p = replace(p, k2_N_per_m=4 * p.k1_N_per_m)
    found = frequency_response(p, np.array([0.0, 1.0, 2.0, 1e4]))
    assert found.amplification[:, 0] == pytest.approx([0, 0])
    assert found.amplification[0, 1] == pytest.approx(1 / 0.2)
    assert found.amplification[1, 2] == pytest.approx(1 / 0.2), "along y the resonance is at Ω = 2"
    assert found.amplification[:, 3] == pytest.approx([1, 1], abs=1e-6)
    assert np.degrees(found.lag_rad[0]) == pytest.approx([0, 90, 180 - np.degrees(np.arctan(0.4 / 3)), 180], abs=0.01)


def test_response_refuses_what_has_none() -> None:
    undamped = replace(rig(zeta=0.0), k2_N_per_m=rig().k1_N_per_m)
    with pytest.raises(OutsideDomain, match="undamped resonance"):
        frequency_response(undamped, np.array([1.0]))
    with pytest.raises(OutsideDomain, match="not negative"):
        frequency_response(rig(), np.array([-1.0]))
    with pytest.raises(OutsideDomain, match="linear suspension"):
        frequency_response(replace(rig(), hardening_per_m2=(1.0, 0.0)), np.array([1.0]))


def test_a_light_pendulum_rests_where_the_disk_points() -> None:
    lag = 0.7
    torque = light_pendulum_torque(lag, np.array([-lag - 0.1, -lag, -lag + 0.1, np.pi - lag]))
    assert torque[0] > 0 > torque[2]
    assert torque[[1, 3]] == pytest.approx([0, 0], abs=1e-15)


def test_figure_2_2(tmp_path: Path) -> None:
    found = made("2.2", tmp_path)
    wrong = [statement for statement, verdict in verdicts(found).items() if verdict != "holds"]
    assert wrong == ["The lag is the arc tangent of ωc/(k − M ω²)."]
    assert column(found, "response", "amplification_zeta_0.1")[200] == pytest.approx(5.0), "Ω = 1"


def test_figure_2_3(tmp_path: Path) -> None:
    assert set(verdicts(made("2.3", tmp_path)).values()) == {"holds"}

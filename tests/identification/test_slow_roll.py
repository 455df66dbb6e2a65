"""Run-out and a bent shaft: found in a run-up, distinguished, named and kept; absent in records without them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from test_run_up_passages import Passage, assert_covers, ramp

from dynamics.equations.speed_history import SpeedHistory
from identification import RunUpFit
from identification.run_up.forced_oscillator import Excitation, responses_at
from identification.run_up.slow_roll import bow_answer, turning
from identification.run_up.slow_roll_vector import slow_roll_of, slow_roll_of_all
from rig_configs import IdentifiedParameters
from rig_configs.errors import ParametersFileError
from rig_configs.slow_roll import SlowRoll


@dataclass
class Crooked(Passage):
    """A passage of a rotor whose target is not round and whose shaft is bent; complex, m."""

    run_out_m: tuple[complex, complex] = (0j, 0j)
    bow_m: complex = 0j

    def __post_init__(self) -> None:
        super().__post_init__()
        turn = np.exp(1j * self.phase)
        step = 1 / self.rate_Hz
        # from rest on its springs: their pull is ω² (b e^{iψ} − q), so that q begins at b
        middle = self.speed(self.time[:-1, None] + 0.5 * step * (np.polynomial.legendre.leggauss(5)[0] + 1))[0]
        begin = turn[0]
        drives = [(2 * np.pi * f) ** 2 * (np.exp(1j * middle) - begin) for f in self.f_Hz]
        h = [begin + self._response(d, f, z) for d, f, z in zip(drives, self.f_Hz, self.zeta, strict=True)]
        x, y = (self.bow_m * h[0]).real, (self.bow_m * h[1]).imag
        c, s = np.cos(np.radians(self.angle_deg)), np.sin(np.radians(self.angle_deg))
        seen = np.column_stack([c * x + s * y, c * y - s * x])
        self.signal = (
            self.signal + seen + np.column_stack([(self.run_out_m[0] * turn).real, (self.run_out_m[1] * turn).imag])
        )

    def fit(self, **options: object) -> RunUpFit:
        return super().fit(**options)


def vector(fit: RunUpFit, stem: str) -> tuple[complex, float]:
    """Value and standard deviation of the size."""
    angle = np.exp(1j * np.radians(fit.values[f"{stem}_deg"]))
    return fit.values[f"{stem}_m"] * angle, fit.std[f"{stem}_m"]


def assert_vector(fit: RunUpFit, stem: str, truth: complex, sharp_m: float = 2e-6) -> None:
    found, std = vector(fit, stem)
    assert abs(found - truth) < 5 * std, (found, truth, std)
    assert std < sharp_m


PASSAGE = ramp(0.3, 7.0, 25.0)


def test_the_answer_to_a_bow_obeys_its_equation() -> None:
    time = np.arange(0.0, 12.0, 1e-3)
    history = SpeedHistory.from_phases(time, ramp(0.5, 6.0, 12.0)(time)[0])
    drive = Excitation.from_history(history, 0.0, 11.9)
    at = np.arange(1.0, 11.0, 1e-3)
    omega, zeta = 2 * np.pi * 3.0, 0.05
    seen = responses_at(at, np.zeros(len(at)), drive, [(omega, zeta)])[0]
    turn = turning(drive, at, np.zeros(len(at)))
    found = bow_answer(seen, turn, omega, zeta)
    rate, bend = np.gradient(found.h, at), np.gradient(found.rate, at)
    left = bend + 2 * zeta * omega * found.rate + omega**2 * (found.h - turn.phasor)
    inside = slice(10, -10)
    assert np.max(np.abs(rate - found.rate)[inside]) < 3e-3 * np.max(np.abs(found.rate))
    assert np.max(np.abs(left)[inside]) < 3e-3 * omega**2 * np.max(np.abs(found.h))
    step = 1e-5
    for name, other in (("by_omega", (omega * np.exp(step), zeta)), ("by_zeta", (omega, zeta * np.exp(step)))):
        moved = bow_answer(responses_at(at, np.zeros(len(at)), drive, [other])[0], turn, *other).h
        slope = getattr(found, name)
        assert np.max(np.abs((moved - found.h) / step - slope)[inside]) < 2e-3 * np.max(np.abs(slope))


def test_run_out_is_found_and_named() -> None:
    truth = (80e-6 * np.exp(0.5j), 60e-6 * np.exp(-1.0j))
    passage = Crooked(PASSAGE, 25.0, run_out_m=truth)
    fit = passage.fit()
    assert_covers(passage, fit)
    assert_vector(fit, "run_out_x", truth[0])
    assert_vector(fit, "run_out_y", truth[1])
    assert "bow_x_m" not in fit.values
    assert [w for w in fit.warnings if w.startswith("run-out: the sensors show ")] == fit.warnings
    assert fit.model.endswith("run-out")
    assert {row.name: row.chosen for row in fit.model_table if row.name in ("run-out", "bow", "run-out and bow")} == {
        "run-out": True,
        "bow": False,
        "run-out and bow": False,
    }


def test_a_bow_is_found_and_distinguished_from_run_out() -> None:
    truth = 90e-6 * np.exp(2.0j)
    passage = Crooked(PASSAGE, 25.0, bow_m=truth)
    fit = passage.fit()
    assert_covers(passage, fit)
    assert_vector(fit, "bow_x", truth)
    assert_vector(fit, "bow_y", truth)
    assert "run_out_x_m" not in fit.values
    assert [w for w in fit.warnings if w.startswith("bow: the springs' rest position")] == fit.warnings


def test_both_at_once() -> None:
    run_out, bow = (40e-6j, 40e-6j), 70e-6 + 0j
    passage = Crooked(PASSAGE, 25.0, bow_m=bow, run_out_m=run_out)
    fit = passage.fit()
    assert_covers(passage, fit)
    assert_vector(fit, "bow_x", bow, 15e-6)  # a bow differs from imbalance and run-out within the resonance alone
    assert_vector(fit, "run_out_y", run_out[1], 15e-6)


@pytest.mark.parametrize(("run_out", "bow"), [(6e-6 + 0j, 0j), (0j, 6e-6 + 0j)])
def test_where_they_are_not_distinguished_the_interval_covers_either(run_out: complex, bow: complex) -> None:
    quick = ramp(0.3, 7.0, 15.0)
    passage = Crooked(quick, 15.0, run_out_m=(run_out, run_out), bow_m=bow)
    fit = passage.fit()
    assert_covers(passage, fit)
    assert any("hardly distinguishes" in w for w in fit.warnings)
    assert 0.5e-6 < fit.std["amplitude_x_m"] < 4e-6  # half the difference of both, 3 µm


def test_a_straight_round_rotor_has_neither() -> None:
    for seed in range(5):
        fit = Crooked(PASSAGE, 25.0, seed=seed).fit()
        assert not [name for name in fit.values if name.startswith(("run_out", "bow"))]
        assert fit.warnings == []
        assert {"run-out", "bow", "run-out and bow"} <= {row.name for row in fit.model_table}


def test_a_bow_of_both_sensors_is_one_vector() -> None:
    passage = Crooked(PASSAGE, 25.0, bow_m=50e-6 + 0j)
    roll = slow_roll_of(passage.fit(), "there/run-up.mcap", "abc")
    assert roll is not None
    std = np.sqrt(np.diag(roll.covariance))
    assert abs(roll.bow_m - 50e-6) < 4 * float(np.hypot(*std[4:]))
    assert roll.run_out_x_m == roll.run_out_y_m == 0
    assert (roll.log, roll.digest) == ("run-up.mcap", "abc")


def _roll(values: list[float], spread: list[float]) -> SlowRoll:
    x, y, bow = (complex(a, b) for a, b in np.reshape(values, (3, 2)))
    mix = np.diag(spread) @ (np.eye(6) + 0.1 * np.ones((6, 6)))
    return SlowRoll(x, y, bow, mix @ mix.T, (0.4, 0.6), "a.mcap", "d1")


numbers = st.lists(st.floats(-1e-3, 1e-3, allow_subnormal=False), min_size=6, max_size=6)
spreads = st.lists(st.floats(1e-9, 1e-5), min_size=6, max_size=6)


@settings(max_examples=25, deadline=None)
@given(numbers, spreads)
def test_the_file_gives_back_what_was_written(
    tmp_path_factory: pytest.TempPathFactory, v: list[float], s: list[float]
) -> None:
    path: Path = tmp_path_factory.mktemp("file") / "parameters.toml"
    IdentifiedParameters({"k1_N_per_m": 1000.0}, np.eye(1), slow_roll=_roll(v, s)).save(path)
    found = IdentifiedParameters.load(path).slow_roll
    assert found is not None
    assert found.values.tolist() == _roll(v, s).values.tolist()
    assert np.array_equal(found.covariance, _roll(v, s).covariance)
    assert (found.bow_shares, found.log, found.digest) == ((0.4, 0.6), "a.mcap", "d1")


@settings(max_examples=25, deadline=None)
@given(numbers, spreads)
def test_independent_errors_make_up_the_covariance(v: list[float], s: list[float]) -> None:
    roll = _roll(v, s)
    total = sum(np.outer(shift, shift) for shift in roll.shifts.values())
    assert total == pytest.approx(roll.covariance, rel=1e-6, abs=1e-9 * float(np.max(roll.covariance)))


@pytest.mark.parametrize("damage", ["covariance = [[1.0]]", '[slow_roll.bow]\nreal_m = "a"'])
def test_a_damaged_table_is_refused(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "parameters.toml"
    IdentifiedParameters({"k1_N_per_m": 1000.0}, np.eye(1)).save(path)
    path.write_text(path.read_text() + f"\n[slow_roll]\n{damage}\n")
    with pytest.raises(ParametersFileError, match="parameters"):
        IdentifiedParameters.load(path)


def test_two_run_ups_that_differ_are_reported() -> None:
    one, other = _roll([8e-5, 0, 0, 5e-5, 0, 0], [1e-7] * 6), _roll([2e-5, 0, 0, 5e-5, 0, 0], [2e-7] * 6)
    best, warnings = slow_roll_of_all([other, one])
    assert best is one
    assert len(warnings) == 1
    assert "different run-out" in warnings[0]
    assert slow_roll_of_all([one, one]) == (one, [])

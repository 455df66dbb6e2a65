"""Numbers of scores, agreement and verdicts by formulas of their own: limits, signs, degrees of freedom, sentences."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError, dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2, norm

from analysis import validation
from analysis.agreement import (
    CAUSES_LEVEL,
    Agreement,
    CauseStatistics,
    Statistic,
    agreement,
    cause_statistics,
    evidence,
    limits_by_chance,
)
from analysis.causes import Cause
from analysis.differences import Differences
from analysis.errors import NoStableState, NotEnoughData
from analysis.overall import Overall, _as_kept, _Case, overall
from analysis.prediction import AXIS_ANGLE
from analysis.results import PointResult
from analysis.scores import DISPLAYED, Score, balanced_z, finite, scores_of, sentence
from analysis.steady_state import Interval
from analysis.validation import Validation, _asked_rpm, _compare, _held, _is_test, _judge, validate, validate_point
from dynamics.errors import DynamicsError
from rig_configs import IdentifiedParameters, Rig, load_rig
from rig_configs.error_label import ErrorLabel
from rig_configs.known import CONTACT_FRICTION, DRAG, FRICTION
from rig_configs.slow_roll import SlowRoll

DEGREE = math.pi / 180
GAIN_X = ErrorLabel("gain", "x")


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig("virtual", settings=["validation.model_std_deg=0.5", "validation.model_std_mm=0.02"])


# scores


def test_z_of_noise_has_the_probability_of_chi2_with_two_degrees_per_amplitude() -> None:
    for size in (0.3, 1.0, 3.0, 6.0):
        one, two = chi2.sf(size**2 / 4.0, 2), chi2.sf(size**2 / 4.0 + 9.0, 4)
        assert balanced_z([size], [2.0]) == pytest.approx(norm.isf(one / 2), rel=1e-9)
        assert balanced_z([size, 1.5], [2.0, 0.5]) == pytest.approx(norm.isf(two / 2), rel=1e-9)


def test_a_difference_in_json_has_the_interval_of_the_models_error() -> None:
    score = Score(2.0, 1.5, 0.01, 1.2, 0.02, error=0.3, u_numerical=0.001, u_validation=0.15)
    found = score.to_json(DISPLAYED["theta3"])
    assert found == {
        "statistic": "difference",
        "measured_deg": pytest.approx(1.5 / DEGREE),
        "measured_std_deg": pytest.approx(0.01 / DEGREE),
        "predicted_deg": pytest.approx(1.2 / DEGREE),
        "predicted_std_deg": pytest.approx(0.02 / DEGREE),
        "error_deg": pytest.approx(0.3 / DEGREE),
        "u_numerical_deg": pytest.approx(0.001 / DEGREE),
        "u_validation_deg": pytest.approx(0.15 / DEGREE),
        "model_error_low_deg": pytest.approx((0.3 - 1.96 * 0.15) / DEGREE),
        "model_error_high_deg": pytest.approx((0.3 + 1.96 * 0.15) / DEGREE),
        "z": 2.0,
    }
    unknown = replace(score, u_validation=math.nan, z=math.inf).to_json(DISPLAYED["amplitude_x"])
    assert set(unknown) == {
        "statistic",
        "measured_mm",
        "measured_std_mm",
        "predicted_mm",
        "predicted_std_mm",
        "z",
    }
    assert unknown["z"] is None
    assert unknown["measured_mm"] == pytest.approx(1500.0)


def test_noise_in_json_has_two_degrees_of_freedom_per_deviation() -> None:
    noise = Score(1.0, 3e-6, 1e-6, 0.0, 0.0, (2e-6, 4e-6), 5.0, 0.3, 3e-6, u_validation=1.0)
    assert noise.to_json(DISPLAYED["amplitude"]) == {
        "statistic": "noise",
        "measured_mm": pytest.approx(3e-3),
        "measured_std_mm": pytest.approx(1e-3),
        "predicted_mm": 0.0,
        "predicted_std_mm": 0.0,
        "noise_mm": pytest.approx([2e-3, 4e-3]),
        "chi2": 5.0,
        "dof": 4,
        "p": 0.3,
        "z": 1.0,
    }
    assert (finite(math.nan), finite(-math.inf), finite(2)) == (None, None, 2.0)


def test_sentences_round_to_the_smaller_uncertainty() -> None:
    angle = Score(5.2, 100.0 * DEGREE, 0.02 * DEGREE, 99.5 * DEGREE, 0.3 * DEGREE)
    assert sentence("theta3", angle) == "θ3 100.000 ± 0.020° measured against 99.500 ± 0.300° predicted, z = 5.2"
    coarse = replace(angle, measured_std=3 * DEGREE, predicted_std=0.0)
    assert sentence("theta4", coarse) == "θ4 100.00 ± 3.00° measured against 99.50 ± 0.00° predicted, z = 5.2"
    fine = Score(-4.5, 1.25e-3, 3e-9, 1.2e-3, 1e-9)
    assert sentence("amplitude_x", fine) == (
        "x amplitude 1.250000 ± 0.000003 mm measured against 1.200000 ± 0.000001 mm predicted, z = -4.5"
    )
    noise = Score(6.14, 3.2e-6, 1e-6, 0.0, 0.0, (1.24e-6, 0.5e-6), 41.26, 1e-8)
    assert sentence("amplitude", replace(noise, measured=0.02)).startswith("rms amplitude 20000.00 µm measured where")
    assert sentence("amplitude", noise) == (
        "rms amplitude 3.20 µm measured where none is predicted, noise of 1.2 and 0.5 µm alone gives χ² = 41.3 on 4, "
        "z = 6.1"
    )


OWN = np.diag([1e-6, 4e-6, 1e-14, 4e-14, 9e-14])


def measurement(**changes: Any) -> Any:
    found = {
        "theta_rad": (Interval(0.01, 2e-3), Interval(3.0, 3e-3)),
        "amplitude_x_m": Interval(4e-4, 5e-6),
        "amplitude_y_m": Interval(3e-4, 6e-6),
        "amplitude_m": Interval(3.6e-4, 7e-6),
        "own": OWN,
        "x_m": 3e-6 + 4e-6j,
        "y_m": 12e-6j,
        "noise_x_m": 3e-6,
        "noise_y_m": 8e-6,
        "state": "II",
        "locked": True,
        "locked_rad": np.array([0.2, 3.0]),
        "creeps": False,
        "settling": SimpleNamespace(why="the reason", remaining_rad=0.02),
        "to_come": SimpleNamespace(sentence=""),
        "speed_rad_s": Interval(60.0, 0.1),
        "remarks": (),
    }
    return SimpleNamespace(**(found | changes))


def prediction(**changes: Any) -> Any:
    found = {
        "values": np.array([2 * math.pi - 0.02, 3.01, 3.9e-4, 3.1e-4, 3.5e-4]),
        "std": np.array([1e-3, 2e-3, 3e-6, 4e-6, 5e-6]),
        "covariance": np.diag([1e-6, 4e-6, 9e-12, 16e-12, 25e-12]),
        "numerical": np.array([1e-4, 2e-4, 1e-7, 2e-7, 3e-7]),
        "shared": {},
        "at_rest": False,
        "held": None,
        "state": SimpleNamespace(type="II"),
        "speed_rad_s": 60.0,
    }
    return SimpleNamespace(**(found | changes))


def test_scores_are_differences_over_all_independent_uncertainties(rig: Rig) -> None:
    found = scores_of(measurement(), prediction(), rig)
    assert list(found) == ["theta3", "theta4", "amplitude_x", "amplitude_y", "amplitude"]
    gain_x, gain_y = rig.roles.gain_stds
    zero, angle, size = rig.roles.zero_std_deg * DEGREE, 0.5 * DEGREE, 2e-5
    variances = [
        1e-6 + 1e-6 + 1e-8 + angle**2 + zero**2,
        4e-6 + 4e-6 + 4e-8 + angle**2 + zero**2,
        1e-14 + 9e-12 + 1e-14 + size**2 + (gain_x * 4e-4) ** 2,
        4e-14 + 16e-12 + 4e-14 + size**2 + (gain_y * 3e-4) ** 2,
        9e-14 + 25e-12 + 9e-14 + size**2 + ((gain_x * 16e-8) ** 2 + (gain_y * 9e-8) ** 2) / (2 * 3.6e-4) ** 2,
    ]
    errors = [0.03, -0.01, 1e-5, -1e-5, 1e-5]
    for score, variance, error in zip(found.values(), variances, errors, strict=True):
        assert score.error == pytest.approx(error)
        assert score.u_validation == pytest.approx(math.sqrt(variance))
        assert score.z == pytest.approx(error / math.sqrt(variance))
        assert score.noise == ()
    assert (found["theta4"].measured, found["theta4"].measured_std) == (3.0, 3e-3)
    assert (found["amplitude_y"].predicted, found["amplitude_y"].predicted_std) == (3.1e-4, 4e-6)
    assert [score.u_numerical for score in found.values()] == pytest.approx([1e-4, 2e-4, 1e-7, 2e-7, 3e-7])
    back = scores_of(
        measurement(theta_rad=(Interval(2 * math.pi - 0.02, 0), Interval(3.01, 0))),
        prediction(values=np.array([0.01, 3.0, 3.9e-4, 3.1e-4, 3.5e-4])),
        rig,
    )
    assert [back["theta3"].error, back["theta4"].error] == pytest.approx([-0.03, 0.01])


def test_an_error_of_both_sides_counts_with_its_difference(rig: Rig) -> None:
    """The gain of x through S_P moves the prediction as much as the measurement: nothing of it is left."""
    gain_x = rig.roles.gain_stds[0]
    alone = scores_of(measurement(), prediction(), rig)["amplitude_x"].u_validation ** 2
    shift = np.array([0.0, 0.0, gain_x * 4e-4, 0.0, 0.0])
    covariance = prediction().covariance + np.outer(shift, shift)
    same = scores_of(measurement(), prediction(shared={GAIN_X: shift}, covariance=covariance), rig)["amplitude_x"]
    assert same.u_validation**2 == pytest.approx(alone - (gain_x * 4e-4) ** 2)
    other = scores_of(measurement(), prediction(shared={GAIN_X: -shift}, covariance=covariance), rig)["amplitude_x"]
    assert other.u_validation**2 == pytest.approx(alone + 3 * (gain_x * 4e-4) ** 2)
    only = scores_of(measurement(), prediction(shared={AXIS_ANGLE: shift}, covariance=covariance), rig)["amplitude_x"]
    assert only.u_validation**2 == pytest.approx(alone + (gain_x * 4e-4) ** 2)


def test_amplitudes_at_rest_are_compared_with_noise(rig: Rig) -> None:
    found = scores_of(measurement(), prediction(at_rest=True), rig)
    x, y, both = (found[name] for name in ("amplitude_x", "amplitude_y", "amplitude"))
    assert (x.noise, y.noise, both.noise) == ((3e-6,), (8e-6,), (3e-6, 8e-6))
    assert [x.chi2, y.chi2, both.chi2] == pytest.approx([25 / 9, 144 / 64, 25 / 9 + 144 / 64])
    assert x.p == pytest.approx(chi2.sf(25 / 9, 2))
    assert both.p == pytest.approx(chi2.sf(25 / 9 + 144 / 64, 4))
    assert both.z == pytest.approx(norm.isf(both.p / 2))
    assert [x.measured, y.measured, both.measured] == pytest.approx([5e-6, 12e-6, 3.6e-4])
    assert [x.measured_std, y.measured_std, both.measured_std] == pytest.approx([3e-6, 8e-6, math.hypot(3e-6, 8e-6)])
    assert [x.predicted, y.predicted_std, both.error] == pytest.approx([0.0, 0.0, 3.6e-4])
    assert found["theta3"].noise == ()
    held = SimpleNamespace(whirl_variance_m2=np.array([16e-12, 36e-12]))
    rubbing = scores_of(measurement(), prediction(at_rest=True, held=held), rig)
    assert rubbing["amplitude"].noise == pytest.approx((5e-6, 10e-6))


# agreement


def test_p_of_rows_is_that_of_chi2() -> None:
    rows = rows_of([1.0, -2.0, 3.0])
    found = Statistic.of(rows)
    assert (found.chi2, found.dof) == (pytest.approx(14.0), 3)
    assert found.p == pytest.approx(chi2.sf(14.0, 3))
    assert found.to_json() == {"chi2": found.chi2, "dof": 3, "p": found.p}
    none = Statistic.of(rows.of([]))
    assert math.isnan(none.p)
    assert none.to_json() == {"chi2": 0.0, "dof": 0, "p": None}


def rows_of(values: list[float], points: tuple[str, ...] = (), std: float = 1.0) -> Differences:
    n = len(values)
    rows = tuple((points[i] if points else "A", f"row {i}") for i in range(n))
    none = np.empty((n, 0))
    return Differences(rows, np.array(values), std**2 * np.eye(n), none, (), np.empty((0, 0)), none, {}, {})


def cause(name: str, direction: list[float], std: float = 1.0, one_sided: bool = False) -> Cause:
    return Cause(name, f"the {name}", 1.0, std, np.array(direction), "", 1.0, "", one_sided)


def made(together_p: float, points: dict[str, float], z: dict[str, float]) -> Agreement:
    return Agreement(
        Statistic(20.0, 10, together_p),
        {name: Statistic(9.0, 4, p) for name, p in points.items()},
        1e-3,
        z,
        {name: f"the {name}" for name in z},
        dict.fromkeys(z, 3.0),
    )


def test_each_question_has_its_own_limit() -> None:
    good = made(0.0051, {"A": 1.1e-3}, {"mass": 2.9, "zero": -2.9})
    assert good.passed
    assert good.why == "all points together agree with the model: χ² 20 on 10, p = 0.0051"
    assert (good.failing_points, good.significant_causes) == ((), ())
    together = made(0.0049, {"A": 0.5}, {})
    assert not together.passed
    assert together.why == "all points together differ from the model: χ² 20 on 10, p = 0.0049"
    assert made(0.5, {"A": 1e-3}, {}).failing_points == ()  # at the limit
    point = made(0.5, {"A": 0.5, "B": 0.9e-3, "C release": 1e-9}, {})
    assert (point.passed, point.failing_points) == (False, ("B", "C release"))
    assert point.why == "point B, C release differs: χ² 20 on 10, p = 0.5"
    caused = made(0.5, {}, {"mass": 3.1, "zero": -3.5, "gain": 2.0})
    assert (caused.passed, caused.significant_causes) == (False, ("zero", "mass"))
    assert caused.why == "a single cause would explain more than chance does: the zero: χ² 20 on 10, p = 0.5"
    every = made(0.001, {"A": 0.0}, {"mass": 4.0})
    assert every.why == (
        "all points together differ from the model; point A differs; a single cause would explain more than chance "
        "does: the mass: χ² 20 on 10, p = 0.001"
    )
    assert every.to_json() == {
        "passed": False,
        "why": every.why,
        "chi2": 20.0,
        "dof": 10,
        "p": 0.001,
        "points": {"A": {"chi2": 9.0, "dof": 4, "p": 0.0}},
        "point_limit_p": 1e-3,
        "cause_z": {"mass": 4.0},
        "cause_limits_z": {"mass": 3.0},
    }


def test_significance_is_ranked_by_the_excess_of_the_square() -> None:
    found = replace(made(0.5, {}, {"a": 5.0, "b": 4.0}), cause_limits={"a": 4.5, "b": 2.0})
    assert found.significant_causes == ("b", "a")  # 12 against 4.75


def test_points_share_their_level_equally() -> None:
    four = rows_of([0.0] * 8, ("A", "A", "B", "B", "C", "C", "D", "D"))
    found = agreement(four, ())
    assert found.point_limit == pytest.approx(0.005 / 4)
    assert {name: each.dof for name, each in found.points.items()} == {"A": 2, "B": 2, "C": 2, "D": 2}
    assert (found.together.dof, found.cause_z, found.cause_limits) == (8, {}, {})
    assert agreement(rows_of([]), ()).point_limit == 0.005


def test_size_of_a_cause_over_its_deviation() -> None:
    """Rows with deviation 0.5: a cause of direction (3, 4) is known to 0.5/5, and (1, 0) to 0.5."""
    rows = rows_of([3.0, 4.0], std=0.5)
    directions = {
        "both": np.array([3.0, 4.0]),
        "none": np.zeros(2),
        "one": np.array([-1.0, 0.0]),
        "bad": np.array([np.nan, 1.0]),
    }
    found = cause_statistics(rows, directions)
    assert found.stds == pytest.approx({"both": 0.1, "one": 0.5})
    assert found.z == pytest.approx({"both": 10.0, "one": -6.0})
    assert found.correlation == pytest.approx(np.array([[1.0, -0.6], [-0.6, 1.0]]))
    empty = cause_statistics(rows, {})
    assert (empty.z, empty.correlation.shape) == ({}, (0, 0))


def test_limits_of_causes_are_those_of_their_widths() -> None:
    """A width is the standard uncertainty of the cause over that by the points."""
    rows = rows_of([0.3, -4.0, 0.0])
    found = agreement(rows, (cause("sure", [1.0, 0.0, 0.0], 0.8), cause("open", [0.0, 2.0, 0.0], 5e3)))
    expected = limits_by_chance(np.eye(2), [0.8, 1e4])
    assert list(found.cause_limits.values()) == pytest.approx(expected.tolist())
    assert found.cause_z == pytest.approx({"sure": 0.3, "open": -4.0})
    assert found.words == {"sure": "the sure", "open": "the open"}
    assert found.cause_limits["open"] > found.cause_limits["sure"] + 0.5
    one = agreement(rows, (cause("friction", [0.0, 1.0, 0.0], 1.0, one_sided=True),))
    assert one.cause_z == {"friction": 0.0}
    assert one.cause_limits["friction"] == pytest.approx(norm.isf(CAUSES_LEVEL), abs=0.04)


def test_a_single_two_sided_cause_has_the_limit_of_a_normal_variable() -> None:
    for level in (0.04, 0.2):
        assert limits_by_chance(np.eye(1), [1.0], level=level) == pytest.approx([norm.isf(level / 2)], abs=0.04)
    assert limits_by_chance(np.eye(1), [1.0]) == pytest.approx([norm.isf(0.02)], abs=0.03)
    assert limits_by_chance(np.empty((0, 0)), []).shape == (0,)
    assert limits_by_chance(np.eye(1), [1.0], (True,), level=0.2) == pytest.approx([norm.isf(0.2)], abs=0.04)


def test_equally_large_limits_have_equal_evidence() -> None:
    limits = limits_by_chance(np.eye(3), [0.5, 10.0, 1e4])
    at = [float(evidence(z, width)) for z, width in zip(limits, (0.5, 10.0, 1e4), strict=True)]
    assert at[1] == pytest.approx(at[0], abs=0.02)
    assert at[2] == pytest.approx(at[0], abs=0.02)


# a cause tried


@dataclass(frozen=True)
class Made:
    """Rows of a release, made up."""

    point: str = "A"
    rows: tuple[str, ...] = ("release 1", "release 2")
    values: np.ndarray = field(default_factory=lambda: np.array([1.0, 2.0]))
    own: np.ndarray = field(default_factory=lambda: np.eye(2))
    by_parameter: np.ndarray = field(default_factory=lambda: np.array([[1.0, 0.0], [0.0, 3.0]]))
    parameters: tuple[str, ...] = ("k1_N_per_m", "c3_Nms_per_rad")
    by_number: dict[str, np.ndarray] = field(
        default_factory=lambda: {
            "rotor.mass_kg": np.array([10.0, 20.0]),
            FRICTION[0]: np.array([5.0, 0.0]),
            FRICTION[1]: np.array([0.0, 7.0]),
        }
    )
    shared: dict[str, np.ndarray] = field(default_factory=dict)
    by_slow_roll: dict[str, np.ndarray] = field(
        default_factory=lambda: {
            "run-out along": np.array([1e3, 0.0]),
            "run-out across": np.array([0.0, 2e3]),
            "bow along": np.array([3e3, 0.0]),
            "bow across": np.array([0.0, 4e3]),
        }
    )
    used_for: tuple[str, ...] = ()
    remark: str = ""
    reading: str = ""


def identified(**changes: Any) -> IdentifiedParameters:
    values = {"k1_N_per_m": 2600.0, "c3_Nms_per_rad": 1e-3}
    slopes = {"rotor.mass_kg": np.array([370.0, 2e-4])}
    return replace(IdentifiedParameters(values, np.diag([1.0, 1e-10]), by_number=slopes), **changes)


@pytest.fixture
def case(rig: Rig) -> _Case:
    found = overall((), rig, identified(), None, (Made(),))
    assert found is not None
    return found._case


def test_a_parameter_at_another_value_moves_the_rows(case: _Case) -> None:
    assert case.differences.values == pytest.approx([1.0, 2.0])
    moved = case.again("k1_N_per_m", 2604.0)
    assert moved is not None
    assert moved.values == pytest.approx([5.0, 2.0])
    less = case.again("c3_Nms_per_rad", 0.9e-3)
    assert less is not None
    assert less.values == pytest.approx([1.0, 2.0 - 3e-4])


def test_friction_that_was_taken_as_zero_moves_the_rows(case: _Case) -> None:
    one = case.again(FRICTION[0], 0.1)
    both = case.again("friction.both_Nm", 0.1)
    assert one is not None
    assert both is not None
    assert one.values == pytest.approx([1.5, 2.0])
    assert both.values == pytest.approx([1.5, 2.7])


def test_a_number_moves_the_rows_directly_and_through_what_was_identified_with_it(case: _Case, rig: Rig) -> None:
    mass = rig.known.values["rotor.mass_kg"]
    moved = case.again("rotor.mass_kg", mass + 0.01)
    assert moved is not None
    assert moved.values == pytest.approx([1.0 + 0.1 + 3.7, 2.0 + 0.2 + 3 * 2e-6])
    without = replace(case, identified=identified(by_number={}))
    alone = without.again("rotor.mass_kg", mass + 0.01)
    assert alone is not None
    assert alone.values == pytest.approx([1.1, 2.2])
    assert case.again("gain x", 1.01) is None


def test_more_run_out_and_bow_move_the_rows(case: _Case) -> None:
    run_out = case.turned("run-out", 1e-3 + 2e-3j)
    bow = case.turned("bow", 1e-3 - 1e-3j)
    assert run_out is not None
    assert bow is not None
    assert run_out.values == pytest.approx([1.0 - 1.0, 2.0 - 4.0])
    assert bow.values == pytest.approx([1.0 - 3.0, 2.0 + 4.0])


def test_the_slow_roll_of_a_trial_is_added_to_the_identified_one(case: _Case, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[IdentifiedParameters] = []

    def predicted(each: str, rig: Rig, trial: IdentifiedParameters) -> str:
        seen.append(trial)
        raise NoStableState("none")

    roll = SlowRoll(1e-5 + 0j, 2e-5j, 3e-5 + 1e-5j, np.zeros((6, 6)))
    one = replace(case, compared=("A",), identified=identified(slow_roll=roll))
    monkeypatch.setattr(_Case, "_predicted", staticmethod(predicted))
    assert one.turned("run-out", 1e-6j) is None
    assert one.turned("bow", 2e-6) is None
    assert one.again("k1_N_per_m", 2700.0) is None
    assert one.again("friction.both_Nm", 1e-4) is None
    first, second, third, fourth = seen
    assert first.slow_roll is not None
    assert second.slow_roll is not None
    assert (first.slow_roll.run_out_x_m, first.slow_roll.run_out_y_m) == pytest.approx((1e-5 + 1e-6j, 2.1e-5j))
    assert first.slow_roll.bow_m == roll.bow_m
    assert second.slow_roll.bow_m == pytest.approx(3.2e-5 + 1e-5j)
    assert (second.slow_roll.run_out_x_m, second.slow_roll.run_out_y_m) == (roll.run_out_x_m, roll.run_out_y_m)
    assert third.values == {"k1_N_per_m": 2700.0, "c3_Nms_per_rad": 1e-3}
    assert fourth.provenance["friction"]["values"]["coulomb_b_Nm"] == 1e-4


def test_other_errors_of_a_trial_are_no_explanation(case: _Case, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(*_: Any) -> None:
        raise DynamicsError("none")

    monkeypatch.setattr(_Case, "_predicted", staticmethod(failing))
    one = replace(case, compared=("A",))
    assert one.again("k1_N_per_m", 2700.0) is None
    assert one.turned("bow", 1e-6) is None


def test_trial_torques_by_their_keys_in_a_file() -> None:
    friction = _as_kept({FRICTION[1]: 2e-4, CONTACT_FRICTION[0]: 3e-9})["friction"]
    assert friction["values"] == {
        "coulomb_a_Nm": 0.0,
        "coulomb_b_Nm": 2e-4,
        "contact_a_kg_m2": 3e-9,
        "contact_b_kg_m2": 0.0,
    }
    assert friction["covariance"] == np.zeros((4, 4)).tolist()
    assert set(_as_kept({FRICTION[0]: -1.0})["friction"]["values"].values()) == {0.0}
    drag = _as_kept({DRAG[0]: -1e-6, DRAG[1]: 2e-6})["drag"]
    assert list(drag["values"].values()) == [0.0, 2e-6]
    assert drag["covariance"] == np.zeros((2, 2)).tolist()
    assert list(_as_kept({DRAG[1]: 2e-6})["drag"]["values"].values()) == [0.0, 2e-6]


def test_without_rows_there_is_nothing_to_agree(rig: Rig) -> None:
    assert overall((), rig, identified()) is None
    nothing = Made(rows=(), values=np.empty(0), own=np.empty((0, 0)))
    assert overall((), rig, identified(), None, (nothing,)) is None
    found = overall((), rig, identified(), (2.0, 0.5), (Made(), nothing))
    assert found is not None
    assert found._case.identified.axis_angle_deg == (2.0, 0.5)
    assert len(found._case.releases) == 1
    assert found.explanations is None
    assert found.explain().chi2 == pytest.approx(found.agreement.together.chi2)
    far = overall((), rig, identified(), None, (Made(values=np.array([100.0, 200.0])),))
    assert far is not None
    assert far.explanations is not None
    assert not far.agreement.passed


# verdicts


def judged(measured: Any, predicted: Any, trouble: str = "", expected: str | None = "II", **scores: float) -> Any:
    table = {name: Score(z, 1.0, 0.1, 1.0, 0.1) for name, z in (scores or {"theta3": 1.0}).items()}
    return _judge(measured, predicted, trouble, expected, table)


def test_verdict_of_a_settled_state() -> None:
    verdict, why = judged(measurement(), prediction(), theta3=-3.9, amplitude_x=4.0)
    assert verdict == "pass"
    assert why == "state II, all within 4 standard deviations; largest: x amplitude, z = 4.0"
    verdict, why = judged(measurement(), prediction(), theta3=4.1, amplitude_x=-5.0, theta4=0.0)
    assert verdict == "fail"
    assert why.startswith("x amplitude ")
    assert "; θ3 " in why
    assert "θ4" not in why
    assert judged(measurement(), prediction(), theta3=math.nan)[0] == "fail"
    moved = measurement(to_come=SimpleNamespace(sentence="extrapolated"))
    assert judged(moved, prediction())[1].endswith("z = 1.0; extrapolated")
    creeping = measurement(creeps=True)
    words = "; dry friction holds and releases it repeatedly, so that it creeps, by up to 1.1° more"
    assert judged(creeping, prediction())[1].endswith(words)
    assert judged(moved, prediction(), theta3=9.0)[1].endswith("; extrapolated")


def test_verdict_of_another_state() -> None:
    other = prediction(state=SimpleNamespace(type="I"))
    assert judged(measurement(), other) == ("fail", "measured state II, but the model's stable state is I")
    assert judged(measurement(), prediction(), expected="I") == (
        "fail",
        "measured and model state II, but the rig file expects I",
    )
    assert judged(measurement(), prediction(), expected=None)[0] == "pass"
    assert judged(measurement(), None, "no stable state exists") == (
        "fail",
        "measured state II, but no stable state exists",
    )


def test_verdict_of_pendulums_that_slip_or_were_not_locked() -> None:
    slipping = measurement(state="slipping")
    assert judged(slipping, prediction(), expected="slipping") == ("pass", "slipping as expected: the reason")
    assert judged(slipping, prediction()) == ("fail", "the reason; the model has a stable state II here")
    assert judged(slipping, prediction(), expected=None)[0] == "fail"
    assert judged(slipping, None, "no stable state") == ("fail", "the reason; no stable state")
    loose = measurement(locked=False)
    words = "before release the pendulums stood at 11.5° and 171.9°, not locked at 0° and 180°"
    assert judged(loose, prediction()) == ("not locked", words)
    assert judged(measurement(state="slipping", locked=False), prediction(), expected="slipping")[0] == "not locked"
    assert judged(measurement(state="not settled", locked=False), prediction())[0] == "not locked"


def test_verdict_of_pendulums_that_move() -> None:
    moving = measurement(state="not settled")
    assert judged(moving, None) == ("not settled", "the reason")
    assert judged(moving, prediction()) == ("not settled", "the reason")
    band = SimpleNamespace(half_width_rad=np.array([0.0, 1e-3]))
    words = "the reason; the dry friction that was identified makes the approach a creep"
    assert judged(moving, prediction(held=band)) == ("not settled", words)
    none = SimpleNamespace(half_width_rad=np.zeros(2))
    late = (
        "the reason; the dry friction that was identified lets the pendulums leave their unstable balance late: "
        "record longer"
    )
    assert judged(moving, prediction(held=none)) == ("not settled", late)


def test_a_comparison_is_of_the_largest_absolute_score() -> None:
    table = {name: Score(z, 1.0, 0.1, 1.0, 0.1) for name, z in (("theta3", 1.0), ("theta4", -2.0))}
    from_a_file = "".join(("I", "I"))  # equal to the measured state, and another object
    for expected in (None, from_a_file):
        verdict, why = _compare(measurement(), prediction(), expected, table)
        assert verdict == "pass"
        assert why.endswith("largest: θ4, z = -2.0")


@dataclass(frozen=True)
class Held:
    """A measurement as `replace` needs it."""

    state: str
    theta_rad: tuple[Interval, Interval]
    own: int = 0


@pytest.mark.parametrize(
    ("off", "state", "expected"),
    [
        ((0.09, 0.0), "I", "II"),
        ((-0.09, 0.19), "I", "II"),
        ((0.11, 0.0), "I", "I"),
        ((0.0, -0.21), "I", "I"),
        ((2 * math.pi, 0.0), "I", "II"),
        ((0.09, 0.0), "slipping", "slipping"),
        ((0.09, 0.0), "not settled", "not settled"),
    ],
)
def test_pendulums_within_the_band_of_friction_have_the_state_of_the_model(
    off: tuple[float, float], state: str, expected: str, monkeypatch: pytest.MonkeyPatch, rig: Rig
) -> None:
    asked: list[tuple[complex, float]] = []

    def again(run: Any, rig: Rig, bow_m: complex, creep_rad: float) -> Held:
        asked.append((bow_m, creep_rad))
        return measured

    monkeypatch.setattr(validation, "measure", again)
    predicted = prediction(held=SimpleNamespace(half_width_rad=np.array([0.0, 0.05]), outer_rad=np.array([0.1, 0.2])))
    theta = [Interval(float(v) + o, 0.0) for v, o in zip(predicted.values[:2], off, strict=True)]
    measured = Held(state, (theta[0], theta[1]))
    own = identified(slow_roll=SlowRoll(0j, 0j, 2e-5j, np.zeros((6, 6))))
    assert _held(None, rig, own, measured, predicted).state == expected
    assert asked == ([(2e-5j, 0.2)] if state == "not settled" else [])
    free = prediction(held=SimpleNamespace(half_width_rad=np.zeros(2), outer_rad=np.array([0.1, 0.2])))
    assert _held(None, rig, own, measured, free) is measured


def point(name: str, verdict: str = "pass", z: float = 0.5, **changes: Any) -> PointResult:
    scores = {"theta3": Score(z, 1.0, 0.1, 1.0, 0.1)} if verdict in ("pass", "fail") else {}
    found = PointResult(name, "II", "II", measurement(), prediction(), scores, verdict, "why", f"logs/{name}.mcap")
    return replace(found, **changes)


def test_a_validation_passes_if_all_of_something_pass() -> None:
    agreed, apart = made(0.5, {}, {}), made(0.001, {}, {})
    series = SimpleNamespace(passed=True, to_json=dict)
    broken = SimpleNamespace(passed=False, to_json=dict)
    assert not Validation().passed
    assert Validation({"A": point("A")}).passed
    assert Validation({"A": point("A")}, agreed).passed
    assert not Validation({"A": point("A")}, apart).passed
    assert not Validation({"A": point("A"), "B": point("B", "not settled")}).passed
    assert Validation(start_ups=[series]).passed
    assert not Validation({"A": point("A")}, start_ups=[series, broken]).passed


def test_reasons_and_warnings_are_in_a_fixed_order() -> None:
    noisy = measurement(remarks=("hum", "wander"))
    points = {"A": point("A", because="a bow"), "B": point("B", measurement=noisy), "C": point("C", measurement=None)}
    found = Validation(points, of_releases=["release"], suspension=["spring"], reading="drag")
    assert found.reasons == ["A: a bow"]
    assert found.warnings[1:] == ["release", "spring", "B.mcap: hum", "B.mcap: wander"]
    assert found.warnings[0].endswith("is the drag of the air")
    assert Validation(points).warnings == ["B.mcap: hum", "B.mcap: wander"]
    assert replace(found, reading="contact").warnings[0].endswith("is dry friction with the contact force")


def test_validation_in_json_is_empty_without_points() -> None:
    assert Validation().to_json() == {
        "points": {},
        "agreement": None,
        "reasons": [],
        "explanations": None,
        "noticed": [],
        "start_ups": [],
        "filled": {},
    }


def test_speed_of_a_start_up_is_that_of_its_log() -> None:
    for text, speed in (("1500", 1500.0), (900.0, 900.0), ("fast", 0.0), (None, 0.0), ("nan", 0.0), ("inf", 0.0)):
        assert _asked_rpm(SimpleNamespace(metadata={"speed_rpm": text})) == speed
    assert _asked_rpm(SimpleNamespace(metadata={})) == 0.0


def test_rows_of_a_test_are_not_those_of_a_release() -> None:
    assert not _is_test(Made())
    assert not _is_test(Made(rows=()))
    assert _is_test(Made(rows=("run-up 1", "release 2")))


def log(test: str, start: float, **facts: Any) -> Any:
    return SimpleNamespace(test=test, start_s=start, source=f"{test}-{start:g}.mcap", metadata=facts, speed=None)


@pytest.fixture
def points(monkeypatch: pytest.MonkeyPatch) -> dict[str, PointResult]:
    """Results by source; `validate` uses them instead of the comparison."""
    results: dict[str, PointResult] = {}
    monkeypatch.setattr(
        validation,
        "validate_point",
        lambda run, *_: replace(results.get(run.test, point(run.test)), source=run.source),
    )
    monkeypatch.setattr(validation, "effects", lambda *_: "")
    return results


def overall_of(monkeypatch: pytest.MonkeyPatch, found: Any) -> list[tuple[Any, ...]]:
    asked: list[tuple[Any, ...]] = []

    def fake(*given: Any) -> Any:
        asked.append(given)
        return found

    monkeypatch.setattr(validation, "overall", fake)
    return asked


def test_runs_are_compared_in_the_order_of_points_and_times(
    rig: Rig, points: dict[str, PointResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = overall_of(monkeypatch, None)
    runs = [log("point-B", 1.0), log("point-A", 9.0), log("run-up", 0.0), log("point-A", 3.0), log("point-A", 5.0)]
    rows = [Made("A"), Made("B (2)"), Made("run-up", ("run-up 1",)), Made("A", remark="seen", reading="contact")]
    found = validate(runs, rig, identified(), None, rows)
    assert list(found.points) == ["A", "A (2)", "A (3)", "B"]
    assert [each.source for each in found.points.values()] == [
        "point-A-3.mcap",
        "point-A-5.mcap",
        "point-A-9.mcap",
        "point-B-1.mcap",
    ]
    ((compared, _, used, angle, releases),) = asked
    twice = [log("point-Low", 2.0), log("point-Low", 1.0), log("point-Lower", 0.0)]
    assert list(validate(twice, rig, identified()).points) == ["Low", "Low (2)", "Lower"]
    assert [each.name for each in compared] == ["A", "A (2)", "A (3)", "B"]
    assert angle is None
    assert releases == [rows[0], rows[2], rows[3]]
    assert len(used.values) > 2  # completed by the rig file
    assert (found.agreement, found.explanations, found.reading, found.of_releases) == (None, None, "contact", ["seen"])
    assert found.passed


def test_only_points_in_the_predicted_state_are_compared_together(
    rig: Rig, points: dict[str, PointResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = overall_of(monkeypatch, None)
    points["point-A"] = point("A", state="I")
    points["point-B"] = point("B", prediction=None)
    points["point-C"] = point("C", scores={})
    runs = [log(f"point-{name}", 0.0) for name in "ABCD"]
    validate(runs, rig, identified())
    assert [each.name for each in asked[0][0]] == ["D"]


def test_a_point_whose_quantities_together_deviate_fails(
    rig: Rig, points: dict[str, PointResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    explained = SimpleNamespace(to_json=dict)
    agreed = replace(
        made(0.5, {"A": 1e-5, "B release": 2e-6, "C": 1e-5, "D": 0.5, "run-up": 1e-9}, {}),
    )
    found = SimpleNamespace(agreement=agreed, explanations=None, noticed=(), explain=lambda: explained)
    overall_of(monkeypatch, found)
    points["point-C"] = point("C", "not settled")
    runs = [log(f"point-{name}", 0.0) for name in "ABCD"]
    result = validate(runs, rig, identified())
    assert {name: each.verdict for name, each in result.points.items()} == {
        "A": "fail",
        "B": "fail",
        "C": "not settled",
        "D": "pass",
    }
    assert result.points["A"].why == "its quantities together: χ² 9 on 4, p = 1e-05"
    assert result.points["B"].why == "what happened right after the release: χ² 9 on 4, p = 2e-06"
    assert result.explanations is explained  # something failed, so the causes are stated
    good = SimpleNamespace(agreement=made(0.5, {}, {}), explanations=None, noticed=(), explain=lambda: explained)
    overall_of(monkeypatch, good)
    assert validate(runs, rig, identified()).explanations is None
    points["point-A"] = point("A", "fail", scores={})  # another state has no differences
    assert validate(runs, rig, identified()).explanations is None


def test_effects_of_the_suspension_are_stated_by_point(
    rig: Rig, points: dict[str, PointResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    overall_of(monkeypatch, None)
    points["point-B"] = point("B", prediction=None)
    monkeypatch.setattr(validation, "effects", lambda _, state, speed: f"{state.type} at {speed:g}")
    found = validate([log("point-A", 0.0), log("point-B", 0.0)], rig, identified())
    assert list(found.suspension) == ["at A II at 60"]


def test_start_ups_are_grouped_by_their_requested_speed(
    rig: Rig, points: dict[str, PointResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    overall_of(monkeypatch, None)
    monkeypatch.setattr(validation, "locked_radius_m", lambda run: run.start_s)
    monkeypatch.setattr(validation, "start_ups", lambda *given: given)
    runs = [
        log("start-ups", 5.0, speed_rpm="900"),
        log("start-ups", 2.0, speed_rpm=1500),
        log("start-ups", 3.0, speed_rpm=900),
        log("start-ups", 1.0),
        log("run-up", 6.0),
        log("tap", 7.0),
    ]
    found = validate(runs, rig, identified())
    assert found.points == {}
    speeds, results, radii = zip(*found.start_ups, strict=True)
    assert speeds == (0.0, 900.0, 1500.0)
    assert [[each.source for each in some] for some in results] == [
        ["start-ups-1.mcap"],
        ["start-ups-3.mcap", "start-ups-5.mcap"],
        ["start-ups-2.mcap"],
    ]
    assert list(radii) == [[1.0], [3.0, 5.0], [2.0]]


@pytest.fixture
def measured_as(monkeypatch: pytest.MonkeyPatch) -> Any:
    """`validate_point` with a measurement and a prediction, either of which may be an error."""

    def given(measured: Any, predicted: Any) -> None:
        def answer(value: Any) -> Any:
            if isinstance(value, Exception):
                raise value
            return value

        monkeypatch.setattr(validation, "measure", lambda *_: answer(measured))
        monkeypatch.setattr(validation, "predict_point", lambda *_, **__: answer(predicted))
        monkeypatch.setattr(validation, "blamed_on_bow", lambda _, speed, state: f"bow {speed:g} {state is None}")

    return given


def test_a_point_is_judged_by_its_log(rig: Rig, measured_as: Any) -> None:
    run = log("point-D", 0.0)
    expected = rig.points["D"].expected
    assert expected is not None
    other = next(kind for kind in ("II", "III") if kind != expected)
    settled, stable = measurement(state=expected), prediction(state=SimpleNamespace(type=expected))
    measured_as(NotEnoughData("too short"), stable)
    lacking = validate_point(run, rig, identified())
    assert (lacking.verdict, lacking.why, lacking.state) == ("not enough data", "too short", "not settled")
    assert (lacking.measurement, lacking.prediction, lacking.scores, lacking.because) == (None, None, {}, "")
    assert (lacking.name, lacking.expected, lacking.source) == ("D", expected, run.source)
    measured_as(settled, stable)
    found = validate_point(run, rig, identified())
    assert (found.because, found.state) == ("", expected)
    assert set(found.scores) == {"theta3", "theta4", "amplitude_x", "amplitude_y", "amplitude"}
    measured_as(measurement(state=expected, amplitude_x_m=Interval(9e-3, 1e-6)), stable)
    large = validate_point(run, rig, identified())
    assert (large.verdict, large.because) == ("fail", "")
    assert large.why.startswith("x amplitude")
    measured_as(settled, NoStableState("no stable state"))
    unstable = validate_point(run, rig, identified())
    assert (unstable.verdict, unstable.prediction, unstable.scores) == ("fail", None, {})
    assert unstable.because == "bow 60 True"
    assert unstable.why == f"measured state {expected}, but no stable state; bow 60 True"
    measured_as(measurement(state=other), stable)
    wrong = validate_point(run, rig, identified())
    assert (wrong.verdict, wrong.because) == ("fail", "bow 60 False")
    assert wrong.scores
    measured_as(measurement(state="not settled"), stable)
    moving = validate_point(run, rig, identified())
    assert (moving.verdict, moving.scores, moving.why) == ("not settled", {}, "the reason; bow 60 False")
    measured_as(measurement(state=other), prediction(state=SimpleNamespace(type=other)))
    assert validate_point(run, rig, identified()).because == "bow 60 False"  # the rig file expects another state
    elsewhere = validate_point(log("point-Z", 0.0), rig, identified())
    assert elsewhere.expected is None
    assert elsewhere.because == ""
    for kind, predicted in (("II", "III"), ("III", "II")):
        measured_as(measurement(state=kind), prediction(state=SimpleNamespace(type=predicted)))
        assert validate_point(log("point-Z", 0.0), rig, identified()).because == "bow 60 False"


@pytest.mark.parametrize("kind", [Validation, Score, Statistic, Agreement, CauseStatistics, Overall, _Case])
def test_a_result_cannot_be_changed(kind: type) -> None:
    with pytest.raises(FrozenInstanceError):
        object.__new__(kind).name = 1


def test_a_difference_without_any_uncertainty_is_described() -> None:
    exact = Score(math.inf, math.radians(30.0), 0.0, math.radians(29.0), 0.0)
    assert "30.000000 ± 0.000000° measured against 29.000000 ± 0.000000° predicted" in sentence("theta3", exact)

"""Numbers of the joint estimate by formulas of their own: weights, χ², limits of the decisions, shares, messages."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError, replace
from datetime import UTC, datetime
from importlib import import_module
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.stats import chi2, norm

from identification.errors import NotIdentifiable
from identification.estimate import Estimate
from identification.joint.agreement import (
    ALARM,
    AgreementVerdict,
    _log_chances_of_each,
    _log_tail,
    _mended,
    covariance_of_all,
    verdict,
)
from identification.joint.budget import ParameterBudgets, _disagreement, parameter_budgets
from identification.joint.combine import JointEstimate, _widen, joint_estimate, reduced
from identification.joint.limits import SOURCES, ParameterLimit, limits
from identification.joint.provenance import KeptTest, kept_tests, model_share, rebuilt, with_tests
from identification.joint.rows import ConsistencyRow, rows_of
from identification.joint.shared_friction import friction_messages, with_shared_friction
from identification.joint.weighting import Weighted, weighted
from identification.pendulums.open_friction import OpenFriction, Together, together
from identification.pendulums.transient import TransientFit
from rig_configs import IdentifiedParameters, load_rig
from rig_configs.error_label import ErrorLabel
from rig_configs.errors import ParametersFileError
from rig_configs.known import KnownSource
from uncertainty import Group

K1, K2 = "k1_N_per_m", "k2_N_per_m"
GAIN_X = ErrorLabel("gain", "x")
FRICTION_1 = ErrorLabel("friction", "1")
TOLERATED = 1.0025  # variance with the tolerated twentieth of a standard deviation


def one(
    value: float,
    std: float = 1.0,
    number: int = 0,
    shared: dict[ErrorLabel, float] | None = None,
    by_number: dict[str, float] | None = None,
    name: str = K1,
    at: float = 1000.0,
) -> Estimate:
    """A test of one parameter; its value is given as the distance from 1000."""
    return Estimate(
        f"test-{number}",
        (f"logs/{number:02d}.mcap",),
        (name,),
        np.array([at + value]),
        np.array([[std**2]]),
        {label: np.array([shift]) for label, shift in (shared or {}).items()},
        "made up",
        {label: np.array([slope]) for label, slope in (by_number or {}).items()},
    )


def several(*values: float, stds: tuple[float, ...] = ()) -> list[Estimate]:
    return [one(v, stds[i] if stds else 1.0, i) for i, v in enumerate(values)]


# agreement


def test_p_of_two_tests_counts_both_tests_and_both_values() -> None:
    """Four comparisons, each with the χ² of the difference, of one degree of freedom."""
    for apart in (0.0, 3.0, 5.0, 6.0, 30.0):
        found = verdict(several(0.0, apart))
        expected = 4 * chi2.sf(apart**2 / (2 * TOLERATED), 1)
        assert found.looks == 4
        assert found.p == pytest.approx(min(1.0, expected), rel=1e-9)
        assert found.alarm == (expected < 1e-3)
        if found.alarm:
            assert sorted(found.suspects) == [0, 1]
            assert found.names == (K1,)
            assert np.abs(found.z) == pytest.approx([apart / math.sqrt(2 * TOLERATED)])
            assert (found.z[0] > 0) == (found.suspects[0] == 1)
        else:
            assert (found.suspects, found.names, found.z) == ((), (), ())


@pytest.mark.parametrize("apart", [44.0, 46.0, 60.0])
def test_p_of_values_far_apart_has_the_tail_of_its_distribution(apart: float) -> None:
    """On both sides of the largest tabulated χ², 1000, and below the smallest number that p is limited to."""
    found = verdict(several(0.0, apart))
    tail = math.log(4) + chi2.logsf(apart**2 / (2 * TOLERATED), 1)
    assert math.log(found.p) == pytest.approx(max(tail, math.log(4) - 700.0), rel=1e-3)


def test_p_of_whole_tests_counts_their_values_as_degrees_of_freedom() -> None:
    """Two tests of two parameters, off by 3 in each: 18 of two degrees is rarer than 9 of one."""
    both = [
        Estimate(f"t{i}", f"{i}", (K1, K2), np.array([1000.0, 1000.0]) + off, np.eye(2))
        for i, off in enumerate((0.0, 5.0))
    ]
    found = verdict(both)
    assert found.looks == 6
    assert found.p == pytest.approx(6 * chi2.sf(2 * 25.0 / (2 * TOLERATED), 2), rel=1e-9)
    far = [both[0], replace(both[1], values=both[1].values + 45.0)]
    assert math.log(verdict(far).p) == pytest.approx(math.log(6) - 700.0, rel=1e-6)


def test_a_parameter_of_one_test_alone_is_not_compared() -> None:
    found = verdict([one(0.0), one(0.0, name=K2)])
    assert (found.p, found.looks, found.suspects, found.alarm) == (1.0, 0, (), False)


def test_a_test_without_values_counts_for_nothing() -> None:
    given = several(0.0, 30.0, 15.0, stds=(1.0, 1.0, 40.0))
    empty = Estimate("empty", ("empty.mcap",), (), np.empty(0), np.empty((0, 0)))
    assert verdict([*given, empty]) == verdict(given)
    assert verdict(given).looks == 6


@pytest.mark.parametrize("apart", [7.0, 7.4, 7.8, 8.2, 8.6, 9.0, 11.0])
def test_one_suspect_is_named_if_the_odds_are_four_hundred_to_one(apart: float) -> None:
    """A third test, twice as uncertain, decides between two: 2 ln of the ratio of their p is above 12."""
    std = np.sqrt(TOLERATED) * np.array([1.0, 1.0, 2.0])
    values = np.array([0.0, apart, 0.0])
    found = verdict(several(*values, stds=(1.0, 1.0, 2.0)))
    without = []
    for i in range(3):
        rest = [j for j in range(3) if j != i]
        others = np.average(values[rest], weights=std[rest] ** -2)
        without.append(chi2.logsf((values[i] - others) ** 2 / (std[i] ** 2 + 1 / np.sum(std[rest] ** -2)), 1))
    limit = math.log(1e-3 / 6)
    expected = {i for i in range(3) if 2 * (without[i] - min(without)) < 12.0 and without[i] < limit}
    assert found.looks == 6
    assert found.alarm == (min(without) < limit)
    if found.alarm:
        assert set(found.suspects) == expected
        assert found.suspects[0] == 1
        assert found.p == pytest.approx(6 * math.exp(min(without)))


def test_a_good_value_that_is_correlated_with_the_bad_one_is_not_named() -> None:
    own = np.array([[1.0, 0.9], [0.9, 1.0]])
    good = [Estimate(f"t{i}", f"{i}", (K1, K2), np.array([1000.0, 2000.0]), own) for i in range(4)]
    bad = replace(good[2], values=np.array([1012.0, 2000.0]))
    found = verdict([*good[:2], bad, good[3]])
    assert found.suspects == (2,)
    assert found.names == (K1,)
    shifted = replace(good[2], values=np.array([1012.0, 1988.0]))
    both = verdict([*good[:2], shifted, good[3]])
    assert set(both.names) == {K1, K2}
    assert {n: z > 0 for n, z in zip(both.names, both.z, strict=True)} == {K1: True, K2: False}


@pytest.mark.parametrize(("z", "named"), [(3.6, False), (4.3, True), (-4.3, True)])
def test_a_second_value_is_named_if_chance_reaches_it_in_a_thousandth_of_all_comparisons(z: float, named: bool) -> None:
    """Twelve comparisons of four tests with two values: p below 10⁻³/12, |z| above 3.94."""
    assert chi2.sf(3.94**2, 1) == pytest.approx(1e-3 / 12, rel=0.03)
    good = [Estimate(f"t{i}", f"{i}", (K1, K2), np.array([1000.0, 2000.0]), np.eye(2)) for i in range(4)]
    off = z * math.sqrt(TOLERATED * 4 / 3)
    found = verdict([*good[:2], replace(good[2], values=np.array([1012.0, 2000.0 + off])), good[3]])
    assert (found.looks, found.suspects) == (12, (2,))
    assert found.names == ((K1, K2) if named else (K1,))
    assert found.z == pytest.approx((12.0 / math.sqrt(TOLERATED * 4 / 3), z)[: len(found.names)])


@pytest.mark.parametrize("dof", [1, 2, 3, 6])
def test_the_tail_of_chi2_is_continuous_and_never_underflows(dof: int) -> None:
    for statistic in (0.0, 3.0, 900.0, 999.0, 1001.0, 1300.0):
        assert _log_tail(statistic, dof) == pytest.approx(chi2.logsf(statistic, dof), abs=0.01)
    assert _log_tail(-1e-9, dof) == 0.0
    assert -5.1e5 < _log_tail(1e6, dof) < -4.9e5
    statistics = np.array([0.0, 3.0, 999.0, 1001.0, 5000.0])
    logs, judged = _log_chances_of_each(np.sqrt(statistics), np.eye(5))
    assert logs == pytest.approx(math.log(2) + norm.logsf(np.sqrt(statistics)), abs=0.01)
    assert judged.all()


def test_a_value_that_no_other_determines_is_not_judged() -> None:
    logs, judged = _log_chances_of_each(np.array([6.0, 1.0, 1.0]), np.diag([4.0, 2e-9, 0.5e-9]))
    assert judged.tolist() == [True, True, False]
    assert logs[[0, 2]] == pytest.approx([chi2.logsf(9.0, 1), 0.0])
    assert _mended(np.array([6.0, 1.0, 1.0]), np.diag([4.0, 2e-9, 0.5e-9]), np.array([1])) == (pytest.approx(5e8), 1)
    assert _mended(np.array([6.0, 1.0, 1.0]), np.diag([4.0, 2e-9, 0.5e-9]), np.array([2]))[1] == 0
    assert _mended(np.array([6.0, 8.0]), np.diag([4.0, 16.0]), np.array([0, 1])) == (pytest.approx(9.0 + 4.0), 2)
    small = np.diag([4e3, 3e-6])  # relative to the largest
    assert _mended(np.array([0.0, 1.0]), small, np.array([0, 1]))[1] == 1


def test_only_values_of_the_worst_test_are_named() -> None:
    good = [Estimate(f"t{i}", f"{i}", (K1, K2), np.array([1000.0, 2000.0]), np.eye(2)) for i in range(4)]
    for worst, other in ((0, 2), (2, 0), (1, 2)):
        estimates = list(good)
        estimates[worst] = replace(good[worst], values=np.array([1014.0, 2000.0]))
        estimates[other] = replace(good[other], values=np.array([1000.0, 2009.0]))
        found = verdict(estimates)
        assert found.suspects[0] == worst
        assert found.names == (K1,)


def test_covariance_of_all_has_common_gains_and_clocks_of_each_log() -> None:
    a = one(0.0, 1.0, 0, {GAIN_X: 2.0, ErrorLabel("clock", "laser_x"): 3.0})
    b = one(0.0, 0.5, 1, {GAIN_X: -1.0, ErrorLabel("clock", "laser_x"): 4.0})
    variances = np.array([1.0 + 4.0 + 9.0, 0.25 + 1.0 + 16.0])
    expected = np.array([[TOLERATED * variances[0], -2.0], [-2.0, TOLERATED * variances[1]]])
    assert covariance_of_all([a, b]) == pytest.approx(expected)
    three = covariance_of_all([a, one(0.0), b])
    assert three[0, 2] == pytest.approx(-2.0)
    assert three[1] == pytest.approx([0.0, TOLERATED, 0.0])


# rows and weights


def test_rows_compare_each_value_with_the_others() -> None:
    """Values 0, 1, 4 with standard deviations 1, 1, 2."""
    values, variance = np.array([0.0, 1.0, 4.0]), TOLERATED * np.array([1.0, 1.0, 4.0])
    rows = rows_of(K1, several(*values, stds=(1.0, 1.0, 2.0)))
    mean = np.average(values, weights=1 / variance)
    total = float(np.sum((values - mean) ** 2 / variance))
    for k, row in enumerate(rows):
        rest = [j for j in range(3) if j != k]
        others = np.average(values[rest], weights=1 / variance[rest])
        others_std = math.sqrt(1 / np.sum(1 / variance[rest]))
        assert (row.parameter, row.test, row.sources) == (K1, f"test-{k}", (f"logs/{k:02d}.mcap",))
        assert (row.value, row.std) == pytest.approx((1000.0 + values[k], math.sqrt(variance[k])))
        assert (row.others, row.others_std) == pytest.approx((1000.0 + others, others_std))
        assert row.z == pytest.approx((values[k] - others) / math.hypot(math.sqrt(variance[k]), others_std))
        assert (row.chi2, row.dof) == (pytest.approx(total), 2)
        assert row.p == pytest.approx(chi2.sf(total, 2))
        assert not row.left_out
    without = rows_of(K1, several(*values, stds=(1.0, 1.0, 2.0)), [2])
    assert [row.left_out for row in without] == [False, False, True]
    assert without[0].others == pytest.approx(1001.0)
    assert without[2].others == pytest.approx(1000.5)
    alone = rows_of(K1, several(0.0, 3.0), [1])  # nothing else to compare with
    assert [row.others for row in alone] == pytest.approx([1003.0, 1000.0])


def test_a_parameter_of_one_test_has_no_rows() -> None:
    assert rows_of(K1, [one(0.0), one(0.0, name=K2)]) == []
    assert len(rows_of(K1, [one(0.0), one(0.0, name=K2), one(1.0)])) == 2


def test_weights_are_the_inverse_variances_without_the_errors_found_together() -> None:
    a = one(0.0, 1.0, 0, {GAIN_X: 2.0, FRICTION_1: 7.0}, {"rotor.mass_kg": 3.0})
    b = one(10.0, 3.0, 1, {GAIN_X: 1.0}, {"rotor.mass_kg": -1.0, "imbalance.mass_kg": 5.0})
    share = np.array([1 / 5.0, 1 / 10.0]) / (1 / 5.0 + 1 / 10.0)
    found = weighted([a, b])
    assert found.names == (K1,)
    assert found.values == pytest.approx([1000.0 + 10.0 * share[1]])
    assert [float(pull[0, 0]) for pull in found.pulls] == pytest.approx(share.tolist())
    assert found.own == pytest.approx(np.array([[share[0] ** 2 + 9.0 * share[1] ** 2]]))
    assert found.shared[GAIN_X] == pytest.approx([2.0 * share[0] + share[1]])
    assert found.shared[FRICTION_1] == pytest.approx([7.0 * share[0]])
    assert found.by_number["rotor.mass_kg"] == pytest.approx([3.0 * share[0] - share[1]])
    assert found.by_number["imbalance.mass_kg"] == pytest.approx([5.0 * share[1]])
    total = found.own[0, 0] + found.shared[GAIN_X][0] ** 2 + found.shared[FRICTION_1][0] ** 2
    assert found.covariance == pytest.approx(np.array([[total]]))


def test_parameters_of_very_different_size_and_zero_are_combined() -> None:
    pair = Estimate("a", "a", (K1, "zeta1"), np.array([1e7, 0.0]), np.diag([1.0, 1e-16]))
    other = Estimate("b", "b", ("zeta1", K1), np.array([2e-8, 1e7 + 2]), np.diag([1e-16, 1.0]))
    found = weighted([pair, other])
    assert found.names == (K1, "zeta1")
    assert found.values == pytest.approx([1e7 + 1, 1e-8], rel=1e-12)
    assert np.diag(found.own) == pytest.approx([0.5, 0.5e-16])


# the joint estimate


@pytest.mark.parametrize(("apart", "stretched"), [(3.5, False), (3.8, True)])
def test_a_mild_disagreement_stretches(apart: float, stretched: bool) -> None:
    """p of the difference of two tests is 1 % at 2.58 √(2 · 1.0025) = 3.65."""
    shared = {GAIN_X: 0.5}
    pair = [one(0.0, 1.0, 0, shared), one(apart, 1.0, 1, shared)]
    found = joint_estimate(pair)
    variance = TOLERATED * 1.25
    statistic = apart**2 / (2 * variance - 2 * 0.25)
    factor = math.sqrt(statistic) if stretched else 1.0
    assert found.stretch == pytest.approx([factor])
    assert found.parameters.shared[GAIN_X] == pytest.approx([0.5 * factor])
    assert found.parameters.std[K1] == pytest.approx(factor * math.sqrt(0.5 + 0.25))
    assert found.parameters.values[K1] == pytest.approx(1000.0 + apart / 2)
    assert (found.warnings, found.left_out, found.extra_std) == ([], {}, {})


def test_two_tests_that_disagree_get_the_extra_error_that_makes_chi2_one() -> None:
    found = joint_estimate(several(0.0, 30.0))
    extra = math.sqrt(30.0**2 / 2 - TOLERATED)
    assert found.extra_std[K1] == pytest.approx(extra, rel=2e-3)
    assert found.parameters.values[K1] == pytest.approx(1015.0)
    assert found.parameters.std[K1] == pytest.approx(math.sqrt((1.0 + extra**2) / 2), rel=2e-3)
    assert found.stretch == pytest.approx([1.0])
    (message,) = found.warnings
    assert message == (
        f"{K1}: tests disagree (p = {4 * chi2.sf(30.0**2 / (2 * TOLERATED), 1):.1g}) and it cannot be decided whether "
        "test-0 (00.mcap) or test-1 (01.mcap) is bad; the interval is widened to cover all of them. Repeat one of "
        "these tests to decide"
    )


def test_two_suspects_are_widened_and_a_third_test_that_agrees_with_both_is_not() -> None:
    found = joint_estimate(several(0.0, 30.0, 15.0, stds=(1.0, 1.0, 10.0)))
    (message,) = found.warnings
    assert "whether test-0 (00.mcap) or test-1 (01.mcap) is bad" in message
    tau = found.extra_std[K1]
    assert found.parameters.std[K1] == pytest.approx((2 / (1.0 + tau**2) + 1 / 100.0) ** -0.5)


def test_the_bad_one_of_three_is_left_out_with_its_distance() -> None:
    given = several(0.0, 1.0, 50.0)
    found = joint_estimate(given)
    assert list(found.left_out) == [2]
    z = 49.5 / math.sqrt(1.5 * TOLERATED)
    percent = 100 * 49.5 / 1000.5
    (message,) = found.warnings
    assert message.startswith(f"tests disagree: test-2 (02.mcap) stands apart ({K1} {percent:+.3g} % from the others, ")
    assert f"z = {z:.3g}; p = " in message
    assert message.endswith("It is left out. Look at its log, or repeat the test")
    assert found.parameters.values[K1] == pytest.approx(1000.5)
    assert found.parameters.std[K1] == pytest.approx(math.sqrt(0.5))
    assert [pull.shape for pull in found.weighted.pulls] == [(1, 1)] * 3
    assert [float(pull[0, 0]) for pull in found.weighted.pulls] == pytest.approx([0.5, 0.5, 0.0])
    assert [row.left_out for row in found.rows] == [False, False, True]
    assert found.estimates == given
    below = joint_estimate(several(0.0, 1.0, -50.0))
    assert f"{K1} {-100 * 50.5 / 1000.5:+.3g} % from the others, z = -" in below.warnings[0]


def test_a_test_of_other_parameters_keeps_what_only_it_has() -> None:
    two = Estimate("two", ("two.mcap",), (K1, K2), np.array([1050.0, 7.0]), np.diag([1.0, 4.0]), {}, "", {}, {})
    found = joint_estimate([*several(0.0, 1.0), two])
    assert list(found.left_out) == [2]
    assert found.parameters.values == pytest.approx({K1: 1000.5, K2: 7.0})
    assert f"It is left out; {K2} of it is kept, no other test determines it." in found.warnings[0]
    assert found.weighted.pulls[2] == pytest.approx(np.array([[0.0, 0.0], [0.0, 1.0]]))


def test_a_majority_of_the_given_tests_must_remain() -> None:
    """Of four, one that stands apart is left out and three remain; of five with two pairs apart, not four."""
    assert list(joint_estimate(several(0.0, 0.5, -0.5, 60.0)).left_out) == [3]
    assert sorted(joint_estimate(several(0.0, 0.5, -0.5, 60.0, -80.0)).left_out) == [3, 4]
    found = joint_estimate(several(0.0, 0.5, 60.0, -80.0))
    assert len(found.left_out) <= 1
    assert found.extra_std


def test_tests_that_differ_in_the_correlation_only_get_twice_their_uncertainty() -> None:
    """Each value agrees by itself; the tests disagree along the direction in which both are sharp."""
    own = np.array([[1.0, 0.9999], [0.9999, 1.0]])
    pair = [
        Estimate(f"t{i}", (f"{i}.mcap",), (K1, K2), np.array([1000.0 + off, 1000.0 - off]), own)
        for i, off in enumerate((0.0, 0.6))
    ]
    found = joint_estimate(pair)
    assert len(found.warnings) == 1  # once, although the tests are widened several times
    # doubled once for each of the two parameters
    assert found.parameters.std[K1] == pytest.approx(4 * math.sqrt(0.5), rel=1e-6)
    assert found.parameters.std[K2] == pytest.approx(4 * math.sqrt(0.5), rel=1e-6)


def test_reduced_keeps_every_part_of_an_estimate() -> None:
    whole = Estimate(
        "t",
        "s",
        (K1, K2, "zeta1"),
        np.array([1.0, 2.0, 3.0]),
        np.arange(9.0).reshape(3, 3),
        {GAIN_X: np.array([4.0, 5.0, 6.0])},
        "m",
        {"rotor.mass_kg": np.array([7.0, 8.0, 9.0])},
        {"term": np.array([10.0, 11.0, 12.0])},
    )
    part = reduced(whole, ["zeta1", K1])
    assert part.names == ("zeta1", K1)
    assert part.values.tolist() == [3.0, 1.0]
    assert part.covariance.tolist() == [[8.0, 6.0], [2.0, 0.0]]
    assert part.shared[GAIN_X].tolist() == [6.0, 4.0]
    assert part.by_number["rotor.mass_kg"].tolist() == [9.0, 7.0]
    assert part.with_terms["term"].tolist() == [12.0, 10.0]
    assert (part.test, part.source, part.method) == ("t", "s", "m")


@pytest.mark.parametrize(
    ("values", "covariance"),
    [
        ([math.nan, 1.0], np.eye(2)),
        ([1.0, 1.0], np.diag([1.0, 0.0])),
        ([1.0, 1.0], np.array([[1.0, math.inf], [math.inf, 1.0]])),
        ([1.0, 1.0], np.diag([4.0, 9.0]) + (1 - 3e-14) * np.array([[0.0, 6.0], [6.0, 0.0]])),
        ([1.0, 1.0], np.array([[1.0, 1.1], [1.1, 1.0]])),
    ],
)
def test_a_test_without_a_regular_covariance_is_refused(values: list[float], covariance: np.ndarray) -> None:
    bad = Estimate("run-up", ("a.mcap",), (K1, K2), np.array(values), covariance)
    with pytest.raises(NotIdentifiable, match=rf"a\.mcap: expected finite values .* of {K1}, {K2}, got .*singular"):
        joint_estimate([bad])


def test_a_nearly_singular_covariance_is_accepted() -> None:
    near = np.diag([4.0, 9.0]) + (1 - 1e-12) * np.array([[0.0, 6.0], [6.0, 0.0]])
    assert joint_estimate([Estimate("t", "s", (K1, K2), np.ones(2), near)]).parameters.std[K2] == pytest.approx(
        3.0, rel=1e-3
    )


# limits


def test_shares_of_a_variance_by_source() -> None:
    """Own variance 4 (a quarter beyond noise), clock 1, gain 9 + 16, known 25, friction 36; 1 % of the mass."""
    shared = {
        ErrorLabel("clock", "laser_x"): 1.0,
        GAIN_X: 3.0,
        ErrorLabel("gain", "y"): 4.0,
        ErrorLabel("known", "rotor.mass_kg"): 5.0,
        FRICTION_1: 6.0,
    }
    file = kept([one(0.0, 2.0, 0, shared)], 0.25)
    (found,) = limits(file, 0.01)
    parts = {"noise": 3.0, "model": 1.0, "clock": 1.0, "gain": 25.0, "known": 25.0, "friction": 36.0, "mass": 100.0}
    total = sum(parts.values())
    assert tuple(found.shares) == SOURCES
    assert found.std == pytest.approx(math.sqrt(total))
    for source, variance in parts.items():
        assert found.shares[source] == pytest.approx(variance / total, abs=1e-12)
    assert found.shares["disagreement"] == pytest.approx(0.0, abs=1e-12)
    assert sum(found.shares.values()) == pytest.approx(1.0)
    assert (found.name, found.main, found.advice) == (K1, "mass", "weigh the rotor")
    assert limits(file)[0].main == "friction"
    zeta = kept([one(0.0, 2.0, 0, name="zeta1")], 0.0)
    assert limits(zeta, 0.01)[0].shares["mass"] == 0.0
    assert limits(replace(file, provenance={})) is None


def test_the_share_of_a_disagreement_is_what_the_own_errors_lack() -> None:
    file = kept(several(0.0, 3.8), 0.0)
    (found,) = limits(file)
    assert found.shares["disagreement"] == pytest.approx(1 - 2 * TOLERATED / 3.8**2)
    assert found.shares["noise"] == pytest.approx(2 * TOLERATED / 3.8**2)


def test_limits_of_an_identification_take_the_shares_of_its_fits() -> None:
    estimates = several(0.0, 0.0)
    fits = [SimpleNamespace(test="test-0", sources=("logs/00.mcap",), fit=SimpleNamespace(chi2_per_dof=4.0, curves=[]))]
    (found,) = limits(SimpleNamespace(estimates=estimates, fits=fits))
    assert found.shares["model"] == pytest.approx(0.5 * 0.75)


# provenance


def kept(estimates: list[Estimate], share: float) -> IdentifiedParameters:
    entries = [
        {
            "test": e.test,
            "log": e.source,
            "method": "by hand",
            "digest": f"d{i}",
            "values": dict(zip(e.names, e.values.tolist(), strict=True)),
            "covariance": e.covariance.tolist(),
            "model_share": share,
            "shared": {label.text: dict(zip(e.names, v.tolist(), strict=True)) for label, v in e.shared.items()},
        }
        for i, e in enumerate(estimates)
    ]
    return replace(joint_estimate(estimates).parameters, provenance={"tests": entries})


def test_the_share_beyond_noise_is_that_of_the_worst_fit_of_the_test() -> None:
    """White residuals count with χ²/dof alone; blocks of 16 equal residuals are 16 times as uncertain in variance."""

    def fit(chi2_per_dof: float, *residuals: np.ndarray) -> SimpleNamespace:
        return SimpleNamespace(
            chi2_per_dof=chi2_per_dof, curves=[SimpleNamespace(measured=r, fitted=np.zeros_like(r)) for r in residuals]
        )

    def share(*fits: SimpleNamespace, test: str = "test-0", sources: tuple[str, ...] = ("logs/00.mcap",)) -> float:
        named = [SimpleNamespace(test=test, sources=sources, fit=each) for each in fits]
        return model_share(one(0.0), SimpleNamespace(fits=named))

    signs = np.where(np.random.default_rng(1).random(64) < 0.5, -1.0, 1.0)
    correlated = np.repeat(signs, 16)
    assert share() == 0.0
    assert share(fit(0.5)) == 0.0
    assert share(fit(2.0)) == pytest.approx(0.5)
    assert share(fit(2.0, correlated)) == pytest.approx(1 - 1 / 16)
    assert share(fit(20.0, correlated)) == pytest.approx(1 - 1 / 20)
    fitted = SimpleNamespace(chi2_per_dof=2.0, curves=[SimpleNamespace(measured=3 * correlated, fitted=3 * correlated)])
    assert share(fitted) == pytest.approx(0.5)  # without residuals
    assert share(fit(4.0), fit(2.0)) == pytest.approx(0.75)
    assert share(fit(4.0), test="test-1") == share(fit(4.0), sources=("logs/01.mcap",)) == 0.0


def test_the_tests_in_a_file_have_their_logs_times_and_devices() -> None:
    estimates = [*several(0.0, 1.0, 50.0), replace(one(0.5), test="pair", sources=("logs/a.mcap", "logs/b.mcap"))]
    found = SimpleNamespace(
        estimates=estimates, fits=[], parameters=replace(joint_estimate(estimates).parameters, provenance={"by": "me"})
    )

    def run(source: str, start: float, serial: str, rig: str) -> SimpleNamespace:
        identities = {"laser": {"serial": serial}, "motor": {"serial": ""}, "radio": "none"}
        clocks = {"x": "laser", "y": "motor", "phase": "radio"}
        facts = {"identities": identities, "rig": rig}
        return SimpleNamespace(source=source, start_s=start, metadata=facts, clocks=clocks)

    runs = [
        run("logs/00.mcap", 0.0, "7", "two"),
        run("logs/b.mcap", 2e9, "8", "one"),
        run("logs/a.mcap", 1e9, "8", "one"),
        SimpleNamespace(source="other", start_s=5e8, metadata={}, clocks={}),
    ]
    facts = with_tests(found, runs).provenance
    assert facts["by"] == "me"
    assert facts["rig"] == "one + two"
    assert "widened" not in facts
    first, second, third, pair = facts["tests"]
    assert first["devices"] == {"laser": "7"}
    assert first["lasers"] == {"x": "7"}
    assert "recorded" not in first
    assert "devices" not in second
    assert "lasers" not in second
    assert "left_out" not in second
    assert third["left_out"].startswith("stands apart")
    assert pair["recorded"] == datetime.fromtimestamp(1e9, UTC).isoformat(timespec="seconds")
    assert pair["covariance"] == [[1.0]]
    assert with_tests(found).provenance.keys() == {"by", "tests"}
    apart = SimpleNamespace(
        estimates=several(0.0, 30.0), fits=[], parameters=joint_estimate(several(0.0, 30.0)).parameters
    )
    widened = with_tests(apart).provenance["widened"]
    assert widened == joint_estimate(several(0.0, 30.0)).extra_std


def test_tests_are_read_from_a_file_as_they_were_written() -> None:
    file = kept(several(0.0, 1.0), 0.25)
    file.provenance["tests"][1] |= {"recorded": "2026-01-02T03:04:05+00:00", "lasers": {"x": 7}, "left_out": "bad"}
    first, second = kept_tests(file) or []
    assert (first.estimate.test, first.estimate.source, first.estimate.method) == ("test-0", "logs/00.mcap", "by hand")
    assert (first.digest, first.recorded, first.lasers, first.model_share, first.left_out) == (
        "d0",
        None,
        {},
        0.25,
        "",
    )
    assert second.recorded == datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
    assert (second.lasers, second.left_out) == ({"x": "7"}, "bad")
    bare = {"test": "t", "log": "l", "values": {K1: 1.0}, "covariance": [[1.0]]}
    (least,) = kept_tests(replace(file, provenance={"tests": [bare]})) or []
    assert (least.digest, least.model_share, least.estimate.method, least.estimate.shared) == ("", 0.0, "", {})
    for incomplete in ([], {}, [bare, {"test": "t"}]):
        assert kept_tests(replace(file, provenance={"tests": incomplete})) is None


@pytest.mark.parametrize(
    ("spoilt", "words"),
    [
        ({"covariance": [[1.0, 0.0], [0.0, 1.0]]}, "expected 1 × 1 number, got"),
        ({"covariance": [["x"]]}, "could not convert"),
        ({"values": {K1: None}}, "float"),
        ({"shared": {"gain x": {K2: 1.0}}}, K1),
        ({"shared": 3}, "items"),
        ({"recorded": "yesterday"}, "yesterday"),
    ],
)
def test_an_invalid_test_in_a_file_is_an_error_with_its_key(spoilt: dict[str, object], words: str) -> None:
    file = kept(several(0.0, 1.0), 0.25)
    file.provenance["tests"][1] |= spoilt
    with pytest.raises(ParametersFileError, match=rf"provenance\.tests\[1\]: expected test.*{words}"):
        kept_tests(file)


def test_a_file_of_another_rule_is_not_rebuilt() -> None:
    """Values within a hundredth of a standard deviation, standard deviations within one per cent."""
    file = kept(several(0.0, 1.0), 0.25)
    std = file.std[K1]
    for off, factor, same in (
        (0.009, 1.0, True),
        (-0.009, 1.0, True),
        (0.011, 1.0, False),
        (-0.011, 1.0, False),
        (0.0, 1.0095, True),
        (0.0, 0.9905, True),
        (0.0, 1.0105, False),
        (0.0, 0.989, False),
    ):
        values = {K1: file.values[K1] + off * std * factor}
        changed = replace(file, values=values, covariance=file.covariance * factor**2)
        assert (rebuilt(changed) is not None) == same, (off, factor)
    more = replace(file, values=file.values | {K2: 1.0}, covariance=np.diag([file.covariance[0, 0], 1.0]))
    assert rebuilt(more) is None


# budgets


@pytest.mark.parametrize(("more", "noted"), [(0.0095, False), (0.0105, True)])
def test_a_deviation_of_one_per_cent_from_the_file_is_noted(more: float, noted: bool) -> None:
    """The rig file's mass has an uncertainty that the file was not identified with."""
    slope = 1.0
    file = replace(kept(several(0.0), 0.0), by_number={"rotor.mass_kg": np.array([slope])})
    rig = load_rig("virtual", settings=[f"rotor.mass_std_kg={math.sqrt((1 + more) ** 2 - 1) / slope:.9f}"])
    found = parameter_budgets(file, rig)
    assert math.sqrt(found.budgets.covariance[0, 0]) == pytest.approx(1 + more)
    assert bool(found.notes) == noted
    if noted:
        assert f"u({K1}) is 1.01 instead of 1;" in found.notes[0]


def test_budget_of_a_disagreement_is_the_widening_alone() -> None:
    file = kept(several(0.0, 30.0), 0.0)
    found = parameter_budgets(file).budgets
    group = next(s for s in found.sources if s.name == "disagreement")
    extra = joint_estimate(several(0.0, 30.0)).extra_std[K1]
    assert float(group.covariance[0, 0]) == pytest.approx(extra**2 / 2)
    own = next(s for s in found.sources if s.name.startswith("own: test-0"))
    assert float(own.covariance[0, 0]) == pytest.approx(1.0)
    assert [s.name for s in found.sources] == ["own: test-0 (00.mcap)", "own: test-1 (01.mcap)", "disagreement"]
    assert found.covariance == pytest.approx(file.covariance)


def test_a_disagreement_has_no_negative_variance_in_any_direction() -> None:
    """Weighed errors that exceed the own ones by a matrix with the eigenvalues −1 and 3."""
    added, got = np.array([[1.0, 2.0], [2.0, 1.0]]), list[Group]()
    joint = SimpleNamespace(weighted=SimpleNamespace(own=np.eye(2) + added, names=(K1, K2)))
    columns = SimpleNamespace(add=lambda group, weights: got.append(group))
    _disagreement(cast("Any", joint), np.eye(2), np.ones(2), cast("Any", columns))
    (group,) = got
    assert np.linalg.eigvalsh(np.asarray(group.covariance)) == pytest.approx([0.0, 3.0], abs=1e-12)


def test_a_test_that_was_left_out_has_no_row() -> None:
    found = parameter_budgets(kept(several(0.0, 1.0, 50.0), 0.5)).budgets
    assert [s.name for s in found.sources] == [
        "own: test-0 (00.mcap)",
        "beyond noise: test-0 (00.mcap)",
        "own: test-1 (01.mcap)",
        "beyond noise: test-1 (01.mcap)",
    ]


def test_three_tests_of_one_log_are_numbered() -> None:
    same = [one(v) for v in (0.0, 0.5, 1.0)]
    found = parameter_budgets(kept(same, 0.0)).budgets
    assert [s.name for s in found.sources] == [f"own: test-0 (00.mcap){more}" for more in ("", " 2", " 3")]


# shared friction


def joint_friction(friction: list[float], std: list[float]) -> Together:
    return Together(np.array(friction), np.diag(np.square(std)), [], [], [], [])


def test_friction_is_reported_from_four_standard_deviations_and_impossible_from_six() -> None:
    positive = "dry friction in addition to viscous damping, by all pendulum tests together: "
    assert friction_messages(joint_friction([3.9e-5, -5.9e-5, 0.0, 0.0], [1e-5] * 4)) == []
    (message,) = friction_messages(joint_friction([4.1e-5, 3.9e-5, 0.0, 4.1e-9], [1e-5, 1e-5, 1e-9, 1e-9]))
    assert message == (
        f"{positive}a torque of A 4.1e-05 ± 2e-05 N m, contact friction of B 4.1e-09 ± 2e-09 kg m² (95 %)"
    )
    (below,) = friction_messages(joint_friction([0.0, -6.1e-5, 0.0, 0.0], [1e-5] * 4))
    assert below.startswith("a torque of B -6.1e-05 ± 2e-05 N m (95 %) by all pendulum tests together: negative")
    assert len(friction_messages(joint_friction([4.1e-5, -6.1e-5, 0.0, 0.0], [1e-5] * 4))) == 2


C = np.array([1e-3, 2e-3])


def transient(number: int, c: np.ndarray, friction: float = 0.0) -> tuple[Estimate, TransientFit]:
    """c and M of a test that both determine each other; the slope by the mass is 0.5 of C."""
    values = np.r_[c, friction, friction, 0.0, 0.0]
    unit = np.array([*(1e-3 * C), 1e-6, 1e-6, 1e-10, 1e-10])
    correlation = np.eye(6)
    correlation[[0, 2, 1, 3], [2, 0, 3, 1]] = -0.8
    slope = {"rotor.mass_kg": np.r_[0.5 * C, np.zeros(4)]}
    own = OpenFriction(values, correlation * np.outer(unit, unit), slope)
    fit = TransientFit(
        {"c3_Nms_per_rad": float(c[0]), "c4_Nms_per_rad": float(c[1])},
        np.diag((1e-3 * c) ** 2),
        {},
        [],
        1.0,
        5.0,
        (0.0, 3.0),
        "m",
        [],
        [],
        open_friction=own,
        by_number={"rotor.mass_kg": np.array([0.5, 0.5])},
    )
    source = (f"{number:02d}.mcap",)
    names = ("c3_Nms_per_rad", "c4_Nms_per_rad")
    shared = {ErrorLabel("friction", "9"): c, GAIN_X: c * 1e-6}
    return Estimate("spin-down", source, names, c, np.diag((1e-3 * c) ** 2), shared), fit


def test_transients_share_the_friction_that_all_of_them_show() -> None:
    pairs = [transient(i, C, 5e-5 + 1e-6 * i) for i in range(3)]
    estimates = [one(0.0, number=7), *(e for e, _ in pairs)]
    found, shared = with_shared_friction(estimates, {f.sources: fit for (f, fit) in pairs})
    assert shared is not None
    assert shared.friction[:2] == pytest.approx([5.1e-5] * 2, rel=1e-6)
    assert np.sqrt(np.diag(shared.covariance))[:2] == pytest.approx([1e-6 / math.sqrt(3)] * 2, rel=1e-3)
    assert found[0] is estimates[0]
    for i, each in enumerate(found[1:]):
        # c moves by −0.8 · 10⁻³ C for 10⁻⁶ N m; with friction known its deviation is √(1 − 0.8²) · 10⁻³ C
        assert each.values == pytest.approx(C * (1 - 0.8e-3 * (1 - i)), rel=1e-8)
        relative = np.sqrt(np.diag(each.covariance)) / C
        assert relative == pytest.approx([0.6e-3] * 2, rel=1e-6)
        labels = {label for label in each.shared if label.kind == "friction"}
        assert labels == {ErrorLabel("friction", f"{k}") for k in (1, 2, 3, 4)}  # the former one is replaced
        assert each.shared[GAIN_X] == pytest.approx(C * 1e-6)
        by_friction = math.sqrt(sum(float(each.shared[label][0]) ** 2 for label in labels)) / C[0]
        assert by_friction == pytest.approx(0.8e-3 / math.sqrt(3), rel=1e-3)
        assert each.by_number["rotor.mass_kg"] == pytest.approx(0.5 * C, rel=1e-6)


def test_one_transient_shares_nothing() -> None:
    estimate, fit = transient(0, C)
    (found,), shared = with_shared_friction([estimate], {estimate.sources: fit})
    assert shared is None
    assert set(found.shared) == {GAIN_X}
    assert found.by_number["rotor.mass_kg"] == pytest.approx(0.5 * C)
    assert found.covariance == pytest.approx(np.diag((1e-3 * C) ** 2), rel=1e-9)
    pair = [transient(i, C) for i in range(2)]
    partly = replace(pair[1][0], names=("c3_Nms_per_rad",), values=pair[1][0].values[:1])
    kept_as_is, none = with_shared_friction(
        [pair[0][0], partly], {e.sources: fit for e, (_, fit) in zip((pair[0][0], partly), pair, strict=True)}
    )
    assert none is None
    assert kept_as_is[1] is partly


def test_friction_is_found_without_a_test_that_stands_apart() -> None:
    pairs = [transient(i, C, 5e-5) for i in range(4)]
    pairs.append(transient(4, 1.6 * C, 3e-4))
    estimates = [e for e, _ in pairs]
    found, shared = with_shared_friction(estimates, {e.sources: fit for e, fit in pairs})
    assert shared is not None
    assert shared.friction[:2] == pytest.approx([5e-5] * 2, rel=1e-6)
    assert list(joint_estimate(found).left_out) == [4]


def test_the_friction_is_computed_four_times_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each joint estimate leaves out one more test."""
    module = "identification.joint.shared_friction"
    pairs = [transient(i, C, 5e-5) for i in range(8)]
    out: set[int] = set()
    used: list[list[int] | None] = []

    def one_more(estimates: list[Estimate]) -> SimpleNamespace:
        out.add(len(out))
        return SimpleNamespace(left_out=dict.fromkeys(out, ""))

    def followed(opens: list[OpenFriction], trusted: list[int] | None, sources: Any) -> Together:
        used.append(trusted)
        return together(opens, trusted, sources)

    monkeypatch.setattr(f"{module}.joint_estimate", one_more)
    monkeypatch.setattr(f"{module}.together", followed)
    with_shared_friction([e for e, _ in pairs], {e.sources: fit for e, fit in pairs})
    assert used == [None, [1, 2, 3, 4, 5, 6, 7], [2, 3, 4, 5, 6, 7], [3, 4, 5, 6, 7]]


@pytest.mark.parametrize(("tau", "factor"), [(0.0, 4.0), (0.1, 4.0 * 1.01), (0.11, 1.0121)])
def test_tests_that_differ_only_in_their_correlation_are_widened_twofold(
    monkeypatch: pytest.MonkeyPatch, tau: float, factor: float
) -> None:
    """The extra error is given in standard deviations of the tests, which are of 0.02."""
    monkeypatch.setattr(import_module("identification.joint.combine"), "_extra_std", lambda *given: 0.02 * tau)
    kept = [one(0.0, 0.02), one(0.1, 0.02)]
    assert _widen(kept, (K1,), (0, 1), {}) == (0, 1)
    assert [each.covariance[0, 0] for each in kept] == pytest.approx([factor * 0.02**2] * 2)


def test_sources_of_known_numbers_weigh_the_tests_together() -> None:
    pairs = [transient(i, C, 5e-5) for i in range(3)]
    source = KnownSource("rotor.mass_kg", 0.01, "kg", {"rotor.mass_kg": 0.01})
    _, shared = with_shared_friction([e for e, _ in pairs], {e.sources: fit for e, fit in pairs}, 0.0, [source])
    assert shared is not None
    assert shared.by_number[0]["rotor.mass_kg"] == pytest.approx(0.5 * C, rel=1e-6)


def test_the_alarm_is_one_in_a_thousand() -> None:
    assert ALARM == 1e-3


@pytest.mark.parametrize(
    "kind", [AgreementVerdict, ParameterBudgets, JointEstimate, ParameterLimit, KeptTest, ConsistencyRow, Weighted]
)
def test_a_result_cannot_be_changed(kind: type) -> None:
    with pytest.raises(FrozenInstanceError):
        object.__new__(kind).name = 1

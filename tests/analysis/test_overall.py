"""All points together: agreement of what is right, and the right cause of what is not."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from analysis_runs import Drawn, draw, point_run

from analysis import validate
from analysis.agreement import CAUSES_LEVEL, agreement, evidence, limits_by_chance
from analysis.causes import Cause
from analysis.differences import Differences
from analysis.explanations import explanations
from analysis.validation import Validation
from daq.signals.run import Run
from rig_configs import IdentifiedParameters, Rig
from rig_configs.error_label import ErrorLabel
from tests.effort import thorough

SETTLED_S = {"A": 45.0, "B": 50.0, "C": 62.0, "D": 30.0, "E": 25.0}


@pytest.fixture(scope="module")
def drawn(rig: Rig) -> Drawn:
    return draw(rig, 4)


@pytest.fixture(scope="module")
def runs(rig: Rig, drawn: Drawn) -> list[Run]:
    return [point_run(rig, name, 4, drawn=drawn, after_s=SETTLED_S[name]) for name in rig.points]


def with_values(identified: IdentifiedParameters, **shares: float) -> IdentifiedParameters:
    return dataclasses.replace(identified, values={n: v * shares.get(n, 1.0) for n, v in identified.values.items()})


def compared(runs: list[Run], rig: Rig, drawn: Drawn, **shares: float) -> Validation:
    return validate(runs, rig, with_values(drawn.identified, **shares), drawn.axis_angle_deg)


def test_points_of_a_rig_with_nothing_wrong_agree(rig: Rig, drawn: Drawn, runs: list[Run]) -> None:
    found = compared(runs, rig, drawn)
    assert found.passed
    assert found.explanations is None
    assert found.agreement is not None
    assert found.agreement.together.dof == 26  # four rows, six where no vibration is predicted
    assert 1e-3 < found.agreement.together.p < 0.999
    assert json.loads(json.dumps(found.to_json(), allow_nan=False)) == found.to_json()
    by_cause = {one.cause.name: one for one in found.noticed}
    assert by_cause["k2_N_per_m"].together < min(by_cause["k2_N_per_m"].sizes.values())


@pytest.mark.parametrize(
    ("name", "share", "words"),
    [
        ("k2_N_per_m", 1.05, "k2"),
        pytest.param("zeta1", 0.9, "ζ1", marks=thorough),  # the pair below has it too
        pytest.param("k1_N_per_m", 0.995, "k1", marks=thorough),
    ],
)
def test_the_parameter_that_is_wrong_is_named_with_its_size(
    rig: Rig, drawn: Drawn, runs: list[Run], name: str, share: float, words: str
) -> None:
    found = compared(runs, rig, drawn, **{name: 1 / share})
    assert not found.passed
    assert found.agreement is not None
    assert found.explanations is not None
    best = found.explanations.best
    assert best is not None
    assert [cause.name for cause in best.causes] == [name]
    size, std = best.sizes[0] / best.causes[0].value, best.stds[0] / best.causes[0].value
    assert abs(1 + size - share) < 4 * math.hypot(std, drawn.identified.std[name] / drawn.identified.values[name])
    assert best.chi2 < 60 < found.agreement.together.chi2
    first = found.explanations.sentences[0]
    assert first.startswith(f"best explanation: {words} ")
    assert f"% {'above' if share > 1 else 'below'} the value used: χ² " in first


def test_two_things_that_are_wrong_are_found_as_a_pair(rig: Rig, drawn: Drawn, runs: list[Run]) -> None:
    found = compared(runs, rig, drawn, k2_N_per_m=1 / 1.003, zeta1=1 / 1.02)
    assert found.explanations is not None
    assert not found.explanations.singles[0].explained
    best = found.explanations.best
    assert best is not None
    assert {cause.name for cause in best.causes} == {"k2_N_per_m", "zeta1"}


def test_values_that_no_test_identified_are_named_and_are_not_exact(rig: Rig, drawn: Drawn, runs: list[Run]) -> None:
    """The rig file's S_P, c3, c4 differ from the true ones by 0.4 to 4 %, as design values do."""
    bare = drawn.identified.without(["SP_kg_m", "c3_Nms_per_rad", "c4_Nms_per_rad"])
    found = validate(runs, rig, bare, drawn.axis_angle_deg)
    assert found.passed, [point.why for point in found.points.values()]
    assert found.explanations is None
    design = rig.physics.identified()
    assert {name: value for name, (value, _) in found.filled.items()} == {
        name: design[name] for name in ("c3_Nms_per_rad", "c4_Nms_per_rad", "SP_kg_m")
    }
    assert set(found.to_json()["filled"]) == set(found.filled)
    (sentence,) = [text for text in found.warnings if "design value" in text]
    assert "SP_kg_m" in sentence
    set_by_hand = validate(runs, rig, bare, drawn.axis_angle_deg, exact=["SP_kg_m", "c3_Nms_per_rad", "c4_Nms_per_rad"])
    assert not set_by_hand.filled
    assert not set_by_hand.passed  # a value that was set is exact, and these are wrong


def test_what_the_user_grants_the_model_is_in_every_row(rig: Rig, drawn: Drawn, runs: list[Run]) -> None:
    granted = rig.model_copy(
        update={"validation": rig.validation.model_copy(update={"model_std_deg": 3.0, "model_std_mm": 1.0})}
    )
    assert not compared(runs, rig, drawn, k2_N_per_m=1.01).passed
    assert compared(runs, granted, drawn, k2_N_per_m=1.01).passed


def test_chance_exceeds_the_limit_of_causes_as_often_as_stated() -> None:
    """Independent causes: the level of the largest of k is 1 − (1 − α)^k of one."""
    rng = np.random.default_rng(3)
    for widths in ([1.0], [1.0] * 5, [0.1, 1.0, 1.0, 30.0, 1e4]):
        limits = limits_by_chance(np.eye(len(widths)), widths)
        above = np.mean(np.any(np.abs(rng.standard_normal((100_000, len(widths)))) > limits, axis=1))
        assert above == pytest.approx(CAUSES_LEVEL, abs=0.004)
    alike, one = limits_by_chance(np.ones((5, 5)), [1.0] * 5), limits_by_chance(np.eye(1), [1.0])
    assert alike == pytest.approx(one[0], abs=0.03)


def test_evidence_is_the_likelihood_ratio_under_the_prior() -> None:
    """∫ of the ratio of two normal densities over a Cauchy distribution of sizes, by quadrature."""
    share = (np.arange(200_000) + 0.5) / 200_000
    for width in (0.3, 1.0, 40.0):
        size = width * np.tan(math.pi * (share - 0.5))
        for z in (0.0, 1.0, 4.0):
            assert evidence(z, width) == pytest.approx(np.log(np.mean(np.exp(z * size - size**2 / 2))), abs=2e-3)


def test_causes_that_the_points_resolve_ten_thousand_times_leave_the_level_to_the_others() -> None:
    """Ten numbers, known to 0.8 of the resolution of the points, and twenty frictions and bows of possibly any size.

    A number that is 5 of its standard uncertainties off shows as z = 4 ± 1. One limit for all, 3.2 for thirty
    independent causes, finds 79 % of them.
    """
    limits = limits_by_chance(np.eye(30), [0.8] * 10 + [1e4] * 20)
    drawn = np.abs(np.random.default_rng(7).standard_normal((100_000, 30)))
    assert np.mean(np.any(drawn > limits, axis=1)) == pytest.approx(CAUSES_LEVEL, abs=0.004)
    found = np.mean(np.random.default_rng(8).normal(4.0, 1.0, 100_000) > limits[0])
    assert found > 0.84
    assert np.max(limits) < 5.0  # a torque of 1 % of a pendulum's shows with z of thousands


def rows_of(values: list[float]) -> Differences:
    """Rows with unit covariance that nothing identified moves."""
    none = np.empty((len(values), 0))
    rows = tuple(("A release", f"{k}") for k in range(len(values)))
    return Differences(rows, np.array(values), np.eye(len(values)), none, (), np.empty((0, 0)), none, {}, {})


def test_a_cause_that_could_have_any_size_comes_after_one_that_explains_nearly_as_much() -> None:
    """z = 4 of a number known as well as the points resolve it, 4.3 of a bow with 10⁴ sizes that could have been."""
    along = np.array([4.0, 0.0]) / 4.0
    nearer = np.array([4.0, 1.6]) / math.hypot(4.0, 1.6)
    length = Cause("pendulums.b.length_m", "length", math.nan, 1.0, along, "", 1.0, "")
    bow = Cause("bow along", "bow", math.nan, 1e4, nearer, "", 1.0, "")
    found = explanations(rows_of([4.0, 1.6]), (bow, length))
    assert found.singles[1].chi2 < found.singles[0].chi2
    assert [each.causes for each in found.singles] == [(length,), (bow,)]


def test_a_cause_that_the_points_do_not_show_is_not_offered() -> None:
    shown = Cause("a", "a", math.nan, 1.0, np.array([1.0, 0.0, 0.0]), "", 1.0, "")
    hidden = Cause("k1_N_per_m", "k1", 2600.0, 1.0, np.zeros(3), "%", 1.0, "")
    found = explanations(rows_of([9.0, 1e3, -1e3]), (hidden, shown))
    assert [each.causes for each in found.singles] == [(shown,)]
    (sentence,) = found.sentences
    assert "k1" not in sentence
    assert "nearest" not in sentence  # it leaves nearly all of χ²
    assert "2e+06 on 3" in sentence
    near = explanations(rows_of([1e3, 40.0, -40.0]), (hidden, shown))
    assert "the nearest is a 1000" in near.sentences[0]


def test_a_pair_is_ranked_by_its_likelihood_over_both_priors() -> None:
    """Two causes that move the rows alike to 0.9, held against the double integral on a grid."""
    a, b, width = np.array([1.0, 0.0]), np.array([0.9, math.sqrt(0.19)]), 8.0
    causes = tuple(Cause(name, name, math.nan, width, d, "", 1.0, "") for name, d in (("a", a), ("b", b)))
    values = [9.0, -7.0]
    (pair,) = explanations(rows_of(values), causes).pairs
    sizes = np.linspace(-60.0, 80.0, 1401)
    x, y = np.meshgrid(sizes, sizes, indexing="ij")
    left = sum((v - a[k] * x - b[k] * y) ** 2 for k, v in enumerate(values))
    prior = width**2 / (math.pi**2 * (width**2 + x**2) * (width**2 + y**2))
    likelihood = np.sum(np.exp(-0.5 * left) * prior) * (sizes[1] - sizes[0]) ** 2
    assert pair.score == pytest.approx(-2 * math.log(likelihood), abs=0.5)


def test_a_cause_that_cannot_be_below_zero_counts_on_its_own_side_only() -> None:
    """Friction that would have to be negative explains nothing; its share of chance goes to the other side."""
    push = np.array([1.0, 2.0, -1.0, 0.5])
    friction = Cause("friction.a_Nm", "dry friction of pendulum A", 0.0, 1.0, push, "%", 1.0, "", one_sided=True)
    for side, significant in ((5.0, ("friction.a_Nm",)), (-5.0, ())):
        found = agreement(rows_of((side * push / np.linalg.norm(push)).tolist()), (friction,))
        assert found.significant_causes == significant
        assert found.cause_z["friction.a_Nm"] == pytest.approx(max(side, 0.0))
    rng = np.random.default_rng(5)
    limit, _ = limits_by_chance(np.eye(2), [1.0, 1.0], (True, False))
    drawn = rng.standard_normal((100_000, 2))
    assert np.mean(np.maximum(drawn[:, 0], abs(drawn[:, 1])) > limit) == pytest.approx(CAUSES_LEVEL, abs=0.004)


@pytest.mark.parametrize(("size", "offered"), [(-0.5, True), (-4.21, False), (4.21, True)])
def test_a_cause_that_leaves_nothing_of_a_length_is_not_offered(size: float, offered: bool) -> None:
    """A pendulum cannot be 421 % shorter than it is, by itself or next to another cause."""
    values = np.array([4.0, 1.6, -2.0])
    length = Cause("pendulums.a.length_m", "the length of pendulum A", 1.0, 1e-3, values / size, "%", 100.0, "")
    other = Cause("bow along", "a bow", math.nan, 1.0, np.array([0.0, 0.0, 1.0]), "µm", 1e6, "")
    found = explanations(rows_of(values.tolist()), (length, other))
    shown = [cause.name for each in (*found.singles, *found.pairs) for cause in each.causes]
    assert (length.name in shown) == offered
    assert any("length of pendulum A" in sentence for sentence in found.sentences) == offered


def test_an_error_that_both_sides_share_counts_once() -> None:
    """Two rows that one error moves alike: their difference stays as sharp as each row is by itself."""
    rows = (("A", "θ3"), ("B", "θ3"))
    shared = {ErrorLabel("known", "rotor.mass_kg"): np.array([10.0, 10.0])}
    found = Differences(
        rows, np.array([8.0, 8.0]), np.eye(2), np.empty((2, 0)), (), np.empty((0, 0)), np.empty((2, 0)), {}, shared
    )
    assert found.chi2 < 1.0
    apart = dataclasses.replace(found, values=np.array([8.0, 4.0]))
    assert apart.chi2 == pytest.approx(4.0**2 / 2 + 12.0**2 / 2 / 201)
    assert found.of([0]).chi2 == pytest.approx(64 / 101)

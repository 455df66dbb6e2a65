"""Monte Carlo: repeatable trials, the adaptive procedure, bounds, refusals, differences of a model."""

from __future__ import annotations

import json
import math
from typing import Any, cast, get_args

import numpy as np
import pytest
from numpy.typing import NDArray

from uncertainty import (
    BadInput,
    BadModel,
    ErrorSource,
    Group,
    MonteCarlo,
    Spread,
    TooManyTrials,
    TrialLimits,
    check_linear,
    ellipsoid_factor,
    linear_budgets,
    monte_carlo,
    second_order_variance,
)
from uncertainty.budget import Budget, Contribution
from uncertainty.source import Distribution

TWO = [ErrorSource("a", 1.0), ErrorSource("b", 2.0, distribution="rectangular")]
Array = NDArray[np.float64]


def both(errors: Array) -> Array:
    """Sum and product of the first two errors, each off its own value."""
    return np.column_stack([10 + errors[:, 0] + errors[:, 1], (5 + errors[:, 0]) * (7 + errors[:, 1])])


def same(one: MonteCarlo, other: MonteCarlo) -> bool:
    return json.dumps(one.to_json()) == json.dumps(other.to_json())


def test_a_seed_repeats_its_trials() -> None:
    found = monte_carlo(both, TWO, seed=1, trials=25_000)
    assert same(found, monte_carlo(both, TWO, seed=1, trials=25_000, limits=TrialLimits(rows=999)))
    assert not same(found, monte_carlo(both, TWO, seed=2, trials=25_000))


def errors_seen(sources: list[Any], trials: int, rows: int = 10_000) -> Array:
    seen: list[Array] = []

    def model(errors: Array) -> Array:
        seen.append(errors.copy())
        return errors[:, :1]

    monte_carlo(model, sources, seed=1, trials=trials, limits=TrialLimits(rows=rows))
    assert not np.any(seen[0])  # one row of zeros shows the shape
    return np.concatenate(seen[1:])


def test_errors_of_a_source_depend_on_the_seed_and_its_place_alone() -> None:
    names = get_args(Distribution)
    sources: list[Any] = [ErrorSource(name, 1.0, "", "A", name, 5.0) for name in names]
    sources.append(Group("g", ("x", "y"), ("", ""), np.eye(2), "A", "t", 5.0))
    long = errors_seen(sources, 20_000)
    assert long.shape == (20_000, len(names) + 2)
    assert np.array_equal(long[:12_345], errors_seen(sources, 12_345, rows=1000))
    for i in range(1, len(names) + 1):
        assert np.array_equal(long[:1000, :i], errors_seen(sources[:i], 1000))
    assert len(np.unique(long)) == long.size  # no two streams and no two batches are alike
    assert np.max(np.abs(np.corrcoef(long, rowvar=False) - np.eye(long.shape[1]))) < 0.03


def test_moments_and_correlation() -> None:
    found = monte_carlo(both, TWO, seed=3, trials=200_000, names=["sum", "product"])
    variance, product, mixed = 1 + 4, 49 + 25 * 4 + 4, 7 * 1 + 5 * 4
    assert found["sum"].mean == pytest.approx(10, abs=0.02)
    assert found["product"].mean == pytest.approx(35, abs=0.1)
    assert found.covariance == pytest.approx(np.array([[variance, mixed], [mixed, product]]), rel=0.015)
    assert found.correlation[0, 1] == pytest.approx(mixed / math.sqrt(variance * product), abs=0.005)
    assert found["sum"].std == pytest.approx(math.sqrt(found.covariance[0, 0]))
    with pytest.raises(KeyError, match="there are sum, product"):
        found["quotient"]


def test_mean_and_covariance_are_those_of_the_values() -> None:
    kept: list[Array] = []

    def model(errors: Array) -> Array:
        kept.append(1e9 + both(errors))
        return kept[-1]

    found = monte_carlo(model, TWO, seed=4, trials=23_456)
    values = np.concatenate(kept[1:])
    assert found.trials == len(values) == 23_456
    assert [q.mean for q in found.quantities] == pytest.approx(np.mean(values, axis=0))
    assert found.covariance == pytest.approx(np.cov(values - 1e9, rowvar=False), rel=1e-6)
    for i, q in enumerate(found.quantities):
        assert q.symmetric == pytest.approx(np.quantile(values[:, i], [0.025, 0.975]), abs=0.05 * q.std)
        assert q.shortest[1] - q.shortest[0] <= q.symmetric[1] - q.symmetric[0]


def test_ellipsoid_of_normal_quantities_has_the_factor_of_chi_square() -> None:
    sources = [ErrorSource("a", 1.0), ErrorSource("b", 2.0), ErrorSource("c", 3e-6)]
    turned = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1e-6, 1.0]])
    for level in (0.5, 0.95):
        found = monte_carlo(lambda e: 7 + e @ turned.T, sources, seed=11, trials=100_000, level=level)
        assert found.ellipsoid_factor == pytest.approx(ellipsoid_factor(level, 3), abs=0.02)
    one = monte_carlo(lambda e: e[:, :1], sources[:1], seed=11, trials=100_000)
    assert one.ellipsoid_factor == pytest.approx(1.96, abs=0.02)
    uniform = monte_carlo(lambda e: e, [ErrorSource("a", 1.0, distribution="rectangular")], seed=11, trials=100_000)
    assert uniform.ellipsoid_factor == pytest.approx(0.95 * math.sqrt(3), abs=0.02)
    flat = monte_carlo(lambda e: np.column_stack([e[:, 0], -2 * e[:, 0]]), sources, seed=11, trials=1000)
    assert flat.ellipsoid_factor is None
    constant = monte_carlo(lambda e: np.column_stack([e[:, 0], 0 * e[:, 0]]), sources, seed=11, trials=1000)
    assert constant.ellipsoid_factor is None


def test_adaptive_procedure_reaches_the_digits_asked_for() -> None:
    calls: list[tuple[int, int | None]] = []
    for digits, tolerance in ((1, 0.5), (2, 0.05)):
        found = monte_carlo(
            lambda e: e[:, :1],
            [ErrorSource("a", 3.0)],
            seed=5,
            progress=lambda *x: calls.append(x),
            limits=TrialLimits(digits=digits),
        )
        assert found.stabilised
        y = found.quantities[0]
        assert y.mean == pytest.approx(0, abs=tolerance)
        assert y.std == pytest.approx(3, abs=tolerance)
        assert y.symmetric == pytest.approx((-5.880, 5.880), abs=tolerance)
        assert max(y.end_errors) <= 1.3 * tolerance
        assert calls[-1] == (found.trials, None)
    assert calls[:10] == [(n * 10_000, None) for n in range(1, 11)]


def test_more_digits_take_more_trials() -> None:
    fewer, more = (monte_carlo(both, TWO, seed=6, limits=TrialLimits(digits=d, most_trials=400_000)) for d in (1, 3))
    assert (fewer.trials, fewer.stabilised) == (100_000, True)
    assert (more.trials, more.stabilised) == (400_000, False)


def test_shortest_interval_takes_more_trials() -> None:
    symmetric, shortest = (
        monte_carlo(lambda e: e, [ErrorSource("a", 4.0)], seed=7, limits=TrialLimits(interval=i, most_trials=400_000))
        for i in ("symmetric", "shortest")
    )
    assert (symmetric.stabilised, shortest.stabilised) == (True, False)
    assert 100_000 < symmetric.trials < 300_000


def test_high_levels_have_larger_batches() -> None:
    calls: list[tuple[int, int | None]] = []
    batches: list[int] = []

    def model(errors: Array) -> Array:
        batches.append(len(errors))
        return both(errors)

    monte_carlo(both, TWO, seed=7, trials=150_000, level=0.999, progress=lambda *x: calls.append(x))
    monte_carlo(model, TWO, seed=7, trials=150_000, level=0.999, limits=TrialLimits(rows=10**9))
    assert calls == [(n * 10_000, 150_000) for n in range(1, 16)]
    assert batches == [1, 100_000, 50_000]


def test_fixed_trials_are_stable_only_where_ten_batches_show_it() -> None:
    assert not monte_carlo(both, TWO, seed=8, trials=99_999, limits=TrialLimits(digits=1)).stabilised
    assert monte_carlo(both, TWO, seed=8, trials=100_000, limits=TrialLimits(digits=1)).stabilised


def test_constant_quantity() -> None:
    found = monte_carlo(
        lambda e: np.column_stack([np.full(len(e), 0.1), e[:, 0]]), TWO, seed=9, limits=TrialLimits(digits=1)
    )
    assert found.stabilised
    assert found.quantities[0].std == 0
    assert found.quantities[0].symmetric == found.quantities[0].shortest == (0.1, 0.1)
    assert np.array_equal(found.correlation, np.eye(2))


def test_digits_beyond_the_rounding_of_the_values_are_not_waited_for() -> None:
    found = monte_carlo(lambda e: 1e9 + 1e-7 * e[:, :1], TWO, seed=9, limits=TrialLimits(digits=6, most_trials=200_000))
    assert (found.stabilised, found.trials) == (True, 100_000)
    assert found.quantities[0].mean == pytest.approx(1e9, abs=1e-6)


def test_heavy_tails_do_not_stabilise() -> None:
    cauchy = [ErrorSource("a", 1.0, "", "A", "t", 1.0)]
    found = monte_carlo(lambda e: e, cauchy, seed=10, limits=TrialLimits(most_trials=200_000))
    assert not found.stabilised
    assert found.quantities[0].symmetric == pytest.approx((-12.71, 12.71), abs=0.5)


def test_bound_on_memory() -> None:
    with pytest.raises(TooManyTrials, match="hold 20000 trials of 2 quantities; 20001 are"):
        monte_carlo(both, TWO, seed=1, trials=20_001, limits=TrialLimits(most_bytes=320_000))
    found = monte_carlo(both, TWO, seed=1, limits=TrialLimits(digits=4, most_bytes=320_000))
    assert (found.trials, found.stabilised) == (20_000, False)
    rows: list[int] = []
    monte_carlo(
        lambda e: both(e) if rows.append(len(e)) is None else e,
        TWO,
        seed=1,
        trials=10_001,
        limits=TrialLimits(rows=3000),
    )
    assert rows == [1, 3000, 3000, 3000, 1000, 1]


def test_one_batch_needs_its_memory() -> None:
    with pytest.raises(TooManyTrials, match="hold 9999 trials of 2 quantities; 10000 are"):
        monte_carlo(both, TWO, seed=1, limits=TrialLimits(most_bytes=16 * 9_999))
    assert monte_carlo(both, TWO, seed=1, limits=TrialLimits(most_bytes=16 * 9_999, most_trials=9_999)).trials == 9_999


def test_progress_of_a_slow_model_is_seen_within_a_batch() -> None:
    calls: list[tuple[int, int | None]] = []
    monte_carlo(both, TWO, seed=1, trials=250, progress=lambda *x: calls.append(x), limits=TrialLimits(rows=100))
    assert calls == [(100, 250), (200, 250), (250, 250)]


def test_model_may_fill_one_array_again() -> None:
    out = np.zeros((1000, 2))

    def model(errors: Array) -> Array:
        out[: len(errors)] = both(errors)
        return out[: len(errors)]

    assert same(
        monte_carlo(model, TWO, seed=1, trials=5000, limits=TrialLimits(rows=1000)),
        monte_carlo(both, TWO, seed=1, trials=5000),
    )


def test_no_sources() -> None:
    found = monte_carlo(lambda e: np.ones((len(e), 1)), [], seed=1, trials=1000)
    assert (found.quantities[0].mean, found.quantities[0].std) == (1, 0)


def test_json_is_plain_and_finite() -> None:
    found = monte_carlo(both, TWO, seed=1, trials=100, names=["sum", "product"])
    read = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert read["quantities"]["sum"]["end_errors"] == [None, None]
    assert read["quantities"]["product"]["mean"] == found["product"].mean
    assert (read["trials"], read["stabilised"], read["level"]) == (100, False, 0.95)


@pytest.mark.parametrize(
    ("model", "why"),
    [
        (lambda e: e[:, 0], "shape"),
        (lambda e: e[:-1], "shape"),
        (lambda e: e[:, :0], "shape"),
        (lambda e: np.zeros((len(e), min(len(e), 3))), "1\\) is needed"),
        (lambda e: np.log(1e-300 + 0 * e) + np.where(e > 1, np.nan, 0), "not finite in"),
        (lambda e: np.where(e > 1, np.inf, 0), "first for the errors"),
    ],
)
def test_bad_models(model: Any, why: str) -> None:
    with pytest.raises(BadModel, match=why):
        monte_carlo(model, TWO, seed=1, trials=1000)
    if why == "shape":
        with pytest.raises(BadModel, match=why):
            linear_budgets(model, TWO, ["q"], ["m"])


@pytest.mark.parametrize(
    "wrong",
    [
        {"seed": -1},
        {"limits": TrialLimits(digits=0)},
        {"level": 1.0},
        {"trials": 5},
        {"trials": 0},
        {"trials": None, "limits": TrialLimits(most_trials=5)},
        {"limits": TrialLimits(rows=0)},
        {"limits": TrialLimits(interval=cast(Any, "widest"))},
        {"names": ["one"]},
        {"names": ["one", "one"]},
        {"sources": [TWO[0], TWO[0]]},
    ],
)
def test_refused(wrong: dict[str, Any]) -> None:
    arguments: dict[str, Any] = {"sources": TWO, "seed": 1, "trials": 1000} | wrong
    with pytest.raises(BadInput):
        monte_carlo(both, **arguments)


def spread(low: float, high: float, error: float) -> MonteCarlo:
    q = Spread("q", 0.0, 1.0, (low, high), (low, high), (error, error))
    return MonteCarlo((q,), np.ones((1, 1)), 0.95, 1000, True, 2)


@pytest.mark.parametrize(
    ("low", "high", "error", "verdict"),
    [
        (-1.96, 1.96, 0.01, "agree"),
        (-1.96, 1.90, 0.001, "differ"),
        (-2.05, 1.96, 0.01, "differ"),
        (-1.96, 1.92, 0.02, "undecided"),
        (-2.00, 1.96, 0.02, "undecided"),
        (-1.96, 1.90, 0.02, "undecided"),
        (-1.96, 1.96, math.inf, "undecided"),
    ],
)
def test_verdict_on_the_linear_interval(low: float, high: float, error: float, verdict: str) -> None:
    budget = Budget("q", 0.0, "m", (Contribution(ErrorSource("a", 1.0), 1.0),))
    check = check_linear(budget, spread(low, high, error))
    assert (check.verdict, check.tolerance) == (verdict, 0.05)
    assert (check.low, check.high) == pytest.approx((abs(low + 1.96), abs(high - 1.96)), abs=1e-4)
    json.dumps(check.to_json(), allow_nan=False)


def test_check_finds_its_quantity() -> None:
    found = monte_carlo(both, TWO, seed=1, trials=1000, names=["sum", "product"])
    budgets = linear_budgets(both, TWO, ["sum", "product"], ["m", "m²"])
    assert check_linear(budgets["product"], found).sampled == found["product"].symmetric
    assert check_linear(budgets["product"], found, quantity="sum").sampled == found["sum"].symmetric
    assert check_linear(budgets["sum"], found, interval="shortest").sampled == found["sum"].shortest
    with pytest.raises(BadInput, match="no quantity 'quotient'"):
        check_linear(budgets["sum"], found, quantity="quotient")


def test_differences_of_a_model() -> None:
    group = Group("g", ("x", "y"), ("m", "m"), np.array([[0.04, 0.01], [0.01, 0.09]]))

    def model(e: Array) -> Array:
        return np.column_stack([3 * e[:, 0] - 2 * e[:, 1] + 5 * e[:, 2], np.exp(e[:, 1])])

    budgets = linear_budgets(model, [ErrorSource("a", 0.1), group], ["q", "r"], ["m", ""], step=1e-3)
    assert budgets.sensitivities == pytest.approx(np.array([[3, -2, 5], [0, 1, 0]]), abs=1e-6)
    assert budgets.values == pytest.approx([0, 1])
    for step, sources in ((0.0, TWO), (1.0, [ErrorSource("a", 0.0)]), (1.0, [])):
        with pytest.raises(BadInput):
            linear_budgets(both, sources, ["q", "r"], ["m", "m"], step=step)


def test_second_order_terms_are_exact_for_normal_errors_of_a_quadratic_model() -> None:
    """q = a + 2 b + 3 a² + 5 a b and r = a + a b², whose variance adds 2 u_a² u_b² and a fourth-order term."""
    u, v = 0.3, 0.2
    found = second_order_variance(
        lambda e: np.column_stack(
            [e[:, 0] + 2 * e[:, 1] + 3 * e[:, 0] ** 2 + 5 * e[:, 0] * e[:, 1], e[:, 0] + e[:, 0] * e[:, 1] ** 2]
        ),
        [ErrorSource("a", u), ErrorSource("b", v)],
    )
    assert found[0] == pytest.approx(18 * u**4 + 25 * u**2 * v**2)
    assert found[1] == pytest.approx(2 * u**2 * v**2)  # c_a = 1, c_abb = 2


def test_second_order_terms_with_third_derivatives() -> None:
    """b + b a² (c_b = 1, c_baa = 2) and a + a³ (c_a = 1, c_aaa = 6)."""
    u, v = 0.01, 0.02
    found = second_order_variance(
        lambda e: np.column_stack([e[:, 1] + e[:, 1] * e[:, 0] ** 2, e[:, 0] + e[:, 0] ** 3]),
        [ErrorSource("a", u), ErrorSource("b", v)],
    )
    assert found == pytest.approx([2 * u**2 * v**2, 6 * u**4], rel=1e-3)

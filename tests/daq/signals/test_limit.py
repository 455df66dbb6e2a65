"""End of an approach: limits whose intervals have the stated coverage, for approaches, constant codes and noise."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import daq.signals.limit as limit_module
from daq.signals.limit import ApproachLimit, limit
from daq.signals.rounding import half_width, rounding_covariance, rounding_terms
from tests.count_limits import mean_limit, share_limits, square_limits
from tests.daq.signals.known_motions import WINDOW_S, means, windows
from tests.effort import cases

STEP = 2 * math.pi / 4096

Motion = Callable[[np.ndarray], np.ndarray]


def white(count: int, quantities: int, std: float = 1.0) -> np.ndarray:
    return np.broadcast_to(std**2 * np.eye(count), (quantities, count, count))


def rate(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def one_rate(rng: np.random.Generator) -> list[Motion]:
    slow = rate(rng, 0.07, 0.6)
    return [lambda t, a=a: a * np.exp(-slow * t) for a in 10 * rng.standard_normal(3)]


def two_rates(rng: np.random.Generator) -> list[Motion]:
    slow = rate(rng, 0.1, 0.25)
    fast = rate(rng, 3.0, 6.0) * slow
    both = rng.standard_normal((3, 2)) * [10.0, 300.0]  # σ: the slow one at the end, the fast one 20 s before
    return [lambda t, a=a: a[0] * np.exp(-slow * t) + a[1] * np.exp(-fast * (t + 20.0)) for a in both]


def oscillation(rng: np.random.Generator) -> list[Motion]:
    decay, turn = rate(rng, 0.1, 0.4), rate(rng, 0.3, 2.0)
    both = 3 * rng.standard_normal((3, 2))
    return [lambda t, a=a: np.exp(-decay * t) * (a[0] * np.cos(turn * t) + a[1] * np.sin(turn * t)) for a in both]


def standing(rng: np.random.Generator) -> list[Motion]:
    return [lambda t: 0 * t] * 3


def drawn(kind: Callable[[np.random.Generator], list[Motion]], seed: int) -> tuple[ApproachLimit | None, np.ndarray]:
    """Limits of one draw for three quantities, and the true ones."""
    rng = np.random.default_rng([seed, 7])
    edges = windows(int(rng.integers(15, 31)))
    ends = 100 * rng.standard_normal(3)
    seen = np.stack([means(m, edges) + end for m, end in zip(kind(rng), ends, strict=True)], axis=1)
    return limit(edges, seen + rng.standard_normal(seen.shape), white(len(edges), 3)), ends


@pytest.mark.parametrize("kind", [standing, one_rate, two_rates, oscillation])
def test_intervals_of_95_percent_hold_the_limit(
    kind: Callable[[np.random.Generator], list[Motion]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the share for approaches that are not exponential: here all are exponential."""
    monkeypatch.setattr(limit_module, "MODEL_SHARE", 0.0)
    off, refused, count = [], 0, cases(16, 70)
    for seed in range(count):
        found, ends = drawn(kind, seed)
        if found is None:
            refused += 1
        else:
            off.append((found.values - ends) / np.sqrt(np.diag(found.covariance)))
    z = np.array(off)
    assert refused <= 2 * count / 70
    fewest, most = share_limits(z.size, 210, 0.92, 0.985)
    assert fewest <= np.mean(np.abs(z) < 1.96) <= most
    least, largest = square_limits(z.size, 210, 0.5, 1.4)
    assert least < np.mean(z**2) < largest
    assert abs(np.mean(z)) < mean_limit(z.size, 210, 0.25)


@pytest.mark.parametrize("noise_steps", [0.0, 0.1, 0.3])
def test_intervals_hold_the_limit_of_a_rounded_angle(noise_steps: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The rounding error is common to windows with a constant code: a mean over windows does not reduce it."""
    monkeypatch.setattr(limit_module, "MODEL_SHARE", 0.0)
    edges, off, claimed = windows(20), [], []
    for seed in range(cases(20, 100)):
        rng = np.random.default_rng([seed, 11])
        end, slow, left = rng.uniform(-2, 2, 2), rate(rng, 0.1, 0.3), 2 * STEP * rng.standard_normal(2)
        seen = np.empty((20, 2))
        for j in (0, 1):
            t = edges[:, :1] + WINDOW_S * np.linspace(0, 1, 1000) - edges[-1, 1]
            codes = (end[j] + left[j] * np.exp(-slow * t)) / STEP + noise_steps * rng.standard_normal(t.shape)
            seen[:, j] = STEP * np.round(codes).mean(axis=1)
        terms = rounding_terms(STEP, noise_steps)
        own = (noise_steps**2 + 1 / 12) / 1000 * STEP**2 * np.eye(20)
        noise = np.stack([own + rounding_covariance(terms, STEP, column) for column in seen.T])
        found = limit(edges, seen, noise)
        std = np.sqrt(np.diag(found.covariance))
        off.append((found.values - end) / std)
        claimed.append(std / STEP)
    z = np.array(off)
    print(noise_steps, np.mean(np.abs(z) < 1.96), np.mean(z**2), np.median(claimed))
    assert np.mean(np.abs(z) < 1.96) >= share_limits(z.size, 200, 0.92)[0]
    assert np.mean(z**2) < square_limits(z.size, 200, 0.0, 1.3)[1]
    assert np.median(claimed) < 0.4


def test_a_standing_code_leaves_a_step_over_root_twelve_however_long_it_stands() -> None:
    for count in (9, 30):
        seen = np.full((count, 1), 1.25)
        noise = rounding_covariance(rounding_terms(STEP, 0.0), STEP, seen[:, 0])[None]
        found = limit(windows(count), seen, noise)
        assert found.values[0] == pytest.approx(1.25, abs=0.2 * STEP)
        assert 0.98 < math.sqrt(found.covariance[0, 0]) / (STEP / math.sqrt(12)) < 2.0


@settings(max_examples=cases(20, 40))
@given(st.floats(0, 0.5), st.floats(0, 3))
def test_the_deviation_of_rounding_is_that_of_rounding_itself(noise: float, ripple: float) -> None:
    """Over all positions between two codes; the rms over neighbouring ripples, and never above the largest error."""
    terms = rounding_terms(1.0, noise, ripple)
    turn = ripple * np.cos(2 * np.pi * np.arange(200) / 200)
    spread = noise * np.sqrt(2) * np.array([float(x) for x in _normal_quantiles(101)])
    exact = turn[:, None] + spread
    errors = [np.mean(np.round(exact + at)) - at for at in np.linspace(0, 1, 41)[:-1]]
    assert (
        np.std(errors) <= 1.05 * math.sqrt(0.5 * float(np.sum(terms**2))) * math.sqrt(2 if ripple > 0.2 else 1) + 0.02
    )
    assert math.sqrt(0.5 * float(np.sum(terms**2))) <= half_width(1.0, noise, ripple) + 1e-9


def _normal_quantiles(count: int) -> np.ndarray:
    from scipy.special import erfinv

    return erfinv(2 * (np.arange(count) + 0.5) / count - 1)


@settings(max_examples=cases(5, 15))
@given(st.integers(0, 50), st.floats(-1e3, 1e3), st.floats(-3, 3).map(lambda p: 10.0**p))
def test_shifted_and_scaled_data_shift_and_scale_the_answer(seed: int, shift: float, scale: float) -> None:
    rng = np.random.default_rng(seed)
    edges = windows(12)
    seen = np.stack([means(motion, edges) for motion in one_rate(rng)[:2]], axis=1)
    seen += rng.standard_normal(seen.shape)
    first, second = limit(edges, seen, white(12, 2)), limit(edges, scale * seen + shift, white(12, 2, scale))
    assert (first is None) == (second is None)
    if first is not None and second is not None:
        std = np.sqrt(np.diag(first.covariance))
        assert np.abs((second.values - shift) / scale - first.values) / std == pytest.approx(0, abs=0.05)
        assert np.sqrt(np.diag(second.covariance)) / scale == pytest.approx(std, rel=0.1)


@pytest.mark.parametrize("growth", [lambda t: 2.0 * t, lambda t: 30 * np.exp(0.2 * t), lambda t: 30 * np.exp(0.6 * t)])
@pytest.mark.parametrize("count", [12, 30])
def test_a_straight_line_and_growth_have_no_limit(growth: Motion, count: int) -> None:
    edges = windows(count)
    for seed in range(cases(1, 4)):
        rng = np.random.default_rng(seed)
        seen = np.stack([means(growth, edges), -0.5 * means(growth, edges)], axis=1)
        assert limit(edges, seen + rng.standard_normal(seen.shape), white(count, 2)) is None


def test_means_that_wander_beyond_their_noise_are_refused_or_widened() -> None:
    edges, rng = windows(20), np.random.default_rng(2)
    outliers = rng.standard_normal((20, 2))
    assert limit(edges, outliers, white(20, 2, 0.1)) is None
    wider = limit(edges, outliers, white(20, 2, 0.5))
    assert np.all(wider.scatter > 1.5)


def test_an_approach_that_is_extrapolated_costs_its_share() -> None:
    """15 % of the remaining change, since an approach is exponential only near its end."""
    edges = windows(20)
    seen = np.stack([means(lambda t: 50 * np.exp(-0.2 * t), edges)] * 2, axis=1)
    found = limit(edges, seen, white(20, 2, 0.1))
    assert found.to_come == pytest.approx([-50, -50], rel=0.02)
    assert found.model == "one rate"
    assert found.rate_per_s == pytest.approx(0.2, rel=0.05)
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx(0.15 * 50, rel=0.1)


@pytest.mark.parametrize("window_s", [0.2, 12.0, 60.0])
@pytest.mark.parametrize("noise", [1e-9, 1.0])
def test_slow_rotors_and_signals_without_noise_leave_finite_numbers(window_s: float, noise: float) -> None:
    edges = windows(30) * window_s / WINDOW_S
    seen = np.stack([means(lambda t: 5 * np.exp(-0.2 * t / window_s), edges), np.full(30, 2.0)], axis=1)
    found = limit(edges, seen, white(30, 2, noise))
    if found is not None:
        assert np.all(np.isfinite(found.values))
        assert np.all(np.diag(found.covariance) > 0)
    standing_still = limit(edges, np.full((30, 2), 2.0), white(30, 2, noise))
    assert standing_still.values == pytest.approx([2.0, 2.0], abs=noise)


def test_what_moves_late_may_be_little() -> None:
    """A slow part of a hundredth of the change, which is not significant, is in the covariance of the limits."""
    rng, z = np.random.default_rng(21), list[float]()
    edges = np.arange(30.0)[:, None] + [0.0, 1.0]
    t = edges.mean(axis=1)
    for _ in range(cases(8, 25)):
        fast, slow = rng.standard_normal(4), 0.015 * rng.standard_normal(4)
        means = np.exp(-0.19 * t)[:, None] * fast + np.exp(-0.08 * t)[:, None] * slow
        means = means + 2e-3 * rng.standard_normal(means.shape)
        found = limit(edges, means, np.tile(4e-6 * np.eye(30), (4, 1, 1)))
        z += list(found.values / np.sqrt(np.diag(found.covariance)))
    assert np.mean(np.square(z)) < 4.0  # 9 if a slow part is expected to be as large as the whole motion


def test_what_is_not_exponential_yet_does_not_pull_the_limit() -> None:
    """θ' = −λ sin θ from 0.1 rad: the square of the approach hardly changes χ² of 30 windows, but shifts the limit."""
    far = 0
    for seed in range(cases(10, 40)):
        rng = np.random.default_rng([seed, 11])
        edges = windows(30)
        towards = rng.uniform(0, 2 * math.pi)

        def angle(t: np.ndarray) -> np.ndarray:
            return 2 * np.arctan(math.tan(0.05) * np.exp(-0.19 * (t + 30 * WINDOW_S)))

        directions = (math.cos(towards), math.sin(towards))
        motions = [lambda t, d=d: 6800 * d * np.sin(angle(t)) for d in directions]
        motions += [lambda t, d=d: 6800 * d * (1 - np.cos(angle(t))) for d in directions]
        seen = np.stack([means(m, edges) for m in motions], axis=1)
        found = limit(edges, seen + rng.standard_normal(seen.shape), white(30, 4))
        far += found.values @ np.linalg.solve(found.covariance, found.values) > 14.9  # 0.5 % of cases
    assert far <= cases(0, 1)


def test_a_square_of_the_size_expected_does_not_pull_the_limit() -> None:
    """m∞ + a u + b u², the same b each time as at a point: too little for χ², enough to shift the limit."""
    edges, size, square = windows(30), np.array([400.0, 400.0, 30.0, 140.0]), np.array([1.0, 1.0, -5.0, 4.0])

    def expected(stretch: np.ndarray) -> np.ndarray:
        return np.full(4, 8.0 * (np.ptp(stretch[:, 0]) / 400.0) ** 2)

    pulled = {"looked for": list[np.ndarray](), "not": list[np.ndarray]()}
    for seed in range(cases(12, 40)):
        rng = np.random.default_rng([seed, 31])
        slow = rate(rng, 0.18, 0.22)
        motions = [
            lambda t, a=a, b=b, s=slow: a * np.exp(-s * (t + 30.6)) + b * np.exp(-2 * s * (t + 30.6))
            for a, b in zip(size, square, strict=True)
        ]
        seen = np.stack([means(m, edges) for m in motions], axis=1)
        seen = seen + rng.standard_normal(seen.shape)
        for name, bends in (("looked for", expected), ("not", None)):
            found = limit(edges, seen, white(30, 4), bends)
            pulled[name].append(found.values / np.sqrt(np.diag(found.covariance)))
    z = np.array(pulled["looked for"])
    assert np.abs(z.mean(axis=0)).max() < mean_limit(len(z), 40, 0.4)
    assert np.mean(np.abs(z) < 1.96) > share_limits(z.size, 160, 0.92)[0]
    assert np.abs(np.mean(pulled["not"], axis=0)).max() > 0.7


def test_no_square_is_looked_for_where_its_size_is_zero() -> None:
    edges = windows(20)
    seen = np.stack([means(lambda t, a=a: a * np.exp(-0.2 * t), edges) for a in (3.0, -2.0)], axis=1)
    seen = seen + np.random.default_rng(5).standard_normal(seen.shape)
    with_none, without = limit(edges, seen, white(20, 2), lambda _: np.zeros(2)), limit(edges, seen, white(20, 2))
    assert with_none.values == pytest.approx(without.values, abs=1e-3)
    assert with_none.covariance == pytest.approx(without.covariance, rel=1e-2, abs=1e-3)

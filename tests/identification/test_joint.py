"""Joint estimate: false alarms, detection, robustness against one bad log, coverage if the bad log is unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import binom
from synthetic import Campaign

from identification import Estimate, NotIdentifiable, combine, identify
from identification.joint import joint_estimate
from identification.joint.agreement import verdict
from rig_configs.error_label import ErrorLabel
from rig_configs.parameters_file import PARAMETER_UNITS
from tests.effort import cases

TRUTH = {
    "k1_N_per_m": 2616.65,
    "k2_N_per_m": 38141.4,
    "zeta1": 0.0208,
    "zeta2": 0.0193,
    "c3_Nms_per_rad": 0.00104,
    "c4_Nms_per_rad": 0.00097,
    "SP_kg_m": 0.00255,
}
# relative own standard deviations, as the fits of these tests have them
OWN = {
    "ring-down-x": {"k1_N_per_m": 3e-6, "zeta1": 8e-5, "k2_N_per_m": 6e-5, "zeta2": 2e-3},
    "ring-down-y": {"k1_N_per_m": 5e-5, "zeta1": 1.5e-3, "k2_N_per_m": 5e-6, "zeta2": 1e-4},
    "run-up": {"k1_N_per_m": 2e-5, "zeta1": 4e-4, "k2_N_per_m": 4e-5, "zeta2": 8e-4, "SP_kg_m": 1e-4},
    "spin-down": {"c3_Nms_per_rad": 1e-3, "c4_Nms_per_rad": 1.2e-3},
    "point-E": {"c3_Nms_per_rad": 5e-4, "c4_Nms_per_rad": 6e-4},
}
CAMPAIGN = ("ring-down-x", "ring-down-y", "run-up", "spin-down", "point-E")


def draw(
    rng: np.random.Generator,
    tests: tuple[str, ...] = CAMPAIGN,
    heavy_tails: bool = False,
    gains: np.ndarray | None = None,
) -> tuple[list[Estimate], np.ndarray]:
    """Estimates of one rig: correlated own errors, a gain common to all, clocks of each log."""
    gains = 1e-3 * rng.standard_normal(2) if gains is None else gains
    out = []
    for number, test in enumerate(tests):
        names = tuple(OWN[test])
        true = np.array([TRUTH[n] for n in names])
        std = true * np.array(list(OWN[test].values()))
        mix = rng.standard_normal((len(names), len(names) + 2))
        own = mix @ mix.T
        own = own / np.sqrt(np.outer(np.diag(own), np.diag(own))) * np.outer(std, std)
        noise = np.linalg.cholesky(own) @ rng.standard_normal(len(names))
        if heavy_tails:
            noise *= np.sqrt(8 / rng.chisquare(10))
        shared: dict[ErrorLabel, np.ndarray] = {}
        values = true + noise
        for device, k in (("laser_x", "k1_N_per_m"), ("laser_y", "k2_N_per_m")):
            shift = np.array([2 * 3e-6 * TRUTH[n] if n == k else 0.0 for n in names])
            if shift.any():
                label = ErrorLabel("clock", "encoder") if test == "run-up" else ErrorLabel("clock", device)
                shared[label] = shared.get(label, 0) + shift
                values = values + shift * rng.standard_normal()
        if test == "run-up":
            for i, axis in enumerate("xy"):
                shift = np.array([0.5e-3 * TRUTH[n] if n == "SP_kg_m" else 0.0 for n in names])
                shared[ErrorLabel("gain", axis)] = shift
                values = values + shift * gains[i] / 1e-3
        out.append(Estimate(test, (f"{number:02d}-{test}.mcap",), names, values, own, shared))
    return out, np.array([TRUTH[n] for n in PARAMETER_UNITS])


def spoilt(estimates: list[Estimate], index: int, name: str, share: float) -> list[Estimate]:
    """The same with one value of one test off by a share."""
    out = list(estimates)
    values = out[index].values.copy()
    values[out[index].names.index(name)] *= 1 + share
    out[index] = replace(out[index], values=values)
    return out


@pytest.mark.parametrize("tests", [CAMPAIGN, ("ring-down-x",) * 3 + ("run-up",) * 2, ("spin-down",) * 2 + ("point-E",)])
def test_good_sets_are_seldom_called_bad(tests: tuple[str, ...]) -> None:
    """The stated chance is 0.2 %."""
    rng, count = np.random.default_rng(20261121), cases(200, 1000)
    alarms = sum(verdict(draw(rng, tests)[0]).alarm for _ in range(count))
    assert alarms <= binom.isf(1e-5, count, 0.002)


def test_somewhat_heavier_tails_do_not_flood_with_alarms() -> None:
    """Student's t with ten degrees of freedom, of the same variance."""
    rng, count = np.random.default_rng(7), cases(200, 1000)
    assert sum(verdict(draw(rng, heavy_tails=True)[0]).alarm for _ in range(count)) <= binom.isf(1e-5, count, 0.007)


def test_detection_power_over_the_size_of_a_fault() -> None:
    """One of three equal tests off by a number of its own standard deviations: detected and correctly named."""
    rng = np.random.default_rng(3)
    seen, count = {}, cases(100, 300)
    for size in (6.0, 8.0, 12.0):
        named = alarms = 0
        for _ in range(count):
            sets, _ = draw(rng, ("spin-down",) * 4)
            found = verdict(spoilt(sets, 2, "c3_Nms_per_rad", size * 1e-3))
            alarms += found.alarm
            named += found.alarm and found.suspects == (2,)
        seen[size] = (alarms / count, named / count)
    assert seen[6.0][0] > 0.7
    assert seen[8.0] >= (0.99, 0.9)
    assert seen[12.0] == (1.0, 1.0)


@pytest.mark.parametrize(
    ("tests", "index", "name", "share"),
    [
        (("ring-down-x", "ring-down-x", "ring-down-y", "run-up", "run-up"), 0, "k1_N_per_m", 0.03),
        (("ring-down-x", "ring-down-x", "ring-down-y", "run-up", "run-up"), 4, "k2_N_per_m", 0.03),
        (("ring-down-x", "ring-down-y", "run-up", "run-up", "run-up"), 3, "SP_kg_m", 0.05),  # a laser 10 % off
        (("spin-down", "spin-down", "point-E"), 2, "c4_Nms_per_rad", -0.1),
        (CAMPAIGN, 1, "k2_N_per_m", 0.002),
    ],
)
def test_one_bad_log_is_named_and_does_not_drag_the_result(
    tests: tuple[str, ...], index: int, name: str, share: float
) -> None:
    rng = np.random.default_rng(index)
    outside, count = 0, cases(15, 60)
    for _ in range(count):
        good, true = draw(rng, tests)
        found = joint_estimate(spoilt(good, index, name, share))
        assert list(found.left_out) == [index]
        assert any(good[index].source in w and name in w and "left out" in w for w in found.warnings)
        at = list(PARAMETER_UNITS).index(name)
        value, std = found.parameters.values[name], found.parameters.std[name]
        outside += abs(value - true[at]) > 1.96 * std
        without = combine([e for i, e in enumerate(good) if i != index])[0]
        assert value == pytest.approx(without.values[name], abs=1e-6 * std)
        assert std <= 2.2 * without.std[name]
    assert outside <= binom.isf(2e-3, count, 0.05)


def test_of_five_recordings_the_bad_one_is_left_out() -> None:
    """A log with k 3 % off, then one with laser x 10 % off, among five whole recordings."""
    campaign = Campaign(6)
    runs = [campaign.ring_down("x"), campaign.ring_down("y"), *(campaign.run_up() for _ in range(3))]
    runs = [replace(run, source=f"{i:02d}-{run.test}.mcap") for i, run in enumerate(runs)]
    good = identify(runs, campaign.rig)
    assert not any("disagree" in w for w in good.warnings)
    true, stretch = campaign.truth.identified(), 1.03**-0.5
    stiff = replace(
        runs[0], source="stiff.mcap", x_time_s=runs[0].x_time_s * stretch, y_time_s=runs[0].y_time_s * stretch
    )
    loud = replace(runs[3], source="loud.mcap", x_m=1.1 * runs[3].x_m)
    # the stiff log contradicts the others; the loud one contradicts itself, so that its S_P has hardly any weight
    for index, bad, words in (
        (0, stiff, ("disagree", "k1_N_per_m", "left out")),
        (3, loud, ("more apart than their gains permit", "S_P")),
    ):
        found = identify([*runs[:index], bad, *runs[index + 1 :]], campaign.rig, earlier=good)
        (warning,) = [w for w in found.warnings if words[0] in w]
        assert bad.source in warning
        assert all(word in warning for word in words)
        for parameter, value in found.parameters.values.items():
            assert abs(value - true[parameter]) < 4 * found.parameters.std[parameter]
            assert found.parameters.std[parameter] < 1e-3 * true[parameter]


def test_what_only_the_bad_log_shows_is_kept_and_reported() -> None:
    good, _ = draw(np.random.default_rng(1))
    found = joint_estimate(spoilt(good, 2, "k1_N_per_m", 0.03))
    assert found.left_out.keys() == {2}
    assert found.parameters.values["SP_kg_m"] == pytest.approx(good[2].value("SP_kg_m"), rel=1e-12)
    assert any("SP_kg_m of it is kept" in w for w in found.warnings)


def test_of_two_that_disagree_both_are_named_and_the_interval_covers_both() -> None:
    a, b = draw(np.random.default_rng(2), ("spin-down", "point-E"))[0]
    b = spoilt([b], 0, "c3_Nms_per_rad", 0.03)[0]
    found = joint_estimate([a, b])
    value, std = found.parameters.values["c3_Nms_per_rad"], found.parameters.std["c3_Nms_per_rad"]
    (warning,) = found.warnings
    assert a.source in warning
    assert b.source in warning
    assert not found.left_out
    for one in (a, b):
        assert abs(one.value("c3_Nms_per_rad") - value) < 1.96 * std
    # what they agree on stays sharp
    assert found.parameters.std["c4_Nms_per_rad"] < 0.9e-3 * TRUTH["c4_Nms_per_rad"]


def test_two_camps_of_two_are_not_decided() -> None:
    tests = draw(np.random.default_rng(4), ("spin-down",) * 4)[0]
    tests = spoilt(spoilt(tests, 0, "c3_Nms_per_rad", 0.03), 1, "c3_Nms_per_rad", 0.03)
    found = joint_estimate(tests)
    assert not found.left_out
    value, std = found.parameters.values["c3_Nms_per_rad"], found.parameters.std["c3_Nms_per_rad"]
    assert all(abs(t.value("c3_Nms_per_rad") - value) < 1.96 * std for t in tests)


def test_a_majority_must_remain() -> None:
    """Two of five bad in different ways are both found; three of five are not all left out."""
    rng = np.random.default_rng(5)
    tests = draw(rng, ("spin-down",) * 5)[0]
    two = spoilt(spoilt(tests, 0, "c3_Nms_per_rad", 0.05), 3, "c3_Nms_per_rad", -0.08)
    assert joint_estimate(two).left_out.keys() == {0, 3}
    three = spoilt(two, 4, "c3_Nms_per_rad", 0.2)
    assert len(joint_estimate(three).left_out) <= 2


def test_weights_reproduce_the_values_and_a_direct_minimum() -> None:
    good, _ = draw(np.random.default_rng(6), ("spin-down", "point-E", "spin-down"))
    found = joint_estimate(good)
    again = sum(w @ e.values for w, e in zip(found.weighted.pulls, good, strict=True))
    assert again == pytest.approx(list(found.parameters.values.values()), rel=1e-12)
    start = np.array([TRUTH["c3_Nms_per_rad"], TRUTH["c4_Nms_per_rad"]])

    def cost(x: np.ndarray) -> float:
        rest = [e.values - start * (1 + 1e-3 * x) for e in good]
        return sum(float(r @ np.linalg.solve(e.total_covariance, r)) for r, e in zip(rest, good, strict=True))

    best = start * (1 + 1e-3 * minimize(cost, [0.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-9}).x)
    assert again == pytest.approx(best, rel=1e-9)


def test_shared_gain_stays_and_own_errors_average_out() -> None:
    tests = [
        Estimate(
            "run-up",
            (f"{i}",),
            ("SP_kg_m",),
            np.array([2.5e-3]),
            np.array([[1e-14]]),
            {ErrorLabel("gain", "laser_x"): np.array([1e-6])},
        )
        for i in range(4)
    ]
    found = joint_estimate(tests)
    assert found.weighted.shared[ErrorLabel("gain", "laser_x")] == pytest.approx([1e-6])
    assert np.sqrt(found.weighted.own[0, 0]) == pytest.approx(1e-7 / 2)


def test_nothing_and_singular_are_refused() -> None:
    with pytest.raises(NotIdentifiable, match="no test"):
        combine([])
    bad = Estimate("run-up", ("a.mcap",), ("zeta1", "zeta2"), np.array([0.02, 0.02]), np.zeros((2, 2)))
    with pytest.raises(NotIdentifiable, match=r"a\.mcap.*singular"):
        combine([bad])

"""Comparison of two parameter sets with few numbers: every result has a value that follows from the definitions."""

from __future__ import annotations

import math

import numpy as np
import pytest

from identification.compare import Change, ParameterComparison, _whitened, compare_parameters
from identification.difference import ParameterDifference
from identification.errors import NotIdentifiable
from rig_configs import IdentifiedParameters

K1, K2, ZETA1 = 2600.123456789012, 38000.98765432101, 0.02034567890123457  # all digits, as files have them


def change(name: str, old: float, by: float, std: float, p: float, share: float = 0.0) -> Change:
    return Change(name, old, old + by, by, std, by / std if std else 0.0, p, p, share)


def comparison(*changes: Change, p: float = 1.0) -> ParameterComparison:
    n = len(changes)
    return ParameterComparison(list(changes), np.eye(n), 1.0, n, p, [], [], [])


def compared(old: dict[str, float], new: dict[str, float], variances: list[float]) -> ParameterComparison:
    """Two independent estimates with the same variances."""
    return compare_parameters(*(IdentifiedParameters(values, np.diag(variances)) for values in (old, new)))


@pytest.mark.parametrize(
    ("p_holm", "level"),
    [(0.0, 0.001), (0.00099, 0.001), (0.001, 0.01), (0.0099, 0.01), (0.01, 0.05), (0.049, 0.05), (0.05, None)],
)
def test_the_level_is_the_strictest_that_is_met(p_holm: float, level: float | None) -> None:
    assert change("zeta1", 0.02, 0.001, 1e-4, p_holm).level == level


def test_a_relative_change_is_over_the_size_of_the_old_value() -> None:
    falling = change("zeta1", -4.0, -1.0, 0.5, 0.1)
    assert (falling.relative, falling.relative_std) == (-0.25, 0.125)
    from_zero = change("c3_Nms_per_rad", 0.0, 1.0, 0.5, 0.1)
    assert math.isnan(from_zero.relative)
    assert math.isnan(from_zero.relative_std)


def test_significant_changes_are_below_the_level_and_the_strongest_is_first() -> None:
    found = comparison(
        change("k1_N_per_m", 2.0, 1.0, 0.1, 0.005),
        change("k2_N_per_m", 2.0, 1.0, 0.1, 0.001),
        change("zeta1", 2.0, 1.0, 0.1, 0.01),
        change("zeta2", 2.0, 1.0, 0.1, 0.04),
    )
    assert [c.name for c in found.significant()] == ["k2_N_per_m", "k1_N_per_m"]
    assert [c.name for c in found.significant(0.05)] == ["k2_N_per_m", "k1_N_per_m", "zeta1", "zeta2"]


@pytest.mark.parametrize(
    ("of", "text"),
    [
        (
            (change("k1_N_per_m", 2000.0, 20.0, 1.0, 1e-9), change("zeta1", 0.02, -0.001, 2e-5, 1e-8)),
            "k1 grew by 1.000 ± 0.050 % and zeta1 fell by 5.00 ± 0.10 %",
        ),
        (
            (
                change("k1_N_per_m", 2000.0, 20.0, 1.0, 1e-9),
                change("k2_N_per_m", 100.0, -30.0, 2.0, 1e-8),
                change("c3_Nms_per_rad", 0.0, -0.0012, 2e-5, 1e-7),
                change("zeta1", 0.02, 0.0, 1e-4, 0.01),
            ),
            "k1 grew by 1.000 ± 0.050 %, k2 fell by 30.0 ± 2.0 % and c3 fell by 0.0012 ± 2e-05; "
            "nothing else changed significantly",
        ),
        ((change("k1_N_per_m", 100.0, 1000.0, 25.0, 1e-9),), "k1 grew by 1000 ± 25 %"),
        ((change("k1_N_per_m", 100.0, 1.0, 0.0, 0.0),), "k1 grew by 1.000000 ± 0.000000 %"),
        ((change("k1_N_per_m", 100.0, 1.0, 1.0, 0.01),), "nothing changed significantly"),
    ],
)
def test_significant_changes_in_one_sentence(of: tuple[Change, ...], text: str) -> None:
    assert comparison(*of, p=0.01).in_words() == text


def test_a_change_of_all_together_is_described_by_its_largest_shares() -> None:
    parts = (
        change("k1_N_per_m", 2000.0, 0.5, 2.0, 0.3, 0.21),
        change("k2_N_per_m", 2000.0, -0.5, 2.0, 0.3, 0.5),
        change("zeta1", 0.02, -1e-5, 2e-5, 0.3, 0.2),
        change("zeta2", 0.02, 1e-5, 2e-5, 0.3, 0.09),
    )
    found = comparison(*parts, p=0.0034)
    assert found.in_words() == (
        "no single parameter changed significantly, but all together they did (p = 0.003), "
        "mostly along k2 down by 0.03 ± 0.10 % and k1 up by 0.03 ± 0.10 %"
    )
    assert found.in_words(0.001) == comparison(*parts, p=0.01).in_words() == "nothing changed significantly"


def test_independent_changes_have_the_chi_square_of_their_z() -> None:
    """Variances of 1/2 in each estimate: a change of 3 and one of −4 standard deviations, χ² = 25, p = e^(−25/2)."""
    old = IdentifiedParameters({"k1_N_per_m": K1, "k2_N_per_m": K2}, np.diag([0.5, 2.0]))
    new = IdentifiedParameters({"k2_N_per_m": K2 - 8.0, "k1_N_per_m": K1 + 3.0}, np.diag([2.0, 0.5]))
    found = compare_parameters(old, new)
    assert [c.name for c in found.changes] == ["k1_N_per_m", "k2_N_per_m"]
    assert [c.std for c in found.changes] == pytest.approx([1.0, 2.0])
    assert [c.z for c in found.changes] == pytest.approx([3.0, -4.0])
    assert [c.p for c in found.changes] == pytest.approx([0.0026997960632601866, 6.334248366623996e-05], rel=1e-6)
    assert [c.p_holm for c in found.changes] == pytest.approx([0.0026997960632601866, 1.2668496733247992e-04], rel=1e-6)
    assert [c.share for c in found.changes] == pytest.approx([9 / 25, 16 / 25])
    assert (found.chi2, found.dof) == (pytest.approx(25.0), 2)
    assert found.p == pytest.approx(math.exp(-12.5))


def test_small_changes_have_shares_too() -> None:
    found = compared({"k1_N_per_m": K1, "k2_N_per_m": K2}, {"k1_N_per_m": K1 + 0.3, "k2_N_per_m": K2 - 0.4}, [0.5, 0.5])
    assert found.chi2 == pytest.approx(0.25)
    assert [c.share for c in found.changes] == pytest.approx([9 / 25, 16 / 25])


def test_parameters_of_one_set_only_are_named() -> None:
    old = IdentifiedParameters({"zeta2": ZETA1, "k1_N_per_m": K1, "zeta1": ZETA1}, np.diag([1e-10, 0.5, 1e-10]))
    new = IdentifiedParameters({"SP_kg_m": ZETA1, "k2_N_per_m": K2, "k1_N_per_m": K1 + 2.0}, np.diag([1.0, 1.0, 0.5]))
    found = compare_parameters(old, new)
    assert (found.only_old, found.only_new) == (["zeta2", "zeta1"], ["SP_kg_m", "k2_N_per_m"])
    (only,) = found.changes
    assert (only.old, only.new, only.std) == (K1, K1 + 2.0, pytest.approx(1.0))
    assert (found.chi2, found.dof) == (pytest.approx(4.0), 1)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ({"zeta2": 0.01}, {"k1_N_per_m": K1, "zeta1": 0.02}, "OLD has zeta2, NEW has k1_N_per_m, zeta1; identify both"),
        ({}, {}, "nothing to compare: OLD has no parameter, NEW has none; identify both"),
    ],
)
def test_estimates_without_a_common_parameter_are_refused(
    old: dict[str, float], new: dict[str, float], text: str
) -> None:
    sets = [IdentifiedParameters(values, np.zeros((len(values), len(values)))) for values in (old, new)]
    with pytest.raises(NotIdentifiable, match=text):
        compare_parameters(*sets)


def test_a_change_of_an_exact_value_has_no_significance() -> None:
    found = compared(
        {"k1_N_per_m": K1, "k2_N_per_m": K2, "zeta1": ZETA1},
        {"k1_N_per_m": K1 + 2.0, "k2_N_per_m": K2 + 9.0, "zeta1": ZETA1},
        [0.5, 0.0, 1e-9],
    )
    assert [(c.std, c.z, c.p) for c in found.changes][1] == (0.0, 0.0, 1.0)
    assert (found.chi2, found.dof) == (pytest.approx(4.0), 2)
    assert found.notes[-1] == "1 of 3 directions rest on the same logs both times: no change there"
    exact = compared({"k1_N_per_m": K1, "zeta1": ZETA1}, {"k1_N_per_m": K1, "zeta1": 0.1 * ZETA1}, [0.0, 0.0])
    assert (exact.chi2, exact.dof, exact.p) == (0.0, 0, 1.0)
    assert exact.in_words() == "nothing changed significantly"


def test_directions_without_a_change_are_counted_if_there_are_any() -> None:
    old, new = {"k1_N_per_m": K1, "k2_N_per_m": K2}, {"k1_N_per_m": K1 + 2.0, "k2_N_per_m": K2}
    assert not any("directions" in note for note in compared(old, new, [0.5, 2.0]).notes)
    assert compared(old, new, [0.5, 0.0]).notes[-1].startswith("1 of 2 directions")


@pytest.mark.parametrize(("share", "rank"), [(0.09, 0), (0.11, 2)])
def test_a_direction_is_known_above_the_blur(share: float, rank: int) -> None:
    """Variance of a change over that of two independent estimates, which are correlated."""
    own = np.array([[1.0, 0.6], [0.6, 1.0]])
    assert _whitened(np.ones(2), share * own, own, 0.1)[1] == rank


def test_the_blur_of_a_variance_is_that_of_the_deviation_squared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Deviations of 0.1 of those of two independent estimates, for a blur of 0.09 and 0.11."""
    old, new = (
        IdentifiedParameters({"k1_N_per_m": K1, "k2_N_per_m": K2 + more}, np.diag([0.5, 0.5])) for more in (0.0, 1.0)
    )
    for blur, rank in ((0.09, 2), (0.11, 0)):
        apart = ParameterDifference(("k1_N_per_m", "k2_N_per_m"), 0.01 * np.eye(2), blur, [])
        monkeypatch.setattr("identification.compare.difference", lambda *given, apart=apart: apart)
        assert compare_parameters(old, new).dof == rank


@pytest.mark.parametrize(("k1", "rounded"), [(26123456789.1, False), (2612345678.9, True)])
def test_values_of_twelve_digits_are_not_rounded(k1: float, rounded: bool) -> None:
    values = {"k1_N_per_m": k1, "zeta1": 0.02}
    assert (compared(values, values, [0.0, 0.0]).dof > 0) is rounded


@pytest.mark.parametrize(
    ("k1", "zeta1", "steps"),
    [
        (2612.3, 0.020311, (0.1, 1e-6)),  # five digits
        (2612.0, 0.0203, (1.0, 1e-5)),  # four
        (1000.0, 0.00099, (100.0, 1e-5)),  # two, and the zeros of 1000 are not counted
        (26123456789.1, 0.02, (0.1, 1e-12)),  # twelve: not rounded
        (2612345678.9, 0.02, (0.1, 1e-12)),  # eleven
        (1.5e-7, 0.02, (1e-8, 1e-3)),
        (0.0, 0.0211, (1e-2, 1e-4)),  # a zero has the size 1
    ],
)
def test_values_with_few_digits_have_the_uncertainty_of_their_rounding(
    k1: float, zeta1: float, steps: tuple[float, float]
) -> None:
    """A rounded value is uniform within its last digit: variance of a twelfth of the square of that digit."""
    values = {"k1_N_per_m": k1, "zeta1": zeta1}
    found = compared(values, values, [1e-18 * k1**2, 1e-30])
    whole = len(str(int(k1))) > 10
    expected = [0.0, 0.0] if whole else [math.sqrt(2 / 12) * step for step in steps]
    own = [math.sqrt(2) * 1e-9 * k1, math.sqrt(2) * 1e-15]
    assert [c.std for c in found.changes] == pytest.approx(np.hypot(expected, own).tolist(), rel=1e-6)


def test_a_single_number_may_be_round_by_chance() -> None:
    found = compared({"k1_N_per_m": 2600.0}, {"k1_N_per_m": 2601.0}, [0.5])
    assert found.changes[0].std == pytest.approx(1.0)

"""Recommendations from made-up rows: worth it, not worth it, undecided."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, strategies as st

from dynamics.bench.recommendations import recommended_accuracies
from dynamics.bench.records import Measurement
from dynamics.bench.tables import markdown
from identification.bench import tables
from identification.bench.recommendations import recommended_settings
from identification.bench.trials import Precision


def row(setting: str, seconds: float, error: float, runs: int = 100, gross: int = 0, case: str = "c") -> Precision:
    return Precision("ring-down", case, "fit", setting, False, seconds, runs, gross, {"f": error}, {}, {})


def measured(
    accuracy: float, seconds: float, error: float | None, case: str = "c", ratio: float | None = None
) -> Measurement:
    return Measurement(
        "motion",
        case,
        "explicit",
        f"accuracy {accuracy:.0e}, 8 steps",
        seconds,
        "run",
        error,
        automatic=True,
        accuracy=accuracy,
        peer_ratio=ratio,
    )


def test_a_dearer_setting_that_is_no_more_exact_is_not_recommended() -> None:
    rows = [row("fast", 1.0, 1.02), row("balanced", 2.0, 1.0), row("reference", 9.0, 0.99)]
    (found,) = recommended_settings(rows)
    assert (found.setting, found.decided) == ("fast", True)
    assert found.text.startswith("ring-down: take fast; balanced takes 2 times the time of fast and is at most ")
    assert "reference takes 9 times the time of fast and is at most 1.3 times as exact (1 case of 100" in found.text
    assert found.figures["reference"] == {
        "time": 4.5,
        "error": (pytest.approx(0.99), pytest.approx(0.99)),
        "records": 100,
    }


def test_a_dearer_setting_that_is_more_exact_is_recommended() -> None:
    rows = [row("fast", 1.0, 3.0), row("balanced", 2.0, 2.0), row("reference", 9.0, 1.0)]
    (found,) = recommended_settings(rows)
    assert found.setting == "reference"
    assert "balanced takes 2 times the time of fast and has errors up to 1.5 times smaller" in found.text
    assert "reference takes 4.5 times the time of balanced and has errors up to 2 times smaller" in found.text


def test_one_case_in_which_it_is_more_exact_is_enough() -> None:
    rows = [
        row(s, t, e, case=c)
        for c, e_slow in (("a", 1.0), ("b", 0.5))
        for s, t, e in (("fast", 1.0, 1.0), ("balanced", 2.0, e_slow))
    ]
    (found,) = recommended_settings(rows)
    assert found.setting == "balanced"


def test_a_dearer_setting_that_fails_less_often_is_recommended() -> None:
    rows = [row("fast", 1.0, 1.0, gross=30), row("balanced", 2.0, 1.0)]
    (found,) = recommended_settings(rows)
    assert found.setting == "balanced"
    assert "fails 30 records fewer" in found.text
    chance = [row("fast", 1.0, 1.0, gross=1), row("balanced", 2.0, 1.0)]
    assert recommended_settings(chance)[0].setting == "fast"


@pytest.mark.parametrize("runs", [3, 6])
def test_few_records_decide_nothing(runs: int) -> None:
    rows = [row("fast", 1.0, 1.0, runs), row("balanced", 2.0, 0.9, runs), row("reference", 9.0, 0.3, runs)]
    (found,) = recommended_settings(rows)
    assert (found.setting, found.decided) == (None, False)
    assert found.text.startswith("ring-down: no recommendation, more records decide")
    assert (
        f"reference takes 9 times the time of fast, its errors, 0.3 times those of fast, may be chance with {runs}"
        in found.text
    )


def test_many_cases_together_resolve_what_one_does_not() -> None:
    few = [row("fast", 1.0, 1.0, 8), row("balanced", 2.0, 1.0, 8)]
    assert recommended_settings(few)[0].setting is None
    more = [row(s, t, 1.0, 8, case=f"{i}") for i in range(6) for s, t in (("fast", 1.0), ("balanced", 2.0))]
    assert recommended_settings(more)[0].setting == "fast"


def test_peers_and_single_settings_get_no_line() -> None:
    peer = Precision("ring-down", "c", "half-power", "spectrum", True, 1.0, 100, 0, {"f": 1.0}, {}, {})
    assert recommended_settings([peer, row("balanced", 1.0, 1.0)]) == []


@given(
    st.lists(
        st.tuples(st.floats(1e-6, 1e3), st.floats(1e-3, 1e3), st.integers(1, 500), st.floats(0, 1)),
        min_size=6,
        max_size=6,
    )
)
def test_any_rows_give_a_line_that_names_a_setting_or_none(values: list[tuple[float, float, int, float]]) -> None:
    names = [(c, s) for c in ("a", "b") for s in ("fast", "balanced", "reference")]
    rows = [
        row(s, seconds, error, runs, int(share * runs), case=c)
        for (c, s), (seconds, error, runs, share) in zip(names, values, strict=True)
    ]
    (found,) = recommended_settings(rows)
    assert found.setting in (None, "fast", "balanced", "reference")
    assert found.decided == ("no recommendation" not in found.text)
    if found.setting is not None:
        assert f"take {found.setting}" in found.text
    assert all(math.isfinite(figure["time"]) for figure in found.figures.values())


def test_the_tightest_accuracy_that_costs_no_more_is_recommended() -> None:
    rows = [
        measured(1e-3, 1.0, 1e-7),
        measured(1e-6, 1.2, 1e-9),
        measured(1e-9, 1.4, 1e-11),
        measured(1e-12, 5.0, 1e-14),
    ]
    (found,) = recommended_accuracies(rows)
    assert found.setting == "accuracy 1e-09"
    assert found.text.startswith("motion: use 1e-09, it takes 1.4 times the time of 1e-03; its largest true error here")
    assert "tighter ones take 5 times the time" in found.text


def test_an_accuracy_that_is_not_kept_is_not_recommended() -> None:
    rows = [measured(1e-3, 1.0, 1e-7), measured(1e-6, 1.1, 1e-5)]
    (found,) = recommended_accuracies(rows)
    assert found.setting == "accuracy 1e-03"
    assert "not kept: 1e-06" in found.text
    (none,) = recommended_accuracies([measured(1e-3, 1.0, 1.0), measured(1e-6, 1.1, 1e-5)])
    assert none.setting is None


def test_accuracies_without_comparison_or_true_error_are_undecided() -> None:
    (one,) = recommended_accuracies([measured(1e-8, 1.0, 1e-10, ratio=1.7)])
    assert (one.setting, one.text) == (
        None,
        "motion: no recommendation, only accuracy 1e-08 was measured; a peer at least as exact is up to 1.7 times as "
        "fast (1 of 1 row)",
    )
    (unknown,) = recommended_accuracies([measured(1e-3, 1.0, None), measured(1e-6, 1.2, 1e-9)])
    assert unknown.setting is None


def test_a_page_begins_with_them() -> None:
    machine = {"processor": "x", "cores": 1, "load_before": None, "python": "3", "numba": "0", "numpy": "2"}
    rows = [row("fast", 1.0, 1.0), row("balanced", 2.0, 1.0)]
    text = markdown(tables.page(rows, [], machine, ["a note"]))
    lines = [line for line in text.splitlines() if line]
    assert lines[1] == "Recommended settings, from the rows of this run:"
    assert lines[2].startswith("- ring-down: take fast; ")
    assert text.index("take fast") < text.index("a note") < text.index("| fit | fast |")

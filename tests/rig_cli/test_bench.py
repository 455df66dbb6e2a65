"""The benchmark: its results are right, independent of the time it took."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.figures.style import to_svg
from analysis.figures.work_precision import draw_work_precision
from dynamics.bench import first_release, first_release_heyoka, heyoka_runs, tables
from dynamics.bench.records import Measurement, Target, compared, over_points, worth_showing
from rig_cli.main import run

KEYS = {"what", "machine", "seconds", "recommendations", "notes", "targets", "measurements", "files"}


def row(method: str, seconds: float, error: float | None, peer: bool = False, case: str = "c") -> Measurement:
    return Measurement("motion", case, method, "as is", seconds, "run", error, peer=peer)


def test_quick_run_gives_keys_figures_and_small_true_errors(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("heyoka")
    assert run(["bench", "dynamics", "--quick", "--json", "-o", str(tmp_path)]) == 0
    result = json.loads(capsys.readouterr().out)
    assert set(result) == KEYS
    rows = result["measurements"]
    assert {r["service"] for r in rows} == {"multipliers", "motion", "map", "batch", "steady states"}
    for r in rows:
        assert 0 < r["seconds"] < math.inf
        assert r["true_error"] is None or 0 <= r["true_error"] < 1
    chosen = [r for r in rows if r["automatic"]]
    assert {r["service"] for r in chosen} == {r["service"] for r in rows}
    for r in chosen:  # the services keep their word
        assert r["true_error"] <= r["error_estimate"]
        accuracies = [float(part.split()[1]) for part in r["setting"].split(",") if part.startswith("accuracy")]
        assert r["error_estimate"] <= accuracies[0]
    methods = {r["method"] for r in rows if r["service"] == "multipliers" and (r["true_error"] or 0) < 1e-6}
    assert methods >= {"explicit", "magnus", "implicit", "chebyshev", "heyoka (variational)"}
    assert all(t["got"] > 0 and math.isfinite(t["got"]) for t in result["targets"])
    assert any(t["name"] == "map, true error of the sample" and t["met"] for t in result["targets"])
    assert sorted(Path(f).suffix for f in result["files"]) == [".json", ".md", ".svg"]
    assert json.loads((tmp_path / "work_precision.json").read_text(encoding="utf-8"))["measurements"] == rows
    figure = (tmp_path / "work_precision.svg").read_text(encoding="utf-8")
    assert "automatic (explicit), with its error bound" in figure
    assert "| **multipliers: all points (time a point)** |" in (tmp_path / "work_precision.md").read_text(
        encoding="utf-8"
    )


def test_identification_writes_every_service_next_to_peers(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from identification.bench import precision

    tiny = precision.BenchmarkSize(
        zetas=(0.02,),
        damaged_zetas=(),
        pairs=(),
        run_up_zetas=(),
        dampings=(1e-3,),
        runs=1,
        damaged_runs=1,
        pair_runs=1,
        run_up_runs=1,
        release_runs=1,
        release_truths=1,
        most_s=0.0,
    )
    monkeypatch.setattr(precision, "QUICK", tiny)
    another = replace(precision._spin_downs(tiny)[0], methods=precision._spin_downs(tiny)[0].methods[:1])
    monkeypatch.setattr(precision, "_release", lambda physics, size: another)
    monkeypatch.setattr(precision, "_tracking", lambda physics, size: another)
    assert run(["bench", "identification", "--quick", "--json", "-o", str(tmp_path)]) == 0
    result = json.loads(capsys.readouterr().out)
    assert set(result) == KEYS
    assert any(f"seed {precision.SEED}" in note for note in result["notes"])
    rows = result["measurements"]
    for service, ours, peer in (("ring-down", "fit_ring_down", "half-power"), ("spin-down", "fit_spin_down", "line")):
        methods = {(r["method"], r["setting"]) for r in rows if r["service"] == service}
        assert {(ours, "fast"), (ours, "balanced"), (ours, "reference")} < methods
        assert peer in {m for m, _ in methods}
    for r in rows:
        if not r["peer"]:
            assert r["gross"] == 0, r["failure"]
            assert all(0 < v < 5 for v in r["rms"].values())
            assert all(c is not None for c in r["coverage"].values())
    assert sorted(Path(f).suffix for f in result["files"]) == [".json", ".md", ".svg"]
    assert json.loads((tmp_path / "identification_precision.json").read_text(encoding="utf-8"))["measurements"] == rows
    assert "ours, balanced" in (tmp_path / "identification_precision.svg").read_text(encoding="utf-8")
    assert "| fit_ring_down | balanced |" in (tmp_path / "identification_precision.md").read_text(encoding="utf-8")


def test_the_reference_has_the_printed_multipliers() -> None:
    pytest.importorskip("heyoka")
    from rig_configs import load_rig

    physics = load_rig("virtual").physics
    for ratio, largest in ((0.83, 1.361992), (2.6, 0.974796)):
        rig = physics, physics.speed_rad_s(ratio)
        found = heyoka_runs.largest_multiplier(rig, heyoka_runs.EXTENDED_TOLERANCE)
        assert found == pytest.approx(largest, abs=2e-6)  # the rig file's k1 has six digits


def test_fronts_hold_what_nothing_beats() -> None:
    rows = compared(
        [
            row("quick", 1.0, 1e-3),
            row("slow and wrong", 2.0, 1e-2),
            row("exact", 3.0, 1e-9),
            row("peer", 2.5, 1e-10, peer=True),
            row("elsewhere", 9.0, 1e-2, case="d"),
            row("unknown", 0.1, None),
        ]
    )
    assert [r.method for r in rows if r.front] == ["quick", "exact", "elsewhere"]
    assert [r.method for r in rows if r.front_of_all] == ["quick", "peer", "elsewhere"]
    ratios = {r.method: r.peer_ratio for r in rows}
    assert ratios["exact"] == pytest.approx(3.0 / 2.5)
    assert ratios["peer"] is None
    assert ratios["elsewhere"] is None


def test_a_peer_less_exact_is_no_measure() -> None:
    rows = compared([row("exact", 3.0, 1e-9), row("coarse peer", 1.0, 1e-6, peer=True)])
    assert rows[0].peer_ratio is None


def test_rounding_counts_as_equal_on_a_front() -> None:
    rows = compared([row("first", 1.0, 3e-14), row("second", 2.0, 0.0)])
    assert [r.front for r in rows] == [True, False]


def test_over_points_takes_the_worst_error_and_the_median_time() -> None:
    rows = [row("m", t, e, case=c) for c, t, e in (("A", 1.0, 1e-6), ("B", 3.0, 1e-9), ("C", 2.0, 1e-8))]
    (joined,) = over_points([*rows, row("only at A", 1.0, 0.0, case="A")], "all", ["A", "B", "C"])
    assert (joined.case, joined.seconds, joined.true_error) == ("all", 2.0, 1e-6)


def test_over_points_joins_the_automatic_choice_over_its_methods() -> None:
    rows = [
        Measurement(
            "multipliers",
            case,
            f"automatic: {method}",
            "accuracy 1e-08",
            1.0,
            "point",
            1e-9,
            bound,
            automatic=True,
            accuracy=1e-8,
            chosen=(method,),
        )
        for case, method, bound in (("A", "explicit", 1e-9), ("B", "magnus", 5e-9))
    ]
    (joined,) = over_points(rows, "all", ["A", "B"])
    assert joined.method == "automatic: explicit, automatic: magnus"
    assert joined.error_estimate == 5e-9
    assert "automatic (explicit, magnus), with" in to_svg(draw_work_precision(compared([joined]), "all", "c"), "w", "w")


def test_tables_show_fronts_peers_and_the_cheapest_useful_setting() -> None:
    rows = compared([row("m", t, e) for t, e in ((1.0, 1e-3), (1.5, 1e-2), (2.0, 1e-9), (2.5, 2e-9))])
    assert [r.seconds for r in worth_showing(rows)] == [1.0, 2.0]
    page = tables.markdown(tables.page(rows, [Target("t", 2.0, 3.0)], _machine(), []))
    assert "| t | ≤ 2 | 3 | missed |" in page
    assert "| m | as is | 2 s | 1.0e-09 |" in page
    assert "**motion: c (time a run)**" in page


@pytest.mark.parametrize(("seconds", "text"), [(2.0, "2 s"), (0.0123, "12.3 ms"), (4.5e-6, "4.5 µs")])
def test_durations_carry_their_unit(seconds: float, text: str) -> None:
    assert tables.duration(seconds) == text


def test_the_figure_states_so_when_nothing_is_known() -> None:
    rows = compared([row("m", 1.0, None)])
    assert "no reference ran" in to_svg(draw_work_precision(rows, "all", "c"), "w", "work and precision")


def test_a_fresh_process_follows_the_same_release_as_heyoka() -> None:
    pytest.importorskip("heyoka")
    ours, theirs = first_release.first_release(), first_release_heyoka.first_release()
    assert np.allclose(ours, theirs, rtol=0, atol=2e-9)


def _machine() -> dict[str, object]:
    return {
        "processor": "p",
        "cores": 2,
        "load_before": 0.1,
        "python": "3",
        "numba": "0",
        "numpy": "2",
    }

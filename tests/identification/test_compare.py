"""Comparison of parameter sets: changes, significance, limits, and the history over files."""

from __future__ import annotations

import dataclasses
import os
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.stats import binom, kstest
from synthetic import Campaign
from test_joint import OWN, TRUTH, draw, spoilt

from identification import Estimate, NotIdentifiable, identify
from identification.compare import compare_parameters, holm
from identification.history import parameter_history
from identification.identify import Identification
from identification.joint import joint_estimate
from identification.joint.limits import SOURCES, limits
from identification.joint.provenance import kept_tests, rebuilt, with_tests
from rig_configs import IdentifiedParameters, ParametersFileError
from rig_configs.error_label import ErrorLabel
from tests.count_limits import mean_limit
from tests.effort import cases

NAN = float("nan")
GAINS = np.array([4e-4, -7e-4])  # of lasers that stay the same


def parameters_of(
    estimates: list[Estimate], serial: str | None = "L1", day: int = 1, rig: str = "bench"
) -> IdentifiedParameters:
    """A parameters file's content as `rig identify` keeps it."""
    joint = joint_estimate(estimates)
    found = Identification(joint.parameters, NAN, NAN, estimates, [], joint.rows, [])
    kept = with_tests(found)
    tests = [
        {
            **test,
            "test": e.test,
            "log": e.source,
            "digest": f"{day}-{e.source}",
            "method": "made up",
            "values": dict(zip(e.names, e.values.tolist(), strict=True)),
            "recorded": f"2026-03-{day:02d}T10:00:00+00:00",
            **({"lasers": {"x": f"{serial}x", "y": f"{serial}y"}} if serial else {}),
        }
        for test, e in zip(kept.provenance["tests"], estimates, strict=True)
    ]
    return IdentifiedParameters(kept.values, kept.covariance, {**kept.provenance, "tests": tests, "rig": rig})


def changed(estimates: list[Estimate], name: str, share: float) -> list[Estimate]:
    """Estimates with a changed parameter of the rig: the value of every test with this parameter changes."""
    for i, estimate in enumerate(estimates):
        if name in estimate.names:
            estimates = spoilt(estimates, i, name, share)
    return estimates


def test_a_changed_spring_is_reported_in_plain_words() -> None:
    rng = np.random.default_rng(1)
    old, new = (
        parameters_of(draw(rng, gains=GAINS)[0]),
        parameters_of(changed(draw(rng, gains=GAINS)[0], "k2_N_per_m", 0.05), day=2),
    )
    found = compare_parameters(old, new)
    (change,) = found.significant()
    assert change.name == "k2_N_per_m"
    assert abs(change.relative - 0.05) < 4 * change.relative_std
    assert change.level == 0.001
    assert found.p < 1e-6
    words = found.in_words()
    assert re.match(r"k2 grew by (4.99|5.00)\d* ± 0.00\d+ %; ", words)
    assert words.endswith("nothing else changed significantly")


def test_no_change_is_called_one_in_few_of_many_pairs() -> None:
    """Holm keeps the chance of any false "changed" at its level: 5 % of 80 pairs, and the overall test too."""
    rng = np.random.default_rng(2)
    single, overall, count = 0, 0, cases(40, 80)
    for _ in range(count):
        found = compare_parameters(parameters_of(draw(rng)[0], None), parameters_of(draw(rng)[0], None))
        single += bool(found.significant(0.05))
        overall += found.p < 0.05
    assert single <= binom.isf(2e-3, count, 0.05)
    assert 1 <= overall <= binom.isf(2e-3, count, 0.05)


def test_changes_that_go_together_are_found_though_each_is_small() -> None:
    names = ("k1_N_per_m", "zeta1")
    close = np.array([[1.0, 0.99], [0.99, 1.0]])
    unit = np.array([0.1, 1e-6])
    covariance = close * np.outer(unit, unit)
    k1, zeta1 = 2600.0 / np.e * 2.7, 0.02 / np.pi * 3.1  # all the digits of a double, as files have them
    old = IdentifiedParameters(dict(zip(names, (k1, zeta1), strict=True)), covariance)
    new = IdentifiedParameters(dict(zip(names, (k1 + 0.1, zeta1 - 1e-6), strict=True)), covariance)
    found = compare_parameters(old, new)
    assert found.significant() == []
    assert found.p < 1e-6
    assert "all together they did" in found.in_words()
    assert sum(c.share for c in found.changes) == pytest.approx(1)
    # not decidable for files whose numbers were rounded to five digits
    old, new = (
        IdentifiedParameters({n: float(f"{v:.5g}") for n, v in p.values.items()}, covariance) for p in (old, new)
    )
    assert compare_parameters(old, new).p > 1e-4


def test_the_same_laser_s_gain_is_no_change() -> None:
    rng = np.random.default_rng(4)
    first, second = draw(rng, ("run-up",), gains=GAINS)[0], draw(rng, ("run-up",), gains=GAINS)[0]
    same = compare_parameters(parameters_of(first, "A"), parameters_of(second, "A", 2))
    other = compare_parameters(parameters_of(first, "A"), parameters_of(second, "B", 2))
    unknown = compare_parameters(parameters_of(first, None), parameters_of(second, None, 2))
    std = [next(c.std for c in found.changes if c.name == "SP_kg_m") for found in (same, other, unknown)]
    own = np.sqrt(2) * 1e-4 * TRUTH["SP_kg_m"]
    gain = np.sqrt(2 * 2) * 0.5e-3 * TRUTH["SP_kg_m"]
    assert std[0] == pytest.approx(own, rel=1e-3)
    assert std[1] == std[2] == pytest.approx(np.hypot(own, gain), rel=1e-3)
    assert any("cancels" in note for note in same.notes)
    assert any("another laser along x" in note for note in other.notes)
    assert any("not known" in note for note in unknown.notes)


def test_the_std_of_a_change_with_shared_logs_is_what_many_draws_show() -> None:
    """Two logs in both, one more in NEW: the change comes from that one alone."""
    rng = np.random.default_rng(5)
    z, alone = [], []
    count = cases(60, 150)
    for _ in range(count):
        estimates, _ = draw(rng, ("spin-down", "spin-down", "point-E"))
        old = parameters_of(estimates[:2])
        new = parameters_of(estimates)
        found = compare_parameters(old, new)
        change = next(c for c in found.changes if c.name == "c3_Nms_per_rad")
        z.append(change.z)
        alone.append(change.change / np.hypot(old.std[change.name], new.std[change.name]))
    assert abs(np.std(z) - 1) < mean_limit(count, 150, 0.1)
    assert np.std(alone) < 0.8  # as independent the change would look too sure to be there


def test_a_comparison_of_two_rigs_is_noted_first() -> None:
    estimates, _ = draw(np.random.default_rng(5), ("spin-down",))
    one = parameters_of(estimates)
    assert (
        compare_parameters(one, parameters_of(estimates, rig="other")).notes[0].startswith("two rigs, bench and other")
    )
    assert not any("two rigs" in note for note in compare_parameters(one, one).notes)


def test_logs_in_both_are_named_in_one_sentence() -> None:
    estimates, _ = draw(np.random.default_rng(5), ("spin-down", "spin-down", "point-E"))
    notes = [
        note
        for note in compare_parameters(parameters_of(estimates[:2]), parameters_of(estimates)).notes
        if "in both" in note
    ]
    assert len(notes) == 1
    assert notes[0].endswith("are in both: their own errors cancel")
    one = compare_parameters(parameters_of(estimates[:2]), parameters_of(estimates[1:])).notes
    assert [note.partition(" is ")[2] for note in one if "in both" in note] == ["in both: its own errors cancel"]


SETS = {
    "nested": ((0, 1, 2), (0, 1, 2, 3, 4)),
    "one less": ((0, 1, 2, 3, 4), (0, 1, 2, 3)),
    "half": ((0, 1, 2), (1, 2, 3, 4)),
    "disjoint": ((0, 2), (1, 3, 4)),
}
DAMPING = ("spin-down", "point-E", "spin-down", "point-E", "spin-down")


@pytest.mark.parametrize(("first", "second"), SETS.values(), ids=SETS)
def test_p_is_uniform_however_the_logs_overlap(first: tuple[int, ...], second: tuple[int, ...]) -> None:
    """Nothing has changed: p of all changes together is uniform, and each change's z has a spread of one."""
    rng = np.random.default_rng([*first, 100, *second])
    p, z = [], []
    for _ in range(cases(30, 80)):
        estimates, _ = draw(rng, DAMPING)
        found = compare_parameters(*(parameters_of([estimates[i] for i in which]) for which in (first, second)))
        p.append(found.p)
        z += [c.z for c in found.changes]
        assert found.dof == 2
    assert kstest(p, "uniform").pvalue > 1e-3
    assert abs(np.std(z) - 1) < mean_limit(len(z), 160, 0.15)


@pytest.mark.parametrize("serial", ["L1", None])
@pytest.mark.parametrize(("first", "second"), SETS.values(), ids=SETS)
def test_a_campaign_against_its_own_beginning_has_not_changed(
    first: tuple[int, ...], second: tuple[int, ...], serial: str | None
) -> None:
    """Campaigns with gains and clocks: small p values have at most their nominal frequency for any common part."""
    rng = np.random.default_rng([*first, 200, *second])
    p = []
    for _ in range(cases(6, 25)):
        estimates, _ = draw(rng)
        old, new = (parameters_of([estimates[i] for i in which], serial) for which in (first, second))
        found = compare_parameters(old, new)
        p.append(found.p)
        assert found.dof <= len(found.changes)
        assert all(abs(c.z) < 5 and np.isfinite([c.std, c.z, c.p]).all() for c in found.changes)
        unit = np.sqrt([old.std[c.name] ** 2 + new.std[c.name] ** 2 for c in found.changes])
        assert np.linalg.eigvalsh(found.covariance / np.outer(unit, unit))[0] > -1e-9
    assert kstest(p, "uniform", alternative="greater").pvalue > 1e-3


def test_a_clock_common_to_what_stayed_and_what_came_is_no_change() -> None:
    """k rests on the same logs, c gets new ones, and one device's clock is in all: nothing is known to have changed.

    What both have in common, taken off C_old + C_new, is indefinite here; its smallest direction would give p = 0.
    """
    rng = np.random.default_rng(31)
    tests, rate, p = ("run-up", "spin-down", "point-E", "point-E"), 2e-5, []
    for _ in range(cases(15, 40)):
        estimates = []
        for estimate in draw(rng, tests, gains=np.zeros(2))[0]:
            power = np.array([{"k": 2.0, "c": 1.0}.get(n[0], 0.0) for n in estimate.names])
            scale = np.array([0.05 if n[0] == "c" else 1.0 for n in estimate.names])
            true = np.array([TRUTH[n] for n in estimate.names])
            shift = power * rate * true
            values = true + scale * (estimate.values - true) + rng.standard_normal() * shift
            covariance = estimate.covariance * np.outer(scale, scale)
            shared = {ErrorLabel("clock", "encoder"): shift}
            estimates.append(dataclasses.replace(estimate, values=values, covariance=covariance, shared=shared))
        found = compare_parameters(parameters_of(estimates[:2]), parameters_of(estimates))
        p.append(found.p)
        assert found.dof == 2  # c3 and c4; all else rests on the same logs
        assert all(0 <= c.share <= 1 for c in found.changes)
    assert kstest(p, "uniform", alternative="greater").pvalue > 1e-3
    assert min(p) > 1e-3


def test_rounded_files_of_the_same_logs_have_not_changed(tmp_path: Path) -> None:
    """Rounding to few digits is not a change in any direction, for any uncertainty of that direction."""
    rng = np.random.default_rng(21)
    for digits in (4, 6, 9):
        estimates, _ = draw(rng)
        whole = parameters_of(estimates)
        short = IdentifiedParameters(
            {n: float(f"{v:.{digits}g}") for n, v in whole.values.items()}, whole.covariance, whole.provenance
        )
        found = compare_parameters(whole, short)
        assert found.p > 1e-3
        assert not found.significant(0.05)


def test_a_file_against_itself_has_not_changed() -> None:
    parameters = parameters_of(draw(np.random.default_rng(6))[0])
    found = compare_parameters(parameters, parameters)
    assert found.chi2 == 0
    assert found.p == 1
    assert [c.std for c in found.changes] == [0.0] * len(parameters.values)
    assert found.in_words() == "nothing changed significantly"


def test_files_without_tests_count_all_errors_as_independent() -> None:
    parameters = parameters_of(draw(np.random.default_rng(6))[0])
    bare = IdentifiedParameters(parameters.values, parameters.covariance)
    found = compare_parameters(bare, parameters)
    assert [c.std for c in found.changes] == pytest.approx([np.sqrt(2) * s for s in bare.std.values()])
    assert found.notes[0].startswith("OLD keeps too little")
    with pytest.raises(NotIdentifiable, match="nothing to compare"):
        compare_parameters(bare, IdentifiedParameters({}, np.zeros((0, 0))))


def test_holm_of_known_values() -> None:
    assert holm([0.01, 0.04, 0.03, 0.9]) == pytest.approx([0.04, 0.09, 0.09, 0.9])


@given(st.lists(st.floats(0, 1), min_size=1, max_size=12))
def test_holm_is_monotone_and_between_p_and_bonferroni(p: list[float]) -> None:
    found = holm(p)
    assert np.all(found >= np.array(p) - 1e-15)
    assert np.all(found <= np.minimum(1, len(p) * np.array(p)) + 1e-15)
    assert np.all(np.diff(found[np.argsort(p, kind="stable")]) >= -1e-15)


def test_limits_are_the_variance_s_parts() -> None:
    estimates, _ = draw(np.random.default_rng(7))
    parameters = parameters_of(estimates)
    (sp,) = [limit for limit in limits(parameters_of(estimates[2:3])) or [] if limit.name == "SP_kg_m"]
    assert sp.shares["noise"] == pytest.approx(1e-8 / (1e-8 + 2 * 0.25e-6), rel=1e-6)
    found = {limit.name: limit for limit in limits(parameters) or []}
    assert found.keys() == TRUTH.keys()
    for limit in found.values():
        assert tuple(limit.shares) == SOURCES
        assert sum(limit.shares.values()) == pytest.approx(1)
        assert limit.std == pytest.approx(parameters.std[limit.name])
    sp = found["SP_kg_m"]
    assert sp.main == "gain"
    assert "lasers" in sp.advice
    assert found["k1_N_per_m"].main == "clock"
    assert found["zeta1"].main == "noise"
    heavy = {limit.name: limit for limit in limits(parameters, mass_std=1e-3) or []}
    assert heavy["k1_N_per_m"].main == "mass"
    assert heavy["zeta1"].shares["mass"] == 0
    bare = IdentifiedParameters(parameters.values, parameters.covariance)
    assert limits(bare) is None


def test_disagreement_is_a_limit_of_its_own() -> None:
    estimates = spoilt(draw(np.random.default_rng(8), ("spin-down", "point-E"))[0], 1, "c3_Nms_per_rad", 0.03)
    found = {limit.name: limit for limit in limits(parameters_of(estimates)) or []}
    assert found["c3_Nms_per_rad"].main == "disagreement"
    assert found["c3_Nms_per_rad"].shares["disagreement"] > 0.9
    assert found["c4_Nms_per_rad"].main == "noise"


def test_what_a_file_keeps_gives_the_same_joint_estimate_again(tmp_path: Path) -> None:
    campaign = Campaign(3)
    runs = [campaign.ring_down("x"), campaign.ring_down("y")]
    identities = {"laser_x": {"serial": "123", "name": "ILD"}, "laser_y": {"serial": "124"}}
    runs = [
        dataclasses.replace(
            r,
            start_s=1.77e9 + i,
            metadata={"identities": identities, "rig": "virtual"},
            clocks={"x": "laser_x", "y": "laser_y"},
        )
        for i, r in enumerate(runs)
    ]
    found = identify(runs, campaign.rig)
    with_tests(found, runs).save(tmp_path / "p.toml")
    loaded = IdentifiedParameters.load(tmp_path / "p.toml")
    again = rebuilt(loaded)
    assert again is not None
    assert again[0].parameters.values == pytest.approx(found.parameters.values, rel=1e-12)
    assert [t.estimate.test for t in again[1]] == [e.test for e in found.estimates]
    assert again[1][0].lasers == {"x": "123", "y": "124"}
    assert again[1][0].recorded is not None
    assert loaded.provenance["rig"] == "virtual"
    direct, kept = limits(found) or [], limits(loaded) or []
    assert [d.shares for d in direct] == [pytest.approx(k.shares) for k in kept]


def test_a_file_written_by_another_rule_is_taken_at_its_word() -> None:
    parameters = parameters_of(draw(np.random.default_rng(9))[0])
    wider = IdentifiedParameters(parameters.values, 4 * parameters.covariance, parameters.provenance)
    assert rebuilt(wider) is None
    damaged = {**parameters.provenance["tests"][0], "covariance": [[1.0]]}
    broken = IdentifiedParameters(parameters.values, parameters.covariance, {"tests": [damaged]})
    with pytest.raises(ParametersFileError, match=r"tests\[0\].*4 × 4"):
        kept_tests(broken)


def test_history_finds_the_files_and_marks_the_change(tmp_path: Path) -> None:
    rng = np.random.default_rng(10)
    for day in (3, 1, 2, 4):
        estimates = draw(rng, gains=GAINS)[0]
        if day >= 3:
            estimates = changed(estimates, "zeta1", 0.2)
        parameters_of(estimates, day=day).save(tmp_path / f"day{day}.toml")
    (tmp_path / "rig.toml").write_text("name = 'x'\n")
    found = parameter_history([tmp_path])
    assert [i.path.name for i in found.instants] == ["day1.toml", "day2.toml", "day3.toml", "day4.toml"]
    assert len(found.skipped) == 1
    marked = {(i, c.name) for i, step in enumerate(found.steps) if step for c in step.significant()}
    assert marked == {(2, "zeta1")}
    assert all(i.time_known and len(i.tests) == len(OWN) for i in found.instants)


def test_history_asks_which_rig_and_refuses_logs(tmp_path: Path) -> None:
    rng = np.random.default_rng(11)
    empty = tmp_path / "empty"
    empty.mkdir()
    for rig in ("one", "two"):
        parameters_of(draw(rng)[0], rig=rig).save(tmp_path / f"{rig}.toml")
    with pytest.raises(ParametersFileError, match="Choose one of them"):
        parameter_history([tmp_path])
    assert len(parameter_history([tmp_path], "two").instants) == 1
    with pytest.raises(ParametersFileError, match="'three'"):
        parameter_history([tmp_path], "three")
    with pytest.raises(ParametersFileError, match="rig identify"):
        parameter_history([tmp_path / "a.mcap"])
    with pytest.raises(NotIdentifiable, match="no parameters file"):
        parameter_history([empty])


def test_a_file_without_a_stated_time_has_its_own_time(tmp_path: Path) -> None:
    parameters = parameters_of(draw(np.random.default_rng(12))[0])
    IdentifiedParameters(parameters.values, parameters.covariance).save(tmp_path / "p.toml")
    os.utime(tmp_path / "p.toml", (1.7e9, 1.7e9))
    (instant,) = parameter_history([tmp_path / "p.toml"]).instants
    assert not instant.time_known
    assert instant.time.timestamp() == 1.7e9

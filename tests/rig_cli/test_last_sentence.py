"""The sentence at the end of a command: what came out, for a person; JSON is as it was."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from daq.drivers.checks import Checks, DeviceCheck
from daq.guided_tests.runner import TestDone
from daq.replay import ReplayCheck
from rig_cli.guided_test_result import against_plan, result_sentence
from rig_cli.last_sentence import (
    campaign_sentence,
    check_sentence,
    identify_sentence,
    parameters_sentence,
    plot_sentence,
    predict_sentence,
    validation_sentence,
    written_sentence,
)
from rig_cli.log_page import log_sentence
from rig_cli.main import run
from rig_cli.replay import replay_sentence
from rig_cli.validation_page import whole_lines
from rig_configs import PARAMETER_UNITS, IdentifiedParameters
from tests.rig_cli.test_exchange import BALANCED_COLUMNS, balanced_point
from tests.rig_cli.test_log_places import resting_rotor

FINE: Checks = {"rate_Hz": DeviceCheck(4000.0, 4000.0, True)}
SILENT: Checks = {"identity": DeviceCheck(None, "ILD1420", False, "is it switched on?")}
SLOW: Checks = {"rate_Hz": DeviceCheck(3600.0, 4000.0, False, "set rate_Hz = 3600")}
OPEN: Checks = {"clock": DeviceCheck(0.1, 0.2, None)}


@pytest.mark.parametrize(
    ("devices", "expected"),
    [
        ({"a": FINE, "b": FINE}, "Both devices are fine."),
        (dict.fromkeys("abcd", FINE), "All 4 devices are fine."),
        ({"a": FINE}, "The device is fine."),
        (
            {"a": FINE, "b": SLOW},
            "1 of 2 devices fails: b: rate_Hz 3600.0, expected 4000.0; set rate_Hz = 3600.",
        ),
        (
            {"a": SLOW, "b": SILENT, "c": FINE},
            "2 of 3 devices fail: b: identity, expected ILD1420; is it switched on?",
        ),
        (
            {"a": FINE, "b": OPEN},
            "Both devices are fine; 1 check is not resolved, with the reason above.",
        ),
    ],
)
def test_a_check_ends_with_its_worst_device(devices: dict[str, Checks], expected: str) -> None:
    assert check_sentence(devices) == expected


def test_a_check_of_fine_devices_does_not_hide_a_warning_of_the_rotor() -> None:
    assert check_sentence({"a": FINE, "b": FINE}, "the rotor turns") == "Both devices are fine, but the rotor turns."


def parameters(*names: str) -> IdentifiedParameters:
    return IdentifiedParameters(dict.fromkeys(names, 1.0), np.diag([1e-4] + [1e-6] * (len(names) - 1)), {})


def test_an_identification_ends_with_its_numbers_and_the_next_step() -> None:
    full = identify_sentence(parameters(*PARAMETER_UNITS), 9, "", Path("p.toml"), with_points=True)
    assert full == (
        "k1, k2, ζ1, ζ2, c3, c4, S_P identified from 9 logs, standard uncertainties up to 1 % (k1); next: rig validate "
        "RIG FOLDER --parameters p.toml."
    )
    no_points = identify_sentence(parameters(*PARAMETER_UNITS), 4, "", Path("p.toml"), with_points=False)
    assert no_points.endswith("next: rig test RIG point A --parameters p.toml.")
    present = [name for name in PARAMETER_UNITS if name not in ("c3_Nms_per_rad", "SP_kg_m")]
    part = identify_sentence(parameters(*present), 1, "record spin-down, run-up", Path("p.toml"), with_points=False)
    assert part == (
        "k1, k2, ζ1, ζ2, c4 identified from 1 log, standard uncertainties up to 1 % (k1); not identified: c3, S_P; "
        "record spin-down, run-up."
    )


def predicted(*ends: str, states: tuple[tuple[str, bool, float], ...] = (("I", True, 0.0),)) -> dict[str, Any]:
    return {
        "speed_rpm": 288.0,
        "steady_states": [{"type": t, "stable": s, "amplitude_mm": a} for t, s, a in states],
        "releases_within_play": [{"reaches": end, "after_s": 30.2, "revolutions": 1} for end in ends],
    }


@pytest.mark.parametrize(
    ("result", "expected"),
    [
        (predicted("I", "I"), "At 288 rpm released pendulums balance the rotor after 30.2 s; no vibration remains."),
        (
            predicted("III", states=(("III", True, 2.74), ("I", False, 0.0))),
            "At 288 rpm released pendulums settle in a state of Type III, which does not balance the rotor, after "
            "30.2 s; the amplitude that remains is 2.74 mm.",
        ),
        (predicted("I", "III"), "At 288 rpm a release may end in any of: balance, a state of Type III."),
        (predicted("slipping"), "At 288 rpm released pendulums slip for ever; the rotor is not balanced."),
        (predicted("not settled"), "At 288 rpm released pendulums do not settle within 1 revolution."),
        (predicted(), "At 288 rpm balance is stable, with an amplitude of 0 mm."),
        (predicted(states=(("I", False, 0.0),)), "At 288 rpm no steady state is stable."),
    ],
)
def test_a_prediction_ends_with_what_will_happen(result: dict[str, Any], expected: str) -> None:
    assert predict_sentence(result) == expected


def judged(**verdicts: str) -> dict[str, dict[str, Any]]:
    return {name: {"verdict": verdict, "why": "θ3 differs by 4.1 std"} for name, verdict in verdicts.items()}


def test_a_validation_ends_with_the_points_that_do_not_pass() -> None:
    assert validation_sentence(judged(A="pass", B="pass"), passed=True) == "A, B pass."
    assert validation_sentence(judged(B="pass"), passed=True) == "B passes."
    one = validation_sentence(judged(A="pass", B="fail"), passed=False)
    assert one == "1 of 2 points does not pass: B: fail, θ3 differs by 4.1 std."
    two = validation_sentence(judged(A="fail", B="not settled", C="pass"), passed=False)
    assert two == "2 of 3 points do not pass (A, B): A: fail, θ3 differs by 4.1 std."
    assert "whole validation does not" in validation_sentence(judged(A="pass"), passed=False)
    assert validation_sentence({}, passed=False) == "No point was compared: record one by rig test."


def test_the_sentence_is_the_last_line_of_a_prediction_and_not_in_its_json(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["predict", "virtual", "--point", "B", "--no-release"]
    assert run(words) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "At 288 rpm balance is stable, with an amplitude of 0 mm."
    assert run([*words, "--json"]) == 0
    assert "sentence" not in json.loads(capsys.readouterr().out)


def test_a_ring_down_ends_with_frequency_and_damping(tmp_path: Path) -> None:
    log = resting_rotor(tmp_path / "pluck.mcap")  # 19.2 rad/s, decay 0.4 1/s
    found = result_sentence(TestDone("ring-down-x", log, {}))
    assert found.startswith("ring-down-x done: f1 = 3.056 Hz, ζ1 = 2.08 % (± ")
    assert found.endswith(" % of it), as good as planned; 5.0 s with 5000 samples recorded, nothing lost.")


@pytest.mark.parametrize(
    ("share", "words"), [(0.01, "as good as planned"), (0.03, "3 times as uncertain as planned (1 %)")]
)
def test_an_uncertainty_is_compared_with_the_planned_one(share: float, words: str) -> None:
    assert against_plan(share, 0.01) == words


def test_ctrl_c_ends_the_evaluation_and_keeps_the_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    log = resting_rotor(tmp_path / "pluck.mcap")
    monkeypatch.setattr("daq.signals.run.load_run", interrupt)
    found = result_sentence(TestDone("ring-down-x", log, {}))
    assert "no quick result (interrupted, the log is complete); 5.0 s with 5000 samples recorded" in found


def test_a_test_without_a_quick_result_ends_with_what_was_recorded(tmp_path: Path) -> None:
    table, log = balanced_point(tmp_path / "b.csv", 100.0), tmp_path / "b.mcap"
    assert run(["import", str(table), "--rig", "virtual", "--point", "B", "-o", str(log), *BALANCED_COLUMNS]) == 0
    recorded = "60.0 s with 24000 samples recorded, nothing lost."
    settled = {"settled": "false", "why": "angles drift"}
    assert result_sentence(TestDone("point-B", log, settled)) == f"point-B done: not settled (angles drift); {recorded}"
    assert result_sentence(TestDone("slow-roll", log, {})) == f"slow-roll done: {recorded}"
    early = result_sentence(TestDone("run-up", log, {}, missed="the top speed"))
    assert early == f"run-up did not reach its end: the top speed; {recorded}"
    assert "no quick result" in result_sentence(TestDone("ring-down-x", tmp_path / "no.mcap", {}))


def test_without_a_point_all_points_agree_is_not_shown_but_a_failure_is() -> None:
    agreement = {"passed": True, "why": "all points together agree with the model"}
    result: dict[str, Any] = {"points": {}, "start_ups": [], "reasons": ["the run-up differs"], "agreement": agreement}
    assert whole_lines(result) == ["the run-up differs"]
    assert (
        whole_lines({**result, "agreement": {"passed": False, "why": "χ² 99 on 3"}})[-1] == "together: FAIL: χ² 99 on 3"
    )
    assert len(whole_lines({**result, "points": {"A": {}}})) == 2


def log_facts(lost: int = 0, **changes: Any) -> dict[str, Any]:
    losses = {"source": "summary", "by_device": {"laser_x": {"samples": lost}}, "total": lost, "events": {}}
    whole = {"log": "a.mcap", "state": "finished", "verified": True, "missing": [], "lost_before": [], "losses": losses}
    return whole | changes


def test_a_log_ends_with_whether_it_is_whole_and_what_was_lost() -> None:
    assert log_sentence(log_facts()) == "The log is finished, every byte checked; nothing lost."
    assert log_sentence(log_facts(3)) == "The log is finished, every byte checked; losses: laser_x 3 samples."
    cut = log_sentence(log_facts(missing=["5 bytes"], state="unfinished"))
    assert cut == "The log is cut, or still being recorded, not whole; nothing lost; next: rig recover a.mcap."


@pytest.mark.parametrize(
    ("differences", "until_ns", "expected"),
    [
        (["", ""], None, "All 2 channels are decoded as they were recorded."),
        (["", ""], 5, "All 2 channels are decoded as they were recorded, as far as raw bytes were compared."),
        (["", "3 samples"], None, "1 of 2 channels differs: b."),
        (["1 sample", "3 samples"], None, "2 of 2 channels differ: a, b."),
    ],
)
def test_a_check_of_the_decoder_ends_with_what_differs(
    differences: list[str], until_ns: int | None, expected: str
) -> None:
    rows: Any = tuple(
        SimpleNamespace(topic=name, difference=each) for name, each in zip("ab", differences, strict=True)
    )
    assert replay_sentence(ReplayCheck(rows, until_ns, (), 1, 1)) == expected


def test_a_parameters_file_ends_with_the_parameter_that_is_known_least() -> None:
    known = {"k1_N_per_m": {"relative_std": 0.0015}, "zeta1": {"relative_std": 0.02}}
    facts = {"parameters": known, "tests": [{}, {}]}
    assert parameters_sentence(facts) == "2 parameters from 2 logs, standard uncertainties up to 2 % (ζ1)."
    facts = {"parameters": {"k1_N_per_m": known["k1_N_per_m"]}, "tests": []}
    assert parameters_sentence(facts) == "1 parameter, standard uncertainties up to 0.15 % (k1)."
    assert parameters_sentence({"parameters": {}, "tests": []}) == "The file contains no parameter."


def test_figures_end_with_their_number_and_place() -> None:
    assert plot_sentence("bode", ["a.svg"], 0) == "1 figure of kind bode drawn: a.svg."
    several = plot_sentence("slip", ["a.svg", "b.svg", "c.svg"], 1)
    assert several == "3 figures of kind slip drawn: a.svg to c.svg; 1 log is not drawn, with the reason above."


def test_an_export_ends_with_what_was_written() -> None:
    assert written_sentence("exported", {"x": 5}, 0, [Path("a.csv")]) == "5 samples of 1 channel exported to a.csv."
    several = written_sentence("exported", {"x": 5, "y": 4}, 1, [Path("a-x.csv"), Path("a-y.csv")])
    assert several == (
        "9 samples of 2 channels exported to 2 files, the first a-x.csv; 1 part is missing, with the reason above."
    )


@pytest.mark.parametrize(
    ("states", "expected"),
    [
        (("done", "missing"), "1 of 2 tests done in out; next: rig test RIG point-A."),
        (("not reached", "done"), "1 of 2 tests done in out; next: rig test RIG run-up."),
        (("done", "done"), "2 of 2 tests done in out; next: rig identify out."),
        (("refused", "done"), "1 of 1 test done in out; next: rig identify out."),
        (("refused", "refused"), "The rig can do no test."),
    ],
)
def test_the_list_of_tests_ends_with_the_next_one(states: tuple[str, str], expected: str) -> None:
    rows = [{"test": name, "state": state} for name, state in zip(("run-up", "point-A"), states, strict=True)]
    assert campaign_sentence({"rig": "virtual", "folder": "out", "tests": rows}) == expected


def test_the_sentence_is_the_last_line_of_export_plot_and_the_list_of_tests(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = resting_rotor(tmp_path / "pluck.mcap")
    for words, end in (
        (["export", str(log), "-o", str(tmp_path / "x.mat")], f" exported to {tmp_path / 'x.mat'}."),
        (["plot", "time", str(log), "-o", str(tmp_path / "x.svg")], f"1 figure of kind time drawn: {tmp_path}/x.svg."),
        (["test", "virtual", "--out", str(tmp_path)], "; next: rig test RIG ring-down-y."),
    ):
        assert run(words) == 0
        assert capsys.readouterr().out.splitlines()[-1].endswith(end)

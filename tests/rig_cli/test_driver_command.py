"""`rig driver list`, `rig driver show` and `rig driver check`."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from types import ModuleType
from typing import Any

import pytest

from rig_cli.main import run
from rig_configs.drivers import installed
from rig_drivers.vesc.driver import DRIVER
from rig_testing import examination, mutations
from rig_testing.report import Failed

KEPT = ("settings", "roles", "opening dialogue", "displacement", "stop")


def stop_raises(settings: object, talk: object) -> None:
    """Raise what the contract does not know."""
    raise RuntimeError("no such command")


@pytest.fixture
def few_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(examination, "CHECKS", {name: examination.CHECKS[name] for name in KEPT})


@pytest.fixture
def stranger(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("strangers_driver")
    vars(module).update(BROKEN=replace(DRIVER, stop=stop_raises), SOUND=DRIVER, NONE=7)
    monkeypatch.setitem(sys.modules, "strangers_driver", module)


def run_rig(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = run(["driver", *arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_drivers_are_listed_with_package_and_roles(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run_rig(capsys, "list", "--json")
    drivers = {facts["name"]: facts for facts in json.loads(out)["drivers"]}
    assert code == 0
    assert list(drivers) == list(installed())
    assert drivers["vesc"] == {
        "name": "vesc",
        "package": "pendulum-balancer-rig",
        "roles": ["speed source"],
        "verified": False,
    }
    assert drivers["rotorlink"]["roles"] == ["pendulum angles", "pendulum locks", "rotor phase"]
    code, out, _ = run_rig(capsys, "list")
    assert code == 0
    assert "displacement" in out


@pytest.mark.usefixtures("few_tests")
@pytest.mark.parametrize(
    "name", ["vesc", "pendulum-balancer-rig:vesc", "pendulum_balancer_rig:vesc", "rig_drivers:vesc"]
)
def test_a_sound_driver_passes(capsys: pytest.CaptureFixture[str], name: str) -> None:
    code, out, err = run_rig(capsys, "check", name, "--json")
    assert (code, json.loads(out)) == (0, {"driver": "vesc", "passed": True, "failed": []})
    assert "opening dialogue" in err


@pytest.mark.usefixtures("few_tests", "stranger")
def test_a_driver_of_a_module_that_fails_exits_1(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run_rig(capsys, "check", "strangers_driver:BROKEN", "--json")
    result = json.loads(out)
    assert (code, result["driver"], result["passed"]) == (1, "vesc", False)
    assert [failed["test"] for failed in result["failed"]] == ["stop"]
    assert "RuntimeError: no such command" in result["failed"][0]["why"]
    code, out, _ = run_rig(capsys, "check", "strangers_driver:BROKEN")
    assert code == 1
    assert "✗" in out
    assert "1 FAILED" in out
    assert "it measures no displacement" in out
    assert run_rig(capsys, "check", "strangers_driver:SOUND")[0] == 0


@pytest.mark.usefixtures("stranger")
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("optoncd", "Did you mean 'optoncdt'?"),
        ("nothing:vesc", "No module named 'nothing'"),
        ("strangers_driver:OTHER", "no attribute 'OTHER'"),
        ("strangers_driver:NONE", "is not a driver"),
        (":", "no driver"),
        ("pendulum-balancer-rig", "expected pendulum-balancer-rig:NAME with one of cia402, cia406"),
    ],
)
def test_no_such_driver_is_bad_use(capsys: pytest.CaptureFixture[str], name: str, words: str) -> None:
    code, _, err = run_rig(capsys, "check", name)
    assert code == 2
    assert words in err


def test_thorough_asks_for_a_million_inputs(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def only_returns(subject: Any) -> str:
        raise Failed(f"thorough {subject.thorough}, {mutations.THOROUGH} against {mutations.QUICK}")

    monkeypatch.setattr(examination, "CHECKS", {"mutations": only_returns})
    code, out, _ = run_rig(capsys, "check", "vesc", "--thorough", "--json")
    assert code == 1
    assert json.loads(out)["failed"][0]["why"] == "thorough True, 1000000 against 10000"


def test_the_settings_of_a_driver_are_shown(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run_rig(capsys, "show", "dbc", "--json")
    shown = json.loads(out)
    assert code == 0
    defaults = {name: row["default"] for row in shown["settings"] for name in row["names"]}
    assert defaults["driver"] == "required"
    assert defaults["bitrate"] == "500000"
    assert list(shown["tables"]) == ["SignalX", "SignalY", "Quantity"]
    code, out, _ = run_rig(capsys, "show", "vesc_can")
    assert code == 0
    assert "pole_pairs" in out
    assert "required" in out

"""Guided tests that a rig can run: refused by its roles, with the missing signals, before a device is opened."""

from __future__ import annotations

from dataclasses import replace

import pytest

from daq import guided_test_kinds
from daq.guided_test_kinds import KINDS, kind_of, point_of, refusal
from daq.guided_tests import test_inputs as inputs
from rig_cli.main import run
from rig_configs import load_rig

ONE, HAND, OTHER = (load_rig(name) for name in ("one_laser", "by_hand", "other_devices"))


def test_one_laser_rings_down_along_its_axis_and_nothing_else() -> None:
    assert inputs.possible_tests(ONE) == ("ring-down-x",)
    assert refusal("ring-down-x", ONE.roles) == ""


@pytest.mark.parametrize(
    ("test", "missing"),
    [
        ("ring-down-y", "ring-down-y needs displacement along y:"),
        ("spin-down", "spin-down needs pendulum angles:"),
        ("run-up", "run-up needs displacement along y and rotor phase:"),
        ("point-A", "point-A needs displacement along y and pendulum angles and rotor phase:"),
    ],
)
def test_what_is_missing_is_named_before_a_device_is_opened(
    test: str, missing: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert refusal(test, ONE.roles).startswith(missing)
    name = test.split("-") if test == "point-A" else [test]
    # the port does not exist: opening it would be an error of another kind
    assert run(["test", "one_laser", *name]) == 2
    assert missing in " ".join(capsys.readouterr().err.split())


def test_a_rig_without_drive_and_locks_can_do_them_all_by_hand() -> None:
    assert HAND.roles.speed is HAND.roles.locks is None
    assert inputs.possible_tests(HAND) == inputs.possible_tests(OTHER) == inputs.test_names(HAND)


def test_a_points_kind_is_found_by_its_name() -> None:
    assert kind_of("point-Z9") is KINDS["point"]
    assert kind_of("dance") is None
    assert KINDS["point"].channels == {"laser/x", "laser/y", "pendulums", "tacho"}


def test_a_points_name_follows_the_name_of_any_kind_with_points(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("point-A", "point-two-of", "point", "point-", "run-up", "dance-A", "slow-roll-B", "slow-roll")
    assert [point_of(name) for name in names] == ["A", "two-of", "", "", "", "", "", ""]
    kinds = {**KINDS, "slow-roll": replace(KINDS["point"], name="slow-roll")}
    monkeypatch.setattr(guided_test_kinds, "KINDS", kinds)
    assert [point_of(name) for name in names] == ["A", "two-of", "", "", "", "", "B", ""]

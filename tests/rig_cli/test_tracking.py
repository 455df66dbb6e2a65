"""c3 and c4 while a test runs: from the session's readings, from start values that are wrong by a factor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daq.acquisition.session import Session
from daq.errors import LinkLost
from daq.guided_tests.procedure import Procedures
from daq.lockstep.rig import LockstepRig
from daq.virtual_rig.simulated_operator import SimulatedOperator
from identification.tracking.tracker import Tracker
from rig_cli.main import run
from rig_cli.simulated import VirtualRigProcess
from rig_cli.tracking import LiveTracking, compile_tracker, imbalance_std
from rig_configs import IdentifiedParameters, load_rig

WRONG = ["pendulums.a.damping_Nms_per_rad=*2", "pendulums.b.damping_Nms_per_rad=*0.5"]


def quiet(text: str, share: float | None) -> None:
    """No progress in tests."""


def test_a_spin_down_is_followed_from_wrong_dampings(tmp_path: Path) -> None:
    compile_tracker(load_rig("virtual").physics)
    with VirtualRigProcess("virtual", ["virtual.seed=3"]) as virtual_rig:
        rig = load_rig("virtual", settings=[*virtual_rig.port_settings(), *WRONG])
        with Session(rig, virtual_rig.clock) as session, LiveTracking(session) as following:
            Procedures(session, SimulatedOperator(virtual_rig.line), tmp_path, quiet).spin_down()
            session.wait_for(lambda: following.now.trusted, 5.0, "the tracker to follow")
            facts, words = following.facts(), following.words()
    truth = load_rig("virtual").true_physics
    assert facts["trusted"]
    assert words.startswith("c3 ")
    for name, true in (("c3_Nms_per_rad", truth.a), ("c4_Nms_per_rad", truth.b)):
        low, high = facts[name]["interval"]
        assert low / 1.2 < true.damping_Nms_per_rad < 1.2 * high  # a flick is hard on a filter, and this is one draw
        assert high < 10 * low  # at the start it was a factor 50


def test_what_goes_wrong_in_the_tracker_does_not_end_the_test(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def broken(*_: object) -> None:
        raise ValueError("not positive definite")

    changes = ["virtual.seed=3"]
    sim = LockstepRig(load_rig("virtual", settings=changes))
    rig = load_rig("virtual", settings=[*changes, *sim.port_settings()])
    compile_tracker(rig.physics)
    with Session(rig, sim.clock, edge=sim.edge) as session, LiveTracking(session) as following:
        monkeypatch.setattr(Tracker, "feed_encoders", broken)
        done = Procedures(session, SimulatedOperator(sim), tmp_path, quiet).spin_down()
        following._thread.join(10.0)
    assert following.words() == "tracking stopped: not positive definite"
    assert done.summary == {"slowed_down": True, "reached": True, "ended": "done"}
    assert not following.facts()["trusted"]


def test_an_identified_imbalance_is_trusted_as_far_as_its_file_states(tmp_path: Path) -> None:
    path = tmp_path / "parameters.toml"
    IdentifiedParameters({"SP_kg_m": 2e-3}, np.array([[4e-12]])).save(path)
    assert imbalance_std(path) == pytest.approx(1e-3)
    assert imbalance_std(None) == Tracker.imbalance_std


def test_the_tracker_is_compiled_before_a_device_is_opened(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    order: list[str] = []

    def open_noted(session: Session) -> Session:
        order.append("opened")
        raise LinkLost("no cable")

    monkeypatch.setattr("rig_cli.tracking.compile_tracker", lambda physics: order.append("compiled"))
    monkeypatch.setattr(Session, "open", open_noted)
    assert run(["test", "virtual", "spin-down", "--track", "--out", str(tmp_path)]) == 3
    assert order == ["compiled", "opened"]


def test_a_test_that_does_not_exist_is_refused_before_a_device_is_opened(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Session, "open", lambda session: pytest.fail("a device was opened"))
    assert run(["test", "virtual", "point", "Z"]) == 2
    assert "'point-Z': no such test. Known: ring-down-x" in " ".join(capsys.readouterr().err.split())

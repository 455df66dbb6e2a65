"""Limits that the simulated rig's truth never violates, for any action of the operator, any answer and any failure.

Whole sessions in lockstep: guided tests in any order, aborted at any time, with faults of any device. Watched at every
step of the world: no pendulum is released while a rotor that is to turn stands, none is free while the rotor is brought
up to speed, and the rotor stands with its drive idle when all is over, or the operator was warned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from daq.errors import AcquisitionError
from daq.guided_tests.controls import Controls
from daq.guided_tests.procedure import Procedures
from daq.lockstep.rig import LockstepRig
from daq.virtual_rig.motion import StepTrajectory
from daq.virtual_rig.simulated_operator import SimulatedOperator
from tests.daq.simulated_sessions import opened
from tests.effort import cases

RPM = math.pi / 30
TESTS = ("ring-down-x", "spin-down", "run-up", "point-A", "point-D")
FAULTS = (
    ("laser_x", "blocked"),
    ("laser_y", "mute"),
    ("encoder", "radio"),
    ("encoder", "dead"),
    ("encoder", "locks stuck"),
    ("encoder", "marks lost"),
    ("encoder", "power"),
    ("drive", "fault"),
    ("drive", "restart"),
    ("drive", "emergency"),
    ("drive", "unheard"),
    ("drive", "silent reports"),
    ("laser_x", "unplug"),
    ("drive", "unplug"),
)
ONCE = ("fault", "restart", "emergency")


@dataclass
class Watch:
    """What the truth has shown so far."""

    sim: LockstepRig
    turns: bool = False  # whether the running test turns the rotor
    wrong: list[str] = field(default_factory=list[str])
    held: tuple[bool, bool] = (True, True)
    stood: bool = True

    def __post_init__(self) -> None:
        advance = self.sim.far.motion.advance

        def watched(until_s: float) -> StepTrajectory | None:
            stretch = advance(until_s)
            self.look()
            return stretch

        self.sim.far.motion.advance = watched

    def look(self) -> None:
        motion = self.sim.far.motion
        rpm, held = abs(motion.speed_rad_s) / RPM, (motion.held(0), motion.held(1))
        if self.turns and self.held == (True, True) and held != self.held and rpm < 20:
            self.wrong.append(f"released at {rpm:.1f} rpm")
        if self.stood and rpm > 20 and held != (True, True):
            self.wrong.append(f"spun up to {rpm:.0f} rpm with a free pendulum")
        self.stood = rpm <= 20 if self.stood else rpm < 0.5
        self.held = held


Action = tuple[str, float | None, tuple[tuple[str, str], float, float] | None]
"""A guided test, when the operator aborts it, and a fault with its begin and duration; times in s."""


def drawn(seed: int) -> list[Action]:
    """One or two tests; fourteen seeds in a row have every fault once, five every test."""
    rng = np.random.default_rng(seed)
    program: list[Action] = []
    for number in range(1 + seed % 2):
        fault = (FAULTS[(seed + 5 * number) % len(FAULTS)], rng.uniform(0.2, 20.0), rng.uniform(0.1, 4.0))
        abort_s = rng.uniform(0.5, 25.0) if rng.random() < 0.4 else None
        program.append((TESTS[(seed + number) % len(TESTS)], abort_s, fault if rng.random() < 0.8 else None))
    return program


@pytest.mark.parametrize("seed", range(cases(7, 200)))
def test_no_path_releases_at_rest_spins_up_unlocked_or_leaves_the_rotor_turning(tmp_path: Path, seed: int) -> None:
    sim, session = opened("virtual", f"virtual.seed={seed}")
    sim.step_s = (0.004, 0.016)
    watch, controls = Watch(sim), Controls()
    try:
        with session:
            tests = Procedures(session, SimulatedOperator(sim), tmp_path, lambda text, share: None, controls=controls)
            for test, abort_s, fault in drawn(seed):
                watch.turns = test != "spin-down"
                controls.take()
                if abort_s is not None:
                    sim.clock.after(abort_s, lambda: controls.abort("enough"))
                if fault is not None:
                    place(sim, *fault)
                name, _, point = test.partition("point-")
                numbers = {"top_rpm": 300.0, "duration_s": 5.0} if test == "run-up" else {}
                tests.run("point" if point else name, point=point, **numbers)
    except AcquisitionError:
        pass  # a fault ended it, or the rig refused to go on
    except ValueError as error:
        assert "virtual rig" in str(error)  # noqa: PT017 (a hand that found nothing to flick)
    sim.step_s = (0.04, 0.06)
    watch.turns = False
    sim.clock.wait(15.0)
    assert watch.wrong == []
    standing = abs(sim.far.motion.speed_rad_s) < 0.5
    assert standing or any("keep away" in notice for notice in session.notices)
    assert sim.far.motion.target_rad_s == 0
    assert not list(tmp_path.glob("*.part"))


def place(sim: LockstepRig, what: tuple[str, str], at_s: float, seconds: float) -> None:
    """A fault some time from now."""
    device, kind = what

    def begin() -> None:
        if kind == "unplug":
            sim.ask("unplug", device=device)
            sim.clock.after(seconds, lambda: sim.ask("plug", device=device), world=True)
        else:
            sim.ask("fail", device=device, what=kind, **({} if kind in ONCE else {"seconds": seconds}))

    sim.clock.after(at_s, begin, world=True)


def test_the_watch_sees_what_a_test_never_does() -> None:
    sim, session = opened("virtual", "virtual.seed=1")
    watch = Watch(sim, turns=True)
    with session:
        session.rotor.command_locks("lock both")
        sim.clock.wait(3.0)
        session.rotor.command_locks("release both")
        sim.clock.wait(1.0)
        session.drive.enable()
        session.drive.set_ramp(300.0)
        session.drive.set_speed(200)
        sim.clock.wait(2.0)
    assert [text.partition(" at ")[0].partition(" to ")[0] for text in watch.wrong] == ["released", "spun up"]

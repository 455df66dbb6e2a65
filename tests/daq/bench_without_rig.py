"""Test doubles for guided tests without rig, thread and wall clock: session, rotor and locks that record commands."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from daq.channels import LOCKS_CLOSED
from daq.errors import DeviceError, ProcedureError
from daq.guided_test_kinds import GuidedTestRequest
from daq.guided_tests.commands import RigCommands
from daq.guided_tests.controls import Controls
from daq.guided_tests.hands import Wait
from daq.guided_tests.runner import Runner, TestDone
from daq.guided_tests.table import State, StateObservation, StateTable, StateView
from daq.items import DeviceEvent
from rig_configs.schema import Rig


class Clock:
    """Time that passes only while a thread sleeps.

    Attributes:
        does: called after each sleep.
    """

    def __init__(self) -> None:
        self.ns = 1_700_000_000_000_000_000
        self.does: Callable[[], None] = lambda: None

    def now_ns(self) -> int:
        return self.ns

    def wait(self, seconds: float) -> None:
        self.ns += int(seconds * 1e9)
        self.does()


class NoRates:
    def summary(self) -> str:
        return ""


@dataclass
class Bench:
    """Session, rotor, locks and operator in one: what they were commanded, and what must never be.

    Attributes:
        commands: in words, as they came.
        wrong: what no test may do.
        fails_at: number of the command that ends in an error.
        fault: what `check` raises from now on.
        while_commanded: called with the number of each command while it is carried out.
    """

    rig: Rig
    fails_at: int | None = None
    clock: Clock = field(default_factory=Clock)
    commands: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    turning: bool = False
    locked: bool = False
    recording: bool = False
    fault: Exception | None = None
    trouble: Exception | None = None
    rates = NoRates()
    ramp_rpm_per_s = 100.0
    reported_rpm = float("nan")
    while_commanded: Callable[[int], None] = lambda number: None
    notes: list[DeviceEvent] = field(default_factory=list)
    logs: list[dict[str, Any]] = field(default_factory=list)

    def _carry_out(self, text: str) -> None:
        self.commands.append(text)
        self.while_commanded(len(self.commands))
        if self.fails_at == len(self.commands):
            raise DeviceError(f"{text} failed")

    # --- session and its parts
    @property
    def channels(self) -> Bench:
        return self

    @property
    def devices(self) -> Bench:
        return self

    def check(self) -> None:
        if self.fault is not None:
            raise self.fault

    def wait_for(self, condition: Callable[[], bool], seconds: float, what: str) -> None:
        end = self.clock.ns + seconds * 1e9
        while not condition():
            self.check()
            if self.clock.ns > end:
                raise DeviceError(f"waited {seconds:g} s for {what}: timeout")
            self.clock.wait(1.0)

    def fail(self, error: Exception) -> None:
        self.trouble = self.trouble or error

    def newest(self, topic: str, fields: tuple[str, ...], seconds: float) -> tuple[Any, list[Any]]:
        values = {"theta3_rad": 0.0, "theta4_rad": np.pi, "flags": LOCKS_CLOSED if self.locked else 0}
        return np.zeros(1, np.int64), [np.array([values.get(name, 0)]) for name in fields]

    def identification_of(self, device: str) -> tuple[bool, str]:
        return True, ""

    def need(self, *topics: str) -> None:
        pass

    def note(self, event: DeviceEvent) -> None:
        self.notes.append(event)

    def start_recording(self, path: Path, metadata: Mapping[str, str], before_s: float = 0.0) -> None:
        self._carry_out("begin the log")
        self.recording = True
        self.logs.append({"path": path, **metadata})

    def stop_recording(self, summary: Mapping[str, Any]) -> Path:
        self.recording = False
        self.logs[-1] |= {"summary": dict(summary)}
        self._carry_out("end the log")
        return self.logs[-1]["path"]

    # --- rotor
    @property
    def speed_rpm(self) -> float:
        return 300.0 if self.turning else 0.0

    def begin(self) -> str:
        self._carry_out("make ready")
        return ""

    def go(self, rpm: float, ramp_rpm_per_s: float) -> None:
        if rpm and not self.locked and not self.turning and "scatter" not in self.commands:
            self.wrong.append("spun up with pendulums that are not locked")
        self.turning = self.turning or rpm > 0
        self._carry_out(f"turn at {rpm:.0f} rpm")

    def stop(self) -> None:
        self._carry_out("rest")
        self.turning = False

    def quick_stop(self) -> None:
        self.commands.append("quick stop")
        self.turning = False

    # --- locks
    def lock(self) -> None:
        if self.turning:
            self.wrong.append("locked while the rotor turned")
        self._carry_out("lock")
        self.locked = True

    def release(self, turning: bool) -> int:
        if turning != self.turning:
            self.wrong.append("released at rest" if turning else "released while the rotor turned")
        self._carry_out("release")
        self.locked = False
        return self.clock.ns

    # --- operator
    def pluck(self, axis: str) -> None:
        self._carry_out(f"pluck {axis}")

    def flick(self) -> None:
        self._carry_out("flick")

    def scatter(self) -> None:
        self._carry_out("scatter")


def runner_of(bench: Bench, controls: Controls, folder: Path) -> Runner:
    def made(wait: Wait) -> RigCommands:
        return RigCommands(bench, bench, folder, lambda text, share: None, "", wait, bench, bench)

    return Runner(made, controls)


def scripted(table: StateTable, look: Callable[[State, StateView], StateObservation], looks: int = 4) -> StateTable:
    """The table with looks that are played, a few of them until a state's limit."""

    def played(row: State) -> State:
        if not row.waits_for:
            return row
        return replace(row, look=lambda view: look(row, view), period_s=max(0.01, row.limit_s / looks), missed=_missed)

    return StateTable(tuple(map(played, table.states)), tuple(map(played, table.ending)))


def _missed(view: StateView) -> str:
    return "what was waited for"


def finished(
    bench: Bench, asked: GuidedTestRequest, table: StateTable, controls: Controls, folder: Path
) -> TestDone | Exception:
    """What a run of a table came to."""
    try:
        return runner_of(bench, controls, folder).run(asked, table, {})
    except (DeviceError, ProcedureError) as error:
        return error


def reached_its_log(
    bench: Bench, asked: GuidedTestRequest, table: StateTable, controls: Controls, folder: Path
) -> TestDone:
    """As `finished`, of a run that has a log."""
    done = finished(bench, asked, table, controls, folder)
    assert isinstance(done, TestDone)
    return done


def plays(script: Iterable[str], controls: Controls, bench: Bench) -> Callable[[State, StateView], StateObservation]:
    """A look that carries out a script: "done" ends the state, "wait" looks on, the others come from outside."""
    steps = iter(script)

    def look(state: State, view: StateView) -> StateObservation:
        step = next(steps, "wait")
        if step == "fault":
            bench.fault = DeviceError("a channel is silent")
        elif step in ("abort", "abort and done"):
            controls.abort("smoke")
        elif step == "note":
            controls.note("a word")
        elif step == "pause":
            controls.pause()
            controls.resume()  # without this the pause would not end
        return StateObservation(step.endswith("done"), store={"released_ns": view.memory.get("released_ns", 1)})

    return look

"""Output of `rig test` without a device: the plan of a test, and which tests of a campaign are missing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.table import Table

from daq.errors import LogError
from daq.guided_test_kinds import given_on, kind_of, refusal
from daq.guided_tests.plan import GuidedTestPlan, PlannedState
from daq.guided_tests.test_inputs import test_names
from daq.log import open_log
from daq.log.outcome import not_reached_of
from rig_basics.texts import number_of
from rig_cli.console import harmless, notify, show
from rig_cli.last_sentence import campaign_sentence
from rig_cli.words import length, stdout_console
from rig_configs.schema import Rig


def print_plan(plan: GuidedTestPlan) -> None:
    """Print a plan: its head, the table of states, and the prompts."""
    times = f", {number_of(plan.repeats, 'time')}" if plan.repeats > 1 else ""
    show(f"{plan.test}: {plan.line}{times}; about {length(plan.usual_s)}")
    show(f"  needs    {', '.join(f'{signal} ({device})' for signal, device in plan.needs.items()) or 'nothing'}")
    show(f"  gives    {', '.join(plan.gives) or 'nothing that is identified'}")
    show(f"  numbers  {', '.join(f'{name}={value:.6g}' for name, value in plan.numbers.items()) or 'none'}")
    show(f"  limits   {plan.limit_rpm:.0f} rpm (the test turns at {plan.top_rpm:.0f}), {plan.limit_m * 1e3:g} mm")
    if plan.warning:
        show(f"  warning  {plan.warning}")
    table = Table(box=None, pad_edge=False)
    for title in ("", "state", "who", "does", "waits for", "rpm", "usual", "at most", "pause", "then", "too late"):
        table.add_column(title, justify="right" if title in ("rpm", "usual", "at most") else "left")
    for number, state in enumerate(plan.states, 1):
        table.add_row(f"{number}", *_cells(state))
    stdout_console().print(table)
    if plan.prompts:
        show("Prompts to the operator:")
        for prompt in plan.prompts:
            show(f"  {harmless(prompt)}")
    show("An abort leads to 'finish' from every state before it. No device was opened.")


def _cells(state: PlannedState) -> tuple[str, ...]:
    limit = f"{state.limit_s:.0f} s" if state.waits_for else ""
    usual = f"{state.usual_s:.1f} s" if state.usual_s else ""
    pause = "no" if state.no_pause else "yes"
    rpm = f"{state.rpm:.0f}" if state.rpm else ""
    return state.name, state.who, state.does, state.waits_for, rpm, usual, limit, pause, state.done, state.late


def campaign(rig: Rig, folder: Path) -> dict[str, Any]:
    """Return the tests that a rig can do, each with its state in a folder of logs.

    An interrupted campaign is resumed by running the tests that are "missing" or "not reached". Every test has a log of
    its own and needs no earlier one.
    """
    logs = _logs(rig, folder)
    tests: list[dict[str, Any]] = []
    for name in test_names(rig):
        kind, why = kind_of(name), refusal(name, rig.roles)
        assert kind is not None
        mine = [(path, missed) for path, test, missed in logs if test == name]
        finished = [path for path, missed in mine if not missed]
        state = "refused" if why else "done" if finished else "not reached" if mine else "missing"
        path = str((finished or [path for path, _ in mine] or [""])[-1])
        tests.append(
            {
                "test": name,
                "line": kind.summary,
                "gives": given_on(kind, rig.roles),
                "state": state,
                "log": path,
                "why": why,
            }
        )
    return {"rig": rig.name, "folder": str(folder), "tests": tests}


def _logs(rig: Rig, folder: Path) -> list[tuple[Path, str, str]]:
    """Return the rig's logs in a folder: file, test, what was not reached. Unreadable logs are reported and skipped."""
    found: list[tuple[Path, str, str]] = []
    for path in sorted(folder.glob("*.mcap*")) if folder.is_dir() else []:
        try:
            with open_log(path) as log:
                run = log.metadata.get("run", {})
                if run.get("rig") == rig.name:
                    cut = "" if log.complete else "the recording was cut"
                    found.append((path, run.get("test", ""), cut or not_reached_of(log)))
        except (LogError, OSError) as error:
            notify(f"warning: {path} is skipped: {error}")
    return found


def print_campaign(found: dict[str, Any]) -> None:
    """Print the tests of a rig, one a line."""
    table = Table(box=None, pad_edge=False)
    for title in ("test", found["folder"], "what it does"):
        table.add_column(title)
    for row in found["tests"]:
        table.add_row(row["test"], row["log"] if row["state"] == "done" else row["state"], row["why"] or row["line"])
    stdout_console().print(table)
    show(campaign_sentence(found))

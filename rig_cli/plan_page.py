"""A plan on the terminal."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from identification.plan.experiment import Experiment
from identification.plan.planning import MOST_RUNS, ExperimentPlan, PlanAnswer
from rig_cli.words import length, percent, stdout_console
from rig_configs.physical_numbers import short


def print_plan(rig: str, found: ExperimentPlan) -> None:
    """Print what to record, what it reaches, what cannot be reached and why."""
    console = stdout_console()
    console.print(Text.assemble(("plan ", "dim"), (rig, "bold")))
    console.print(Text(_sensors(found), "dim"), soft_wrap=True)
    if found.steps:
        console.print(_steps(found))
    console.print(_wants(found))
    for answer in found.answers:
        if not answer.possible:
            console.print(Text(_cannot(answer), "bold red"), soft_wrap=True)
    for remark in found.remarks:
        console.print(Text(f"note: {remark}", "dim"), soft_wrap=True)


def _sensors(found: ExperimentPlan) -> str:
    s = found.sensors
    there = ["xy".index(axis) for axis in s.axes]
    if not there:
        return "no sensor of displacements"
    noise = " and ".join(dict.fromkeys(f"{1e6 * s.laser_noise_m[i]:.2g} µm" for i in there))
    gain = " and ".join(dict.fromkeys(percent(s.gain_std[i]) for i in there))
    rate = " and ".join(dict.fromkeys(f"{s.laser_rate_Hz[i]:.0f} Hz" for i in there))
    source = "as measured in the log" if s.measured else "usual values: --log LOG measures this rig's"
    return f"displacements along {' and '.join(s.axes)}: {noise} noise at {rate} ({source}), gain known to {gain}"


def _steps(found: ExperimentPlan) -> Table:
    table = Table(box=SIMPLE_HEAD, pad_edge=False, title_justify="left")
    for title in ("record", "times", "how", "length", "for"):
        table.add_column(title, justify="right" if title in ("times", "length") else "left", no_wrap=title != "how")
    for step in found.steps:
        e = step.experiment
        wanted = ", ".join(short(n) for n in step.wanted_for)
        table.add_row(Text(e.test, "bold"), str(step.runs), _how(e), length(e.record_s), wanted)
    return table


def _how(experiment: Experiment) -> str:
    s = experiment.settings
    if experiment.method == "ring-down":
        return f"pluck by {s['pluck_mm']:.2g} mm, let it ring"
    if experiment.method == "passage":
        largest = f", up to {1e3 * experiment.largest_m:.2g} mm"
        return f"ramp to {s['top_rpm']:.0f} rpm at {s['rate_rpm_per_s']:.2g} rpm/s{largest}"
    if experiment.method == "spin-down":
        return f"flick both to {s['flick_rad_per_s']:.2g} rad/s, against each other"
    return f"release at {s['speed_rpm']:.0f} rpm"


def _wants(found: ExperimentPlan) -> Table:
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for title in ("want", "wanted ±", "this plan ±", "best of one run each"):
        table.add_column(title, justify="right" if "±" in title else "left", no_wrap=title != "best of one run each")
    for answer in found.answers:
        mark = ("✓ ", "green") if answer.possible else ("✗ ", "bold red")
        single = ", ".join(f"{e.test} {percent(std)} ({length(e.record_s)})" for e, std in answer.best[:4])
        table.add_row(
            Text.assemble(mark, short(answer.want.name)), percent(answer.wanted), percent(answer.reached), single
        )
    return table


def _cannot(answer: PlanAnswer) -> str:
    name, wanted = short(answer.want.name), percent(answer.wanted)
    if not answer.best:
        return f"{name} to {wanted} cannot be reached: no test on this rig shows it"
    remedy = {
        "gain": "a better calibration of the lasers and the lever between laser and disk",
        "known": "weighing and measuring the parts better, and setting zeros and the index angle better",
        "clock": "better known clocks: a smaller clock_tolerance_ppm, or longer logs",
        "mass": "weighing the rotor more exactly",
        "noise": "less noise, or larger motion",
    }[answer.limited_by]
    return (
        f"{name} to {wanted} cannot be reached with these sensors: {answer.limited_by} limits it to "
        f"{percent(answer.floor)} even after {MOST_RUNS} runs. Remedy: {remedy}"
    )

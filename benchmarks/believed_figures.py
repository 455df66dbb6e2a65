"""Correctness of the suite's uncertainties and verdicts, from campaigns on rigs that its own model did not make.

    python -m benchmarks.believed_figures --seeds A:B [--effect NAME[=STRENGTH]] [--wrong NAME[=N]] [--knowledge exact]
        [--joint] [--run-up-after] [--jobs N] [--out FILE.jsonl] [--resume]

Each campaign draws a true rig and its sensors (benchmarks.worlds), records two ring-downs, a spin-down, a run-up and
releases at the five points, identifies and validates. Printed: coverage of the 95 % intervals, of parameters and of
what is predicted at the points, with its own binomial 95 % interval, mean and spread of z (|z| of an amplitude of
nothing), the share of campaigns that pass, the share whose warnings name the effect, alarms where nothing is wrong,
and median times. `--knowledge` selects what is uncertain in the rig file: "exact" nothing, "usual" zeros, gains, index
and clocks within what it states, "weighed" masses and lengths to 0.05 % too. Effects: cubic, quadratic, dry, contact,
drag, bow, runout, hum, wander, creep, phase_step, speed_noise, turned, noise, gaps. Wrong: k2, zeta1, c3, SP change
between the tests and the points, by N of the standard deviations that were found; mass_b, length_b, zero_a, gain_x are
off from the beginning, by N of those stated.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from benchmarks.worlds.campaign import Plan, campaign, is_routine, named_effects, names_effect
from benchmarks.worlds.world import WRONG, Effects, Spread, with_effect
from uncertainty.binomial import binomial_interval

KNOWLEDGE = {"exact": Spread.exact, "usual": Spread, "weighed": Spread.weighed}
_LIMIT = 1.959964


def summary(rows: Sequence[dict[str, Any]], effects: Effects) -> str:
    """The table of a series of campaigns."""
    done = [row for row in rows if "error" not in row]
    lines = [f"{len(rows)} campaigns, {len(rows) - len(done)} broke off"]
    lines += [f"  seed {row['seed']}: {row['error']}" for row in rows if "error" in row]
    if not done:
        return "\n".join(lines)
    lines += _coverage("before the points", done)
    if joint := [row["joint"] for row in done if "joint" in row]:
        lines += _coverage("with the points", joint)
    lines += _verdicts(done) + _warnings(done, effects)
    names = [n for n in ("data", "identification", "validation", "joint") if n in done[0]["seconds"]]
    medians = ", ".join(f"{n} {np.median([row['seconds'][n] for row in done]):.2f} s" for n in names)
    return "\n".join([*lines, f"medians: {medians}"])


def _coverage(title: str, rows: Sequence[dict[str, Any]]) -> list[str]:
    lines = [f"{title:22}{'n':>5}{'95 %':>7}{'interval':>15}{'mean z':>8}{'sd z':>7}{'max |z|':>9}{'std/value':>11}"]
    names = list(dict.fromkeys(name for row in rows for name in row["z"]))
    for name in names:
        have = [row for row in rows if name in row["z"]]
        relative = float(np.median([row["std"][name] / abs(row["parameters"][name]) for row in have]))
        lines.append(_line(name, [row["z"][name] for row in have], relative))
    axis = [
        (a["found_deg"] - a["true_deg"]) / a["std_deg"] for row in rows if np.isfinite((a := row["axis"])["std_deg"])
    ]
    if axis:
        lines.append(_line("axis angle", axis))
    return [*lines, _line("all", [z for row in rows for z in row["z"].values()])]


def _line(name: str, z: Sequence[float], relative: float | None = None) -> str:
    inside = int(np.sum(np.abs(z) < _LIMIT))
    low, high = binomial_interval(inside, len(z))
    end = "" if relative is None else f"{relative:11.1e}"
    return (
        f"{name:22}{len(z):5}{inside / len(z):7.3f}{f'{low:.3f}…{high:.3f}':>15}{np.mean(z):8.2f}{np.std(z):7.2f}"
        f"{np.max(np.abs(z)):9.2f}{end}"
    )


def _verdicts(rows: Sequence[dict[str, Any]]) -> list[str]:
    passed = sum(bool(row["passed"]) for row in rows)
    low, high = binomial_interval(passed, len(rows))
    lines = [f"pass: {passed} of {len(rows)} ({low:.2f}…{high:.2f})"]
    for point in dict.fromkeys(p for row in rows for p in row["points"]):
        results = [row["points"][point] for row in rows if point in row["points"]]
        z = {n: [r["z"][n] for r in results if n in r["z"]] for n in dict.fromkeys(n for r in results for n in r["z"])}
        verdicts = {v: sum(r["verdict"] == v for r in results) for v in dict.fromkeys(r["verdict"] for r in results)}
        lines.append(f"  {point}: {', '.join(f'{n} {v}' for v, n in verdicts.items())}")
        lines += [_line(f"  {point} {name}", found) for name, found in z.items()]
    every = [z for row in rows for point in row["points"].values() for z in point["z"].values()]
    return [*lines, _line("  all predicted", every)] if every else lines


def _warnings(rows: Sequence[dict[str, Any]], effects: Effects) -> list[str]:
    """Which share of warnings and of campaigns names the effect; alarms where there is none to give."""
    texts = [
        [w for w in dict.fromkeys([*row["warnings"], *row.get("joint", {}).get("warnings", [])]) if not is_routine(w)]
        for row in rows
    ]
    warnings = sum(map(len, texts))
    if not named_effects(effects):
        alarms = sum(bool(found) or not row["passed"] for found, row in zip(texts, rows, strict=True))
        kind = "something is wrong" if rows[0]["wrong"] else "false alarms"
        return [f"{kind}: {alarms} of {len(rows)} campaigns have a warning or do not pass ({warnings} warnings)"]
    naming = [sum(names_effect(w, effects) for w in found) for found in texts]
    words = ", ".join(named_effects(effects))
    return [
        f"{words}: {sum(naming)} of {warnings} warnings name it, in {sum(map(bool, naming))} of {len(rows)} campaigns"
    ]


def campaigns(seeds: Sequence[int], plan: Plan, jobs: int) -> Iterator[dict[str, Any]]:
    """Each as it is done, in processes of their own where there are several jobs."""
    if jobs <= 1:
        yield from (campaign(seed, plan) for seed in seeds)
        return
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        for done in as_completed([pool.submit(campaign, seed, plan) for seed in seeds]):
            yield done.result()


def key_of(plan: Plan) -> str:
    """What must be the same for two campaigns of one file to be of one series."""
    return repr(plan)


def earlier_rows(path: Path, key: str) -> list[dict[str, Any]]:
    """Campaigns of a series that a file has, each once; a line that was cut off is left out."""
    rows: dict[int, dict[str, Any]] = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        if row.get("plan") == key:
            rows[row["seed"]] = row
    return list(rows.values())


def run(seeds: Sequence[int], plan: Plan, jobs: int, out: Path | None, resume: bool) -> list[dict[str, Any]]:
    """All campaigns, with progress on standard error; every line is on the disk when its campaign is done."""
    key, wanted = key_of(plan), set(seeds)
    rows = [row for row in earlier_rows(out, key) if row["seed"] in wanted] if out and resume else []
    if out:
        out.parent.mkdir(parents=True, exist_ok=True)
    left = sorted(wanted - {row["seed"] for row in rows})
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[rate]}"),
        console=Console(stderr=True),
    )
    with bar:
        task = bar.add_task("campaigns", total=len(seeds), completed=len(rows), rate="")
        for row in campaigns(left, plan, jobs):
            rows.append(row | {"plan": key})
            if out:
                with out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
            speed = bar.tasks[0].speed
            bar.update(task, advance=1, rate=f"{60 * speed:.1f} a minute" if speed else "")
    return sorted(rows, key=lambda row: row["seed"])


def seeds_of(text: str) -> range:
    """A:B as the seeds from A up to B − 1.

    Raises:
        argparse.ArgumentTypeError: it is not that, or holds no seed.
    """
    first, sign, last = text.partition(":")
    if not (sign and first.isdecimal() and last.isdecimal() and int(first) < int(last)):
        raise argparse.ArgumentTypeError(f"expected A:B with whole numbers A < B, got {text!r}")
    return range(int(first), int(last))


def parsed(arguments: Sequence[str] | None = None) -> tuple[argparse.Namespace, Plan]:
    """The command line and the plan it stands for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=seeds_of, default="0:20", metavar="A:B", help="from A up to B − 1")
    parser.add_argument("--effect", action="append", default=[], metavar="NAME[=STRENGTH]")
    parser.add_argument("--wrong", default="", metavar="NAME[=N]", help=f"one of {', '.join(WRONG)}")
    parser.add_argument("--knowledge", choices=KNOWLEDGE, default="usual")
    parser.add_argument("--joint", action="store_true", help="identify once more with the points' releases")
    parser.add_argument("--run-up-after", action="store_true", help="validate with a further run-up after the points")
    parser.add_argument("--jobs", type=int, default=1, help=f"processes; this machine has {os.cpu_count()} processors")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--resume", action="store_true", help="leave out seeds that --out has")
    given = parser.parse_args(arguments)
    effects = Effects()
    try:
        for text in given.effect:
            effects = with_effect(text, effects)
    except ValueError as error:
        parser.error(str(error))
    wrong, _, by = given.wrong.partition("=")
    if wrong and wrong not in WRONG:
        parser.error(f"--wrong: expected one of {', '.join(WRONG)}, got {wrong!r}")
    if given.resume and not given.out:
        parser.error("--resume: expected --out FILE to go on with")
    if given.out and given.out.exists() and not given.resume:
        parser.error(f"--out: {given.out} is there already; --resume goes on with it")
    return given, Plan(KNOWLEDGE[given.knowledge](), effects, wrong, float(by or 5.0), given.joint, given.run_up_after)


def main() -> None:
    """See the module."""
    given, plan = parsed()
    rows = run(given.seeds, plan, given.jobs, given.out, given.resume)
    print(summary(rows, plan.effects))


if __name__ == "__main__":
    main()

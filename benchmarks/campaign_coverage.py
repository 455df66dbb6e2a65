"""Whole campaigns over seeds and changed truths: how far off, how sure, how long, how much memory.

    uv run python benchmarks/campaign_coverage.py --seeds 0:10 [--changed] [--busy LOOPS] [--out FILE.json]

Each campaign is `rig demo --json` in a process of its own, through drivers, logs and all; with `--busy` next to
processes that use every processor completely.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

CHANGED = {
    "k2 +7 %": ["virtual.truth.suspension.k2_N_per_m=+7%"],
    "zeta1 x2": ["virtual.truth.suspension.zeta1=*2"],
    "c3 x1.5": ["virtual.truth.pendulums.a.damping_Nms_per_rad=*1.5"],
    "c4 x0.7": ["virtual.truth.pendulums.b.damping_Nms_per_rad=*0.7"],
    "M_B 0.070": ["pendulums.b.mass_kg=0.070"],
}


def campaign(seed: int, settings: list[str]) -> dict[str, Any]:
    """One demo; its JSON with the exit code added."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            "-m",
            "rig_cli.main",
            "demo",
            "--json",
            "--seed",
            str(seed),
            "--out",
            f"{folder}/demo",
        ]
        for setting in settings:
            command += ["--set", setting]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if not done.stdout.strip():
            return {"error": done.stderr[-2000:], "exit": done.returncode}
        return {**json.loads(done.stdout), "exit": done.returncode}


@contextmanager
def busy_host(loops: int) -> Iterator[None]:
    """So many processes that never rest, meanwhile."""
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(loops)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="0:10")
    parser.add_argument("--changed", action="store_true")
    parser.add_argument("--busy", type=int, default=0)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    with busy_host(arguments.busy):
        campaigns(arguments)


def campaigns(arguments: argparse.Namespace) -> None:
    """All of them, each with a few lines of its own."""
    first, last = (int(x) for x in arguments.seeds.split(":"))
    plans = [(f"seed {s}", s, []) for s in range(first, last)]
    if arguments.changed:
        plans = [(name, 100 + i, settings) for i, (name, settings) in enumerate(CHANGED.items())]
    rows: list[dict[str, Any]] = []
    for name, seed, settings in plans:
        result = campaign(seed, settings)
        rows.append({"name": name, **result})
        if "error" in result:
            print(f"{name}: FAILED exit {result['exit']}\n{result['error']}", flush=True)
            continue
        z = {n: (p["value"] - result["truth"][n]) / p["std"] for n, p in result["parameters"].items()}
        relative = {n: 100 * p["std"] / result["truth"][n] for n, p in result["parameters"].items()}
        verdicts = " ".join(f"{n}:{p['state']}:{p['verdict']}" for n, p in result["points"].items())
        radio = all(r["counted"] == r["dropped"] for r in result["radio"])
        print(f"{name:10} exit {result['exit']} {result['seconds']:4.0f} s  radio {'equal' if radio else 'DIFFERS'}")
        print(f"           {verdicts}")
        print("           z   " + "  ".join(f"{n.split('_')[0]} {v:+.2f}" for n, v in z.items()))
        print("           sd% " + "  ".join(f"{n.split('_')[0]} {v:.4f}" for n, v in relative.items()))
        for warning in result["warnings"]:
            print(f"           warning: {warning}")
        for point, p in result["points"].items():
            if p["verdict"] != "pass":
                print(f"           {point}: {p['why']}")
        sys.stdout.flush()
        rows[-1]["z"] = z
    every = np.array([v for row in rows for v in row.get("z", {}).values()])
    if len(every):
        inside = 100 * np.mean(np.abs(every) < 1)
        print(f"{len(every)} values: {inside:.0f} % within 1 sd, largest |z| {np.max(np.abs(every)):.2f}")
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    print(f"largest process {peak:.0f} MiB")
    if arguments.out:
        arguments.out.write_text(json.dumps(rows))


if __name__ == "__main__":
    main()

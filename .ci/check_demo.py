"""Checks a demo campaign: truth recovered within its intervals, precise enough, every point passed, every log whole.

Every log is read to its last byte and decoded again, and must give what was decoded live, bit for bit.
"""

import json
import sys
from pathlib import Path
from typing import Any

from daq import open_log
from daq.log.verdicts import verdict_of
from daq.replay import check

WORST = {
    "k1_N_per_m": 5e-4,
    "k2_N_per_m": 5e-4,
    "zeta1": 1e-2,
    "zeta2": 1e-2,
    "c3_Nms_per_rad": 1e-2,
    "c4_Nms_per_rad": 1e-2,
    "SP_kg_m": 1e-2,
}


RAREST = 1e-5
BY_CHANCE = ("its quantities together", "what happened right after the release")  # judged below, by RAREST


def main() -> int:
    """Exit code 0 when everything holds; says what does not."""
    result = json.loads(Path(sys.argv[1]).read_text())
    faults = parameter_faults(result) + campaign_faults(result)
    for path in result["logs"]:
        faults += [f"{path}: {fault}" for fault in log_faults(path)]
    if int(sys.argv[2]) != int(not result["passed"]) and not faults:
        faults.append(f"the demo ended with {sys.argv[2]}, passed: {result['passed']}")
    print(f"{result['seconds']:.0f} s")
    for warning in result["warnings"] if faults else ():
        print(f"WARNING {warning}")
    for fault in faults:
        print(f"FAULT {fault}")
    return 1 if faults else 0


def parameter_faults(result: dict[str, Any]) -> list[str]:
    """What was not found, or not as the simulated rig had it."""
    faults = []
    for name, relative in WORST.items():
        found, truth = result["parameters"].get(name), result["truth"][name]
        if found is None:
            faults.append(f"{name}: not identified")
            continue
        z = (found["value"] - truth) / found["std"]
        print(f"{name:16} {found['value']:.7g} ± {found['std']:.2g}, truth {truth:.7g}, {z:+.2f} sd")
        if abs(z) > 4:
            faults.append(f"{name}: {z:+.2f} standard deviations from the truth")
        if found["std"] > relative * truth:
            faults.append(f"{name}: standard deviation {found['std'] / truth:.2g} of the value, wanted {relative:g}")
    return faults


def campaign_faults(result: dict[str, Any]) -> list[str]:
    """Points that do not pass, tests that ended early, frames not counted, no report, or too long."""
    faults = []
    for name, point in result["points"].items():
        print(f"{name}: {point['verdict']} {point['state']}")
        if point["verdict"] != "pass" and not point["why"].startswith(BY_CHANCE):
            faults.append(f"point {name}: {point['verdict']}: {point['why']}")
    faults += agreement_faults(result["agreement"])
    faults += [f"{test} did not reach: {missed}" for test, missed in result["not_reached"].items()]
    for row in result["radio"]:
        if row["counted"] != row["dropped"]:
            faults.append(f"{row['log']}: {row['counted']} radio frames counted lost, {row['dropped']} were")
    if not Path(result["report"]).stat().st_size > 100_000:
        faults.append("the report is suspiciously small")
    if result["seconds"] > 180:
        faults.append(f"the demo took {result['seconds']:.0f} s")
    return faults


def agreement_faults(agreement: dict[str, Any]) -> list[str]:
    """What chance does not give in ten thousand demos: the demo's own verdict is wrong in one of twenty by design."""
    print(f"together: {agreement['why']}")
    parts = {"all points": agreement, **agreement["points"]}
    faults = [f"{name}: p = {found['p']:.2g}: {found}" for name, found in parts.items() if found["p"] < RAREST]
    beyond = {cause: abs(z) - agreement["cause_limits_z"][cause] for cause, z in agreement["cause_z"].items()}
    largest = max(beyond, key=lambda cause: beyond[cause])
    z = agreement["cause_z"][largest]
    if beyond[largest] > 2:
        faults.append(f"{largest} alone would explain {z:+.1f} standard deviations")
    return faults


def log_faults(path: str) -> list[str]:
    """What is wrong with a log."""
    with open_log(path) as log:
        faults = [str(missing) for missing in log.verify()]
    if verdict_of(path) is None and "point" in path:
        faults.append("no verdict is kept beside it")
    return faults + [f"{row.topic} decoded again: {row.difference}" for row in check(path) if row.difference]


if __name__ == "__main__":
    sys.exit(main())

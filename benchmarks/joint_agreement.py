"""The joint estimate over many made-up sets of tests: false alarms, detection of one bad test, coverage afterwards.

    python benchmarks/joint_agreement.py [sets] [--recordings N]

Estimates are drawn from their own covariances (tests/identification/test_joint.py). With --recordings, N campaigns of
five whole recordings are made up and identified: once as they are, once with one ring-down's k 3 % off, once with one
run-up's laser x 10 % off. Seeds are fixed and printed.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "identification"))

from synthetic import Campaign
from test_joint import CAMPAIGN, TRUTH, draw, spoilt

from identification import Identification, identify
from identification.joint import joint_estimate
from identification.joint.agreement import verdict

SEED = 1
NAME, OWN_STD = "c3_Nms_per_rad", 1e-3  # the spoilt parameter and its relative own standard deviation


def main() -> None:
    sets = int(sys.argv[1]) if len(sys.argv) > 1 and sys.argv[1].isdigit() else 3000
    _false_alarms(sets)
    _detection(max(400, sets // 3))
    if "--recordings" in sys.argv:
        _recordings(int(sys.argv[sys.argv.index("--recordings") + 1]))


def _false_alarms(sets: int) -> None:
    kinds = {
        "whole campaign": (CAMPAIGN, False),
        "3 ring-downs, 2 run-ups": (("ring-down-x",) * 3 + ("run-up",) * 2, False),
        "3 damping tests": (("spin-down", "spin-down", "point-E"), False),
        "whole campaign, Student's t of 10": (CAMPAIGN, True),
    }
    for label, (tests, heavy) in kinds.items():
        rng = np.random.default_rng(SEED)
        drawn = [draw(rng, tests, heavy)[0] for _ in range(sets)]
        began = time.perf_counter()
        found = [verdict(estimates) for estimates in drawn]
        each = 1e3 * (time.perf_counter() - began) / sets
        print(
            f"{label:36} false alarms {np.mean([v.alarm for v in found]):.4f} of {sets} (seed {SEED}), "
            f"{each:.1f} ms each"
        )


def _detection(sets: int) -> None:
    for count in (3, 5):
        for size in (3, 4, 5, 6, 8, 10, 12):
            rng = np.random.default_rng(SEED)
            seen, alone, covered = [], [], []
            for _ in range(sets):
                estimates = spoilt(draw(rng, ("spin-down",) * count)[0], 1, NAME, size * OWN_STD)
                found = verdict(estimates)
                joint = joint_estimate(estimates).parameters
                seen.append(found.alarm)
                alone.append(found.alarm and found.suspects == (1,))
                covered.append(abs(joint.values[NAME] - TRUTH[NAME]) < 1.96 * joint.std[NAME])
            print(
                f"one of {count} off by {size:2d} sd: seen {np.mean(seen):.3f}, named alone {np.mean(alone):.3f}, "
                f"95 % interval covers {np.mean(covered):.3f} ({sets} sets, seed {SEED})"
            )


def _recordings(campaigns: int) -> None:
    alarms, named, z = 0, {"k 3 % off": 0, "laser 10 % off": 0}, {"k 3 % off": [], "laser 10 % off": []}
    for seed in range(100, 100 + campaigns):
        campaign = Campaign(seed)
        runs = [campaign.ring_down("x"), campaign.ring_down("y"), *(campaign.run_up() for _ in range(3))]
        runs = [replace(run, source=f"{i:02d}-{run.test}.mcap") for i, run in enumerate(runs)]
        good = identify(runs, campaign.rig)
        alarms += verdict(good.estimates).alarm
        stretch = 1.03**-0.5
        stiff = replace(runs[0], source="bad", x_time_s=runs[0].x_time_s * stretch, y_time_s=runs[0].y_time_s * stretch)
        loud = replace(runs[3], source="bad", x_m=1.1 * runs[3].x_m)
        for label, index, bad, name in (
            ("k 3 % off", 0, stiff, "k1_N_per_m"),
            ("laser 10 % off", 3, loud, "SP_kg_m"),
        ):
            found = identify([*runs[:index], bad, *runs[index + 1 :]], campaign.rig, earlier=good)
            named[label] += _left_out(found) == ["bad"]
            off = found.parameters.values[name] - campaign.truth.identified()[name]
            z[label].append(abs(off) / found.parameters.std[name])
    print(f"{campaigns} campaigns of five recordings, seeds from 100: {alarms} false alarms")
    for label, count in named.items():
        covers = np.mean(np.array(z[label]) < 1.96)
        print(f"  {label}: named and left out alone {count}, 95 % interval covers {covers:.3f}")


def _left_out(found: Identification) -> list[str]:
    return [found.estimates[i].source for i in joint_estimate(found.estimates).left_out]


if __name__ == "__main__":
    main()

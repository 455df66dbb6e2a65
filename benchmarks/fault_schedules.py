"""Thousands of randomised faults under simulated time, or some in real time: what did not hold, by seed.

    python -m benchmarks.fault_schedules --rig virtual --first 0 --count 10000 --jobs 2
    python -m benchmarks.fault_schedules --rig virtual --count 100 --real-time          # on ptys, one after the other
    python -m benchmarks.fault_schedules --rig virtual --count 400 --calm               # an hour without a fault

Exit code 1 when anything did not hold. A seed is looked into with `--first SEED --count 1 --show`.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from rig_configs import load_rig
from rig_testing.fault_schedules import Result, draw, run


def judged(rig: str, seed: int, twice: bool, calm: bool, real_time: bool) -> tuple[Result, bool]:
    """One schedule, and whether a second run of it gives the same bytes (True where it was not asked for)."""
    with tempfile.TemporaryDirectory() as folder:
        first, second = Path(folder, "1"), Path(folder, "2")
        first.mkdir()
        second.mkdir()
        schedule = draw(load_rig(rig), seed, calm)
        result = run(rig, schedule, first, real_time=real_time)
        return result, not twice or run(rig, schedule, second).digest == result.digest


def main() -> int:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rig", default="virtual")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--twice-every", type=int, default=20, help="every so many run twice, bytes compared")
    parser.add_argument("--calm", action="store_true", help="without faults")
    parser.add_argument("--real-time", action="store_true", help="on ptys and the wall's clock; nothing runs twice")
    parser.add_argument("--show", action="store_true", help="show every schedule and how it ended")
    given = parser.parse_args()
    begun, wrong, rig_s, stops, ends = time.perf_counter(), 0, 0.0, [], Counter[str]()
    seeds = range(given.first, given.first + given.count)
    jobs = 1 if given.real_time else given.jobs
    twice = [seed % given.twice_every == 0 and not given.real_time for seed in seeds]
    same_for_all = ([each] * len(seeds) for each in (given.calm, given.real_time))
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        for result, same in pool.map(judged, [given.rig] * len(seeds), seeds, twice, *same_for_all, chunksize=4):
            found = [*result.wrong, *([] if same else ["a second run gave other bytes"])]
            rig_s += result.rig_s
            ends["ended by a fault" if result.ended else "came to its end"] += 1
            if not math.isnan(result.stop_s):
                stops.append(result.stop_s)
            if found or given.show:
                print(
                    f"{given.rig} {result.schedule}\n    ended: {result.ended or '-'}\n    wrong: {found}", flush=True
                )
            wrong += bool(found)
    seconds = time.perf_counter() - begun
    print(f"{given.count} schedules of {given.rig}: {wrong} with something wrong; {dict(ends)}")
    print(f"{rig_s / 3600:.2f} h of rig time in {seconds:.0f} s on {jobs} processes")
    print(f"while the rotor turned a guard was blind for {max(stops, default=0.0):.2f} s at the most")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())

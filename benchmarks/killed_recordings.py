"""kill -9 at random moments of a recording: what is in the file, and what is missing before the kill.

    python -m benchmarks.killed_recordings --kills 50 --seed 1

`rig record` records a virtual rig at the pace of life and is killed at a random moment. The cut file is opened by
`open_log` and made whole by `rig recover`; both must hold every channel up to at most 100 ms before the kill, and the
recovered file must pass every check and decode again bit for bit. POSIX (it needs SIGKILL).
"""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from daq.log import Log, open_log
from daq.replay import check
from rig_cli.simulated import VirtualRigProcess

_ALLOWED_MS = 100.0
_TOPICS = ("laser/x", "laser/y", "pendulums", "motor", "raw/laser_x", "raw/encoder")
_SETTINGS = ["virtual.radio.burst_start=0.0"]  # what the radio loses is not the recorder's doing


def main() -> int:
    """Exit code 1 when a file does not open or misses more than is allowed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    dice = random.Random(arguments.seed)
    rows: list[float] = []
    faults: list[str] = []
    with tempfile.TemporaryDirectory() as folder, VirtualRigProcess("virtual", _SETTINGS) as rig:
        for number in range(arguments.kills):
            part, *when_ns = _record_and_kill(rig, Path(folder) / f"{number}.mcap", dice.uniform(0.02, 3.0))
            missing_ms, trouble = _judge(part, *when_ns)
            rows.append(missing_ms)
            faults += [f"kill {number}: {text}" for text in trouble]
            print(f"kill {number:3}: {missing_ms:6.1f} ms missing {'; '.join(trouble)}", flush=True)
    print(f"{len(rows)} kills: median {np.median(rows):.1f} ms, worst {max(rows):.1f} ms, {len(faults)} faults")
    return 1 if faults else 0


def _record_and_kill(rig: VirtualRigProcess, path: Path, after_s: float) -> tuple[Path, int, int]:
    """The cut file, when it came into being and when the recorder was killed, ns since 1970."""
    part = path.with_name(path.name + ".part")
    command = [sys.executable, "-m", "rig_cli.main", "record", "virtual", "-o", str(path)]
    for setting in [*_SETTINGS, *rig.port_settings()]:
        command += ["--set", setting]
    host = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    while not part.exists():
        if host.poll() is not None:
            raise SystemExit(f"rig record ended with {host.returncode} before it was killed")
        time.sleep(0.001)
    begun_ns = time.time_ns()
    time.sleep(after_s)
    killed_ns = time.time_ns()
    host.kill()
    host.wait()
    return part, begun_ns, killed_ns


def _judge(part: Path, begun_ns: int, killed_ns: int) -> tuple[float, list[str]]:
    """How much is missing before the kill in the channel that misses most, and what is wrong."""
    faults: list[str] = []
    with open_log(part) as log:
        missing_ms = max(_missing_ms(log, topic, begun_ns, killed_ns) for topic in _TOPICS)
        counts = {topic: log.count(topic) for topic in log.topics}
    if missing_ms > _ALLOWED_MS:
        faults.append(f"{missing_ms:.0f} ms missing")
    whole = part.with_name(part.name.removesuffix(".part"))
    done = subprocess.run(
        [sys.executable, "-m", "rig_cli.main", "recover", str(part), "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0 or json.loads(done.stdout)["log"] != str(whole):
        return missing_ms, [*faults, f"rig recover: exit {done.returncode}: {done.stderr.strip()[-200:]}"]
    with open_log(whole) as log:
        problems = [str(missing) for missing in log.verify()]
        if counts != {topic: log.count(topic) for topic in log.topics}:
            problems.append("the recovered file holds other messages than the cut one")
    problems += [f"{row.topic}: {row.difference}" for row in check(whole) if row.difference]
    return missing_ms, faults + problems


def _missing_ms(log: Log, topic: str, begun_ns: int, killed_ns: int) -> float:
    """Time before the kill of which a channel holds nothing; all of it when the kill came before the first flush."""
    if log.count(topic) == 0:
        last = begun_ns
    elif topic.startswith("raw/"):
        last = log.raw(topic.removeprefix("raw/"))[-1].host_ns
    else:
        last = int(log[topic].log_time_ns[-1])
    return (killed_ns - last) / 1e6


if __name__ == "__main__":
    sys.exit(main())

"""The rig's real load on the recorder: two lasers at 4 kHz, encoder at 1 kHz, CAN at 1 kHz, for as long as you like.

    python -m benchmarks.real_load --minutes 30

A virtual rig in a process of its own sends on ptys at the pace of life; `rig record` records it as a user would.
Printed: the recorder's share of one core, its resident memory over time, and what was lost: counted by the recorder
itself, by the holes in the counters that are in the file, and, for the CAN bus, which has no counters, by the bytes the
rig could not hand over. (A rig whose simulation stalls sends fewer frames than nominal.) Linux (it reads /proc).
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from daq.log import open_log
from daq.log.losses import losses_of
from rig_cli.simulated import VirtualRigProcess

_LOAD = ["virtual.drive.report_s=0.001", "virtual.radio.burst_start=0.0"]
_COUNTERS = (("laser/x", "counter", 2**18), ("laser/y", "counter", 2**18), ("pendulums", "index", 2**32))
_TICK = os.sysconf("SC_CLK_TCK")


def main() -> int:
    """Exit code 1 when anything was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        result = measure(60 * arguments.minutes, Path(folder))
    print(json.dumps(result, indent=1) if arguments.json else _lines(result))
    return 1 if result["lost"] or result["dropped_by_the_rig_bytes"] else 0


def measure(seconds: float, folder: Path) -> dict[str, object]:
    """One recording."""
    path = folder / "load.mcap"
    with VirtualRigProcess("virtual", _LOAD) as rig:
        command = [
            sys.executable,
            "-m",
            "rig_cli.main",
            "record",
            "virtual",
            "-o",
            str(path),
            "--duration",
            str(seconds),
        ]
        for setting in [*_LOAD, *rig.port_settings()]:
            command += ["--set", setting]
        host = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        usage = _watch(host)
        usage["dropped_by_the_rig_bytes"] = rig.line.ask("state")["overrun_bytes"]["drive"]
        if host.returncode != 0:
            raise SystemExit(f"rig record ended with {host.returncode}")
    return {**usage, **_content(path, seconds)}


def _watch(host: subprocess.Popen[bytes]) -> dict[str, object]:
    """CPU and memory of the recorder, from when it records steadily until it ends."""
    time.sleep(5.0)  # start-up, compilation, the devices' set-up
    rows: list[tuple[float, float, float]] = []
    while host.poll() is None:
        try:
            fields = Path(f"/proc/{host.pid}/stat").read_text().rpartition(")")[2].split()
            pages = int(Path(f"/proc/{host.pid}/statm").read_text().split()[1])
        except (OSError, IndexError):
            break
        rows.append((time.monotonic(), (int(fields[11]) + int(fields[12])) / _TICK, pages * os.sysconf("SC_PAGESIZE")))
        time.sleep(0.5)
    host.wait()
    wall, cpu, memory = np.array(rows[:-2]).T  # the last looks see the file being finished
    share = np.diff(cpu[::20]) / np.diff(wall[::20])
    third = max(1, len(memory) // 3)
    return {
        "seconds": float(wall[-1] - wall[0]),
        "cpu_share_of_a_core": float((cpu[-1] - cpu[0]) / (wall[-1] - wall[0])),
        "cpu_share_worst_10_s": float(share.max()) if len(share) else None,
        "memory_first_third_MB": float(np.median(memory[:third]) / 1e6),
        "memory_last_third_MB": float(np.median(memory[-third:]) / 1e6),
        "memory_slope_MB_per_hour": float(np.polyfit(wall[third:] - wall[0], memory[third:], 1)[0] * 3600 / 1e6),
    }


def _content(path: Path, seconds: float) -> dict[str, object]:
    with open_log(path) as log:
        counts = {topic: log.count(topic) for topic in log}
        counted = losses_of(log).total
        holes = {topic: _holes(log[topic][field], wrap) for topic, field, wrap in _COUNTERS}
        nominal = {"laser/x": 4000, "laser/y": 4000, "pendulums": 1000, "motor": 1000}
        rates = {topic: counts[topic] / seconds / rate for topic, rate in nominal.items()}
        disk = json.loads(log.metadata["summary"]["disk"])
    return {
        "samples": sum(counts.values()),
        "bytes_per_sample": path.stat().st_size / sum(counts.values()),
        "received_of_nominal": rates,
        "lost": counted + sum(holes.values()),
        "lost_counted": counted,
        "holes_in_counters": holes,
        "disk_slow_s": disk["slow_s"],
    }


def _holes(counter: np.ndarray, wrap: int) -> int:
    steps = np.diff(counter.astype(np.int64)) % wrap
    return int(np.sum(steps - 1))


def _lines(result: dict[str, object]) -> str:
    return "\n".join(f"{name:28} {value}" for name, value in result.items())


if __name__ == "__main__":
    sys.exit(main())

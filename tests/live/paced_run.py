"""A guided test with its virtual rig, whose time stops while the machine keeps rig or host waiting.

Started as `python -m tests.live.paced_run TEST FOLDER TIMES`; it is `rig test virtual TEST --live --json --out FOLDER`.
TIMES receives pairs of wall time and rig time, ns.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from pathlib import Path
from unittest.mock import patch

from daq.transports.paced_clock import PacedClock
from rig_cli.main import main
from rig_cli.simulated import VirtualRigProcess
from tests.conftest import LATE_BEATS

_INTERVAL_S = 0.005


def _run(test: str, folder: Path, times: Path) -> None:
    pairs: list[tuple[int, int]] = []
    ended = threading.Event()
    with VirtualRigProcess("virtual", ["virtual.seed=3"], 1.0, waits=True) as rig:
        clock = rig.clock
        assert isinstance(clock, PacedClock)

        def note_times() -> None:
            while not ended.wait(_INTERVAL_S):
                pairs.append((time.time_ns(), clock._times()[0]))  # `now_ns` would report a host that is not late

        noting = threading.Thread(target=note_times, daemon=True)
        noting.start()
        settings = [part for setting in (*rig.port_settings(), LATE_BEATS) for part in ("--set", setting)]
        sys.argv[1:] = ["test", "virtual", test, "--live", "--json", "--out", str(folder), *settings]
        try:
            with patch("rig_cli.guided_test.HostClock", lambda rate: clock):
                main()
        finally:
            ended.set()
            noting.join()
            times.write_text(json.dumps(pairs))


if __name__ == "__main__":
    _run(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]))

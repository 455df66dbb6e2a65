"""What the Foxglove connection costs: processor on both sides, messages a second, and what the recorder feels of it.

    python -m benchmarks.foxglove_connection [--rig virtual] [--seconds 20] [--clients 1]

A virtual rig at the speed of life in a process of its own; a session records it here. Cases: no connection; clients,
each a process of its own, that take every channel; clients that subscribe and then read nothing; a connection whose
process stands still. Linux only: it reads /proc.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import signal
import tempfile
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from benchmarks.live_page import _cpu_s, _rss_mb, reads_of
from daq.acquisition.session import Session
from live.foxglove.protocol import SUBPROTOCOLS
from live.foxglove.session_connection import FoxgloveConnection
from rig_cli.simulated import VirtualRigProcess
from rig_configs import load_rig

CASES = ("no connection", "looked at", "asleep", "stands still")


def _client(url: str, reads: bool, count: Any) -> None:
    """A client: takes everything, or subscribes to everything and takes nothing."""
    more: dict[str, Any] = {} if reads else {"max_queue": 1}
    with (
        suppress(ConnectionClosed, TimeoutError),  # the connection stood still
        connect(url, subprotocols=[Subprotocol(SUBPROTOCOLS[0])], compression=None, **more) as line,
    ):
        line.recv()
        numbers = [each["id"] for each in json.loads(line.recv())["channels"]]
        line.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": n, "channelId": n} for n in numbers]}))
        while not reads:
            time.sleep(1)
        for data in line:
            count.value += isinstance(data, bytes) and data[0] == 1


def _case(name: str, args: argparse.Namespace, folder: Path) -> None:
    context = multiprocessing.get_context("spawn")
    count = context.Value("q", 0, lock=False)
    memory: list[float] = []
    with ExitStack() as stack:
        far = stack.enter_context(VirtualRigProcess(args.rig, []))
        rig = load_rig(args.rig, settings=far.port_settings())
        connection = None if name == "no connection" else stack.enter_context(FoxgloveConnection(rig, 0, (), print))
        session = stack.enter_context(Session(rig, far.clock))
        pid = 0
        if connection is not None:
            connection.follow(session)
            pid = connection._process.pid or 0
            for _ in range(args.clients):
                process = context.Process(target=_client, args=(connection.url, name != "asleep", count), daemon=True)
                process.start()
                stack.callback(process.kill)
            time.sleep(3.0)
        session.start_recording(folder / f"{name.replace(' ', '_')}.mcap", {"test": "record"})
        if name == "stands still":
            os.kill(pid, signal.SIGSTOP)
        began = time.monotonic(), _cpu_s(os.getpid()), _cpu_s(pid) if pid else 0.0, count.value
        for _ in range(4):
            memory += [_rss_mb(pid)] if pid else []
            time.sleep(args.seconds / 4)
        passed = time.monotonic() - began[0]
        ours, theirs = _cpu_s(os.getpid()) - began[1], (_cpu_s(pid) - began[2]) if pid else 0.0
        messages = (count.value - began[3]) / passed
        if name == "stands still":
            os.kill(pid, signal.SIGCONT)
        losses = session.recording.losses()
        path = session.stop_recording({})
    left_out = connection.left_out if connection is not None else 0
    print(
        f"{name:14} {reads_of(path, losses)}; recorder {100 * ours / passed:4.1f} %, "
        f"connection {100 * theirs / passed:4.1f} % of a core; "
        f"{messages:6.0f} messages/s, {left_out} left out, memory {' '.join(f'{m:.0f}' for m in memory)} MB",
        flush=True,
    )


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rig", default="virtual")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--clients", type=int, default=1)
    parser.add_argument("--only", default="")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for name in CASES:
            if args.only in name:
                _case(name, args, Path(folder))


if __name__ == "__main__":
    main()

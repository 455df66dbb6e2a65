"""What the live page costs: frames a second, processor, memory on both sides, and what the recorder feels of it.

    python -m benchmarks.live_page [--rig virtual] [--seconds 20] [--viewers 3] [--browser]

A virtual rig at the speed of life in a process of its own; a session records it here, with lasers of 2 x 4 kHz. Cases:
no page; a page that is looked at; viewers that answer nothing; a page whose process stands still. Of each: the longest
waits between two reads of a laser in the log (the recorder's threads were kept), losses, processor time of the recorder
and of the page, memory of both. With --browser one viewer is Chromium, with its memory. Linux only: it reads /proc.

A real hour: --only "looked at" --seconds 3600 --viewers 1 --browser
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Origin

from daq.acquisition.session import Session
from daq.log import open_log
from live.followers import Followers
from live.frames import decode
from live.model import LiveModel
from live.picture import Pictures, ViewerView
from live.session_page import Asking, LivePage
from live.watched import Watched
from rig_cli.simulated import VirtualRigProcess
from rig_configs import load_rig

_TICKS = os.sysconf("SC_CLK_TCK")
_UNITS = {"drawn": ", frames", "nodes": " of DOM"}


@dataclass
class Seen:
    """What one viewer got."""

    frames: int = 0
    bytes: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def _rss_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


@contextmanager
def _viewer(page: LivePage, seen: Seen, answers: bool) -> Iterator[None]:
    parts = urlsplit(page.url)
    ending = threading.Event()

    def look() -> None:
        address = f"ws://{parts.netloc}/data?{parts.query}"
        origin = Origin(f"http://{parts.netloc}")
        with suppress(TimeoutError, ConnectionClosed), connect(address, origin=origin, compression=None) as line:
            line.send(json.dumps({"view": {"window_s": 10, "end_s": None, "pixels": 700}}))
            while not ending.wait(0 if answers else 0.2):
                if not answers:
                    continue
                data = line.recv(timeout=10)
                seen.bytes += len(data)
                if isinstance(data, bytes) and (header := decode(data)[0])["kind"] == "frame":
                    seen.frames += 1
                    line.send(json.dumps({"seen": header["number"]}))

    thread = threading.Thread(target=look, daemon=True)
    thread.start()
    yield
    ending.set()
    thread.join(10)


@contextmanager
def _chromium(page: LivePage, facts: dict[str, list[float]]) -> Iterator[Callable[[], None]]:
    """A browser with a debugger connected only for moments: a connected debugger keeps all that it receives."""
    from playwright.sync_api import sync_playwright  # only with --browser

    program = next(b for b in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if b)
    with ExitStack() as stack:
        profile = Path(stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True)))
        options = ["--headless=new", "--no-sandbox", "--enable-precise-memory-info", "--window-size=1600,900"]
        options += ["--remote-debugging-port=0", f"--user-data-dir={profile}", "--no-first-run"]
        browser = stack.enter_context(
            subprocess.Popen([program, *options, page.url], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        )
        stack.callback(browser.terminate)
        player = stack.enter_context(sync_playwright())
        while not (port_file := profile / "DevToolsActivePort").exists() or not port_file.read_text().count("\n"):
            if browser.poll() is not None:
                raise RuntimeError(f"{program} ended with {browser.returncode} before it offered a port")
            time.sleep(0.1)
        port = port_file.read_text().split()[0]

        def look() -> None:
            there = player.chromium.connect_over_cdp(f"http://127.0.0.1:{port}")
            tab = next(t for t in there.contexts[0].pages if t.url.startswith(page.url.split("?")[0]))
            whole, client = there.new_browser_cdp_session(), tab.context.new_cdp_session(tab)
            facts["drawn"].append(int(tab.evaluate("page.drawn")))
            processes = whole.send("SystemInfo.getProcessInfo")["processInfo"]
            facts["renderer"].append(max(_rss_mb(each["id"]) for each in processes if each["type"] == "renderer"))
            client.send("HeapProfiler.collectGarbage")
            facts["heap"].append(tab.evaluate("performance.memory.usedJSHeapSize / 1e6"))
            facts["nodes"].append(client.send("Memory.getDOMCounters")["nodes"])
            there.close()

        yield look


def _case(name: str, args: argparse.Namespace, folder: Path) -> None:
    rig_name, seconds = args.rig, args.seconds
    with ExitStack() as stack:
        far = stack.enter_context(VirtualRigProcess(rig_name, []))
        rig = load_rig(rig_name, settings=far.port_settings())
        page = None if name == "no page" else stack.enter_context(LivePage(rig, None, "rig file", rig.name))
        session = stack.enter_context(Session(rig, far.clock))
        pid = 0
        seen = [Seen() for _ in range(args.viewers)]
        facts: dict[str, list[float]] = defaultdict(list)
        look: Callable[[], None] | None = None
        if page is not None:
            page.follow(session, Asking(), session.stop, {})
            pid = page._process.pid or 0
            for each in seen:
                stack.enter_context(_viewer(page, each, name != "asleep"))
            if args.browser and name == "looked at":
                look = stack.enter_context(_chromium(page, facts))
        session.start_recording(folder / f"{name.replace(' ', '_')}.mcap", {"test": "record"})
        if name == "page stands still":
            os.kill(pid, signal.SIGSTOP)
        began = time.monotonic(), _cpu_s(os.getpid()), _cpu_s(pid) if pid else 0.0, sum(s.frames for s in seen)
        for _ in range(parts := max(4, round(seconds / 300))):
            time.sleep(seconds / parts)
            facts["recorder"].append(_rss_mb(os.getpid()))
            if pid:
                facts["page"].append(_rss_mb(pid))
            if look is not None:
                look()
        passed = time.monotonic() - began[0]
        ours, theirs = _cpu_s(os.getpid()) - began[1], (_cpu_s(pid) - began[2]) if pid else 0.0
        frames = (sum(s.frames for s in seen) - began[3]) / passed / len(seen)
        if name == "page stands still":
            os.kill(pid, signal.SIGCONT)
        losses = session.recording.losses()
        path = session.stop_recording({})
    print(
        f"{name:18} {reads_of(path, losses)}; recorder {100 * ours / passed:4.1f} %, "
        f"page {100 * theirs / passed:4.1f} % of a core; {frames:4.1f} frames/s each",
        flush=True,
    )
    for who, values in facts.items():
        print(f"{'':18} {who + _UNITS.get(who, ', MB'):15} {' '.join(f'{v:.0f}' for v in values)}")


def reads_of(path: Path, losses: Mapping[str, Mapping[str, int]]) -> str:
    """Return in words the time between the reads of a laser, and the samples lost by devices without radio."""
    with open_log(path) as log:
        host_ns = np.array([chunk.host_ns for chunk in log.raw("laser_x") if chunk.direction == 0])
    waits = np.diff(host_ns) * 1e-6
    kinds = ("samples", "bytes", "damaged")
    lost = sum(losses[device].get(kind, 0) for device in ("laser_x", "laser_y", "drive") for kind in kinds)
    p50, p99 = np.percentile(waits, (50, 99))
    return f"reads p50 {p50:5.2f} p99 {p99:5.2f} max {waits.max():6.2f} ms, lost {lost}"


def _hour(rig_name: str, minutes: int = 60) -> None:
    """An hour of samples through the page's own side, as fast as it goes: what it keeps does not grow."""
    rig = load_rig(rig_name)
    ours, theirs = multiprocessing.Pipe()
    watched = Watched(rig, theirs, "an hour")
    pictures = Pictures(watched, LiveModel(rig), followers := Followers(watched.signals, LiveModel(rig)))
    channels = watched.signals.topics
    print(f"{minutes} min of samples: memory of the page's process after each tenth, MB:", end="", flush=True)
    view = ViewerView(600.0, None, 700)
    for second in range(60 * minutes):
        rows: list[tuple[str, object, dict[str, object]]] = []
        for topic, fields in channels.items():
            rate = {"tacho": 10, "motor": 100, "pendulums": 1000}.get(topic, 4000)
            at = second * 10**9 + np.arange(rate, dtype=np.int64) * (10**9 // rate)
            count = second * rate + np.arange(rate)
            columns = {
                name: (
                    count
                    if name == "revolutions"
                    else np.zeros(rate, np.int64)
                    if name == "flags"
                    else np.sin(62.8 * at * 1e-9) + 600.0 * ("rpm" in name)
                )
                for name in fields
            }
            rows.append((topic, at, dict(columns)))
        event = {"time_ns": second * 10**9, "kind": "gap", "device": "encoder", "text": "an event a second"}
        watched._take({"heard_ns": (second + 1) * 10**9, "rows": rows, "events": [event], "facts": {}})
        followers.follow()
        pictures.frame(view, second)
        if second % 10 == 0:
            pictures.slow()
            pictures.state()
        if (second + 1) % (6 * minutes) == 0:
            print(f" {_rss_mb(os.getpid()):.0f}", end="", flush=True)
    print()
    ours.close()


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rig", default="virtual")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--viewers", type=int, default=3)
    parser.add_argument("--browser", action="store_true")
    parser.add_argument("--only", default="")
    parser.add_argument("--hour", action="store_true", help="an hour of samples instead, as fast as they are taken")
    args = parser.parse_args()
    if args.hour:
        _hour(args.rig)
        return
    with tempfile.TemporaryDirectory() as folder:
        for name in ("no page", "looked at", "asleep", "page stands still"):
            if args.only in name:
                _case(name, args, Path(folder))


if __name__ == "__main__":
    main()

"""How long STOP takes from the press to the drive's stop command, with any other connections.

    python -m benchmarks.stop_path [--rig virtual] [--presses 100] [--only CASE] [--browser]

A virtual rig in a process of its own; a session of it runs here with its live page, under a limit of 1 024 open files.
A press is a POST to /stop on a new connection by a process of its own. With --browser it is a mouse press in Chromium,
timed by the browser's input event. The end is the return of `Session.stop`, which has then written the command to the
drive's port. A press that is not answered within 10 s is counted as lost.

Cases: no viewer; 8 and 16 viewers that answer each frame at 30 frames/s; 16 that flood (as many requests for views
as the connection accepts, each for the longest window, and an answer to each frame); 16 that flood with new requests;
1 020 connections that send nothing; a client that connects without a pause; a page whose process stands still. Linux
only: it stops a process.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import resource
import shutil
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from http.client import HTTPConnection, HTTPException
from multiprocessing.connection import Connection
from urllib.parse import SplitResult, urlsplit

import numpy as np
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from daq.acquisition.session import Session
from live.frames import decode
from live.session_page import Asking, LivePage
from rig_cli.simulated import VirtualRigProcess
from rig_configs import load_rig

_FILES, _IDLE, _PATIENCE_S, _PAUSE_S = 1024, 1020, 10.0, 0.05
_BETWEEN_CLICKS_S = 0.7  # the page takes two presses within half a second for one
_OFTEN = 1e-6
_Load = Callable[[SplitResult], None]


def _line(parts: SplitResult) -> ClientConnection:
    address = f"ws://{parts.netloc}/data?{parts.query}"
    return connect(address, origin=Origin(f"http://{parts.netloc}"), compression=None, open_timeout=_PATIENCE_S)


def _look(parts: SplitResult, answers: int = 1, window_s: float = 10.0) -> None:
    """One viewer; more answers than frames are a flood."""
    while True:
        with suppress(OSError, WebSocketException, TimeoutError), _line(parts) as line:
            view = json.dumps({"view": {"window_s": window_s, "end_s": None, "pixels": 4000 if answers > 1 else 700}})
            line.send(view)
            while True:
                data = line.recv(timeout=_OFTEN if answers > 1 else _PATIENCE_S)
                if isinstance(data, bytes) and (header := decode(data)[0])["kind"] == "frame":
                    line.send(json.dumps({"seen": header["number"]}))
                for _ in range(answers - 1):
                    line.send(view)
        time.sleep(_PAUSE_S)


def _flood_with_views(parts: SplitResult) -> None:
    """One viewer that reads in one thread and sends in another."""
    while True:
        with suppress(OSError, WebSocketException, TimeoutError), _line(parts) as line:
            ending = threading.Event()

            def read(line: ClientConnection = line, ending: threading.Event = ending) -> None:
                with suppress(OSError, WebSocketException, TimeoutError):
                    while not ending.is_set():
                        line.recv(timeout=_PATIENCE_S)

            threading.Thread(target=read, daemon=True).start()
            try:
                number = 0
                while True:
                    number += 1
                    line.send(json.dumps({"view": {"window_s": 36000, "end_s": None, "pixels": 4000}, "seen": number}))
            finally:
                ending.set()
        time.sleep(_PAUSE_S)


def _flood_with_requests(parts: SplitResult) -> None:
    while True:
        with suppress(OSError, HTTPException):
            _post(parts, "/act", {"verb": "nothing"})


def _stay_idle(parts: SplitResult) -> None:
    """All connections of the case, held open and opened again when they were closed."""
    resource.setrlimit(resource.RLIMIT_NOFILE, (8192, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
    held: list[socket.socket] = []
    while True:
        with suppress(OSError):
            while len(held) < _IDLE:
                held.append(socket.create_connection((parts.hostname or "", parts.port or 0), _PATIENCE_S))
                held[-1].setblocking(False)
        held = [each for each in held if not _is_closed(each)]
        time.sleep(_PAUSE_S)


def _is_closed(held: socket.socket) -> bool:
    try:
        closed = held.recv(1) == b""
    except BlockingIOError:
        return False
    except OSError:
        closed = True
    if closed:
        held.close()
    return closed


def _connect_without_a_pause(parts: SplitResult) -> None:
    while True:
        with suppress(OSError):
            socket.create_connection((parts.hostname or "", parts.port or 0), _PATIENCE_S).close()


_CASES: dict[str, tuple[tuple[_Load, int], ...]] = {
    "no viewer": (),
    "8 viewers": ((_look, 8),),
    "16 viewers": ((_look, 16),),
    "16 flood with views": ((_flood_with_views, 16),),
    "16 flood with requests": ((_flood_with_requests, 16),),
    "1020 idle": ((_stay_idle, 1),),
    "connects without a pause": ((_connect_without_a_pause, 1),),
    "16 viewers and 1020 idle": ((_look, 16), (_stay_idle, 1)),
    "page stands still": ((_look, 8),),
}


def _serve_load(url: str, case: str, share: int, shares: int, ready: Connection) -> None:
    parts = urlsplit(url)
    for load, count in _CASES[case]:
        for _ in range(share, count, shares):
            threading.Thread(target=load, args=(parts,), daemon=True).start()
    ready.send(True)
    threading.Event().wait()


def _post(parts: SplitResult, path: str, body: object) -> int:
    connection = HTTPConnection(parts.netloc, timeout=_PATIENCE_S)
    try:
        connection.request("POST", f"{path}?{parts.query}", json.dumps(body), {"Origin": f"http://{parts.netloc}"})
        answer = connection.getresponse()
        answer.read()
        return answer.status
    finally:
        connection.close()


def _press(url: str, presses: int, times: Connection) -> None:
    """Press STOP again and again on connections of their own; send the monotonic time of each press, ns."""
    parts = urlsplit(url)
    dice = np.random.default_rng(1)
    for _ in range(presses):
        time.sleep(dice.uniform(0.05, 0.15))
        pressed_ns, status = time.monotonic_ns(), 0
        with suppress(OSError, HTTPException):
            status = _post(parts, "/stop", {})
        times.send((pressed_ns, status))
    times.send(None)


def _click(url: str, presses: int, times: Connection) -> None:
    """As `_press`, with the mouse in Chromium."""
    from playwright.sync_api import sync_playwright  # only with --browser

    note = """window.pressed = 0; document.getElementById("stop").addEventListener("pointerdown", (event) => {
      window.pressed = performance.timeOrigin + event.timeStamp; }, { capture: true })"""
    program = next(b for b in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if b)
    with sync_playwright() as player:
        browser = player.chromium.launch(executable_path=program, args=["--no-sandbox"])
        tab = browser.new_page(viewport={"width": 1600, "height": 900})
        tab.goto(url)
        tab.wait_for_timeout(3000)
        tab.evaluate(note)
        box = tab.locator("#stop").bounding_box()
        assert box is not None
        for _ in range(presses):
            tab.mouse.move(box["x"] + 20, box["y"] + 20)
            tab.mouse.down()
            tab.mouse.up()  # soon, else the page takes the click for a press of its own and the next one for its end
            tab.wait_for_timeout(1e3 * _BETWEEN_CLICKS_S)
            wall_ns = time.time_ns() - time.monotonic_ns()
            times.send((round(1e6 * tab.evaluate("window.pressed")) - wall_ns, 200))
        browser.close()
    times.send(None)


@contextmanager
def _loaded(url: str, case: str) -> Iterator[None]:
    """The case's clients, in two processes."""
    context = multiprocessing.get_context("spawn")
    running = []
    try:
        for share in range(2 if _CASES[case] else 0):
            ours, theirs = context.Pipe()
            process = context.Process(target=_serve_load, args=(url, case, share, 2, theirs), daemon=True)
            process.start()
            running.append(process)
            ours.recv()
        time.sleep(5.0 if running else 0.0)
        yield
    finally:
        for process in running:
            process.kill()
            process.join()


def _case(case: str, rig_name: str, presses: int, browser: bool) -> bool:
    """Print one case; whether all presses arrived."""
    stops_ns: list[int] = []
    context = multiprocessing.get_context("spawn")
    with ExitStack() as stack:
        far = stack.enter_context(VirtualRigProcess(rig_name, []))
        rig = load_rig(rig_name, settings=far.port_settings())
        page = stack.enter_context(LivePage(rig, None, "rig file", rig.name))
        session = stack.enter_context(Session(rig, far.clock))

        def stop(reason: str) -> None:
            session.stop(reason)
            stops_ns.append(time.monotonic_ns())

        page.follow(session, Asking(), stop, {})
        time.sleep(1.0)
        ours, theirs = context.Pipe()
        pressing = context.Process(target=_click if browser else _press, args=(page.url, presses, theirs), daemon=True)
        if browser:  # the page is open before the others come
            pressing.start()
            time.sleep(3.0)
        stack.enter_context(_loaded(page.url, case))
        pid = page._process.pid or 0
        if case == "page stands still":
            os.kill(pid, signal.SIGSTOP)
        if not browser:
            pressing.start()
        pressed = list(iter(ours.recv, None))
        if case == "page stands still":
            os.kill(pid, signal.SIGCONT)
        pressing.join()
        time.sleep(0.5)
        stops = np.array(sorted(stops_ns))
    late_ms, lost = [], 0
    for at_ns, _status in pressed:
        after = stops[stops >= at_ns]
        if len(after) and after[0] - at_ns < _PATIENCE_S * 1e9:
            late_ms.append((after[0] - at_ns) * 1e-6)
        else:
            lost += 1
    words = "no press arrived"
    if late_ms:
        p50, p99 = np.percentile(late_ms, (50, 99))
        words = f"p50 {p50:6.1f}  p99 {p99:7.1f}  max {max(late_ms):7.1f} ms"
    print(f"{case:26} {len(pressed):4} presses: {words}, lost {lost}", flush=True)
    return not lost


def main() -> int:
    """Exit code 1 if a press was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rig", default="virtual")
    parser.add_argument("--presses", type=int, default=100)
    parser.add_argument("--only", default="")
    parser.add_argument("--browser", action="store_true")
    given = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_NOFILE, (_FILES, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
    whole = [_case(case, given.rig, given.presses, given.browser) for case in _CASES if given.only in case]
    return 0 if all(whole) else 1


if __name__ == "__main__":
    sys.exit(main())

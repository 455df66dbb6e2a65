"""The page while the rig opens: nothing was measured yet, and nothing is called old."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from multiprocessing import Pipe

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from live.model import LiveModel
from live.serving import Serving
from live.watched import Watched
from rig_configs import load_rig

WAIT_MS = 30_000


@pytest.fixture
def watched() -> Iterator[Watched]:
    """A rig that is being opened."""
    ours, theirs = Pipe()
    yield Watched(load_rig("virtual"), theirs, "virtual")
    ours.close()
    theirs.close()


def test_the_server_s_modules_are_imported_before_its_thread_starts(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The main thread goes on to import modules for Foxglove; two threads in the same packages may block each other."""
    loaded: list[bool] = []
    serving = Serving(watched, LiveModel(watched.signals.rig))

    def started(thread: threading.Thread) -> None:
        loaded.append(thread.name != "live page" or serving._server._config.loaded)
        start(thread)

    start = threading.Thread.start
    monkeypatch.setattr(threading.Thread, "start", started)
    with serving:
        pass
    assert loaded
    assert all(loaded)


def test_a_rig_that_opens_is_waited_for_and_not_stale(page: Page, watched: Watched) -> None:
    with Serving(watched, LiveModel(watched.signals.rig)) as serving:
        page.goto(serving.url)
        for panel in ("#strip-x", "#strip-y", "#strip-theta3", "#strip-speed", "#orbit", "#dial"):
            expect(page.locator(panel)).to_have_attribute("data-waits", "waiting for the rig", timeout=WAIT_MS)
        expect(page.locator(".stale")).to_have_count(0)
        expect(page.locator("#dial .legend")).to_have_text("no model: no device reports the speed")
        heard_ns = 10**18
        times = heard_ns - np.arange(100, 0, -1, dtype=np.int64) * 10**6
        columns = {"displacement_m": np.zeros(100), "flags": np.zeros(100, np.uint16)}
        rows = [(watched.signals.rig.roles.displacements[0].topic, times, columns)]
        watched._take({"heard_ns": heard_ns, "rows": rows, "events": [], "facts": None})
        expect(page.locator("#strip-y")).to_have_attribute("data-waits", "no data yet", timeout=WAIT_MS)
        expect(page.locator("#strip-x")).not_to_have_attribute("data-waits", re.compile("."))
        expect(page.locator("#strip-x")).to_have_class(re.compile("stale"), timeout=WAIT_MS)
        expect(page.locator("#strip-y")).not_to_have_class(re.compile("stale"))

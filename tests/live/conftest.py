"""A log of the virtual rig, a page that plays it, a browser to look with."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

from daq.acquisition.session import Session
from daq.guided_tests.procedure import Procedures
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.log.snapshot import rig_of
from daq.virtual_rig.simulated_operator import SimulatedOperator
from live.model import LiveModel
from live.replayed import Replayed
from live.serving import Serving
from rig_configs import load_rig

CHROMIUM = next((b for b in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if b), None)


@pytest.fixture(scope="session")
def point_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Point A on simulated time: locked, brought up to speed, released, settled."""
    changes = ["virtual.seed=3"]
    sim = LockstepRig(load_rig("virtual", settings=changes))
    rig = load_rig("virtual", settings=[*changes, *sim.port_settings()])
    with Session(rig, sim.clock, edge=sim.edge) as session:
        folder = tmp_path_factory.mktemp("live")
        return Procedures(session, SimulatedOperator(sim), folder, lambda text, share: None).run("point-A").log


@pytest.fixture
def replayed(point_log: Path) -> Replayed:
    """The log as the page's source, at its beginning, standing."""
    with open_log(point_log) as log:
        source = Replayed(log, rig_of(log))
    source.transport.pause()
    return source


@pytest.fixture
def serving(replayed: Replayed) -> Iterator[Serving]:
    """A page of it."""
    with Serving(replayed, LiveModel(replayed.signals.rig)) as page:
        yield page


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """The distribution's Chromium, without a window."""
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine")
    with sync_playwright() as player:
        found = player.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield found
        found.close()


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A tab; what goes wrong in it goes wrong in the test."""
    tab = browser.new_page(viewport={"width": 1600, "height": 900})
    faults: list[str] = []
    tab.on("pageerror", lambda error: faults.append(str(error)))
    tab.on("console", lambda entry: faults.append(entry.text) if entry.type == "error" else None)  # also of the CSP
    yield tab
    tab.close()
    ended = ("WebSocket connection to ", "net::ERR_")  # no connection: its server ends, or has ended, before the tab
    assert [fault for fault in faults if not any(words in fault for words in ended)] == []

"""Draw docs/figures/live_page.png again: a replay of a run-up of the virtual rig beyond its second resonance.

    python -m tests.live.page_picture [--out docs/figures/live_page.png] [--log run.mcap] [--at 35]

The run is recorded on simulated time, so that only a change of the page or of the rig changes the picture.
"""

from __future__ import annotations

import argparse
import re
import shutil
import tempfile
from pathlib import Path

from playwright.sync_api import Page, expect, sync_playwright

from daq.acquisition.session import Session
from daq.guided_tests.procedure import Procedures
from daq.lockstep.rig import LockstepRig
from daq.log import open_log
from daq.log.snapshot import rig_of
from daq.virtual_rig.simulated_operator import SimulatedOperator
from dynamics.compiled_code import keep_compiled_code
from live.model import LiveModel
from live.replayed import Replayed
from live.serving import Serving
from rig_configs import load_rig

WIDTH, HEIGHT = 1440, 860
PLACE = Path(__file__).parents[2] / "docs" / "figures" / "live_page.png"
WAIT_MS = 60_000


def recorded(folder: Path) -> Path:
    """A log of the run-up."""
    changes = ["virtual.seed=3"]
    sim = LockstepRig(load_rig("virtual", settings=changes))
    rig = load_rig("virtual", settings=[*changes, *sim.port_settings()])
    with Session(rig, sim.clock, edge=sim.edge) as session:
        return Procedures(session, SimulatedOperator(sim), folder, lambda text, share: None).run("run-up").log


def draw(page: Page, log: Path, at_s: float, out: Path) -> None:
    """Open a page of the log at an instant and keep it as a picture, when all that is worked out is there."""
    with open_log(log) as opened:
        replayed = Replayed(opened, rig_of(opened))
    replayed.transport.pause()
    replayed.transport.seek(at_s)
    with Serving(replayed, LiveModel(replayed.signals.rig)) as serving:
        page.goto(serving.url)
        expect(page.locator("#position")).to_have_text(re.compile(rf"^{at_s:.1f} s of"), timeout=WAIT_MS)
        expect(page.locator("#dial .legend")).to_contain_text("model", timeout=WAIT_MS)
        expect(page.locator("#bode .ramp")).to_be_visible(timeout=WAIT_MS)
        before = -1
        while (count := page.evaluate("page.bode.measured.x[0].data.x.length")) != before or count == 0:
            before = count
            page.wait_for_timeout(2000)
        page.screenshot(path=out)


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=PLACE)
    parser.add_argument("--log", type=Path, help="instead of a run that is recorded for it")
    parser.add_argument("--at", type=float, default=35.0, help="instant that is shown, s since the log's start")
    args = parser.parse_args()
    keep_compiled_code()
    program = next(p for p in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if p)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as player:
        log = args.log or recorded(Path(folder))
        browser = player.chromium.launch(executable_path=program, args=["--no-sandbox"])
        draw(browser.new_page(viewport={"width": WIDTH, "height": HEIGHT}), log, args.at, args.out)
        browser.close()
    print(args.out)


if __name__ == "__main__":
    main()

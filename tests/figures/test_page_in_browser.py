"""The zoomable page as a person uses it: a real browser zooms it by its keys and shows the whole again."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from analysis.figures.page import write_figure
from analysis.figures.sheet import sheet

BROWSER = next((b for b in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if b), None)
PROBE = """<script>
window.addEventListener("load", () => {
  const stage = document.getElementById("stage"), svg = stage.querySelector("svg");
  const width = () => svg.viewBox.baseVal.width, left = () => svg.viewBox.baseVal.x;
  const press = (key) => stage.dispatchEvent(new KeyboardEvent("keydown", {key, bubbles: true}));
  const said = {whole: width()};
  press("+"); said.closer = width();
  press("ArrowRight"); said.moved = left();
  document.getElementById("whole").click(); said.again = width();
  stage.dispatchEvent(new WheelEvent("wheel", {deltaY: -100, clientX: 300, clientY: 300, cancelable: true}));
  said.wheel = width();
  said.asked = performance.getEntriesByType("resource").length;
  said.drawn = svg.getBoundingClientRect().width;
  const out = document.createElement("pre");
  out.id = "probe";
  out.textContent = JSON.stringify(said);
  document.body.append(out);
});
</script></body>"""


@pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
def test_a_page_zooms_moves_and_shows_all_again(tmp_path: Path) -> None:
    with sheet(6.0, 3.0, "a line") as figure:
        figure.add_subplot().plot([0, 1, 2], [0, 2, 1], label="measured")
    page = tmp_path / "line.html"
    write_figure(page, figure, "a line")
    page.write_text(page.read_text(encoding="utf-8").replace("</body>", PROBE), encoding="utf-8")
    done = subprocess.run(
        [str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
         "--disable-background-networking", "--disable-component-update", "--disable-sync", "--window-size=1280,900",
         f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=5000", "--dump-dom", page.as_uri()],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    found = re.search(r'<pre id="probe">(.*?)</pre>', done.stdout)
    assert found, done.stdout[-500:] + done.stderr[-500:]
    said = json.loads(found[1])
    assert said["closer"] == pytest.approx(0.8 * said["whole"])
    assert said["moved"] > 0
    assert said["again"] == pytest.approx(said["whole"])
    assert said["wheel"] < said["whole"]
    assert said["asked"] == 0
    assert said["drawn"] > 600

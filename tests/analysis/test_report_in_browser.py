"""The report in a real browser: layout, figures, and no network requests."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from test_report import campaign

from analysis.report import write_report

BROWSER = next((b for b in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if b), None)
PROBE = """<script>
window.addEventListener("load", () => {
  const boxes = [...document.querySelectorAll("svg")].map(s => s.getBoundingClientRect());
  const out = document.createElement("pre");
  out.id = "probe";
  out.textContent = JSON.stringify({
    figures: boxes.length,
    drawn: boxes.filter(b => b.width > 100 && b.height > 50).length,
    wider: document.documentElement.scrollWidth > window.innerWidth,
    requests: performance.getEntriesByType("resource").length,
    heading: document.querySelector("h1").textContent,
  });
  document.body.append(out);
});
</script></body>"""


@pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
def test_a_browser_draws_every_figure_and_fetches_nothing(tmp_path: Path) -> None:
    page = write_report(tmp_path / "report.html", campaign())
    text = page.read_text(encoding="utf-8")
    figures = text.count("<svg")
    page.write_text(text.replace("</body>", PROBE), encoding="utf-8")
    done = subprocess.run(
        [
            str(BROWSER),
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--window-size=1280,900",
            f"--user-data-dir={tmp_path / 'profile'}",
            "--virtual-time-budget=5000",
            "--dump-dom",
            page.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    found = re.search(r'<pre id="probe">(.*?)</pre>', done.stdout)
    assert found, done.stdout[-500:] + done.stderr[-500:]
    seen = json.loads(found[1])
    assert figures >= 5
    assert seen == {
        "figures": figures,
        "drawn": figures,
        "wider": False,
        "requests": 0,
        "heading": seen["heading"],
    }
    assert seen["heading"]


@pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
def test_without_its_appendix_it_prints_on_eight_pages(tmp_path: Path) -> None:
    page = write_report(tmp_path / "report.html", campaign())
    text = page.read_text(encoding="utf-8")
    page.write_text(text[: text.index('<section id="appendix">')] + "</body></html>", encoding="utf-8")
    paper = tmp_path / "report.pdf"
    subprocess.run(
        [
            str(BROWSER),
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--no-first-run",
            "--no-pdf-header-footer",
            f"--user-data-dir={tmp_path / 'profile'}",
            f"--print-to-pdf={paper}",
            page.as_uri(),
        ],
        capture_output=True,
        timeout=120,
        check=True,
    )
    pages = len(re.findall(rb"/Type\s*/Page\b", paper.read_bytes()))
    assert 3 <= pages <= 8

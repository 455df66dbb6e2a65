"""The report in a real browser: layout, figures, and no network requests."""

import re
from pathlib import Path

from test_report import campaign

from analysis.report import write_report
from tests.browser import browse, needs_browser, probed

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


@needs_browser
def test_a_browser_draws_every_figure_and_fetches_nothing(tmp_path: Path) -> None:
    page = write_report(tmp_path / "report.html", campaign())
    text = page.read_text(encoding="utf-8")
    figures = text.count("<svg")
    seen = probed(page, PROBE)
    assert figures >= 5
    assert seen == {
        "figures": figures,
        "drawn": figures,
        "wider": False,
        "requests": 0,
        "heading": seen["heading"],
    }
    assert seen["heading"]


@needs_browser
def test_without_its_appendix_it_prints_on_eight_pages(tmp_path: Path) -> None:
    page = write_report(tmp_path / "report.html", campaign())
    text = page.read_text(encoding="utf-8")
    page.write_text(text[: text.index('<section id="appendix">')] + "</body></html>", encoding="utf-8")
    paper = tmp_path / "report.pdf"
    browse(page, "--no-pdf-header-footer", f"--print-to-pdf={paper}")
    pages = len(re.findall(rb"/Type\s*/Page\b", paper.read_bytes()))
    assert 3 <= pages <= 8

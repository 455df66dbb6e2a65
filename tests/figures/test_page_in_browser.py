"""The zoomable page as a person uses it: a real browser zooms it by its keys and shows the whole again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from analysis.figures.page import write_figure
from analysis.figures.readout import Readout
from analysis.figures.sheet import sheet
from tests.browser import needs_browser, probed

PROBE = """<script>
window.addEventListener("load", () => {
  const stage = document.getElementById("stage"), svg = stage.querySelector("svg");
  const width = () => svg.viewBox.baseVal.width, left = () => svg.viewBox.baseVal.x;
  const press = (key) => stage.dispatchEvent(new KeyboardEvent("keydown", {key, bubbles: true}));
  const result = {whole: width()};
  press("+"); result.closer = width();
  press("ArrowRight"); result.moved = left();
  document.getElementById("whole").click(); result.again = width();
  stage.dispatchEvent(new WheelEvent("wheel", {deltaY: -100, clientX: 300, clientY: 300, cancelable: true}));
  result.wheel = width();
  result.requests = performance.getEntriesByType("resource").length;
  result.drawn = svg.getBoundingClientRect().width;
  const out = document.createElement("pre");
  out.id = "probe";
  out.textContent = JSON.stringify(result);
  document.body.append(out);
});
</script></body>"""


READ = """<script>
window.addEventListener("load", () => {
  const stage = document.getElementById("stage"), svg = stage.querySelector("svg");
  const values = document.getElementById("values");
  const result = {before: values.textContent};
  const point = (across, up) => {
    const at = new DOMPoint(72 * (1 + 4 * across), 72 * (3 - (0.5 + 2 * up))).matrixTransform(svg.getScreenCTM());
    stage.dispatchEvent(new PointerEvent("pointermove", {clientX: at.x, clientY: at.y, pointerId: 1, bubbles: true}));
    return values.textContent;
  };
  result.first = point(0.01, 0.01);
  result.last = point(0.99, 0.99);
  result.middle = point(0.45, 0.52);
  result.outside = point(1.1, 0.5);
  document.getElementById("closer").click();
  result.zoomed = point(0.01, 0.01);
  const out = document.createElement("pre");
  out.id = "probe";
  out.textContent = JSON.stringify(result);
  document.body.append(out);
});
</script></body>"""


@needs_browser
def test_a_page_reads_out_the_value_under_the_pointer(tmp_path: Path) -> None:
    figure = Figure(figsize=(6.0, 3.0))
    figure.add_axes((1 / 6, 0.5 / 3, 4 / 6, 2 / 3)).plot([1, 100], [0, 1])
    values = np.arange(6.0).reshape(2, 3)
    values[1, 2] = np.nan
    box = (1 / 6, 0.5 / 3, 5 / 6, 2.5 / 3)
    x, y = np.array([1.0, 10.0, 100.0]), np.array([0.0, 1.0])
    readout = Readout(box, ("Ω", "K <y>"), (True, False), x, y, {"|μ|": values, "rate, 1/s": 10 * values})
    page = tmp_path / "map.html"
    write_figure(page, figure, "a map", readout)
    result = probed(page, READ)
    assert result["before"] == "point at the map to read its values"
    assert result["first"].split("   ") == ["Ω: 1", "K <y>: 0", "|μ|: 0", "rate, 1/s: 0"]
    assert result["middle"].split("   ") == ["Ω: 10", "K <y>: 1", "|μ|: 4", "rate, 1/s: 40"]
    assert result["last"].split("   ")[2] == "|μ|: none (no balanced state)"
    assert result["outside"] == result["middle"]
    assert result["zoomed"] == result["first"]


@needs_browser
def test_a_page_zooms_moves_and_shows_all_again(tmp_path: Path) -> None:
    with sheet(6.0, 3.0, "a line") as figure:
        figure.add_subplot().plot([0, 1, 2], [0, 2, 1], label="measured")
    page = tmp_path / "line.html"
    write_figure(page, figure, "a line")
    result = probed(page, PROBE)
    assert result["closer"] == pytest.approx(0.8 * result["whole"])
    assert result["moved"] > 0
    assert result["again"] == pytest.approx(result["whole"])
    assert result["wheel"] < result["whole"]
    assert result["requests"] == 0
    assert result["drawn"] > 600

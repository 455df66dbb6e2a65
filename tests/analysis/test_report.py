"""The report: complete, self-contained, well-formed, safe against what a log's names may hold."""

import dataclasses
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from analysis_runs import draw, point_run

from analysis import validate
from analysis.errors import TakenName
from analysis.figures.style import bins_for, envelope
from analysis.report import (
    Campaign,
    Changes,
    ConsistencyCheck,
    FitCurve,
    IdentificationResult,
    ParameterChange,
    TestEstimate,
    render,
    twin,
    write_report,
)
from analysis.report.tables import quantity_rows
from analysis.report.twin import twin_path
from analysis.rounding import plain, with_std
from analysis.scores import Score
from daq.signals.run import Run
from rig_configs import load_rig
from uncertainty import Budgets, ErrorSource

HOSTILE = '<script>alert("$x^$ & 1")</script>'
VOID = {"meta", "br", "hr", "img", "link", "input"}


class Page(HTMLParser):
    """Collects ids, tags and text; fails on tags that do not nest."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        self.ids += [value for name, value in attrs if name == "id"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data) -> None:
        self.text += data


def fit_curve(title: str) -> FitCurve:
    t = np.arange(0, 20, 1e-3)
    fitted = 4 * np.exp(-0.37 * t) * np.cos(18.8 * t)
    measured = fitted + 4e-3 * np.random.default_rng(0).standard_normal(len(t))
    measured[500:600] = np.nan
    return FitCurve(title, t, measured, fitted, "mm", "x", "released by hand")


def campaign(text: str = "plain") -> Campaign:
    rig = load_rig("virtual")
    drawn = draw(rig, 0)
    runs: list[Run] = [
        point_run(rig, "D", drawn=drawn, after_s=20.0),
        point_run(rig, "E", drawn=drawn, after_s=14.0),
        point_run(rig, "B", drawn=drawn, after_s=3.0),
    ]
    runs = [dataclasses.replace(r, source=f"{text}-{r.source}", losses={text: 3}) for r in runs]
    other = load_rig("virtual", settings={"points.E.expected": "III"})
    identification = IdentificationResult(
        drawn.identified,
        [TestEstimate("ring-down-x", (text,), {"k1_N_per_m": 2616.62, text: 1.0}, {"k1_N_per_m": 0.21})],
        [ConsistencyCheck("k1_N_per_m", 1.2, text)],
        [f"warning {text}"],
        [fit_curve("ring-down x"), dataclasses.replace(fit_curve(text), unit=text, y_label=text, notes=text)],
    )
    return Campaign(
        title=f"Title {text}",
        rig=other,
        runs=runs,
        identification=identification,
        validation=validate(runs, other, drawn.identified, drawn.axis_angle_deg),
        axis_angle_deg=drawn.axis_angle_deg,
        devices={"laser_x": {"serial": text}},
        truth=rig.true_physics.identified(),
        notes=[text],
        software_version=text,
        seed=7,
    )


@pytest.fixture(scope="module")
def hostile() -> Campaign:
    return campaign(HOSTILE)


@pytest.fixture(scope="module")
def html(hostile: Campaign) -> str:
    return render(hostile)


def test_every_section_and_figure_is_there(html: str) -> None:
    page = Page(html)
    for section in ("summary", "runs", "losses", "parameters", "fits", "points", "map"):
        assert section in page.ids
    assert page.tags.count("svg") == 2 + 2 + 1  # fits, points with data, map
    for words in ("k1", "ζ2", "S_P", "2616.67 ± 0.18 N/m", "seed 7", "not enough data", "fail", "pass", "truth"):
        assert words in page.text, words


def test_the_summary_states_why_points_fail(html: str, hostile: Campaign) -> None:
    summary = Page(html[html.index('id="summary"') - 10 : html.index('<section id="parameters"')]).text
    assert hostile.validation is not None
    for point in hostile.validation.points.values():
        assert (point.why in summary) == (point.verdict != "pass")


def test_nothing_outside_is_asked_for(html: str) -> None:
    page = Page(html)
    assert not {"link", "iframe", "img", "object"} & set(page.tags)
    for name, value in page.attributes:
        if name in ("href", "xlink:href", "src", "data"):
            assert value.startswith("#"), (name, value)
        if not name.startswith("xmlns"):
            assert "http" not in value
    assert not re.search(r"url\((?!#)|@import", html)


def test_ids_are_unique_and_references_lead_somewhere(html: str) -> None:
    page = Page(html)
    assert len(page.ids) == len(set(page.ids))
    wanted = set(re.findall(r'(?:href="#|url\(#)([^")]+)', html))
    assert wanted
    assert wanted <= set(page.ids)


def test_hostile_names_stay_text(html: str) -> None:
    assert html.count("<script") == 1  # ours
    assert html[html.index("<script>") + 8 :].startswith('"use strict";')
    assert HOSTILE in Page(html).text


def test_the_same_campaign_gives_the_same_file(html: str, hostile: Campaign, tmp_path) -> None:
    path = write_report(tmp_path / "report.html", hostile)
    assert path.read_text(encoding="utf-8") == html
    numbers = json.loads(twin_path(path).read_text(encoding="utf-8"))
    assert numbers == twin(hostile)
    assert hostile.validation is not None
    shown = numbers["points"]["D"]["measured"]["theta3_deg"]
    assert f"{shown:.1f}".replace("-", "−") in Page(html).text
    assert numbers["parameters"]["k1_N_per_m"]["std"] == hostile.identification.parameters.std["k1_N_per_m"]
    assert path.stat().st_size < 6e6


def test_what_changed_stands_in_the_result_and_next_to_the_parameters(hostile: Campaign) -> None:
    rows = [
        ParameterChange("k2_N_per_m", 39000.0, 39390.0, 390.0, 12.0, 1e-9),
        ParameterChange("zeta1", 0.02, 0.02001, 1e-5, 2e-5, 0.9),
    ]
    changes = Changes(HOSTILE, "k2 grew by 1.00 ± 0.03 %", rows, ["both rest on one balance"])
    html = render(dataclasses.replace(hostile, changes=changes))
    result = Page(html[html.index('id="summary"') - 9 : html.index('<section id="parameters"')]).text
    assert "K2 grew by 1.00 ± 0.03 %. Both rest on one balance." in result
    assert f"Since {HOSTILE}" in result
    cells = re.findall(r'<td class="n( off)?">([^<]*± [^<]* %)</td>', html[html.index('<section id="parameters"') :])
    assert cells == [(" off", "+1.000 ± 0.031 %"), ("", "+0.050 ± 0.1 %")]


def test_losses_stand_in_the_result(html: str, hostile: Campaign) -> None:
    assert f"Lost: 9 {HOSTILE}" in Page(html).text
    none = dataclasses.replace(hostile, losses={})
    assert "No stream of any log lost anything." in Page(render(none)).text


def test_a_file_that_is_no_report_s_numbers_is_not_written_over(hostile: Campaign, tmp_path) -> None:
    page, other = tmp_path / "v.html", tmp_path / "v.json"
    other.write_text('{"points": {}}', encoding="utf-8")
    with pytest.raises(TakenName, match=r"v\.json, where another file is already"):
        write_report(page, hostile)
    assert not page.exists()
    assert other.read_text(encoding="utf-8") == '{"points": {}}'
    other.unlink()
    for _ in range(2):  # its own are replaced
        write_report(page, hostile)


def test_an_empty_campaign_still_gives_a_page() -> None:
    full = draw(load_rig("virtual"), 0)
    page = Page(render(Campaign("empty", load_rig("virtual"), [], IdentificationResult(full.identified))))
    assert "No validation point was run" in page.text


def test_budgets_are_tables_with_the_largest_source_first(hostile: Campaign) -> None:
    sources = (
        ErrorSource("gain x", 1e-3, "1"),
        ErrorSource(HOSTILE, 0.2, "mm"),
        ErrorSource("dust", 1e-9, "mm"),
        ErrorSource("clock a", 1, "u"),
    )
    table = np.array([[2.5, 0.1, 1.0, 1e-3]])
    budgets = Budgets(("D.amplitude_mm",), np.array([4.0]), ("mm",), sources, table)
    html = render(dataclasses.replace(hostile, budgets=budgets))
    text = Page(
        html[html.index("<details><summary>Uncertainty budgets") : html.index("<details><summary>Correlation")]
    ).text
    assert "D.amplitude_mm = 4.00 ± 0.02 mm; U = 0.04 mm at 95 % (k = 1.960, νeff = ∞)" in text
    assert text.index(HOSTILE) < text.index("gain x") < text.index("clock a") < text.index("1 more")
    assert re.findall(r"(?:< )?[\d.]+ %(?! \(k)", text) == ["98.2 %", "1.5 %", "0.2 %", "< 0.1 %"]
    assert "Uncertainty budgets" not in render(hostile)


@pytest.mark.parametrize(
    ("value", "std", "unit", "text"),
    [
        (2616.643, 0.21, "N/m", "2616.6 ± 0.2 N/m"),
        (2616.643, 0.14, "N/m", "2616.64 ± 0.14 N/m"),
        (38141.4, 12.0, "N/m", "38141 ± 12 N/m"),
        (0.00104, 4.2e-6, "N m s/rad", "(1.040 ± 0.004)·10⁻³ N m s/rad"),
        (0.0208, 4e-5, "1", "0.02080 ± 0.00004"),
        (-1.5, 0.31, "°", "−1.5 ± 0.3°"),
        (9.97, 0.0996, "mm", "9.97 ± 0.10 mm"),
        (5.0, 0.0, "", "5"),
        (float("nan"), 1.0, "", "–"),
    ],
)
def test_numbers_are_rounded_to_their_uncertainty(value: float, std: float, unit: str, text: str) -> None:
    assert with_std(value, std, unit) == text


def test_plain_numbers() -> None:
    assert plain(-1.25e-9) == "−1.25·10⁻⁹"


def test_envelope_covers_every_sample() -> None:
    t = np.linspace(0, 10, 5001)
    v = np.sin(40 * t)
    v[100] = 7.0
    middle, low, high = envelope(t, v, 50)
    assert len(middle) == 50
    assert (np.nanmin(low), np.nanmax(high)) == (v.min(), 7.0)
    assert bins_for(190) == 190
    assert bins_for(5) == 400


def test_an_amplitude_where_none_is_predicted_has_its_uncertainty_too() -> None:
    rig = load_rig("virtual")
    drawn = draw(rig, 1)
    validation = validate([point_run(rig, "B", 1, drawn=drawn, after_s=30.0)], rig, drawn.identified)
    still = Score(z=0.1, measured=2.1e-8, measured_std=5.8e-8, predicted=0.0, predicted_std=0.0, noise=(5.8e-8,), p=0.9)
    point = dataclasses.replace(validation.points["B"], scores={"amplitude_x": still})
    row = next(row for row in quantity_rows(point) if row["name"].startswith("x amplitude"))
    assert row["predicted"].startswith("0, noise")
    assert float(row["measured"].split()[0]) * (1e3 if row["measured"].endswith("µm") else 1e6) == pytest.approx(
        21, abs=1
    )
    assert " ± " in row["measured"]

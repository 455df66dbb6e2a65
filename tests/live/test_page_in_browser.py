"""The page in a browser: every panel draws, seek and zoom work, old data are marked."""

from __future__ import annotations

import io
import re
import time

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, Page, expect

from live.replayed import Replayed
from live.serving import Serving
from tests.effort import thorough

X, Y, THREE, FOUR, MODEL = (86, 180, 233), (230, 159, 0), (47, 199, 155), (217, 143, 184), (242, 242, 242)
WAIT_MS = 30_000
STALE_ATTEMPTS = 3
INKS = {
    "#strip-x .plot": [X],
    "#strip-y .plot": [Y],
    "#strip-theta3 .plot": [THREE],
    "#strip-theta4 .plot": [FOUR],
    "#strip-speed .plot": [X],
    "#orbit .plot": [X, MODEL],
    "#dial .plot": [THREE, FOUR],
    "#bode .amplitude": [X, Y],
    "#bode .phase": [X, Y],
    "#tracked .plot": [THREE, FOUR],
}


def _pixels(page: Page, selector: str) -> NDArray[np.int64]:
    data = page.locator(selector).screenshot()
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), np.int64)


def _share(pixels: NDArray[np.int64], ink: tuple[int, int, int]) -> int:
    """Pixels of about a colour; lines are thin, so that most of theirs are mixed with the ground."""
    return int(np.count_nonzero(np.abs(pixels - np.array(ink)).max(axis=2) < 60))


def _opened(page: Page, serving: Serving, replayed: Replayed, at_s: float) -> None:
    replayed.transport.seek(at_s)
    page.goto(serving.url)
    expect(page.locator("#position")).to_have_text(re.compile(rf"^{at_s:.1f} s of"), timeout=WAIT_MS)
    expect(page.locator("#dial .legend")).to_contain_text("model", timeout=WAIT_MS)


def test_every_panel_draws_what_the_log_holds(page: Page, serving: Serving, replayed: Replayed) -> None:
    _opened(page, serving, replayed, 20.0)
    expect(page.locator("#limits .limit.main .used").first).to_contain_text("%")
    expect(page.locator("#dial .legend")).to_have_text(re.compile("free.*type III"), timeout=WAIT_MS)
    for selector, inks in INKS.items():
        for ink in inks:
            drawn = 0
            for _ in range(60):  # the followers may still be at work
                drawn = _share(_pixels(page, selector), ink)
                if drawn >= 25:
                    break
                page.wait_for_timeout(250)
            assert drawn >= 25, f"{selector}: {drawn} pixels of {ink}"


def test_the_bode_plot_states_what_it_compares_and_x_differs_from_y_in_grey(
    page: Page, serving: Serving, replayed: Replayed
) -> None:
    _opened(page, serving, replayed, 20.0)
    legend = page.locator("#bode .legend")
    expect(legend).to_contain_text("steady response, model")
    expect(legend).to_contain_text("phase wrapped to ±180°, lead positive")
    assert page.locator("#bode figcaption").evaluate("e => e.scrollWidth <= e.clientWidth")
    drawn = page.evaluate(
        """() => Object.values(page.bode.figures).map(figure => [figure.left[0].axis_label, figure.renderers
        .map(({ glyph }) => [glyph.type, glyph.marker?.value ?? "", JSON.stringify(glyph.line_dash?.value ?? [])])])"""
    )
    assert [label for label, _ in drawn] == ["mm (0–peak)", "phase, °"]
    for _, glyphs in drawn:
        lines, dots = ([g for g in glyphs if g[0] == kind] for kind in ("Line", "Scatter"))
        assert (len(lines), len(dots)) == (4, 2)
        x, ramp_x, y, ramp_y = (line[2] for line in lines)
        assert x != y, "one dashed"
        assert (ramp_x, ramp_y) == (x, y), "the ramp's as the steady response's"
        assert dots[0][1] != dots[1][1], "one hollow triangles"


def test_seek_shows_another_instant(page: Page, serving: Serving, replayed: Replayed) -> None:
    _opened(page, serving, replayed, 20.0)
    before = page.locator("#strip-theta3 b").inner_text()
    page.locator("#seek").evaluate("e => { e.value = 1.5; e.dispatchEvent(new Event('input')); }")
    expect(page.locator("#position")).to_have_text(re.compile(r"^1\.5 s of"), timeout=WAIT_MS)
    expect(page.locator("#dial .legend")).to_contain_text("locked")
    assert replayed.transport.at() == 1.5
    assert page.locator("#strip-theta3 b").inner_text() != before
    assert float(page.locator("#strip-theta4 b").inner_text().split()[0]) == pytest.approx(180, abs=2)


def test_play_pause_and_speed(page: Page, serving: Serving, replayed: Replayed) -> None:
    _opened(page, serving, replayed, 5.0)
    page.select_option("#speed", "16")
    page.click("#play")
    expect(page.locator("#position")).to_have_text(re.compile(r"^(1[5-9]|[23]\d)\.\d s of"), timeout=WAIT_MS)
    assert replayed.transport.speed == 16
    replayed.transport.set_speed(0.1)  # at 16 the end may come before the click
    replayed.transport.seek(10.0)
    expect(page.locator("#position")).to_have_text(re.compile(r"^10\.\d s of"), timeout=WAIT_MS)
    expect(page.locator("#play")).to_have_text("pause", timeout=WAIT_MS)
    page.click("#play")
    expect(page.locator("#play")).to_have_text("play", timeout=WAIT_MS)
    assert not replayed.transport.playing


def test_zoom_and_a_narrower_window_ask_again(page: Page, serving: Serving, replayed: Replayed) -> None:
    _opened(page, serving, replayed, 20.0)
    how = page.locator("#strip-x .how")
    expect(how).to_contain_text("min–max of")
    wide = how.inner_text()
    page.set_viewport_size({"width": 1200, "height": 900})
    expect(how).not_to_have_text(wide, timeout=WAIT_MS)
    assert "min–max of" in how.inner_text()
    page.select_option("#window", "0.5")
    expect(page.locator("#strip-theta3 .how")).to_have_text("samples", timeout=WAIT_MS)
    page.select_option("#window", "60")
    expect(page.locator("#strip-theta3 .how")).to_contain_text("min–max of", timeout=WAIT_MS)


def test_what_is_old_is_marked_within_a_second(
    page: Page, serving: Serving, replayed: Replayed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The shortest of some attempts counts: a busy machine keeps server and browser waiting."""
    _opened(page, serving, replayed, 20.0)
    marked_s: list[float] = []
    while len(marked_s) < STALE_ATTEMPTS and not any(passed < 1 for passed in marked_s):
        expect(page.locator(".stale")).to_have_count(0, timeout=WAIT_MS)
        began = time.monotonic()
        monkeypatch.setattr(replayed, "heard_s", lambda: replayed.transport.at() + 0.7)
        expect(page.locator("#strip-x")).to_have_class(re.compile("stale"), timeout=WAIT_MS)
        expect(page.locator("#orbit")).to_have_class(re.compile("stale"), timeout=WAIT_MS)
        marked_s.append(time.monotonic() - began)
        monkeypatch.undo()
    assert min(marked_s) < 1, marked_s
    expect(page.locator(".stale")).to_have_count(0, timeout=WAIT_MS)


def test_a_server_that_is_gone_is_marked_within_a_second(page: Page, serving: Serving, replayed: Replayed) -> None:
    _opened(page, serving, replayed, 20.0)
    serving._server._server.should_exit = True
    serving._server._thread.join(10)
    expect(page.locator("#link")).to_have_class("stale", timeout=1500)
    expect(page.locator("#strip-y")).to_have_class(re.compile("stale"), timeout=1500)


@pytest.mark.parametrize("width", [360, pytest.param(800, marks=thorough), 1100])
def test_narrow_screens_need_no_sideways_scrolling(
    page: Page, serving: Serving, replayed: Replayed, width: int
) -> None:
    page.set_viewport_size({"width": width, "height": 800})
    _opened(page, serving, replayed, 20.0)
    page.wait_for_timeout(300)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert _share(_pixels(page, "#strip-x .plot"), X) >= 25


def test_everything_has_a_name_for_who_cannot_see_it(page: Page, serving: Serving, replayed: Replayed) -> None:
    _opened(page, serving, replayed, 20.0)
    unnamed = page.evaluate(
        """() => [...document.querySelectorAll("button, input, select, [role=img], [role=meter], section")]
        .filter(e => !(e.getAttribute("aria-label") || e.closest("label") || e.textContent.trim()
          || e.getAttribute("aria-labelledby"))).map(e => e.outerHTML.slice(0, 80))"""
    )
    assert unnamed == []
    expect(page.locator("#strip-x")).to_have_attribute(
        "aria-label", re.compile(r"x over time, now -?\d"), timeout=WAIT_MS
    )
    expect(page.locator("#dial")).to_have_attribute("aria-label", re.compile("θ3 .*predicted III"), timeout=WAIT_MS)


def test_a_replay_has_no_stop_button_and_the_keyboard_plays_it(
    page: Page, serving: Serving, replayed: Replayed
) -> None:
    _opened(page, serving, replayed, 5.0)
    expect(page.locator("#stop")).to_be_hidden()
    page.locator("body").press("Space")
    expect(page.locator("#play")).to_have_text("pause", timeout=WAIT_MS)
    assert replayed.transport.playing


def test_the_keyboard_reaches_the_controls_and_nothing_else(page: Page, serving: Serving, replayed: Replayed) -> None:
    _opened(page, serving, replayed, 20.0)
    page.wait_for_function("() => page.drawn > 3")
    reached: list[str] = []
    for _ in range(40):
        page.keyboard.press("Tab")
        reached.append(page.evaluate("document.activeElement.id || document.activeElement.tagName"))
    assert set(reached) == {"window", "zoom-in", "zoom-out", "hold", "OL", "play", "seek", "speed", "BODY"}
    for panel in ("#strip-x", "#orbit", "#dial", "#bode", "#tracked"):
        assert page.locator(panel).get_attribute("role") == "img"
        expect(page.locator(panel)).to_have_attribute("aria-label", re.compile(r"\w+"), timeout=WAIT_MS)


def test_the_wheel_over_a_chart_changes_the_window(page: Page, serving: Serving, replayed: Replayed) -> None:
    _opened(page, serving, replayed, 20.0)
    page.locator("#strip-y .plot").hover(force=True)
    page.mouse.wheel(0, 100)
    expect(page.locator("#window")).not_to_have_value("10")


@pytest.mark.parametrize(("touch", "least_px", "most_px"), [(True, 40, 48), (False, 24, 32)])
def test_what_a_finger_meets_is_large_and_what_a_mouse_meets_is_not(
    browser: Browser, serving: Serving, replayed: Replayed, touch: bool, least_px: float, most_px: float
) -> None:
    width, height = (390, 844) if touch else (1400, 900)
    page = browser.new_page(viewport={"width": width, "height": height}, is_mobile=touch, has_touch=touch)
    _opened(page, serving, replayed, 20.0)
    page.evaluate("document.body.dataset.rig = 'yes'")
    boxes = page.evaluate(  # at once: the next state hides again what a replay does not offer
        """() => {
        document.querySelectorAll("#test [data-verb], #note").forEach((e) => { e.hidden = false; });
        return [...document.querySelectorAll("button, select, input")].filter((e) => e.offsetParent)
        .map((e) => [e.id || e.textContent, e.getBoundingClientRect().width, e.getBoundingClientRect().height]); }"""
    )
    page.close()
    names = {name for name, *_ in boxes}
    assert {"stop", "window", "zoom-in", "zoom-out", "hold", "play", "seek", "abort"} <= names
    for name, wide, high in boxes:
        assert wide >= least_px, name
        assert high >= least_px, name
        assert high <= most_px or name == "stop"


def test_a_tab_that_slept_draws_again_at_once(page: Page, serving: Serving, replayed: Replayed) -> None:
    _opened(page, serving, replayed, 20.0)
    before = page.evaluate("() => { page.turned -= 3.6e6; page.drew = true; return page.drawn; }")
    page.wait_for_function("before => page.drawn > before + 3", arg=before, timeout=WAIT_MS)

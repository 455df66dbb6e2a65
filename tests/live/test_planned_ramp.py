"""The Bode plot shows what a planned ramp will look like before and while it is run."""

from __future__ import annotations

from multiprocessing import Pipe

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from daq.guided_tests.controls import Controls, GuidedTestStatus
from live.model import LiveModel
from live.planned import SpeedRamp, simulated_ramp
from live.serving import Serving
from live.session_page import Asking
from live.watched import Watched
from rig_basics.arrays import Array
from rig_configs import load_rig

TOP_RPM = 903.0
UP = {"test": "run-up", "numbers": {"top_rpm": TOP_RPM, "duration_s": 40.0}}


def _peaks(rows: Array) -> list[tuple[float, float]]:
    """(rpm, mm) of the largest x and y."""
    found = [np.abs(rows[:, k] + 1j * rows[:, k + 1]) for k in (1, 3)]
    return [(float(rows[amplitude.argmax(), 0]), float(amplitude.max())) for amplitude in found]


def test_a_ramp_passes_its_peaks_late_and_low_and_a_slow_one_is_steady() -> None:
    rig = load_rig("virtual")
    model = LiveModel(rig)
    rpm, x, y = model.bode()
    steady = _peaks(np.column_stack([rpm, x.real, x.imag, y.real, y.imag]))
    up, down, slow = (
        _peaks(simulated_ramp(rig, model, ramp))
        for ramp in (SpeedRamp(0, TOP_RPM, 40), SpeedRamp(TOP_RPM, 0, 40), SpeedRamp(0, TOP_RPM, 400))
    )
    for axis in range(2):
        assert down[axis][0] < steady[axis][0] < up[axis][0]
        assert max(up[axis][1], down[axis][1]) < steady[axis][1]
        assert up[axis][1] < slow[axis][1] < 1.01 * steady[axis][1]
        assert steady[axis][0] < slow[axis][0] < up[axis][0]


def test_far_from_the_resonances_a_ramp_is_the_steady_response_in_the_sensors_axes() -> None:
    """Of sensors that stand turned, too: size and phase of both."""
    rig = load_rig("virtual", settings=["devices.laser_x.direction_deg=30", "devices.laser_y.direction_deg=120"])
    model = LiveModel(rig)
    rows = simulated_ramp(rig, model, SpeedRamp(0, TOP_RPM, 200))
    rpm, x, y = model.bode()
    for first, steady in ((1, x), (3, y)):
        near = np.abs(rows[:, 0] - 450) < 20
        found = rows[near, first] + 1j * rows[near, first + 1]
        wanted = np.interp(rows[near, 0], rpm, steady.real) + 1j * np.interp(rows[near, 0], rpm, steady.imag)
        np.testing.assert_allclose(found, wanted, rtol=0.05)


@pytest.mark.parametrize(
    ("facts", "wanted"),
    [
        (UP, SpeedRamp(0.0, TOP_RPM, 40.0)),
        ({**UP, "test": "run-down"}, SpeedRamp(TOP_RPM, 0.0, 40.0)),
        ({**UP, "test": "point-A"}, None),
        ({"test": "run-up", "numbers": {}}, None),
        ({"test": "run-up", "numbers": {"top_rpm": TOP_RPM, "duration_s": 1e5}}, None),
        ({}, None),
    ],
)
def test_a_ramp_is_known_by_the_tests_numbers(facts: dict[str, object], wanted: SpeedRamp | None) -> None:
    assert SpeedRamp.of(facts) == wanted


def test_the_page_receives_the_numbers_of_the_test_that_runs() -> None:
    controls = Controls()
    controls.status = GuidedTestStatus("run-up", "ramp", numbers={"top_rpm": TOP_RPM, "duration_s": 40.0})
    assert SpeedRamp.of(Asking(controls).facts()) == SpeedRamp(0.0, TOP_RPM, 40.0)


def test_the_bode_plot_draws_the_ramp_of_the_test_and_no_other(page: Page) -> None:
    ours, theirs = Pipe()
    with ours, theirs:
        watched = Watched(load_rig("virtual"), theirs, "virtual")
        handed = {"heard_ns": 10**18, "rows": [], "events": []}
        with Serving(watched, LiveModel(watched.signals.rig)) as serving:
            page.goto(serving.url)
            legend = page.locator("#bode .ramp")
            expect(legend).to_be_hidden()
            watched._take({**handed, "facts": UP})
            expect(legend).to_be_visible(timeout=30_000)
            drawn = page.evaluate("['x', 'y'].map((axis) => Math.max(...page.bode.planned[axis][0].data.y))")
            assert drawn == pytest.approx([4.33, 7.86], abs=0.02)
            watched._take({**handed, "facts": {"test": "point-A", "numbers": {}}})
            expect(legend).to_be_hidden(timeout=30_000)
            assert page.evaluate("page.bode.planned.x[0].data.x.length") == 0

"""A report shows its run-up, measured and simulated."""

from __future__ import annotations

import dataclasses

from analysis.report import Campaign, IdentificationResult, render
from daq.signals.run import Run
from tests.figures.figure_runs import MODEL, RIG, point, run_up


def reported(*runs: Run) -> str:
    assert MODEL.identified is not None
    found = IdentificationResult(MODEL.identified, [], [], [], [])
    return render(Campaign(title="Campaign", rig=RIG, runs=runs, identification=found, validation=None))


def test_a_run_up_is_drawn_once_with_the_model() -> None:
    first = run_up()
    text = reported(first, dataclasses.replace(first, source="again.mcap"), point("D"))
    assert text.count('<section id="run-up">') == 1
    section = text[text.index('<section id="run-up">') :]
    section = section[: section.index("</section>")]
    assert 'aria-label="Run-up: Bode plot, measured and simulated"' in section
    assert "same run simulated, identified parameters" in section
    assert "again.mcap" not in section


def test_what_is_no_run_up_is_left_out() -> None:
    standing = dataclasses.replace(point("D"), test="run-up")  # called one, and stays at one speed
    text = reported(standing)
    assert '<section id="run-up">' not in text
    assert "What was run" in text

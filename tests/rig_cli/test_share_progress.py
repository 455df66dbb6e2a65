"""Progress: rate and time left, and how far the work was when it is stopped."""

from __future__ import annotations

import pytest

from rig_cli import console
from rig_cli.share_progress import Pace, share_progress


@pytest.mark.parametrize(
    ("share", "elapsed_s", "count", "words"),
    [
        (0.0, 1.0, None, ""),
        (0.25, 5.0, None, "5 %/s, 15 s left"),
        (0.25, 5.0, 400, "20 points/s, 15 s left"),
        (0.5, 2.0, 1_000_000, "250\u202f000 points/s, 2 s left"),
        (0.01, 60.0, None, "0.0167 %/s, 1 h 39 min left"),
        (0.5, 300.0, 300, "0.5 points/s, 5 min left"),
        (1.0, 4.0, 400, "100 points/s"),
    ],
)
def test_rate_and_time_left_of_steady_work(share: float, elapsed_s: float, count: float | None, words: str) -> None:
    pace = Pace(count, "points")
    for part in range(1, 10):
        pace.words(0.1 * part * share, 0.1 * part * elapsed_s)
    assert pace.words(share, elapsed_s) == words


def test_after_the_first_step_the_time_left_is_not_guessed() -> None:
    assert Pace(None, "").words(0.1, 10.0) == "1 %/s"


def test_a_first_step_that_compiles_gives_no_time_until_the_rate_is_steady() -> None:
    """One of 20 steps takes 30 s, the others 1 s. By the mean rate 10 min were left after the first."""
    pace = Pace(None, "")
    words = [pace.words(step / 20, 29.0 + step) for step in range(1, 20)]
    assert [step for step, text in enumerate(words, 1) if "left" in text] == []
    assert words[-1] == "1.98 %/s"


@pytest.mark.parametrize(("slower", "shown"), [(1.0, True), (1.4, True), (2.5, False)])
def test_work_that_becomes_slower_gives_no_time(slower: float, shown: bool) -> None:
    """Five steps of a second each are followed by four that take longer."""
    pace = Pace(None, "")
    times = [float(step) for step in range(1, 6)] + [5 + slower * step for step in range(1, 5)]
    words = [pace.words(0.05 * step, now) for step, now in enumerate(times, 1)]
    assert ("left" in words[-1]) is shown


def test_the_share_done_before_does_not_count() -> None:
    pace = Pace(10, "tiles", before=0.5)
    pace.words(0.6, 1.0)
    assert pace.words(0.7, 2.0) == "1 tiles/s, 3 s left"


def test_without_a_terminal_a_line_states_rate_and_time_left(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [100.0]
    monkeypatch.setattr("rig_cli.share_progress.time.monotonic", lambda: now[0])
    with share_progress("80 points", 80, "points") as answer:
        for share in (0.1, 0.3, 0.5):
            now[0] += 6.0
            answer(share)
    assert capsys.readouterr().err == "80 points: 30 %, 2 points/s, 28 s left\n"


def test_stopped_work_states_how_far_it_was(capsys: pytest.CaptureFixture[str]) -> None:
    def stopped() -> None:
        with share_progress("80 points") as answer:
            answer(0.42)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert capsys.readouterr().err == "stopped: 80 points, 42 % done\n"


def test_a_terminal_shows_the_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = console.Console(force_terminal=True, width=160, record=True)
    monkeypatch.setattr(console, "STDERR", terminal)
    with share_progress("80 points", 80, "points") as answer:
        answer(0.5)
        terminal.print("a line")
    assert "points/s" in terminal.export_text()

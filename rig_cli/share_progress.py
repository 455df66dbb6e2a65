"""Progress of work with a known completed share: rate and time left, updated in place on a terminal."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from rig_cli import console

_EVERY_S = 10.0


@contextmanager
def share_progress(
    text: str, count: float | None = None, unit: str = "", before: float = 0.0
) -> Generator[Callable[[float], None]]:
    """Yield a function that shows the completed share, 0 … 1: a bar on a terminal, else a line every ten seconds.

    Ctrl-C prints the share that was completed.

    Args:
        text: the work.
        count, unit: total amount of work and its unit; None: the rate is shown in percent.
        before: share that is completed at the start.
    """
    live = console.STDERR.is_terminal
    bar = Progress(
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=32),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[pace]}", markup=False),
        console=console.STDERR,
        disable=not live,
        transient=True,
    )
    began = last = time.monotonic()
    reached = 0.0

    def pace(share: float, now: float) -> str:
        return pace_words(share, now - began, count, unit, before)

    def progress(share: float) -> None:
        nonlocal last, reached
        reached, now = share, time.monotonic()
        if live:
            bar.update(task, completed=share, pace=pace(share, now))
        elif now - last > _EVERY_S:
            last = now
            console.notify(
                f"{text}: {100 * share:.0f} %{_after_comma(pace_words(share, now - began, count, unit, before))}"
            )

    try:
        with bar:
            task = bar.add_task(console.harmless(text), total=1.0, pace="")
            yield progress
    except KeyboardInterrupt:
        console.notify(f"stopped: {text}, {100 * reached:.0f} % done")
        raise


def pace_words(share: float, elapsed_s: float, count: float | None, unit: str, before: float = 0.0) -> str:
    """Return mean rate since the start and time left; empty before any progress.

    Args:
        before: share that was completed at the start.
    """
    if not before < share <= 1 or elapsed_s <= 0:
        return ""
    rate = (share - before) / elapsed_s
    words = f"{_short(100 * rate)} %/s" if count is None else f"{_short(count * rate)} {unit}/s"
    return f"{words}, {_duration((1 - share) / rate)} left" if share < 1 else words


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def _short(number: float) -> str:
    """Return three digits, with a space between thousands."""
    return f"{number:.3g}" if number < 1000 else f"{float(f'{number:.3g}'):,.0f}".replace(",", "\u202f")


def _after_comma(words: str) -> str:
    return f", {words}" if words else ""
